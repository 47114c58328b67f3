"""A sample of the detected boxes of a run, and how resampling shifts the errors of such boxes."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from modsim3d.arrays import Array, read_only
from modsim3d.detector.box_error import BoxErrorSource
from modsim3d.detector.records import TRUE
from modsim3d.detector.truncation import truncated_errors
from modsim3d.runs.blocks import Block
from modsim3d.scene.scene import Scene
from modsim3d.truth.modes import annotation_boxes

BOXES_A_STATE, POINTS_A_BOX = 32, 1024
"""Few enough that a run hardly takes longer; the standard error beside the mean shows how much so few boxes tell."""
_MIX = np.array([2_654_435_761, 40_503, 97_003], dtype=np.int64)
_RANGE = 2**32
_NO_ROWS = read_only(np.empty((0, 7)))


@dataclass(frozen=True, eq=False)
class BoxSample:
    """Boxes spread evenly over a run, the same however it was split into blocks.

    Each box has a key, a hash of its step, vessel and camera. Of each state the boxes with the least keys are kept.

    Attributes:
        rows: Key, state, camera and annotated box in pixels, in order of state and key, shape (n, 7).
        counts: State → number of detections of a vessel in that state, whether kept or not.
    """

    rows: Array = field(default_factory=lambda: _NO_ROWS)
    counts: Counter[int] = field(default_factory=Counter)

    @classmethod
    def of(cls, block: Block, scene: Scene) -> BoxSample:
        """Sample the boxes of a block."""
        pieces, counts = [_NO_ROWS], Counter[int]()
        for part in block.cameras:
            detections, truth = part.detections, part.truth
            found = np.flatnonzero(detections.kind == TRUE)
            rows, state = part.truth_row[found], detections.states[detections.frame[found]]
            keys = np.stack([truth.step[rows], truth.vessel[rows], truth.camera[rows]], axis=1) @ _MIX % _RANGE
            boxes = annotation_boxes(truth, scene.annotation.mode)[rows]
            pieces.append(np.column_stack([keys, state, truth.camera[rows], boxes]))
            counts.update(state.tolist())
        return cls(_least(np.concatenate(pieces)), counts)

    def __add__(self, other: BoxSample) -> BoxSample:
        """Keep the least keys of both."""
        return BoxSample(_least(np.concatenate([self.rows, other.rows])), self.counts + other.counts)

    def truncation(self, scene: Scene) -> dict[str, dict[str, Any]]:
        """How resampling shifts the box errors, by name of the state, as `run.json` has it.

        In the units of the detector file, averaged over the sampled boxes: the share of first draws that are
        resampled, the mean and covariance after resampling, and the standard error of that mean.
        """
        source = BoxErrorSource.from_model(scene.detector)
        report = {}
        for index, performance in enumerate(scene.detector.states):
            ours = self.rows[self.rows[:, 1] == index]
            if not len(ours):
                continue
            kept = []
            for number, camera in enumerate(scene.cameras):
                boxes, image = ours[ours[:, 2] == number, 3:], camera.intrinsics.image_size_px
                kept.append(truncated_errors(source, index, boxes, image, in_file_units=True, points=POINTS_A_BOX))
            means = np.concatenate([part.means for part in kept])
            mean = means.mean(axis=0)
            covariance = np.concatenate([part.second_moments for part in kept]).mean(axis=0) - np.outer(mean, mean)
            report[performance.name] = {
                "unit": performance.box_error.unit,
                "detections": self.counts[index],
                "boxes": len(ours),
                "redrawn": _rounded(1 - np.concatenate([part.accepted for part in kept]).mean()),
                "mean": _rounded(mean),
                "mean_shift": _rounded(mean - performance.box_error.mean),
                "mean_standard_error": _rounded(means.std(axis=0) / np.sqrt(len(means))),
                "covariance": _rounded(covariance),
            }
        return report


def _least(rows: Array) -> Array:
    """The rows with the least keys of each state, in order."""
    kept = [_NO_ROWS]
    for state in np.flatnonzero(np.bincount(rows[:, 1].astype(np.int64))):  # np.unique imports masked arrays
        ours = rows[rows[:, 1] == state]
        if len(ours) > BOXES_A_STATE:  # few rows are sorted faster than many
            ours = ours[ours[:, 0] <= np.partition(ours[:, 0], BOXES_A_STATE - 1)[BOXES_A_STATE - 1]]
        kept.append(ours[np.lexsort((*ours.T[:1:-1], ours[:, 0]))][:BOXES_A_STATE])
    return np.concatenate(kept)


def _rounded(values: Any) -> Any:
    """Round to six digits: as precise as the integration, and coarse enough to hide the order of sums."""
    rows = np.asarray(values).tolist()
    return [_rounded(row) for row in rows] if isinstance(rows, list) else float(f"{rows:.6g}")
