"""The commands `modsim3d track` and `score`: a tracker over the detections of a run, and how well it did."""

from __future__ import annotations

import shlex
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from modsim3d.cli import detect, shared
from modsim3d.cli.shared import argument, option
from modsim3d.cli.terminal import open_console, say_json, tell, tell_files, timed
from modsim3d.cli.terminal_tables import print_document, print_prose, print_table
from modsim3d.core.errors import ModsimError

if TYPE_CHECKING:
    from modsim3d.tracking.track_run import TrackCounts, TrackResult

_EXAMPLE = "lost_s=2.5"
MAX_TIMEOUT_S = 86_400
HEADER = ("camera", "frames", "detections", "tracks", "boxes", "median track")


def track_command(
    out: Annotated[Path, option("DIR", "Folder for the tracks and tracks.json.")],
    run: Annotated[Path | None, argument("[RUN]", "Run directory of a finished run.")] = None,
    truth: detect.TruthOption = None,
    detections: detect.DetectionsOption = None,
    labels: detect.LabelsOption = None,
    image_size: detect.ImageSizeOption = None,
    frame_rate: detect.FrameRateOption = None,
    first_frame: detect.FirstFrameOption = None,
    tracker: Annotated[
        str | None,
        option(
            "NAME",
            "Tracker: reference, sort, bytetrack, ocsort, stonesoup_gnn, stonesoup_jpda, world_gnn, world_jpda, or "
            "one of a plug-in.",
            autocompletion=shared.complete_tracker,
            show_default="reference",
        ),
    ] = None,
    command: Annotated[
        str | None, option("PROGRAM", "Program that is the tracker, with its arguments (docs/tracker_command.md).")
    ] = None,
    timeout: Annotated[
        float | None, option("SECONDS", "Time that the program has for each answer.", show_default="30 s")
    ] = None,
    settings: Annotated[
        list[str] | None, option("KEY=VALUE", "Set a setting of the tracker, in place of the chosen one.", "--set")
    ] = None,
    overwrite: shared.OverwriteOption = False,
) -> None:
    """Run a tracker over a run's detections, and write its tracks, in the images or in the world.

    Example: modsim3d track runs/first --tracker reference --out tracks/reference
    """
    from modsim3d.scene.settings import read_settings
    from modsim3d.tracking.track_run import track_run

    given = read_settings(settings or (), _EXAMPLE)
    if truth is not None and detections is None:
        raise ModsimError("--truth needs --detections: what a real detector found, for the tracker to work on")
    files = {"image_size": image_size, "frame_rate": frame_rate, "first_frame": first_frame, "labels": labels}
    with detect.opened(run, truth, detections, **files) as stored:
        frames = None if stored.stored is None else stored.settings["counts"]["frames"]
        chosen = _track_arguments(tracker, command, timeout)
        with timed("tracks and files"), shared.progress(tracker or command or "reference", frames) as advance:
            result = track_run(stored, out, settings=given, overwrite=overwrite, progress=advance, **chosen)
    tell("tracker", ", ".join(f"{name} {version}" for name, version in result.origin.versions.items()))
    written = list(result.written)
    typed = {"truth": truth, "detections": detections, **files}
    options = [f"--{name.replace('_', '-')} {shlex.quote(str(value))}" for name, value in typed.items() if value]
    _print_result(result, shlex.quote(str(run)) if run else " ".join(options), written)
    say_json(track_json(result, stored.scene.name, written))


def _track_arguments(tracker: str | None, command: str | None, timeout: float | None) -> dict[str, Any]:
    """The arguments of `track_run` for a tracker or a program. Raises ModsimError if both are given, or what is for a
    program is given without one."""
    if command is None:
        if timeout is not None:
            raise ModsimError("--timeout is for --command: leave it out")
        return {"tracker": tracker or "reference"}
    if tracker is not None:
        raise ModsimError("--tracker and --command each name a tracker: leave one out")
    if timeout is not None and not 0 < timeout <= MAX_TIMEOUT_S:
        raise ModsimError(f"--timeout: needs seconds above 0, at most {MAX_TIMEOUT_S:,} (got {timeout:g})")
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise ModsimError(f"--command: is no command of a shell: {error}") from None
    return {"command": words, **({} if timeout is None else {"timeout_s": timeout})}


def track_json(result: TrackResult, scene: str, written: list[Path]) -> dict[str, Any]:
    """The result as `--json` prints it."""
    counts = {name: vars(numbers) for name, numbers in result.camera_counts.items()}
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
        "frame_ms": result.frame_ms,
        "written": written,
    }


def _print_result(result: TrackResult, run: str, written: list[Path]) -> None:
    console = open_console()
    print_prose(console, f"{result.name}: {result.origin.package}; settings: {result.origin.chosen}")
    rows = [_cells(name, counts) for name, counts in (result.camera_counts or {"all": result.counts}).items()]
    print_table(console, "tracks", rows, header=HEADER, right=range(1, len(HEADER)))
    if result.frame_ms:
        times = ", ".join(f"{name} {value:.3g}" for name, value in result.frame_ms.items())
        shared.print_line(console, f"ms a frame: {times}", "dim")
    shared.print_written(console, written)
    shared.print_line(console, f"\nnext\n  modsim3d score {run} {shlex.quote(str(result.folder))}")


