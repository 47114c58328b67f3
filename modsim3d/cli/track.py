"""The command `modsim3d track`: a tracker over the detections of a run."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from modsim3d.cli import detect, shared
from modsim3d.cli.shared import argument, option
from modsim3d.cli.terminal import open_console, say_json, tell, timed
from modsim3d.cli.terminal_tables import print_prose, print_table
from modsim3d.core.errors import ModsimError

if TYPE_CHECKING:
    from modsim3d.tracking.track_run import TrackCounts, TrackResult

_EXAMPLE = "lost_s=2.5"
HEADER = ("camera", "frames", "detections", "tracks", "boxes", "median track")


def track_command(
    out: Annotated[Path, option("DIR", "Folder for tracks.parquet and tracks.json.")],
    run: Annotated[Path | None, argument("[RUN]", "Run directory of a finished run.")] = None,
    truth: detect.TruthOption = None,
    detections: detect.DetectionsOption = None,
    labels: detect.LabelsOption = None,
    image_size: detect.ImageSizeOption = None,
    frame_rate: detect.FrameRateOption = None,
    first_frame: detect.FirstFrameOption = None,
    tracker: Annotated[
        str,
        option(
            "NAME",
            "Tracker: reference, sort, bytetrack, ocsort, stonesoup_gnn, stonesoup_jpda, or one of a plug-in.",
            autocompletion=shared.complete_tracker,
        ),
    ] = "reference",
    settings: Annotated[
        list[str] | None, option("KEY=VALUE", "Set a setting of the tracker, in place of the chosen one.", "--set")
    ] = None,
    overwrite: shared.OverwriteOption = False,
    quiet: shared.QuietOption = False,
    verbose: shared.VerboseOption = False,
    json: shared.JsonOption = False,
) -> None:
    """Run a tracker over a run's detections, each camera by itself, and write its tracks.

    Example: modsim3d track runs/first --tracker reference --out tracks/reference
    """
    from modsim3d.scene.settings import read_settings
    from modsim3d.tracking.track_run import track_run
    from modsim3d.tracks.reading import track_paths

    given = read_settings(settings or (), _EXAMPLE)
    if truth is not None and detections is None:
        raise ModsimError("--truth needs --detections: what a real detector found, for the tracker to work on")
    files = {"image_size": image_size, "frame_rate": frame_rate, "first_frame": first_frame, "labels": labels}
    with detect.opened(run, truth, detections, **files) as stored:
        frames = None if stored.stored is None else stored.settings["counts"]["frames"]
        with timed("tracks and files"), shared.progress(tracker, frames) as advance:
            result = track_run(stored, out, tracker=tracker, settings=given, overwrite=overwrite, progress=advance)
    tell("tracker", ", ".join(f"{name} {version}" for name, version in result.origin.versions.items()))
    written = track_paths(out)
    typed = {"truth": truth, "detections": detections, **files}
    options = [f"--{name.replace('_', '-')} {shlex.quote(str(value))}" for name, value in typed.items() if value]
    _print_result(result, shlex.quote(str(run)) if run else " ".join(options), written)
    say_json(track_json(result, stored.scene.name, written))


def track_json(result: TrackResult, scene: str, written: list[Path]) -> dict[str, Any]:
    """The result as `--json` prints it."""
    counts = {name: vars(each) for name, each in result.camera_counts.items()}
    return {
        "format": 1,
        "command": "track",
        "scene": scene,
        "folder": result.folder,
        "name": result.name,
        **vars(result.origin),
        "counts": vars(result.counts),
        "camera_counts": counts,
        "seconds": result.seconds,
        "written": written,
    }


def _print_result(result: TrackResult, run: str, written: list[Path]) -> None:
    console = open_console()
    print_prose(console, f"{result.name}: {result.origin.package}; settings: {result.origin.chosen}")
    rows = [_cells(name, counts) for name, counts in result.camera_counts.items()]
    print_table(console, "tracks", rows, header=HEADER, right=range(1, len(HEADER)))
    shared.print_written(console, written)
    shared.print_line(console, f"\nnext\n  modsim3d score {run} {shlex.quote(str(result.folder))}")


def _cells(name: str, counts: TrackCounts) -> tuple[str, ...]:
    numbers = (counts.frames, counts.detections, counts.tracks, counts.boxes)
    median = "-" if counts.median_track_s is None else f"{counts.median_track_s:.1f} s"
    return (name, *(f"{number:,}" for number in numbers), median)
