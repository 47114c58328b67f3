"""The shapes that box errors may have: distributions of four numbers with mean zero and the identity as covariance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from scipy import special

from modsim3d.arrays import Array

ERROR_NORMALS = 4
"""Standard normal numbers that every box error is made from: one for each component."""


class ErrorDistribution(Protocol):
    """A distribution of standardised errors: four independent standard normal numbers times one random scale.

    Attributes:
        keys: What `box_error` has for it in a detector file: its fields.
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
    """The multivariate t distribution, scaled to have the identity as covariance.

    A normal number times √((ν − 2) / w), with w chi-square of ν degrees of freedom and common to the four components.

    Attributes:
        degrees_of_freedom: ν, above 2: with less there is no covariance.
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
    return normal * distribution.scales(latent[..., ERROR_NORMALS : ERROR_NORMALS + extra])[..., None]


ERROR_DISTRIBUTIONS: Mapping[str, type[ErrorDistribution]] = {"normal": Normal, "student_t": StudentT}
"""By the name that `box_error.law` has in a detector file."""
