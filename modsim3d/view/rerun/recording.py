"""A run as a recording for the Rerun viewer: cameras, vessels and boxes in space and time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from modsim3d.errors import ModsimError, RunDirectoryError
from modsim3d.outputs.placing import put_in_place
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.rerun.blueprint import blueprint
from modsim3d.view.rerun.boxes import Boxes
from modsim3d.view.rerun.log import Log
from modsim3d.view.rerun.pictures import Pictures
from modsim3d.view.rerun.space import Space, first_eye

STEPS_TOGETHER = 250
"""Steps whose geometry is computed together."""


def write_recording(
    run: StoredRun,
    out: Path,
    every: int = 1,
    progress: Callable[[int], None] = lambda steps: None,
    followed: FollowedTracks | None = None,
) -> None:
    """Write every K-th step of a run as an `.rrd` file with the time lines `step` and `time`, and what to open it with.

    Args:
        run: The run.
        out: The file.
        every: K.
        progress: Called with the number of steps that were written since its last call.
        followed: The tracks of a tracker; none if None.

    Raises:
        ModsimError: The Rerun SDK is not installed, or the run has no steps.
    """
    try:
        import rerun
    except ImportError:
        raise ModsimError("modsim3d rerun needs the Rerun SDK: pip install 'modsim3d[rerun]'") from None
    if not run.steps:
        raise RunDirectoryError(f"{run.folder} was interrupted before its first steps were finished")
    rows = RunRows.of(run)
    name = f"{run.scene.name}-{run.scene.sha256[:12]}"
    # The viewer keeps one layout for an application, so that scenes with other cameras must be other applications.
    application = f"modsim3d-{name}-{run.steps}{'' if followed is None else '-tracks'}"
    stream = rerun.RecordingStream(application, recording_id=name, send_properties=False)
    stream.set_log_time_enabled(False)  # the time of writing does not belong to the run
    log = Log(rerun, stream, run.scene)
    eye, steps = first_eye(log), np.arange(0, run.steps, every)
    pictures, boxes, space = Pictures(log, rows), Boxes(log, rows, followed), Space(log)
    with put_in_place(out) as partial:
        stream.save(partial, blueprint(log, eye, int(steps[-1]), tracks=followed is not None))
        space.fixed(eye.span_m)
        pictures.fixed()
        boxes.fixed()
        for first in range(0, len(steps), STEPS_TOGETHER):
            some = steps[first : first + STEPS_TOGETHER]
            for part in (space, pictures, boxes):
                part.show(some)
            progress(len(some))
        stream.flush()
        stream.disconnect()
