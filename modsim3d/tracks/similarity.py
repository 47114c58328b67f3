"""How alike a track's box and a vessel's are, from 0 to 1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from modsim3d.arrays import Array
from modsim3d.boxes import centres, iou
from modsim3d.errors import ModsimError

SimilarityName = Literal["iou", "centre"]


@dataclass(frozen=True)
class Similarity:
    """A similarity of boxes, and from where on a track follows a vessel.

    Attributes:
        name: `iou`: intersection over union; `centre`: 1 − distance of the centres / scale, and 0 beyond the scale.
        scale_px: The scale of `centre`, in pixels.
        least: The least similarity of a match.
    """

    name: SimilarityName = "iou"
    scale_px: float | None = None
    least: float = 0.5

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ModsimError: `centre` has no scale, `iou` has one, or a value is out of range.
        """
        if self.name == "centre" and self.scale_px is None:
            raise ModsimError("--similarity centre needs --scale, the distance in pixels at which it is 0")
        if self.name == "iou" and self.scale_px is not None:
            raise ModsimError("--scale is for --similarity centre")
        if self.scale_px is not None and not 0 < self.scale_px < np.inf:
            raise ModsimError(f"--scale must be above 0 (got {self.scale_px:g})")
        if not 0 < self.least <= 1:
            raise ModsimError(f"--threshold must be above 0 and at most 1 (got {self.least:g})")

    def __str__(self) -> str:
        """The similarity in words."""
        return "IoU" if self.scale_px is None else f"1 - distance of centres / {self.scale_px:g} px"

    def __call__(self, a_px: Array, b_px: Array) -> Array:
        """Similarity of boxes pair by pair; shapes broadcast, as (n, 1, 4) and (m, 4) to (n, m)."""
        if self.scale_px is None:
            return iou(a_px, b_px)
        distance = np.hypot(*np.moveaxis(centres(a_px) - centres(b_px), -1, 0))
        alike: Array = np.maximum(1 - distance / self.scale_px, 0)
        return alike
