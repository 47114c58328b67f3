"""The columns of one part of a run's recording: truth, detections and performance states of its frames."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from modsim3d.core.arrays import NOBODY, Array, Indices
from modsim3d.detector.records import KINDS
from modsim3d.runs.files.tables import indices, number_column
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.scene.scene import Scene
from modsim3d.view.report.overview import ANNOTATED, DETECTED, UNKNOWN_FRACTION, WHOLE
from modsim3d.view.report.packing import NONE, ROW_BEFORE, Codes, Column, in_quanta, starts

# ---- The tables of a run in parts of its shown steps ----

MAX_SHOWN, SHOWN_ROWS, MAX_ROWS = 250, 8_000, 400_000
"""Of a part: shown steps; shown steps times vessels; all steps times vessels. Little is unpacked at once."""


@dataclass(frozen=True, eq=False)
class PartRows:
    """Rows of a run at some consecutive steps."""

    rows: RunRows  # its rows, and those of frames before that cameras still show
    steps: Indices  # the shown steps, ascending, shape (S,)
    taken: Indices  # step of the frame that each camera shows at them, `NOBODY` before its first, shape (S, cameras)


def shown_in_a_part(scene: Scene, every: int) -> int:
    """Number of shown steps in each part but the last."""
    vessels = max(len(scene.vessels), 1)
    return max(1, min(MAX_SHOWN, SHOWN_ROWS // vessels, MAX_ROWS // (vessels * every)))


def parts(run: StoredRun, every: int, count: Callable[[RunRows], None]) -> Iterator[PartRows]:
    """The parts of a run of which every K-th step is shown; `count` receives all rows once, some steps at a time.
    Raises RunDirectoryError if the tables are not what a run has written."""
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


# ---- The numbers of the truth that only the table below the picture shows ----

WHOLE_SILHOUETTE = NONE - 1  # fractions of a silhouette in the image are counted in 65,534ths; `NONE` is a null


def number_columns(rows: RunRows, shown: Indices, main_hider: Indices) -> dict[str, Column | Codes]:
    """Columns of the rows `shown` of the truth, shape (k,), by the occluder that hides most of each row, shape (n,).
    They are `silhouettePx`, `hiddenPx` and `inFrame`, shape (k,); `otherName` and `otherPx`: the occluders of each row
    other than the main one, most pixels first; `otherStart`: where those of each row begin, shape (k + 1,). What can be
    computed from other columns is left out. Pixels that are hidden are stored in place of those that are seen, as most
    are 0; the pixels that the main hider hides are those that the others do not."""
    silhouette_px, fraction = rows.numbers("silhouette_px")[shown], rows.numbers("in_frame_fraction")[shown]
    # A part never becomes 0 or all.
    counted = np.rint(np.nan_to_num(fraction) * WHOLE_SILHOUETTE)
    counted = np.clip(counted, fraction > 0, WHOLE_SILHOUETTE - (fraction < 1))
    occluders = rows.occluders()
    place = np.full(len(rows.truth_frame), -1)
    place[shown] = np.arange(len(shown))
    of = np.where(occluders.name == main_hider[occluders.hidden], -1, place[occluders.hidden])
    order = np.lexsort((-occluders.px, of))
    order = order[of[order] >= 0]
    return {
        "silhouettePx": silhouette_px.astype(np.float32),
        "hiddenPx": (silhouette_px - rows.numbers("visible_px")[shown]).astype(np.float32),
        "inFrame": np.where(np.isnan(fraction), NONE, counted).astype(np.uint16),
        "otherStart": Codes(starts(of[order], len(shown)), by=ROW_BEFORE),
        "otherName": occluders.name[order].astype(np.uint16),
        "otherPx": occluders.px[order].astype(np.float32),
    }


NO_STATE, ALL_SEA = 255, (0.0, 0.0, 1.0)  # state and horizon of a camera that has not taken a frame yet
PER_METRE = 100  # depths are in centimetres
NO_DEPTH = 2**32 - 1


class PartFrames:
    """The frames that a part shows, camera by camera, each in order of step; an empty one comes last if it is shown."""

    def __init__(self, part: PartRows) -> None:
        """Find the frames of a part."""
        cameras = part.taken.shape[1]
        self._cameras = cameras
        self.steps = [np.unique(column[column != NOBODY]) for column in part.taken.T]  # of each camera, shape (F_c,)
        # The number of each camera's first frame, and the number of frames, shape (cameras + 1,).
        self.begins = np.concatenate([[0], np.cumsum([len(steps) for steps in self.steps])])
        self.count = int(self.begins[-1])  # frames without the empty one
        self.pages = self.count + int(np.any(part.taken == NOBODY))  # frames with it
        self.shown = np.empty(part.taken.shape, dtype=np.int64)  # frame of each camera at each step, (S, cameras)
        for camera, (steps, taken) in enumerate(zip(self.steps, part.taken.T, strict=True)):
            place = self.begins[camera] + np.searchsorted(steps, taken)
            self.shown[:, camera] = np.where(taken == NOBODY, self.count, place)
        # Step × cameras + camera of each frame, shape (count,).
        self.numbers = np.concatenate([steps * cameras + camera for camera, steps in enumerate(self.steps)])

    def of(self, number: Indices) -> Indices:
        """The frame of each row, from step × cameras + camera of each, shape (n,); `NOBODY` if it is not shown."""
        frame = np.full(len(number), NOBODY)
        for camera, steps in enumerate(self.steps):
            mine = np.flatnonzero(number % self._cameras == camera)
            step = number[mine] // self._cameras
            place = np.searchsorted(steps, step)
            matches = np.flatnonzero(np.append(steps, NOBODY)[place] == step)
            frame[mine[matches]] = self.begins[camera] + place[matches]
        return frame


def frame_columns(part: PartRows, frames: PartFrames) -> dict[str, Column | Codes]:
    """Frame that each camera shows at each step, when it was taken, and the performance state in it."""
    state = part.rows.states_of(frames.numbers).astype(np.uint8)
    empty = frames.pages - frames.count
    held = np.any(part.taken != part.steps[:, None])
    return {
        "frame": Codes(frames.shown.astype(np.uint32), by=ROW_BEFORE),
        **({"taken": Codes(part.taken.astype(np.int32), by=ROW_BEFORE)} if held else {}),
        "state": np.append(state, np.full(empty, NO_STATE, dtype=np.uint8)),
    }


def truth_columns(rows: RunRows, frames: PartFrames, quantum: float) -> dict[str, Column | Codes]:
    """The truth of frames, the farthest vessel of each frame first."""
    frame, depth_m = frames.of(rows.truth_frame), rows.numbers("depth_m")
    order = np.lexsort((-depth_m, frame))
    shown, hiders = order[frame[order] != NOBODY], np.full(len(frame), NONE)
    occluders = rows.occluders()
    least_first = np.argsort(occluders.px, kind="stable")
    hiders[occluders.hidden[least_first]] = occluders.name[least_first]  # what is written last, the main one, stays
    return {
        "truthStart": Codes(starts(frame[shown], frames.pages), by=ROW_BEFORE),
        "vessel": Codes(rows.truth_vessel[shown].astype(np.uint16), by=ROW_BEFORE),
        "flags": (ANNOTATED * rows.annotated[shown] + DETECTED * rows.detected[shown]).astype(np.uint8),
        "fraction": Codes(in_250ths(rows.numbers("visible_fraction")[shown]), by="vessel"),
        "depth": Codes(_depths(depth_m[shown]), by="vessel"),
        "hider": Codes(hiders[shown].astype(np.uint16), by="vessel"),
        "full": Codes(in_quanta(rows.boxes_px("full")[shown], quantum), by="vessel"),
        "visible": Codes(in_quanta(rows.boxes_px("visible")[shown], quantum), base="full"),
        **number_columns(rows, shown, hiders),
    }


def _depths(depth_m: Array) -> Column:
    """Depths in centimetres; the largest number where one is not known."""
    finite = np.isfinite(depth_m)
    return np.where(finite, np.rint(PER_METRE * np.where(finite, depth_m, 0.0)), NO_DEPTH).astype(np.uint32)


def detection_columns(rows: RunRows, frames: PartFrames, quantum: float) -> dict[str, Column | Codes]:
    """The detections of frames, in the order of the run."""
    frame = frames.of(rows.detection_frame)
    order = np.argsort(frame, kind="stable")
    drawn = order[frame[order] != NOBODY]
    vessel = np.where(rows.detection_vessel < 0, NONE, rows.detection_vessel)[drawn].astype(np.uint16)
    confidence = number_column(rows.detections, "confidence")[drawn]
    counted = np.rint(1000 * confidence)
    counted -= counted / 1000 > confidence  # down, so that none reaches a threshold that it is below
    return {
        "drawnStart": Codes(starts(frame[drawn], frames.pages), by=ROW_BEFORE),
        "drawnVessel": vessel,
        "label": indices(rows.detections, "label", rows.scene.detector.labels)[drawn].astype(np.uint16),
        "confidence": Codes(counted.astype(np.uint16)),
        "outcome": rows.outcomes[drawn],
        "kind": indices(rows.detections, "kind", KINDS)[drawn].astype(np.uint8),
        "box": Codes(in_quanta(rows.detection_boxes_px()[drawn], quantum), by="drawnVessel"),
    }


def in_250ths(fraction: Array) -> NDArray[np.uint8]:
    """Visible fractions in 250ths, of the same shape; NaN is `UNKNOWN_FRACTION`, and a part never rounds to 0 or 1."""
    counted = np.clip(np.rint(np.nan_to_num(fraction) * WHOLE), np.where(fraction > 0, 1, 0), WHOLE)
    counted = np.where((fraction < 1) & (counted == WHOLE), WHOLE - 1, counted)
    return np.where(np.isnan(fraction), UNKNOWN_FRACTION, counted).astype(np.uint8)
