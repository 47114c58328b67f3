"""Detections without what could tell where they came from: what a tracker may read of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.detector.records import Detections

BOX_DECIMALS = 3
"""Of a box's edges in pixels: the last bits of exact edges tell true detections from false ones."""
_CONFIDENCE_DECIMALS = 6
"""The last bits of exact ones tell some false detections from true ones, which more goes into."""


@dataclass(frozen=True, eq=False)
class Told:
    """Detections as a tracker may read them: m rows by frame, the most confident of a frame first.

    Attributes:
        frame: Number of the frame, shape (m,).
        label: Index of the label, shape (m,).
        boxes_px: x_min, y_min, x_max, y_max, rounded, shape (m, 4).
        confidence: Rounded, shape (m,).
    """

    frame: Indices
    label: Indices
    boxes_px: Array
    confidence: Array

    @classmethod
    def of(cls, detections: Detections) -> Told:
        """What a tracker may read of a detector's detections."""
        return told(detections.frame, detections.label, detections.boxes_px, detections.confidence)

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.frame)

    def take(self, chosen: Mask | Indices) -> Self:
        """The chosen rows."""
        return type(self)(**{name: column[chosen] for name, column in vars(self).items()})


def told(frame: Indices, label: Indices, boxes_px: Array, confidence: Array) -> Told:
    """Round detections, and bring them into an order that tells nothing either.

    Equally confident detections of a frame follow each other by their boxes. For the arguments see `Told`; they are in
    any order, and not rounded.
    """
    boxes_px, confidence = boxes_px.round(BOX_DECIMALS), confidence.round(_CONFIDENCE_DECIMALS)
    order = np.lexsort((-confidence, frame))
    # Few detections are equally confident: only those are put in order of their boxes.
    before, after = order[:-1], order[1:]
    same = (frame[before] == frame[after]) & (confidence[before] == confidence[after])
    if same.any():
        tied = (np.append(same, False) | np.append(False, same)).nonzero()[0]
        rows = order[tied]
        order[tied] = rows[np.lexsort((label[rows], *boxes_px[rows].T[::-1], -confidence[rows], frame[rows]))]
    return Told(frame, label, boxes_px, confidence).take(order)
