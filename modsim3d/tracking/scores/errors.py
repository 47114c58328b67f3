"""How far tracks are from the vessels that they follow, and whether their covariances say so."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array
from modsim3d.core.boxes import errors_between
from modsim3d.tracking.scores.scored import Scored

_LEAST_CONDITION = 1e-12


@dataclass(frozen=True)
class Errors:
    """Errors over the pairs of a scored vessel and the track that follows it; None where there is no pair.

    Attributes:
        error_pairs: Number of pairs.
        rmse_px: Root of the mean squared distance of the centres.
        median_error_px: Median distance of the centres.
        rmse_width_px: Root of the mean squared error of the width.
        rmse_height_px: That of the height.
        nees: Mean of the normalised estimation error squared of the centre; 2 is expected. None without covariances,
            infinite where one is singular.
        anees: NEES / 2, the number of its dimensions; 1 is expected.
        nees_pairs: Number of pairs with a covariance.
        singular_covariances: Number of those whose covariance is not positive definite.
    """

    error_pairs: int
    rmse_px: float | None
    median_error_px: float | None
    rmse_width_px: float | None
    rmse_height_px: float | None
    nees: float | None
    anees: float | None
    nees_pairs: int
    singular_covariances: int


def errors(scored: Scored) -> Errors:
    """Errors over all pairs.

    Errors of consecutive frames are correlated, so the chi-square interval of NEES does not hold over frames: take an
    interval over runs.
    """
    error_px, squares = _pair_errors(scored)
    if not len(error_px):
        return Errors(0, None, None, None, None, None, None, 0, 0)
    distance = np.hypot(error_px[:, 0], error_px[:, 1])
    given = squares[~np.isnan(squares)]
    mean = float(given.mean()) if len(given) else None
    return Errors(
        len(error_px),
        _root_mean_square(distance),
        float(np.median(distance)),
        _root_mean_square(error_px[:, 2]),
        _root_mean_square(error_px[:, 3]),
        mean,
        None if mean is None else mean / 2,
        len(given),
        int(np.isinf(given).sum()),
    )


def nees(errors: Array, covariances: Array) -> Array:
    """Normalised estimation errors squared e' P⁻¹ e (Bar-Shalom et al. (2001), equation 5.4.2-1), shape (k,).

    Jessen & Mohr (2023) misplace the transpose in equation 2.2, and leave out 1/n in that of ANEES, 2.3.

    Args:
        errors: Estimate minus truth, shape (k, d).
        covariances: P, positive definite, shape (k, d, d). NaN in either gives NaN.
    """
    known = np.isfinite(covariances).all(axis=(1, 2)) & np.isfinite(errors).all(axis=1)
    found = np.full(len(errors), np.nan)
    wanted = errors[known, :, None]
    found[known] = (wanted * np.linalg.solve(covariances[known], wanted)).sum(axis=(1, 2))
    return found


def nees_or_infinity(error: Array, covariance: Array) -> Array:
    """NEES of k errors whose covariances may be singular: infinite where they are not positive definite, shape (k,).

    The smallest eigenvalue must be above 10⁻¹² of the largest. Where error or covariance is unknown, so is NEES: NaN.
    """
    squares = np.full(len(error), np.nan)
    given = np.flatnonzero(np.isfinite(covariance).all(axis=(1, 2)) & np.isfinite(error).all(axis=1))
    spread = np.linalg.eigvalsh(covariance[given])
    regular = (spread[:, 0] > 0) & (spread[:, 0] >= _LEAST_CONDITION * spread[:, -1])
    squares[given[~regular]] = np.inf
    good = given[regular]
    squares[good] = nees(error[good], covariance[good])
    return squares


def _pair_errors(scored: Scored) -> tuple[Array, Array]:
    """Errors of centre x, centre y, width and height of each pair, shape (m, 4), and its NEES, shape (m,)."""
    vessels, tracks = scored.pairs
    following = scored.following
    error_px = errors_between(following.tracks.boxes_px[tracks], following.truth.boxes_px[vessels])
    return error_px, nees_or_infinity(error_px[:, :2], following.tracks.covariance_px2[tracks])


def _root_mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
