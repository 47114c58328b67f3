"""What a tracker answers about a camera, checked: a tracker may be anybody's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Self

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.errors import ModsimError
from modsim3d.tracking.trackers.interface import CameraFacts, TrackedFrame
from modsim3d.tracks.credibility import FAR, covariances, far_tracks

Named = Callable[[int, str], ModsimError]
"""The error of a problem in a frame, by the frame's place in the sequence."""
_SYMMETRIC = 1e-6
"""Largest difference of the two covariances of x and y, as a share of the variances."""


class Answers:
    """The answers to some frames of a camera, as columns: k rows, in the order of the frames.

    Attributes:
        frame: Place of the frame in the sequence, shape (k,).
        track: Number that the tracker gave the track, shape (k,).
        boxes_px: x_min, y_min, x_max, y_max, shape (k, 4).
        label: Index of the label, −1 for none, shape (k,).
        confidence: NaN for none, shape (k,).
        covariance_px2: NaN for none, shape (k, 2, 2).
    """

    def __init__(self, answers: Sequence[TrackedFrame], facts: CameraFacts, problem: Named) -> None:
        """Join answers, one for each frame, and check them.

        Args:
            answers: The answers.
            facts: The camera.
            problem: Makes the error.

        Raises:
            ModsimError: One is not what a tracker answers.
        """
        columns = [_columns(answer, partial(problem, at)) for at, answer in enumerate(answers)]
        counts = [len(each[0]) for each in columns]
        self.frame: Indices = np.repeat(np.arange(len(columns)), counts)
        empty = _columns(TrackedFrame.empty(), partial(problem, 0))
        self.track, self.boxes_px, self.label, self.confidence, self.covariance_px2 = (
            np.concatenate(parts) for parts in zip(empty, *columns, strict=True)
        )
        self._refuse(problem, len(facts.labels), np.array(facts.image_size_px))

    def _refuse(self, problem: Named, labels: int, image_px: Array) -> None:
        """Refuse values that cannot be."""
        x_min, y_min, x_max, y_max = self.boxes_px.T
        order = np.lexsort((self.track, self.frame))
        twice = np.zeros(len(order), dtype=bool)
        twice[order[1:]] = (np.diff(self.frame[order]) == 0) & (np.diff(self.track[order]) == 0)
        confidence = self.confidence
        checks: tuple[tuple[Mask, str, Array | Indices], ...] = (
            (twice, "two boxes have the track", self.track),
            (~np.isfinite(self.boxes_px).all(axis=1), "a box must be finite, not", self.boxes_px),
            (
                ~((x_max > x_min) & (y_max > y_min)),
                "a box is x_min, y_min, x_max, y_max, with a positive width and height, not",
                self.boxes_px,
            ),
            (
                (self.label < -1) | (self.label >= labels),
                f"a label is an index from 0 to {labels - 1}, or -1 for none, not",
                self.label,
            ),
            (
                ~np.isnan(confidence) & ~((confidence >= 0) & (confidence <= 1)),
                "a confidence is from 0 to 1, not",
                confidence,
            ),
            (far_tracks(self.boxes_px, self.track, image_px), f"{FAR}:", self.boxes_px),
            (~_possible(self.covariance_px2), "this is no covariance of x and y:", self.covariance_px2),
        )
        for wrong, text, column in checks:
            if wrong.any():
                row = int(np.argmax(wrong))
                raise problem(int(self.frame[row]), f"track {self.track[row]}: {text} {_shown(column[row])}")

    def numbered(self) -> Self:
        """Number the tracks 1, 2, … in order of their first box, as nobody else's numbers start where they did."""
        _, first, inverse = np.unique(self.track, return_index=True, return_inverse=True)
        rank = np.empty(len(first), dtype=np.int64)
        rank[np.argsort(first)] = np.arange(1, len(first) + 1)
        self.track = rank[inverse.reshape(-1)]
        return self


def _columns(answer: TrackedFrame, refuse: Callable[[str], ModsimError]) -> tuple[Any, ...]:
    """Columns of an answer, of the right types and shapes."""
    if not isinstance(answer, TrackedFrame):
        raise refuse(f"the answer to a frame is a modsim3d.TrackedFrame, not {type(answer).__name__}")
    track = np.asarray(answer.track)
    if track.ndim != 1:
        raise refuse(f"TrackedFrame.track has one number for each track, shape (k,); got the shape {track.shape}")
    count = len(track)
    if count and not np.issubdtype(track.dtype, np.integer):
        raise refuse(f"TrackedFrame.track must be integers, not {track.dtype}")
    label = np.full(count, -1) if answer.label is None else np.asarray(answer.label)
    if count and not np.issubdtype(label.dtype, np.integer):
        raise refuse(f"TrackedFrame.label must be integers, not {label.dtype}")
    return (
        track.astype(np.int64),
        _floats(answer.boxes_px, "boxes_px", (count, 4), refuse),
        _shaped(label, "label", (count,), refuse).astype(np.int64),
        _floats(answer.confidence, "confidence", (count,), refuse),
        _floats(answer.covariance_px2, "covariance_px2", (count, 2, 2), refuse),
    )


def _floats(value: Any, name: str, shape: tuple[int, ...], refuse: Callable[[str], ModsimError]) -> Array:
    if value is None and name != "boxes_px":
        return np.full(shape, np.nan)
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise refuse(f"TrackedFrame.{name} must be an array of numbers of the shape {shape}") from None
    shaped: Array = _shaped(array, name, shape, refuse)
    return shaped


def _shaped(array: Any, name: str, shape: tuple[int, ...], refuse: Callable[[str], ModsimError]) -> Any:
    if not array.size and not shape[0]:
        return np.empty(shape, dtype=array.dtype)  # an empty list has no second axis
    if array.shape != shape:
        raise refuse(f"TrackedFrame.{name} must have the shape {shape} with {shape[0]} tracks; got {array.shape}")
    return array


def _possible(covariance: Array) -> Mask:
    """Whether each matrix is a covariance, or NaN throughout, shape (k,)."""
    xx, xy, yx, yy = covariance.reshape(-1, 4).T
    alike = np.abs(xy - yx) <= _SYMMETRIC * (xx + yy)
    return (alike & covariances(xx, xy, yy)) | np.isnan(covariance).all(axis=(1, 2))


def _shown(value: Any) -> str:
    return ", ".join(f"{number:g}" for number in np.ravel(value).tolist())
