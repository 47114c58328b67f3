"""The truth and the detections of a run, as columns over all cameras: what verification works on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modsim3d.core.arrays import Array, Indices, row_before
from modsim3d.core.boxes import Overlaps, at_least_a_pixel, iou
from modsim3d.detector.chain import Detector, target_statistics
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import CameraFrames, Detections, Targets
from modsim3d.detector.target_statistics import TargetStatistics
from modsim3d.runs.pipeline import DetectorInput, block_ranges, block_steps, detector_inputs, open_renderer, truth_block
from modsim3d.scene.scene import Scene
from modsim3d.truth.record import Truth, concatenate

Columns = dict[str, NDArray[Any]]
MERGED = -2  # outcome of a vessel in another's box


@dataclass(frozen=True, eq=False)
class CameraEvidence:
    """The frames and annotated boxes of one camera over a whole run, and its detections."""

    frames: CameraFrames
    targets: Targets
    detections: Detections


@dataclass(frozen=True, eq=False)
class Instances:
    """The annotated boxes of all cameras: each is a chance to detect a vessel; shapes (n,) unless given."""

    camera: Indices
    time_s: Array
    frame: Indices  # index of the camera's frame
    vessel: Indices
    state: Indices
    label: Indices
    outcome: Indices  # detected label; −1 if missed, `MERGED` into another's box, which tells nothing of its own draw
    before: Indices  # row of the same vessel in the camera's frame before, −1 if it was not annotated there
    boxes_px: Array  # the boxes that errors are added to, shape (n, 4)
    image_px: Array  # width and height of the camera's image, shape (n, 2)
    visible_fraction: Array  # NaN where unknown

    def tracks(self, rows: Indices) -> tuple[Indices, Array]:
        """Numbers that are equal in rows of one vessel in one camera, shape (k, 2), and times of rows, shape (k,)."""
        return np.stack([self.camera[rows], self.vessel[rows]], axis=1), self.time_s[rows]


@dataclass(frozen=True, eq=False)
class TrueDetections:
    """Detections that count as that of a vessel; two vessels that are merged are one. Shapes (m,) unless given."""

    instance: Indices  # row of `Instances`
    kind: Indices  # index into `KINDS`
    errors_px: Array  # e_x, e_y, e_w, e_h before clipping, NaN where it is not one box of one vessel, shape (m, 4)
    confidence: Array
    boxes_px: Array  # as output, shape (m, 4)


@dataclass(frozen=True, eq=False)
class FalsePositiveRows:
    """False positives, second boxes of vessels among them; shapes (m,) unless given."""

    frame_row: Indices  # row of `FrameTable`
    instance: Indices  # row of `Instances` of a second box, −1 for all others
    state: Indices
    label: Indices
    confidence: Array
    kind: Indices  # index into `KINDS`
    boxes_px: Array  # as output, shape (m, 4)


@dataclass(frozen=True, eq=False)
class FrameTable:
    """The frames of all cameras in order of camera and time, with true detections and false positives; shapes (s,)."""

    camera: Indices
    time_s: Array
    step: Indices
    state: Indices
    n_kept: Indices
    n_false: Indices


@dataclass(frozen=True, eq=False)
class Evidence:
    """A whole run, all cameras."""

    cameras: tuple[CameraEvidence, ...]
    frames: FrameTable
    instances: Instances
    true_detections: TrueDetections
    false_positives: FalsePositiveRows

    @classmethod
    def of(cls, cameras: Sequence[CameraEvidence]) -> Evidence:
        """Join the evidence of cameras."""
        first_row = np.cumsum([0, *(len(seen.targets) for seen in cameras)])
        first_frame = np.cumsum([0, *(len(seen.frames) for seen in cameras)])
        true = [_true(seen.detections) for seen in cameras]
        false = [_false(seen.detections) for seen in cameras]
        return cls(
            tuple(cameras),
            FrameTable(**_joined([_frames(index, seen) for index, seen in enumerate(cameras)])),
            Instances(**_joined([_instances(index, seen) for index, seen in enumerate(cameras)], before=first_row)),
            TrueDetections(**_joined(true, instance=first_row)),
            FalsePositiveRows(**_joined(false, frame_row=first_frame, instance=first_row)),
        )

    @property
    def iou(self) -> Overlaps:
        """IoU of the true detections with the boxes of their vessels."""
        boxes_px = self.instances.boxes_px[self.true_detections.instance]
        return Overlaps.of(iou(self.true_detections.boxes_px, boxes_px))

    def images_of(self, instances: Indices) -> Indices:
        """Row of `FrameTable` of instances, shapes (k,)."""
        first = np.cumsum([0, *(len(seen.frames) for seen in self.cameras)])
        return first[self.instances.camera[instances]] + self.instances.frame[instances]

    def target_statistics(self, model: DetectorModel) -> TargetStatistics:
        """Statistics that the detector knew of the scene's targets."""
        return target_statistics(model, ((seen.frames, seen.targets) for seen in self.cameras))