def _cells(name: str, counts: TrackCounts) -> tuple[str, ...]:
    numbers = (counts.frames, counts.detections, counts.tracks, counts.boxes)
    median = "-" if counts.median_track_s is None else f"{counts.median_track_s:.1f} s"
    return (name, *(f"{number:,}" for number in numbers), median)


# ---- Scores ----


def score_command(
    context: typer.Context,
    run: Annotated[Path | None, argument("[RUN]", "Run directory of a finished run; not with --truth.")] = None,
    tracks: Annotated[
        list[Path] | None, argument("TRACKS", "Folders that `modsim3d track` wrote, or files of your own tracker.")
    ] = None,
    truth: detect.TruthOption = None,
    detections: detect.DetectionsOption = None,
    labels: detect.LabelsOption = None,
    image_size: detect.ImageSizeOption = None,
    frame_rate: detect.FrameRateOption = None,
    first_frame: detect.FirstFrameOption = None,
    vessels: Annotated[
        Literal["annotated", "full"],
        typer.Option(
            help="Vessels that count: annotated, as the detector was given, or full, all in the image with whole boxes."
        ),
    ] = "annotated",
    similarity: shared.SimilarityOption = None,
    threshold: Annotated[float, option("S", "Least similarity at which a track follows a vessel.")] = 0.5,
    gap_s: Annotated[
        float, option("SECONDS", "Time outside the image after which a vessel is a new one.", "--gap")
    ] = 2.0,
    by: Annotated[Literal["class"] | None, option("KEY", "Key to tell apart too: class.")] = None,
    gospa: Annotated[
        str | None,
        option(
            "C[:P[:G]]",
            "Cutoff of GOSPA, its power, and what a switch costs T-GOSPA in the world.",
            show_default="100 px, in the world 50 m; power 1; G as C",
        ),
    ] = None,
    gate_m: Annotated[
        float | None, option("M", "Farthest that a track in the world follows a vessel.", "--gate", show_default="50 m")
    ] = None,
    cameras: Annotated[
        list[str] | None, option("NAME", "Camera to score; repeatable.", "--camera", show_default="all")
    ] = None,
    seeds: Annotated[
        int | None, option("N", "Run detector, tracker and scores again with N seeds of the detector.")
    ] = None,
    out: Annotated[Path | None, option("DIR", "Folder for score.json and score.html.", show_default="none")] = None,
    overwrite: shared.OverwriteOption = False,
) -> None:
    """Score tracks against what was true, and beside them the same detections with perfect association.

    Example: modsim3d score runs/first runs/tracks
    """
    from modsim3d.io.overwrite_guard import claimed
    from modsim3d.runs.files.overwrite import read_of_run
    from modsim3d.tracking.score_outcome import score_data
    from modsim3d.tracking.score_page import FILES, document, write_scores
    from modsim3d.tracking.score_run import score_run
    from modsim3d.tracks.tracks import Similarity

    if truth is not None and run is not None:
        tracks, run = [run, *(tracks or ())], None
    if not tracks:
        raise ModsimError("give TRACKS: folders that `modsim3d track` wrote, or files of your own tracker")
    paths = [] if out is None else [out / file for file in FILES]
    given = shared.arguments(context, score_run, truth=vessels, by_class=by is not None)
    compared = Similarity.parse(similarity, threshold)
    given |= {"similarity": compared.name, "scale_px": compared.scale_px} | parse_gospa(gospa)
    with (
        detect.opened(
            run, truth, detections, image_size=image_size, frame_rate=frame_rate, first_frame=first_frame, labels=labels
        ) as stored,
        claimed(paths, overwrite=overwrite, inputs=[*read_of_run(stored.folder), *tracks]),
    ):
        tell_files(tracks)
        with timed("scores"), shared.progress("seeds", seeds) if seeds else nullcontext(lambda done: None) as advance:
            scores = score_run(**given | {"run": stored, "tracks": tracks}, progress=advance)
        if out is not None:
            with timed("files"):
                write_scores(scores, out, shared.typed_command(context))
        console = open_console()
        print_document(console, document(scores))
        shared.print_written(console, paths)
        say_json({"command": "score", **score_data(scores), "written": paths})


def parse_gospa(text: str | None) -> dict[str, float]:
    """Cutoff of GOSPA, its power, and the cost of a switch, those that are given in a text such as `70`, `70:2` or
    `70:2:30`. Raises ModsimError if it is no such text."""
    given = text.split(":") if text is not None else []
    names = ("gospa_c", "gospa_p", "gospa_switch")
    try:
        return dict(zip(names, map(float, given), strict=len(given) > 3))
    except ValueError:
        raise ModsimError(f"--gospa {text}: needs a cutoff, its power as in 70:2, and G as in 70:2:30") from None
