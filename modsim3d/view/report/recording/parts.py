"""The tables of a run in parts of its shown steps, so that no more than a part of a long run is in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from modsim3d.arrays import Indices
from modsim3d.runs.files.columns import NOBODY
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.scene.scene import Scene

MOST_SHOWN, SHOWN_ROWS, MOST_ROWS = 250, 8_000, 400_000
"""Of a part: shown steps; shown steps times vessels; all steps times vessels. Little is unpacked at once."""


@dataclass(frozen=True, eq=False)
class PartRows:
    """What a run has of some consecutive steps.

    Attributes:
        rows: Its rows, and those of frames before that cameras still show.
        steps: The shown steps, ascending, shape (S,).
        taken: Step of the frame that each camera shows at them, `NOBODY` before its first, shape (S, cameras).
    """

    rows: RunRows
    steps: Indices
    taken: Indices


def shown_in_a_part(scene: Scene, every: int) -> int:
    """Number of shown steps in each part but the last."""
    vessels = max(len(scene.vessels), 1)
    return max(1, min(MOST_SHOWN, SHOWN_ROWS // vessels, MOST_ROWS // (vessels * every)))


def parts(run: StoredRun, every: int, count: Callable[[RunRows], None]) -> Iterator[PartRows]:
    """The parts of a run of which every K-th step is shown; `count` receives all rows once, some steps at a time.

    Raises:
        RunDirectoryError: The tables are not what a run has written.
    """
    scene, at_once = run.scene, shown_in_a_part(run.scene, every) * every
    before: dict[str, pa.Table] = {}
    for first, tables in run.tables_of_steps(at_once):
        stop = min(first + at_once, run.steps)
        own = RunRows.of_tables(scene, stop, tables)
        count(own)
        rows = own
        if before:
            joined = {name: pa.concat_tables([before[name], table]) for name, table in tables.items()}
            rows = RunRows.of_tables(scene, stop, joined)
        steps = np.arange(first, stop, every)
        yield PartRows(rows, steps, rows.last_taken(steps))
        before = _still_shown(rows, stop)


def _still_shown(rows: RunRows, step: int) -> dict[str, pa.Table]:
    """The rows of the frames that cameras show at a step if they take none then; none if all take one at each step."""
    scene = rows.scene
    if all(camera.frame_rate_hz is None and not camera.start_offset_s for camera in scene.cameras):
        return {}
    (taken,) = rows.last_taken(np.array([step]))
    frames = (taken * len(scene.cameras) + np.arange(len(scene.cameras)))[taken != NOBODY]
    of_table = {"truth": rows.truth_frame, "detections": rows.detection_frame}
    kept = {name: getattr(rows, name).filter(pa.array(np.isin(frame, frames))) for name, frame in of_table.items()}
    return kept | {"frames": rows.frames_table.filter(pa.array(np.isin(rows.frames, frames)))}
