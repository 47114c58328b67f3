"""The distribution of box errors in a performance state, as a detector file describes it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from modsim3d.arrays import Array, read_only
from modsim3d.detector.error_distributions import ErrorDistribution, Normal

ErrorUnit = Literal["px", "relative", "mixed"]


@dataclass(frozen=True, eq=False)
class BoxErrorLaw:
    """The distribution of (e_x, e_y, e_w, e_h) before degenerate boxes are resampled.

    Attributes:
        mean: In pixels, or in sides of the box if relative, shape (4,).
        covariance: In the square of the mean's unit, symmetric and positive semi-definite, shape (4, 4).
        unit: `px`; `relative`, in sides of the box; or `mixed`, in pixels with standard deviations that grow.
        growth: By how many pixels mixed standard deviations grow with each pixel of the side, shape (4,).
        distribution: The shape of the errors once mean and covariance are taken away.
    """

    mean: Array
    covariance: Array
    unit: ErrorUnit = "px"
    growth: Array = field(default_factory=lambda: read_only(np.zeros(4)))
    distribution: ErrorDistribution = field(default_factory=Normal)

    @property
    def relative(self) -> bool:
        """Whether errors are in sides of the box."""
        return self.unit == "relative"

    @property
    def std(self) -> Array:
        """Standard deviations in the mean's unit, shape (4,)."""
        std: Array = np.sqrt(np.diag(self.covariance))
        return std
