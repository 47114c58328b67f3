"""Confidences of true and of false detections, with what they may depend on."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import Literal

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import sizes
from modsim3d.learn.observed.observed import Observed

Kind = Literal["true", "false"]
KINDS: tuple[Kind, Kind] = ("true", "false")


@dataclass(frozen=True, eq=False)
class Scores:
    """Confidences of some detections: values, images and states, shapes (n,).

    Attributes:
        visible_fraction: Of the detected vessel, NaN where there is none or where it is unknown, shape (n,).
        log_size: Logarithm to base two of the side of a square as large as the detected box, in pixels, shape (n,).
    """

    values: Array
    image: Indices
    state: Indices
    visible_fraction: Array
    log_size: Array

    @classmethod
    def of(cls, observed: Observed, kind: Kind) -> Scores:
        """Confidences of true or false detections."""
        results = observed.labelled.results
        rows = observed.detection[observed.found] if kind == "true" else observed.false
        visible = np.full(len(rows), np.nan)
        if kind == "true":
            visible = observed.labelled.annotations.visible_fraction[observed.rows[observed.found]]
        image = results.image[rows]
        area = np.prod(np.maximum(sizes(results.boxes_px[rows]), 1e-6), axis=1)
        return cls(results.confidence[rows], image, observed.image_state[image], visible, np.log2(area) / 2)

    def __len__(self) -> int:
        """Number of detections."""
        return len(self.values)

    def __add__(self, other: Scores) -> Scores:
        """The detections of both."""
        return Scores(*(np.concatenate(pair) for pair in zip(astuple(self), astuple(other), strict=True)))

    @property
    def hidden(self) -> Array:
        """Hidden share of the vessel, 0 where unknown, shape (n,)."""
        hidden: Array = 1 - np.where(np.isfinite(self.visible_fraction), self.visible_fraction, 1.0)
        return hidden

    def of_state(self, state: int) -> Scores:
        """Those of one state."""
        return self.chosen(self.state == state)

    def chosen(self, rows: Mask | Indices) -> Scores:
        """Some of them."""
        return Scores(*(column[rows] for column in astuple(self)))
