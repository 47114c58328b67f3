"""Counts of what happened in a run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from enum import IntFlag
from functools import reduce
from operator import or_

import numpy as np
from numpy.typing import NDArray

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import iou, sizes
from modsim3d.detector.records import Detections
from modsim3d.geometry.curved_sea import shift_px
from modsim3d.runs.blocks import Block, CameraBlock
from modsim3d.runs.frames import Frame, detected_rows
from modsim3d.scene.scene import Scene
from modsim3d.truth.record import annotation_boxes

GOOD_IOU = 0.5  # a box with a smaller IoU with its vessel's annotated box is a bad one


class Outcome(IntFlag):
    """Faults of a detection; 0 if there is none. The names are those of the counts in `run.json`."""

    FALSE_POSITIVE = 1  # it is not the one detection of a vessel; its kind says what it is
    MISLABELLED = 2  # it has another label than its vessel
    BELOW_HALF_IOU = 4  # its box has IoU < 0.5 with its vessel's annotated box
    OFF_VESSEL = 8  # its box does not even touch that box; BELOW_HALF_IOU is set too


NOTHING_WRONG = Outcome(0)
Outcomes = NDArray[np.uint8]  # flags of `Outcome`, shape (m,)


def outcomes(false: Mask, mislabelled: Mask, boxes_px: Array, annotated_px: Array) -> Outcomes:
    """The outcome of each of m detections, by their boxes, shape (m, 4), and the annotated boxes of their vessels,
    shape (m, 4). `false` are false positives, of which the other arguments say nothing; `mislabelled` have another
    label than their vessel; both (m,)."""
    overlap = iou(boxes_px, annotated_px)
    flags = (
        Outcome.MISLABELLED * mislabelled
        | Outcome.BELOW_HALF_IOU * (overlap < GOOD_IOU)
        | Outcome.OFF_VESSEL * (overlap == 0)
    )
    return np.where(false, Outcome.FALSE_POSITIVE, flags).astype(np.uint8)


def having(flags: Outcomes, flag: Outcome) -> Mask:
    """Mask of the outcomes that have a flag, shape (m,)."""
    return (flags & flag) > 0


def frame_outcomes(frame: Frame) -> list[Outcome]:
    """The outcome of each detection of a frame."""
    truth, detections, rows = frame.truth, frame.detections, detected_rows(frame)
    names = zip(detections.labels, rows, strict=True)
    mislabelled = np.array([row is not None and label != truth.labels[row] for label, row in names], dtype=bool)
    false = np.array([row is None for row in rows], dtype=bool)
    annotated_px = np.full((len(rows), 4), np.nan)
    annotated_px[~false] = truth.boxes_px[[row for row in rows if row is not None]]
    flags = outcomes(false, mislabelled, detections.boxes_px, annotated_px)
    return [Outcome(flag) for flag in flags.tolist()]


def faults_of(frames: Iterable[Frame]) -> Outcome:
    """Faults of any detection in some frames."""
    return reduce(or_, (outcome for frame in frames for outcome in frame_outcomes(frame)), NOTHING_WRONG)


WORTH_A_WARNING_PX = 1.0  # curvature that moves a box by more than this is reported for a flat sea


@dataclass(frozen=True)
class Counts:
    """Counts over the frames of one camera, or of all, summed over steps. The names are keys of `run.json`."""

    frames: int = 0
    vessel_frames: int = 0  # vessels whose silhouette was in a frame
    seen: int = 0  # vessels with a visible pixel
    partly_hidden: int = 0  # vessels with some visible pixels, but fewer than silhouette pixels
    fully_hidden: int = 0  # vessels with silhouette pixels, none of them visible
    annotated: int = 0  # vessels that were given to the detector
    detected: int = 0  # annotated vessels that were detected, under whatever label
    missed: int = 0  # annotated vessels that were not detected
    missed_by_gate: int = 0  # missed vessels that a hard limit removed, not chance
    merged: int = 0  # detections that are one box for two vessels
    mislabelled: int = 0  # detections of a vessel under another label
    false_positives: int = 0  # detections of nothing, and second boxes of a vessel
    clipped: int = 0  # detections of a vessel whose box was cut at the image edge
    redrawn: int = 0  # detections of a vessel whose box error was resampled: it shrank the box below one pixel
    below_half_iou: int = 0
    """Detections of a vessel whose box has IoU < 0.5 with the annotated one. An evaluation that matches boxes counts
    such a detection as a miss and a false positive."""
    off_vessel: int = 0  # detections of these whose box does not even overlap the annotated one: IoU is 0
    off_by_curvature: int = 0  # vessels on a flat sea whose box the Earth's curvature would move by more than a pixel
    largest_curvature_px: float = 0.0  # the largest such shift

    @property
    def true_detections(self) -> int:
        """Detections of a vessel; a merged box is one detection of two vessels."""
        return self.detected - self.merged

    def __add__(self, other: Counts) -> Counts:
        """The counts of both; of the curvature's shift the larger one."""
        sums = {field.name: getattr(self, field.name) + getattr(other, field.name) for field in fields(self)}
        sums["largest_curvature_px"] = max(self.largest_curvature_px, other.largest_curvature_px)
        return Counts(**sums)

    @classmethod
    def total(cls, camera_counts: Mapping[str, Counts]) -> Counts:
        """The counts of all cameras together."""
        return sum(camera_counts.values(), cls())


