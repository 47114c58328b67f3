"""A run's tables as columns of numbers, with names as indices into its scene: what a page of it is made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import corner_form
from modsim3d.formats.tables import BOX_SIDES, CENTRE_FORM
from modsim3d.scene import Scene
from modsim3d.stored_run import StoredRun
from modsim3d.view.report.count_tables import CountTables

NOBODY = -1
"""The vessel of a false positive; the row of an occluder that is no vessel."""


@dataclass(frozen=True, eq=False)
class Occluders:
    """Who hides whom: p entries.

    Attributes:
        hidden: Truth row, shape (p,).
        name: Index into the scene's occluder names, shape (p,).
        row: The occluder's own truth row; `NOBODY` if it has none, shape (p,).
        px: Pixels that it hides, shape (p,).
    """

    hidden: Indices
    name: Indices
    row: Indices
    px: Array


@dataclass(frozen=True, eq=False)
class RunRows:
    """All rows of a run. A frame is one camera at one step; its number is step × cameras + camera.

    Attributes:
        scene: Of the run.
        steps: That are there.
        frames: Numbers of the frames that were taken, ascending, shape (F,).
        frame_state: Performance state in each, shape (F,).
        truth: The table of n rows.
        truth_frame: Frame of each row, shape (n,).
        truth_vessel: Shape (n,).
        drawn: The table of m detections.
        drawn_frame: Frame of each, shape (m,).
        drawn_vessel: `NOBODY` for a false positive, shape (m,).
    """

    scene: Scene
    steps: int
    frames: Indices
    frame_state: Indices
    truth: pa.Table
    truth_frame: Indices
    truth_vessel: Indices
    drawn: pa.Table
    drawn_frame: Indices
    drawn_vessel: Indices

    @classmethod
    def of(cls, run: StoredRun) -> RunRows:
        """All rows of the steps that a run has."""
        tables, scene = run.tables(), run.scene
        frames, truth, drawn = (tables[name].combine_chunks() for name in ("frames", "truth", "detections"))
        cameras = [camera.name for camera in scene.cameras]

        def frame(table: pa.Table) -> Indices:
            steps: Indices = table["step"].to_numpy()
            return steps * len(cameras) + indices(table, "camera", cameras)

        return cls(
            scene,
            run.steps,
            frame(frames),
            indices(frames, "state", [state.name for state in scene.detector.states]),
            truth,
            frame(truth),
            indices(truth, "vessel", scene.vessel_names),
            drawn,
            frame(drawn),
            indices(drawn, "vessel", scene.vessel_names),
        )

    def states_of(self, frames: Indices) -> Indices:
        """Performance state in frames that were taken, by their numbers."""
        return self.frame_state[np.searchsorted(self.frames, frames)]

    def last_taken(self, steps: Indices) -> Indices:
        """For each step and camera the step of the last frame taken until then, `NOBODY` if none; (steps, cameras)."""
        cameras = len(self.scene.cameras)
        last = np.full((len(steps), cameras), NOBODY)
        for index in range(cameras):
            taken = self.frames[self.frames % cameras == index] // cameras
            place = np.searchsorted(taken, steps, side="right") - 1
            last[place >= 0, index] = taken[place[place >= 0]]
        return last

    def numbers(self, name: str) -> Array:
        """A column of the truth; NaN for null."""
        return numbers(self.truth, name)

    def boxes_px(self, prefix: str) -> Array:
        """The full or the visible boxes of the truth, shape (n, 4)."""
        return np.column_stack([self.numbers(f"{prefix}_{side}") for side in BOX_SIDES])

    def drawn_boxes_px(self) -> Array:
        """The detections' boxes as x_min, y_min, x_max, y_max, shape (m, 4)."""
        return corner_form(np.column_stack([numbers(self.drawn, name) for name in CENTRE_FORM]))

    @cached_property
    def annotated(self) -> Mask:
        """Shape (n,)."""
        return _flags(self.truth, "annotated")

    @cached_property
    def detected(self) -> Mask:
        """Shape (n,)."""
        return _flags(self.truth, "detected")

    def occluders(self) -> Occluders:
        """Who hides whom, from the truth."""
        lists = self.truth["occluded_by"].combine_chunks()
        counts = np.asarray(lists.value_lengths(), dtype=np.int64)
        entries = lists.flatten()
        hidden = np.repeat(np.arange(len(counts)), counts)
        names = pa.table({"id": entries.field("id")})
        vessel = indices(names, "id", self.scene.vessel_names)
        count = len(self.scene.vessels)
        rows = positions(
            self.truth_frame * count + self.truth_vessel,
            np.where(vessel >= 0, self.truth_frame[hidden] * count + vessel, NOBODY),
        )
        name = indices(names, "id", self.scene.occluder_names)
        return Occluders(hidden, name, rows, np.asarray(entries.field("px"), dtype=np.float64))

    def count_tables(self) -> CountTables:
        """What is counted."""
        known = self.drawn_vessel >= 0
        labels = self.scene.detector.labels
        meant = np.array([labels.index(vessel.label) for vessel in self.scene.vessels])
        given = indices(self.drawn, "label", labels)
        return CountTables(
            frame_state=self.frame_state,
            vessel=self.truth_vessel,
            state=self.states_of(self.truth_frame),
            silhouette_px=self.numbers("silhouette_px"),
            visible_px=self.numbers("visible_px"),
            annotated=self.annotated,
            detected=self.detected,
            false_state=self.states_of(self.drawn_frame[~known]),
            mislabelled=int((given[known] != meant[self.drawn_vessel[known]]).sum()),
        )


def positions(keys: Indices, asked: Indices) -> Indices:
    """Where each of the numbers asked for stands among distinct ones, `NOBODY` if nowhere."""
    if not len(keys):
        return np.full(len(asked), NOBODY)
    order = np.argsort(keys)
    at = order[np.minimum(np.searchsorted(keys, asked, sorter=order), len(keys) - 1)]
    return np.where(keys[at] == asked, at, NOBODY)


def numbers(table: pa.Table, name: str) -> Array:
    """A column as doubles; NaN for null."""
    return np.asarray(table[name].to_numpy(), dtype=np.float64)


def indices(table: pa.Table, name: str, names: Sequence[str]) -> Indices:
    """A column of names as indices; `NOBODY` for null and for a name that is not among them."""
    found = pc.index_in(table[name], value_set=pa.array(list(names), pa.string()))
    return np.asarray(found.fill_null(NOBODY).to_numpy(), dtype=np.int64)


def _flags(table: pa.Table, name: str) -> Mask:
    return np.asarray(table[name].to_numpy(), dtype=bool)
