"""The shapes that box errors may have: distributions of four numbers with mean zero and the identity as covariance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from modsim3d.arrays import Array

ERROR_NORMALS = 4
"""Standard normal numbers that every box error is made from: one for each component."""


class ErrorDistribution(Protocol):
    """A distribution of standardised errors: four independent standard normal numbers times one random scale.

    Its dataclass fields are the keys that `box_error` has for it in a detector file.
    """

    @property
    def extra_normals(self) -> int:
        """Normal numbers that the scale is made from."""

    def scales(self, extra: Array) -> Array:
        """Scales from independent standard normal numbers of shape (..., extra), shape (...)."""


@dataclass(frozen=True)
class Normal:
    """The multivariate normal distribution (Jessen & Mohr (2023), section 7.6.2)."""

    extra_normals = 0

    def scales(self, extra: Array) -> Array:
        """One, shape (...)."""
        return np.ones(extra.shape[:-1])


def standardised(distribution: ErrorDistribution, latent: Array) -> Array:
    """Standardised errors from normal numbers of shape (..., at least 4 + extra), shape (..., 4)."""
    normal, extra = latent[..., :ERROR_NORMALS], distribution.extra_normals
    if not extra:
        return normal
    return normal * distribution.scales(latent[..., ERROR_NORMALS : ERROR_NORMALS + extra])[..., None]


ERROR_DISTRIBUTIONS: Mapping[str, type[ErrorDistribution]] = {"normal": Normal}
"""By the name that `box_error.law` has in a detector file."""
