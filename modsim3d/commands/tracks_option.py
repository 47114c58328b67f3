"""The option `--tracks` of the commands that show a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from modsim3d.runs.stored_run import StoredRun
    from modsim3d.view.followed_tracks import FollowedTracks

TracksOption = Annotated[
    Path | None,
    typer.Option(
        metavar="TRACKS",
        help="Show the tracks of a tracker: a folder of modsim3d track, a .csv file, or MOT (docs/track_files.md).",
    ),
]


def opened_tracks(path: Path | None, run: StoredRun) -> FollowedTracks | None:
    """The tracks that `--tracks` names, with the vessels that they follow; None without it.

    Raises:
        ModsimError: The run is not finished, or the tracks are wrong.
    """
    if path is None:
        return None
    from modsim3d.commands.terminal import timed
    from modsim3d.view.followed_tracks import read_followed_tracks

    with timed("tracks"):
        return read_followed_tracks(path, run)


def read_of_tracks(path: Path | None) -> list[Path]:
    """Files that are read of tracks, so that none of them is written."""
    if path is None:
        return []
    return sorted(inner for inner in path.rglob("*") if inner.is_file()) if path.is_dir() else [path]
