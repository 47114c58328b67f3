"""The shapes that box errors may have: distributions of four numbers with mean zero and the identity as covariance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from modsim3d.arrays import Array

ERROR_NORMALS = 4
"""Standard normal numbers that every box error is made from: one for each component."""


class ErrorDistribution(Protocol):
    """A distribution of standardised errors, made from independent standard normal numbers.

    Its dataclass fields are the keys that `box_error` has for it in a detector file.
    """

    @property
    def extra_normals(self) -> int:
        """Normal numbers that an error needs beyond `ERROR_NORMALS`."""

    def standardise(self, latent: Array) -> Array:
        """Standardised errors from normal numbers of shape (..., 4 + extra), shape (..., 4)."""


@dataclass(frozen=True)
class Normal:
    """The multivariate normal distribution (Jessen & Mohr (2023), section 7.6.2)."""

    extra_normals = 0

    def standardise(self, latent: Array) -> Array:
        """The numbers themselves."""
        return latent[..., :ERROR_NORMALS]


ERROR_DISTRIBUTIONS: Mapping[str, type[ErrorDistribution]] = {"normal": Normal}
"""By the name that `box_error.law` has in a detector file."""