def camera_counts(block: Block, scene: Scene) -> dict[str, Counts]:
    """Counts over a block, by name of the camera."""
    return {scene.cameras[part.camera].name: _count(part, scene) for part in block.cameras}


def _count(part: CameraBlock, scene: Scene) -> Counts:
    truth, rows = part.truth, part.truth_row[~part.detections.false()]
    labels = np.array([scene.detector.labels.index(vessel.label) for vessel in scene.vessels])
    focal_px = scene.cameras[part.camera].intrinsics.focal_px
    curvature_px = shift_px(truth.depth_m if scene.sea == "flat" else np.empty(0), focal_px)
    curvature_px = curvature_px[curvature_px > WORTH_A_WARNING_PX]
    return Counts(
        frames=len(part.steps),
        vessel_frames=len(truth),
        seen=int((truth.visible_px > 0).sum()),
        partly_hidden=int(((truth.visible_px > 0) & (truth.visible_px < truth.silhouette_px)).sum()),
        fully_hidden=int(((truth.visible_px == 0) & (truth.silhouette_px > 0)).sum()),
        annotated=len(part.target_rows),
        detected=(detected := int(part.detected.sum())),
        missed=len(part.target_rows) - detected,
        **detection_counts(
            part.detections, annotation_boxes(truth, scene.annotation.mode)[rows], labels[truth.vessel[rows]]
        ),
        off_by_curvature=len(curvature_px),
        largest_curvature_px=float(curvature_px.max(initial=0.0)),
    )


def detection_counts(detections: Detections, boxes_px: Array, labels: Indices) -> dict[str, int]:
    """Counts of what a detector put out, by their names in `Counts`. For each of the t true detections, `labels` (t,)
    is the index of its vessel's label, and `boxes_px` (t, 4) the annotated box of that vessel."""
    true = np.flatnonzero(~detections.false())
    true_px = detections.boxes_px[true]
    outcome = outcomes(np.zeros(len(true), dtype=bool), detections.label[true] != labels, true_px, boxes_px)
    unclipped = sizes(boxes_px) + detections.errors_px[true, 2:]
    return {
        "missed_by_gate": int(detections.gated.sum()),
        "merged": int((detections.partner >= 0).sum()),
        "mislabelled": int(having(outcome, Outcome.MISLABELLED).sum()),
        "false_positives": len(detections) - len(true),
        "clipped": int(np.any(sizes(true_px) < unclipped - 1e-6, axis=1).sum()),
        "redrawn": int(detections.redrawn[true].sum()),
        "below_half_iou": int(having(outcome, Outcome.BELOW_HALF_IOU).sum()),
        "off_vessel": int(having(outcome, Outcome.OFF_VESSEL).sum()),
    }
