"""The command `modsim3d ais`: a scene from real traffic."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from modsim3d.cli import shared
from modsim3d.cli.shared import argument, flag, option
from modsim3d.cli.terminal import open_console, tell_files, timed, warn
from modsim3d.cli.terminal_tables import print_table

if TYPE_CHECKING:
    from modsim3d.scene.ais.traffic import AisTraffic


BY_TYPE = "type"  # what `--label` takes in place of the label of a group


# More than fifty lines, because each option stands in the signature, where the command line finds it.
def ais_command(
    context: typer.Context,
    files: Annotated[list[Path], argument("FILE...", "AIS logs, CSV or NMEA, gzipped or not.")],
    out: Annotated[Path, option("DIR", "Scene folder to write.")],
    origin: Annotated[
        str | None, option("LAT,LON", "Origin of the scene's coordinates, in degrees.", show_default="median position")
    ] = None,
    region: Annotated[
        str | None, option("LAT1,LON1,LAT2,LON2", "Keep only positions between these two corners.")
    ] = None,
    start: Annotated[str | None, option("TIME", "Time of the first step, in UTC.", show_default="first report")] = None,
    end: Annotated[
        str | None,
        option("TIME", "Time of the last step, in UTC, or +SECONDS from the first.", show_default="last report"),
    ] = None,
    time_step: Annotated[float, option("SECONDS", "Time between steps.")] = 1.0,
    gap: Annotated[float, option("SECONDS", "Time between reports beyond which a vessel is absent.")] = 400.0,
    max_speed: Annotated[
        float, option("KNOTS", "Drop a position that a vessel can reach only at a higher speed.")
    ] = 60.0,
    swap_coordinates: Annotated[
        bool, flag("--swap-coordinates", "Exchange latitude and longitude, for CSV files that have them swapped.")
    ] = False,
    label: Annotated[
        list[str] | None,
        option(
            "type|GROUP=LABEL",
            "Label of one group of ship types, or type for a label of each; repeatable.",
            show_default="Vessel for all",
        ),
    ] = None,
    detector: Annotated[
        Path | None, option("FILE", "Detector file or shipped name of the scene.", show_default="vessel")
    ] = None,
    overwrite: shared.OverwriteOption = False,
    quiet: shared.QuietOption = False,
    verbose: shared.VerboseOption = False,
) -> None:
    """Make a scene folder from real traffic: AIS of Denmark, MarineCadastre or a receiver.

    Example: modsim3d ais aisdk-2024-01-04.csv --region 55.6,12.6,55.8,12.9 --end +600 --out scenes/sound
    """
    from modsim3d.detector.file.reading import find_detector, load_detector
    from modsim3d.io import overwrite_guard
    from modsim3d.io.overwrite_guard import locked_folder
    from modsim3d.scene.ais import options as given
    from modsim3d.scene.ais.scene_folder import FILES, check_free, write_scene
    from modsim3d.scene.ais.traffic import read_traffic
    from modsim3d.view.pages.ais_page import ais_page

    labels, found = label or [], find_detector(detector or "vessel")
    options = given.Options(
        origin=given.parse_origin(origin) if origin else None,
        region=given.parse_region(region) if region else None,
        start_s=given.parse_time(start, "--start") if start else None,
        **given.parse_end(end),
        time_step_s=time_step,
        max_gap_s=gap,
        max_speed_kn=max_speed,
        swap_coordinates=swap_coordinates,
        labels_by_type=BY_TYPE in labels,
        labels=given.parse_labels(text for text in labels if text != BY_TYPE),
        detector_labels=load_detector(found).labels,
    )
    check_free(out, overwrite)
    with locked_folder(out):
        read = [file for file in files if not file.is_dir()]  # folders are refused when they are read
        for name in FILES:
            overwrite_guard.check_free(out / name, overwrite, [*read, found])
        with timed("reading"):
            traffic = read_traffic(files, options)
        tell_files([*read, found])
        with timed("writing"):
            write_scene(traffic, out, found, overwrite, ais_page(traffic, shared.typed_command(context)))
    _print_summary(traffic, out)


def _print_summary(traffic: AisTraffic, folder: Path) -> None:
    from modsim3d.scene.ais.scene_folder import PAGE, summary_rows, warning

    console = open_console()
    if text := warning(traffic):
        warn(text)
    for title, rows in summary_rows(traffic):
        print_table(console, title, rows)
    shared.print_line(console, "")
    shared.print_path(console, "scene folder", folder)
    shared.print_path(console, "page", folder / PAGE)
    shared.print_line(console, f"run it with   modsim3d run {folder}")
