"""The options of the commands that show a run with tracks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from modsim3d.runs.stored_run import StoredRun
    from modsim3d.view.followed_tracks import FollowedTracks

TracksOption = Annotated[
    Path | None,
    typer.Option(
        "--tracks",
        metavar="TRACKS",
        help="Show the tracks of a tracker: a folder of modsim3d track, a .csv file, or MOT (docs/track_files.md).",
    ),
]
SimilarityOption = Annotated[
    Literal["iou", "centre"] | None,
    typer.Option(
        help="How boxes of --tracks and vessels are compared; centre: by distance over --scale.", show_default="iou"
    ),
]
ScaleOption = Annotated[
    float | None, typer.Option(metavar="PX", help="Distance of centres at which --similarity centre is 0.")
]
ThresholdOption = Annotated[
    float | None,
    typer.Option(metavar="S", help="Least similarity at which a track follows a vessel.", show_default="0.5"),
]


def opened_tracks(
    path: Path | None,
    run: StoredRun,
    similarity: Literal["iou", "centre"] | None,
    scale: float | None,
    threshold: float | None,
) -> FollowedTracks | None:
    """The tracks that `--tracks` names, with the vessels that they follow; None without it.

    Raises:
        ModsimError: The run is not finished, the tracks are wrong, or an option is.
    """
    from modsim3d.commands.terminal import timed
    from modsim3d.errors import ModsimError
    from modsim3d.tracks.similarity import Similarity
    from modsim3d.view.followed_tracks import read_followed_tracks

    if path is None:
        if (similarity, scale, threshold) != (None, None, None):
            raise ModsimError("--similarity, --scale and --threshold are for --tracks")
        return None
    compared = Similarity(similarity or "iou", scale, 0.5 if threshold is None else threshold)
    with timed("tracks"):
        return read_followed_tracks(path, run, compared)


def read_of_tracks(path: Path | None) -> list[Path]:
    """Files that are read of tracks, so that none of them is written."""
    if path is None:
        return []
    return sorted(inner for inner in path.rglob("*") if inner.is_file()) if path.is_dir() else [path]
