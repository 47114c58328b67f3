"""How large false positives are."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import special

from modsim3d.arrays import Array
from modsim3d.detector.census import TargetCensus
from modsim3d.random_streams import normals

_LN_2 = math.log(2)


class Sizes(Protocol):
    """A distribution of width and height."""

    def at(self, uniforms: Array) -> Array:
        """Width and height from one uniform number each, shape (m, 2)."""


@dataclass(frozen=True)
class FixedSize:
    """All the same."""

    width_px: float
    height_px: float

    def at(self, uniforms: Array) -> Array:
        """The same for all numbers, shape (m, 2)."""
        return np.tile([self.width_px, self.height_px], (len(uniforms), 1))


@dataclass(frozen=True)
class LognormalSize:
    """One aspect ratio, with a size whose logarithm is normal."""

    width_px: float
    height_px: float
    log_std: float

    def at(self, uniforms: Array) -> Array:
        """The median box, scaled, shape (m, 2)."""
        scale: Array = special.exp2(self.log_std / _LN_2 * normals(uniforms))
        return scale[:, None] * [self.width_px, self.height_px]


@dataclass(frozen=True, eq=False)
class SceneSizes:
    """The sizes of the scene's annotated boxes, over all its steps."""

    census: TargetCensus

    def at(self, uniforms: Array) -> Array:
        """The size of one of them each, shape (m, 2)."""
        return self.census.sizes_px(uniforms)
