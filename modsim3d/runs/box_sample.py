"""A sample of the boxes that a run's detector was given, and what resampling does to the errors of such boxes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from modsim3d.arrays import Array
from modsim3d.detector.box_error import BoxErrorSource
from modsim3d.detector.records import TRUE
from modsim3d.detector.truncation import truncated_errors
from modsim3d.runs.blocks import Block
from modsim3d.scene.scene import Scene
from modsim3d.truth.modes import annotation_boxes

BOXES_A_STATE, POINTS_A_BOX = 32, 1024
"""Few enough that a run hardly takes longer; the standard error beside the mean says what so few boxes leave open."""
_MIX = np.array([2_654_435_761, 40_503, 97_003], dtype=np.int64)
_RANGE = 2**32


def _empty() -> Array:
    return np.empty((0, 7))


@dataclass(frozen=True, eq=False)
class BoxSample:
    """Boxes spread evenly over a run, the same however it was split into blocks.

    Attributes:
        rows: Key, state, camera and annotated box of each, in order of state and key, shape (n, 7): the least keys of
            each state.
        counts: How many detections of a vessel each state had in all, by the state's index.
    """

    rows: Array = field(default_factory=_empty)
    counts: dict[int, int] = field(default_factory=dict)

    @classmethod
    def of(cls, block: Block, scene: Scene) -> BoxSample:
        """Sample the boxes of a block."""
        pieces, counts = [_empty()], dict[int, int]()
        for part in block.cameras:
            drawn, truth = part.detections, part.truth
            found = np.flatnonzero(drawn.kind == TRUE)
            rows, state = part.truth_row[found], drawn.states[drawn.frame[found]]
            keys = np.stack([truth.step[rows], truth.vessel[rows], truth.camera[rows]], axis=1) @ _MIX % _RANGE
            boxes = annotation_boxes(truth, scene.annotation.mode)[rows]
            pieces.append(np.column_stack([keys, state, truth.camera[rows], boxes]))
            for index, count in zip(*np.unique(state, return_counts=True), strict=True):
                counts[int(index)] = counts.get(int(index), 0) + int(count)
        return cls(_least(np.concatenate(pieces)), counts)

    def __add__(self, other: BoxSample) -> BoxSample:
        """Keep the least keys of both."""
        counts = {
            state: self.counts.get(state, 0) + other.counts.get(state, 0) for state in {*self.counts, *other.counts}
        }
        return BoxSample(_least(np.concatenate([self.rows, other.rows])), counts)

    def truncation(self, scene: Scene) -> dict[str, dict[str, Any]]:
        """What resampling degenerate boxes does to the errors, by name of the state, ready for a file.

        In the units of the detector file, averaged over the sampled boxes: the share of first draws that are
        resampled, the mean and covariance that are left, and the standard error of that mean from the sampling.
        """
        source = BoxErrorSource.from_model(scene.detector)
        report = {}
        for index, performance in enumerate(scene.detector.states):
            ours = self.rows[self.rows[:, 1] == index]
            if not len(ours):
                continue
            left = [
                truncated_errors(
                    source,
                    index,
                    ours[ours[:, 2] == number, 3:],
                    camera.intrinsics.image_size_px,
                    in_file_units=True,
                    points=POINTS_A_BOX,
                )
                for number, camera in enumerate(scene.cameras)
            ]
            means = np.concatenate([part.means for part in left])
            mean = means.mean(axis=0)
            covariance = np.concatenate([part.second_moments for part in left]).mean(axis=0) - np.outer(mean, mean)
            report[performance.name] = {
                "unit": performance.box_error.unit,
                "detections": self.counts[index],
                "boxes": len(ours),
                "redrawn": _rounded(1 - np.concatenate([part.accepted for part in left]).mean()),
                "mean": _rounded(mean),
                "mean_shift": _rounded(mean - performance.box_error.mean),
                "mean_standard_error": _rounded(means.std(axis=0) / np.sqrt(len(means))),
                "covariance": _rounded(covariance),
            }
        return report


def _least(rows: Array) -> Array:
    """The rows with the least keys of each state, in order."""
    ordered = rows[np.lexsort((*rows.T[:1:-1], rows[:, 0], rows[:, 1]))]
    rank = np.arange(len(ordered)) - np.searchsorted(ordered[:, 1], ordered[:, 1])
    least: Array = ordered[rank < BOXES_A_STATE]
    return least


def _rounded(values: Any) -> Any:
    """Round to six digits: as precise as the integration, and the order of sums does not show."""
    return np.vectorize(lambda value: float(f"{value:.6g}"))(values).tolist()