def _joined(parts: Sequence[Columns], **offsets: Indices) -> Columns:
    """Columns of all cameras joined; those that index rows get their camera's offset, and −1 stays."""
    for name, first in offsets.items():
        for part, start in zip(parts, first.tolist(), strict=False):
            part[name] = np.where(part[name] < 0, -1, part[name] + start)
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _frames(index: int, seen: CameraEvidence) -> Columns:
    """Columns of `FrameTable` of a camera."""
    detections, length = seen.detections, len(seen.frames)
    false = detections.false()
    return {
        "camera": np.full(length, index),
        "time_s": seen.frames.times_s,
        "step": seen.frames.steps,
        "state": detections.states,
        "n_kept": np.bincount(detections.frame[~false], minlength=length),
        "n_false": np.bincount(detections.frame[false], minlength=length),
    }


def _instances(index: int, seen: CameraEvidence) -> Columns:
    """Columns of `Instances` of a camera."""
    frames, targets, detections = seen.frames, seen.targets, seen.detections
    true, before = ~detections.false(), row_before(targets.vessel)  # rows are in order of frame
    outcome = np.full(len(targets), -1)
    outcome[detections.partner[detections.partner >= 0]] = MERGED
    outcome[detections.target[true]] = detections.label[true]
    return {
        "camera": np.full(len(targets), index),
        "time_s": frames.times_s[targets.frame],
        "frame": targets.frame,
        "vessel": targets.vessel,
        "state": detections.states[targets.frame],
        "label": targets.label,
        "outcome": outcome,
        "before": np.where(targets.frame == targets.frame[before] + 1, before, -1),
        "boxes_px": at_least_a_pixel(targets.boxes_px, frames.image_size_px),
        "image_px": np.tile(np.array(frames.image_size_px, dtype=np.float64), (len(targets), 1)),
        "visible_fraction": targets.visible_fraction,
    }


def _true(detections: Detections) -> Columns:
    """Columns of `TrueDetections` of a camera."""
    true = ~detections.false()
    columns = {name: getattr(detections, name)[true] for name in ("kind", "errors_px", "confidence", "boxes_px")}
    return {"instance": detections.target[true], **columns}


def _false(detections: Detections) -> Columns:
    """Columns of `FalsePositiveRows` of a camera."""
    false = detections.false()
    frame = detections.frame[false]
    columns = {name: getattr(detections, name)[false] for name in ("label", "confidence", "kind", "boxes_px")}
    return {"frame_row": frame, "instance": detections.target[false], "state": detections.states[frame], **columns}


def unknown_rest_note(model: DetectorModel, evidence: Evidence) -> str:
    """Reason why rates and confidence cannot be tested; empty if they can."""
    limit, threshold = model.gates.max_detections, model.operating_threshold
    if threshold is not None and threshold > model.confidence_threshold:
        return f"operating_threshold is {threshold:g}: what was dropped below it is not known"
    if limit is None:
        return ""
    reached = int((evidence.frames.n_kept + evidence.frames.n_false >= limit).sum())
    return f"max_detections was reached in {reached} images: what was left out is not known" if reached else ""


def frames_above_max(model: DetectorModel, evidence: Evidence) -> int:
    """Images with more detections than the limit."""
    limit = model.gates.max_detections
    return 0 if limit is None else int(np.sum(evidence.frames.n_kept + evidence.frames.n_false > limit))


@dataclass(frozen=True, eq=False)
class ManyDetections:
    """The truth of a whole run, as the inputs of each camera's detector."""

    scene: Scene
    inputs: tuple[DetectorInput, ...]

    @classmethod
    def of_scene(cls, scene: Scene) -> ManyDetections:
        """Make the truth of a scene."""
        with open_renderer(scene) as renderer:
            ranges = block_ranges(scene.steps, block_steps(scene))
            return cls.of_truth(scene, concatenate([truth_block(scene, *steps, renderer) for steps in ranges]))

    @classmethod
    def of_truth(cls, scene: Scene, truth: Truth) -> ManyDetections:
        """Take the truth of a whole run, such as that of a stored run."""
        return cls(scene, tuple(detector_inputs(scene, truth, 0, scene.steps)))

    def detect(self, model: DetectorModel, seed: int) -> Evidence:
        """Evidence of a run with this detector and seed."""
        statistics = target_statistics(model, ((part.frames, part.targets) for part in self.inputs))
        detector = Detector(model, seed, statistics, self.scene.times_s)
        parts = [(part.frames, part.targets) for part in self.inputs]
        return Evidence.of([CameraEvidence(*part, detector.detect(*part)) for part in parts])
