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
    time_step_s: Annotated[float, option("SECONDS", "Time between steps.", "--time-step")] = 1.0,
    max_gap_s: Annotated[
        float, option("SECONDS", "Time between reports beyond which a vessel is absent.", "--report-gap")
    ] = 400.0,
    max_speed_kn: Annotated[
        float, option("KNOTS", "Drop a position that a vessel can reach only at a higher speed.", "--max-speed")
    ] = 60.0,
    swap_coordinates: Annotated[
        bool, flag("--swap-coordinates", "Exchange latitude and longitude, for CSV files that have them swapped.")
    ] = False,
    labels: Annotated[
        list[str] | None,
        option(
            "type|GROUP=LABEL",
            "Label of one group of ship types, or type for a label of each; repeatable.",
            "--label",
            show_default="Vessel for all",
        ),
    ] = None,
    detector: Annotated[
        Path | None, option("FILE", "Detector file or shipped name of the scene.", show_default="vessel")
    ] = None,
    overwrite: shared.OverwriteOption = False,
) -> None:
    """Make a scene folder from real traffic: AIS of Denmark, MarineCadastre or a receiver.

    Example: modsim3d ais aisdk-2024-01-04.csv --region 55.6,12.6,55.8,12.9 --end +600 --out scenes/sound
    """
    from modsim3d.detector.file.reading import find_detector
    from modsim3d.view.pages.ais_page import ais

    with timed("reading and writing"):
        made = ais(**shared.arguments(context, ais, call=shared.typed_command(context)))
    tell_files([*(file for file in files if not file.is_dir()), find_detector(detector or "vessel")])
    _print_summary(made.traffic, made.path)


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
