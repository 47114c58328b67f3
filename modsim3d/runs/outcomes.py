"""How each detection turned out: right, of another class than its vessel, with a bad box, or false."""

from __future__ import annotations

from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array, Mask
from modsim3d.boxes import iou
from modsim3d.detector.records import FALSE_KINDS, KINDS
from modsim3d.runs.frames import Frame

FALSE_NAMES = frozenset(KINDS[kind] for kind in FALSE_KINDS)
GOOD_IOU = 0.5
"""A box with a smaller IoU with its vessel's annotated box is a bad one."""


class Outcome(IntFlag):
    """What is wrong with a detection; 0 if nothing is. The names are those of the counts in `run.json`.

    Attributes:
        FALSE_POSITIVE: It is not the one detection of a vessel; its kind says what it is.
        MISLABELLED: It has another label than its vessel.
        BELOW_HALF_IOU: Its box has IoU < 0.5 with its vessel's annotated box.
        OFF_VESSEL: Its box does not even touch that box; `BELOW_HALF_IOU` is set too.
    """

    FALSE_POSITIVE = 1
    MISLABELLED = 2
    BELOW_HALF_IOU = 4
    OFF_VESSEL = 8


NOTHING_WRONG = Outcome(0)
Outcomes = NDArray[np.uint8]
"""Flags of `Outcome`, shape (m,)."""


def outcomes(false: Mask, mislabelled: Mask, boxes_px: Array, annotated_px: Array) -> Outcomes:
    """The outcome of each of m detections.

    Args:
        false: Which are false positives, shape (m,). What follows says nothing about these.
        mislabelled: Which have another label than their vessel, shape (m,).
        boxes_px: Their boxes, shape (m, 4).
        annotated_px: The annotated boxes of their vessels, shape (m, 4).
    """
    overlap = iou(boxes_px, annotated_px)
    flags = (
        Outcome.MISLABELLED * mislabelled
        | Outcome.BELOW_HALF_IOU * (overlap < GOOD_IOU)
        | Outcome.OFF_VESSEL * (overlap == 0)
    )
    return np.where(false, Outcome.FALSE_POSITIVE, flags).astype(np.uint8)


def having(found: Outcomes, flag: Outcome) -> Mask:
    """Which outcomes have a flag, shape (m,)."""
    mask: Mask = (found & flag) > 0
    return mask


def frame_outcomes(frame: Frame) -> list[Outcome]:
    """The outcome of each detection of a frame."""
    truth, found, rows = frame.truth, frame.detections, detected_rows(frame)
    names = zip(found.labels, rows, strict=True)
    mislabelled = np.array([row is not None and label != truth.labels[row] for label, row in names], dtype=bool)
    false = np.array([row is None for row in rows], dtype=bool)
    annotated_px = np.full((len(rows), 4), np.nan)
    annotated_px[~false] = truth.boxes_px[[row for row in rows if row is not None]]
    flags = outcomes(false, mislabelled, found.boxes_px, annotated_px)
    return [Outcome(each) for each in flags.tolist()]


def detected_rows(frame: Frame) -> list[int | None]:
    """Row of a frame's truth that each of its detections detects, None for a false positive.

    A duplicate and the smaller part of a split box are false positives, though they come from a vessel.
    """
    row_of: dict[str | None, int] = {vessel: row for row, vessel in enumerate(frame.truth.vessels)}
    found = zip(frame.detections.kinds, frame.detections.vessels, strict=True)
    return [None if kind in FALSE_NAMES or vessel is None else row_of[vessel] for kind, vessel in found]
