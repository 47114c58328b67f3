"""Rows of a run's tables in memory, with the names of frames, states and vessels as indices."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import pyarrow as pa

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask, positions
from modsim3d.core.document import Result
from modsim3d.detector.records import FALSE_KINDS, KINDS
from modsim3d.runs.counts import Outcomes, outcomes
from modsim3d.runs.files.tables import (
    Occluders,
    detection_boxes_px,
    flags,
    frame_numbers,
    indices,
    number_column,
    truth_boxes_px,
)
from modsim3d.runs.stored_run import StoredRun
from modsim3d.scene.scene import Scene
from modsim3d.world.poses.labelled import IgnoredRegions


@dataclass(frozen=True, eq=False, repr=False)
class RunRows(Result):
    """Rows of a run's tables. A frame is one camera at one step; its number is step × cameras + camera.

    Attributes:
        steps: Number of steps that are there.
        frames: Numbers of the frames that were taken, ascending, shape (F,).
        frame_state: Index of the performance state in each frame, shape (F,).
        frames_table: The table of frames, F rows.
        truth: The truth table, n rows.
        truth_frame: Number of the frame of each row, shape (n,).
        truth_vessel: Index of the vessel of each row, shape (n,).
        detections: The table of detections, m rows.
        detection_frame: Number of the frame of each detection, shape (m,).
        detection_vessel: Index of the vessel that each detection came from, `NOBODY` if from none, shape (m,).
    """

    scene: Scene
    steps: int
    frames: Indices
    frame_state: Indices
    frames_table: pa.Table
    truth: pa.Table
    truth_frame: Indices
    truth_vessel: Indices
    detections: pa.Table
    detection_frame: Indices
    detection_vessel: Indices

    @classmethod
    def of(cls, run: StoredRun) -> RunRows:
        """All rows of the steps that a run has."""
        return cls.of_tables(run.scene, run.steps, run.tables())

    @classmethod
    def of_tables(cls, scene: Scene, steps: int, tables: Mapping[str, pa.Table]) -> RunRows:
        """Some detections of a run of a scene, with the frames and the truth of their steps; tables by their names."""
        frames, truth, detections = (tables[name].combine_chunks() for name in ("frames", "truth", "detections"))
        return cls(
            scene=scene,
            steps=steps,
            frames=frame_numbers(frames, scene),
            frame_state=indices(frames, "state", [state.name for state in scene.detector.states]),
            frames_table=frames,
            truth=truth,
            truth_frame=frame_numbers(truth, scene),
            truth_vessel=indices(truth, "vessel", scene.vessel_names),
            detections=detections,
            detection_frame=frame_numbers(detections, scene),
            detection_vessel=indices(detections, "vessel", scene.vessel_names),
        )

    @property
    def regions(self) -> IgnoredRegions | None:
        """Regions of a labelled video in which a track that follows nothing is ignored."""
        return None if self.scene.labels is None else self.scene.labels.regions

    def in_cameras(self, cameras: Sequence[int]) -> Self:
        """The rows of some cameras, by their indices; frames keep their numbers."""
        count = len(self.scene.cameras)
        frames, truth, detections = (
            np.isin(frame % count, cameras) for frame in (self.frames, self.truth_frame, self.detection_frame)
        )
        return replace(
            self,
            frames=self.frames[frames],
            frame_state=self.frame_state[frames],
            frames_table=self.frames_table.filter(pa.array(frames)),
            truth=self.truth.filter(pa.array(truth)),
            truth_frame=self.truth_frame[truth],
            truth_vessel=self.truth_vessel[truth],
            detections=self.detections.filter(pa.array(detections)),
            detection_frame=self.detection_frame[detections],
            detection_vessel=self.detection_vessel[detections],
        )

    def states_of(self, frames: Indices) -> Indices:
        """Index of the performance state in each of some frames, by their numbers, shape (k,)."""
        return self.frame_state[np.searchsorted(self.frames, frames)]

    def last_taken(self, steps: Indices) -> Indices:
        """The step of the last frame of each camera at each step, `NOBODY` before the first, shape (steps, cameras)."""
        cameras = len(self.scene.cameras)
        last = np.full((len(steps), cameras), NOBODY)
        for index in range(cameras):
            taken = self.frames[self.frames % cameras == index] // cameras
            place = np.searchsorted(taken, steps, side="right") - 1
            last[place >= 0, index] = taken[place[place >= 0]]
        return last

    def numbers(self, name: str) -> Array:
        """A column of the truth, NaN for null, shape (n,)."""
        return number_column(self.truth, name)

    def boxes_px(self, prefix: str) -> Array:
        """The boxes `full` or `visible` of the truth as x_min, y_min, x_max, y_max, shape (n, 4)."""
        return truth_boxes_px(self.truth, prefix)

    def detection_boxes_px(self) -> Array:
        """The detections' boxes as x_min, y_min, x_max, y_max, shape (m, 4)."""
        return detection_boxes_px(self.detections)

    @cached_property
    def detections_sha256(self) -> str:
        """Checksum of what a tracker sees: frames, boxes, labels and confidence of the detections."""
        label = indices(self.detections, "label", self.scene.detector.labels)
        scores = label, number_column(self.detections, "confidence")
        columns = (self.frames, self.detection_frame, self.detection_boxes_px(), *scores)
        return hashlib.sha256(b"".join(column.tobytes() for column in columns)).hexdigest()

    @cached_property
    def annotated_boxes_px(self) -> Array:
        """The boxes that the annotation mode takes as x_min, y_min, x_max, y_max, shape (n, 4)."""
        return self.boxes_px("visible" if self.scene.annotation.mode == 2 else "full")

    @cached_property
    def detected_row(self) -> Indices:
        """Row of the truth that each detection detects, `NOBODY` for a false positive, shape (m,)."""
        vessels, false = len(self.scene.vessels), np.isin(indices(self.detections, "kind", KINDS), FALSE_KINDS)
        wanted = self.detection_frame * vessels + self.detection_vessel
        wanted[false | (self.detection_vessel == NOBODY)] = NOBODY
        return positions(self.truth_frame * vessels + self.truth_vessel, wanted)

    @cached_property
    def outcomes(self) -> Outcomes:
        """The outcome of each detection, shape (m,)."""
        labels, rows = self.scene.detector.labels, self.detected_row
        false = rows == NOBODY
        annotated_px = np.full((len(rows), 4), np.nan)
        annotated_px[~false] = self.annotated_boxes_px[rows[~false]]
        true_label = np.array([labels.index(vessel.label) for vessel in self.scene.vessels])
        mislabelled = indices(self.detections, "label", labels) != true_label[self.detection_vessel]
        return outcomes(false, mislabelled, self.detection_boxes_px(), annotated_px)

    @cached_property
    def annotated(self) -> Mask:
        """Whether each row of the truth was given to the detector, shape (n,)."""
        return flags(self.truth, "annotated")

    @cached_property
    def detected(self) -> Mask:
        """Whether each row of the truth was detected, shape (n,)."""
        return flags(self.truth, "detected")

    def occluders(self) -> Occluders:
        """Occluders of each row of the truth."""
        return Occluders.of(self.truth, self.scene.occluder_names)
