"""Hard limits of a detector: what it never sees, when it runs, how many detections it outputs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import sizes
from modsim3d.detector.records import CameraFrames, Targets

_EARLY = 1e-6  # of an interval: 0.6 / 0.2 is a hair below 3, and the frame at 0.6 s is due


@dataclass(frozen=True)
class Gates:
    """Rules before and after the draws; each is off unless given.

    Attributes:
        max_range_m: Vessels at a greater depth are never detected.
        min_box_px: Vessels whose box is narrower or lower are never detected.
        max_occlusion: Vessels of which a larger share is hidden are never detected; unknown shares pass.
        update_interval_s: The detector runs at the first frame at or after each multiple of this.
        max_detections: Only so many detections of each frame are output, the most confident ones.
    """

    max_range_m: float | None = None
    min_box_px: float | None = None
    max_occlusion: float | None = None
    update_interval_s: float | None = None
    max_detections: int | None = None

    def due(self, frames: CameraFrames) -> Mask:
        """At which frames the detector runs, shape (S,)."""
        if self.update_interval_s is None:
            return np.ones(len(frames), dtype=bool)
        previous_s = 0.0 if math.isinf(frames.previous_s) else frames.previous_s
        intervals = np.floor(np.concatenate([[previous_s], frames.times_s]) / self.update_interval_s + _EARLY)
        if math.isinf(frames.previous_s):
            intervals[0] = -1  # a camera's first frame is always due
        due: Mask = np.diff(intervals) > 0
        return due

    def passed(self, frames: CameraFrames, targets: Targets) -> Mask:
        """Which targets can be detected at all, shape (n,)."""
        passed = self.due(frames)[targets.frame]
        if self.max_range_m is not None:
            passed &= targets.depth_m <= self.max_range_m
        if self.min_box_px is not None:
            passed &= np.all(sizes(targets.boxes_px) >= self.min_box_px, axis=1)
        if self.max_occlusion is not None:
            passed &= ~(1 - targets.visible_fraction > self.max_occlusion)
        return passed

    def most_confident(self, frame: Indices, confidence: Array, key: Array) -> Mask:
        """Which detections are output, given their frame, confidence and a key that breaks ties, shapes (m,)."""
        if self.max_detections is None:
            return np.ones(len(frame), dtype=bool)
        order = np.lexsort((key, -confidence, frame))
        ordered = frame[order]
        rank = np.arange(len(frame)) - np.searchsorted(ordered, ordered)
        kept = np.empty(len(frame), dtype=bool)
        kept[order] = rank < self.max_detections
        return kept
