"""A Rauch-Tung-Striebel smoother over many sequences of boxes at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from modsim3d.arrays import Array, Mask
from modsim3d.boxes import centre_form
from modsim3d.tracking.kalman import Motion
from modsim3d.tracking.oracle.noise import SmootherNoise

_FIRST_RATE_PX_S = 1000.0
"""Standard deviation of a rate before anything is known of it: beyond any vessel's."""


@dataclass(frozen=True, eq=False)
class BoxSequences:
    """I sequences of boxes, each in rows 0 to at most L − 1 from its first detection on.

    Attributes:
        boxes_px: x_min, y_min, x_max, y_max; anything where there is no detection, shape (L, I, 4).
        there: Where there is a detection; everywhere in row 0, shape (L, I).
        time_s: Time since the row before, above 0, shape (L, I).
    """

    boxes_px: Array
    there: Mask
    time_s: Array


class _Filtered(NamedTuple):
    """After a row: with its detections, and as predicted from the rows before; log-likelihood of its detections."""

    corrected: Motion
    predicted: Motion
    log_likelihood: float


def smoothed_motion(sequences: BoxSequences, noise: SmootherNoise) -> list[Motion]:
    """Centre x, centre y, width and height given all detections: for each row a motion of shape (I, 4).

    Forward a Kalman filter with constant velocity, back the recursion of Rauch, Tung & Striebel (1965), "Maximum
    likelihood estimates of linear dynamic systems", AIAA Journal 3(8). The noise of a detection goes by the size that
    the filter predicts, since the detected one has noise itself.
    """
    filtered = _filtered(sequences, noise)
    later = filtered[-1].corrected
    found = [later]
    for row in range(len(filtered) - 2, -1, -1):
        time_s = sequences.time_s[row + 1, :, None]
        later = filtered[row].corrected.smoothed(filtered[row + 1].predicted, later, time_s)
        found.append(later)
    return found[::-1]


def log_likelihood(sequences: BoxSequences, noise: SmootherNoise) -> float:
    """Of all detections after the first of each sequence, from the innovations of the filter."""
    return sum(each.log_likelihood for each in _filtered(sequences, noise))


def _filtered(sequences: BoxSequences, noise: SmootherNoise) -> list[_Filtered]:
    boxes = centre_form(sequences.boxes_px)
    motion = Motion.at(boxes[0], noise.variance_px2(boxes[0, :, 2:]), _FIRST_RATE_PX_S**2)
    found = [_Filtered(motion, motion, 0.0)]
    for row in range(1, len(boxes)):
        there = sequences.there[row]
        predicted = motion.predicted(sequences.time_s[row, :, None], noise.rate_walk_px_s)
        seen, measured = predicted.take(there), boxes[row, there]
        variance = noise.variance_px2(seen.place[:, 2:])
        total = seen.place_variance + variance
        chance = -0.5 * float(np.sum((measured - seen.place) ** 2 / total + np.log(2 * np.pi * total)))
        motion = predicted.with_rows(there, seen.corrected(measured, variance))
        found.append(_Filtered(motion, predicted, chance))
    return found
