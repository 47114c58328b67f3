"""The command `modsim3d score`: how well tracks follow the vessels of a run, and where they fail."""

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Literal

import typer

from modsim3d.cli import detect, shared
from modsim3d.cli.shared import argument, flag, option
from modsim3d.cli.terminal import open_console, say_json, tell_files, timed
from modsim3d.cli.terminal_tables import print_document
from modsim3d.core.errors import ModsimError


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
    gap: Annotated[float, option("SECONDS", "After so long outside the image a vessel is a new one.")] = 2.0,
    by_class: Annotated[bool, flag("--by-class", "Score each class by itself too.")] = False,
    gospa: Annotated[
        str | None,
        option("C[:P]", "Cutoff of GOSPA, and its power.", show_default="100 px, in the world 50 m; power 1"),
    ] = None,
    gate: Annotated[
        float | None, option("M", "Farthest that a track in the world follows a vessel.", show_default="50 m")
    ] = None,
    camera: Annotated[list[str] | None, option("NAME", "Camera to score; repeatable.", show_default="all")] = None,
    seeds: Annotated[
        int | None, option("N", "Run detector, tracker and scores again with N seeds of the detector.")
    ] = None,
    out: Annotated[Path | None, option("DIR", "Folder for score.json and score.html.", show_default="none")] = None,
    overwrite: shared.OverwriteOption = False,
    quiet: shared.QuietOption = False,
    verbose: shared.VerboseOption = False,
    json: shared.JsonOption = False,
) -> None:
    """Score tracks against what was true, and beside them the same detections with perfect association.

    Example: modsim3d score runs/first runs/tracks
    """
    from modsim3d.io.overwrite_guard import claimed
    from modsim3d.runs.files.overwrite import read_of_run
    from modsim3d.tracking.score_outcome import score_data
    from modsim3d.tracking.score_page import FILES, document, write_scores
    from modsim3d.tracking.score_run import score_run

    if truth is not None and run is not None:
        tracks, run = [run, *(tracks or ())], None
    if not tracks:
        raise ModsimError("give TRACKS: folders that `modsim3d track` wrote, or files of your own tracker")
    paths = [] if out is None else [out / file for file in FILES]
    name, scale_px = shared.parse_similarity(similarity)
    cutoff, power = parse_gospa(gospa)
    with (
        detect.opened(
            run, truth, detections, image_size=image_size, frame_rate=frame_rate, first_frame=first_frame, labels=labels
        ) as stored,
        claimed(paths, overwrite=overwrite, inputs=[*read_of_run(stored.folder), *tracks]),
    ):
        tell_files(tracks)
        with timed("scores"), shared.progress("seeds", seeds) if seeds else nullcontext(lambda done: None) as advance:
            scores = score_run(
                stored,
                tracks,
                truth=vessels,
                similarity=name,
                scale_px=scale_px,
                threshold=threshold,
                gap_s=gap,
                by_class=by_class,
                gospa_c=cutoff,
                gospa_p=power,
                gate_m=gate,
                cameras=camera,
                seeds=seeds,
                progress=advance,
            )
        if out is not None:
            with timed("files"):
                write_scores(scores, out, shared.typed_command(context))
        console = open_console()
        print_document(console, document(scores))
        shared.print_written(console, paths)
        say_json({"command": "score", **score_data(scores), "written": paths})


def parse_gospa(text: str | None) -> tuple[float | None, float]:
    """Cutoff of GOSPA, None for the usual one, and its power, from a text such as `70` or `70:2`. Raises ModsimError if
    it is no such text."""
    if text is None:
        return None, 1.0
    cutoff, colon, power = text.partition(":")
    try:
        return float(cutoff), float(power) if colon else 1.0
    except ValueError:
        raise ModsimError(f"--gospa {text}: needs a cutoff, and its power as in 70:2") from None
