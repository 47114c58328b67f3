"""The distribution of box errors in a performance state, and the distributions of standardised errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Literal, Protocol

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Mask, read_only
from modsim3d.random_streams import on_grid

ERROR_NORMALS = 4
"""Standard normal numbers that every box error is made from: one for each component."""
ErrorUnit = Literal["px", "relative", "mixed"]


class ErrorDistribution(Protocol):
    """A distribution of standardised errors: four independent standard normal numbers times one random scale.

    Its mean is zero and its covariance the identity. `keys` are its own keys in a detector file's `box_error`: its
    fields.
    """

    keys: ClassVar[tuple[str, ...]]

    @property
    def extra_normals(self) -> int:
        """Normal numbers that the scale is made from."""

    def scales(self, extra: Array) -> Array:
        """Scales from independent standard normal numbers of shape (..., extra), shape (...)."""


@dataclass(frozen=True)
class Normal:
    """The multivariate normal distribution (Jessen & Mohr (2023), section 7.6.2)."""

    keys: ClassVar[tuple[str, ...]] = ()
    extra_normals = 0

    def scales(self, extra: Array) -> Array:
        """One, shape (...)."""
        return np.ones(extra.shape[:-1])


@dataclass(frozen=True)
class StudentT:
    """The multivariate t distribution of ν > 2 degrees of freedom, scaled to have the identity as covariance.

    A normal number times √((ν − 2) / w), with w chi-square of ν degrees of freedom and common to the four components.
    """

    degrees_of_freedom: float

    keys: ClassVar[tuple[str, ...]] = ("degrees_of_freedom",)
    extra_normals = 1

    def scales(self, extra: Array) -> Array:
        """From one normal number each, read as its probability and that as the quantile of w, shape (...)."""
        half = self.degrees_of_freedom / 2
        chi_square = 2 * special.gammaincinv(half, special.ndtr(extra[..., 0]))
        scales: Array = np.sqrt((self.degrees_of_freedom - 2) / chi_square)
        return scales


def standardised(distribution: ErrorDistribution, latent: Array) -> Array:
    """Standardised errors from normal numbers of shape (..., at least 4 + extra), shape (..., 4)."""
    normal, extra = latent[..., :ERROR_NORMALS], distribution.extra_normals
    if not extra:
        return normal
    return normal * on_grid(distribution.scales(latent[..., ERROR_NORMALS : ERROR_NORMALS + extra]))[..., None]


ERROR_DISTRIBUTIONS: Mapping[str, type[ErrorDistribution]] = {"normal": Normal, "student_t": StudentT}
"""By the name that `box_error.law` has in a detector file."""


def size_factors(sizes_px: Array, relative: Mask | bool, growths: Array) -> tuple[Array, Array]:
    """What the size of a box multiplies its errors by, and their distance from the mean besides, shapes (..., 4).

    Args:
        sizes_px: Width and height of the true box, at least a pixel, shape (..., 2).
        relative: Whether errors are in sides of the box; broadcast with shape (..., 4).
        growths: k over σ₀ of `mixed` errors, whose standard deviation is σ₀ + k·side, in 1/px; 0 for others. Broadcast
            with shape (..., 4).
    """
    sides = np.concatenate([sizes_px, sizes_px], axis=-1)
    return np.where(relative, sides, 1.0), 1 + growths * sides


@dataclass(frozen=True, eq=False)
class BoxErrorLaw:
    """The distribution of (e_x, e_y, e_w, e_h) before degenerate boxes are resampled.

    Attributes:
        mean: In pixels, or in sides of the box if relative, shape (4,).
        covariance: In the square of the mean's unit, symmetric and positive semi-definite, shape (4, 4).
        unit: `px`; `relative`, in sides of the box; or `mixed`, in pixels with standard deviations that grow.
        growth: By how many pixels mixed standard deviations grow with each pixel of the side, shape (4,).
        distribution: The distribution once mean and covariance are taken away.
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
