"""Whether a run of a campaign that is to be made again is there already, with its tracks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import orjson

from modsim3d.errors import ModsimError
from modsim3d.runs.run import settings_of
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun, open_run
from modsim3d.scene.scene import Scene
from modsim3d.tracking.trackers.registry import named_tracker
from modsim3d.tracks.stored_tracks import read_stored_tracks
from modsim3d.tracks.tracks import Tracks


def run_there(folder: Path, scene: Scene) -> StoredRun | None:
    """The run of a scene in a folder; None if there is none, or another one, or a damaged one.

    Args:
        folder: The run directory.
        scene: The scene with the seeds of the run.
    """
    try:
        found = open_run(folder)
        found.finished_tables.check_checksums()
    except ModsimError:
        return None
    wanted = orjson.loads(orjson.dumps(settings_of(scene, found.settings["backend"])))
    return found if all(found.settings.get(key) == value for key, value in wanted.items()) else None


def tracks_there(folder: Path, run: StoredRun, tracker: str, settings: Mapping[str, Any]) -> Tracks | None:
    """The tracks of a tracker in a run; None if there are none, or those of another tracker, or damaged ones.

    Args:
        folder: The folder of the tracks.
        run: The run.
        tracker: Name of the tracker.
        settings: Its settings, in place of those chosen for the scene.
    """
    try:
        found = read_stored_tracks(folder, run, RunRows.of(run))
    except ModsimError:
        return None
    return found.tracks if found.origin == named_tracker(tracker, settings, run.scene.name).origin else None
