"""How far tracks are from the vessels that they follow, and whether their covariances say so."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.boxes import errors_between
from modsim3d.tracking.scores.scored import Scored

_LEAST_CONDITION = 1e-12
"""A covariance whose smallest eigenvalue is below this share of its largest is taken as singular."""


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
            and where one is singular, because it would be infinite.
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


@dataclass(frozen=True, eq=False)
class IdentityErrors:
    """Errors of each followed identity, for intervals over vessels or runs: v rows.

    Attributes:
        identity: Number of the identity in the truth, shape (v,).
        pairs: Number of its pairs, shape (v,).
        mean_square_px2: Mean squared distance of the centres, shape (v,).
        nees: Mean NEES, NaN without covariances and infinite where one is singular, shape (v,).
    """

    identity: Indices
    pairs: Indices
    mean_square_px2: Array
    nees: Array


def errors(scored: Scored) -> Errors:
    """Errors over all pairs.

    Errors of consecutive frames are correlated, so the chi-square interval of NEES does not hold over frames; take an
    interval over vessels (`identity_errors`) or runs.
    """
    error_px, nees = _pair_errors(scored)
    if not len(error_px):
        return Errors(0, None, None, None, None, None, None, 0, 0)
    distance = np.hypot(error_px[:, 0], error_px[:, 1])
    given = nees[~np.isnan(nees)]
    mean = float(given.mean()) if len(given) and np.isfinite(given).all() else None
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


def identity_errors(scored: Scored) -> IdentityErrors:
    """Errors over the pairs of each identity."""
    error_px, nees = _pair_errors(scored)
    vessels, _ = scored.pairs
    identity, row, pairs = np.unique(scored.following.truth.identity[vessels], return_inverse=True, return_counts=True)
    square = np.bincount(row, (error_px[:, :2] ** 2).sum(axis=1), len(identity))
    given = ~np.isnan(nees)
    counts = np.bincount(row[given], minlength=len(identity))
    sums = np.bincount(row[given], nees[given], len(identity))
    means = np.divide(sums, counts, out=np.full(len(identity), np.nan), where=counts > 0)
    return IdentityErrors(identity, pairs, square / np.maximum(pairs, 1), means)


def normalised_squares(error: Array, covariance: Array) -> Array:
    """NEES of each of k errors: e' P⁻¹ e (Bar-Shalom et al. (2001), section 5.4.2), in d dimensions, shape (k,).

    Jessen & Mohr (2023) misplace the transpose in equation 2.2, and leave out 1/n in that of ANEES, 2.3.

    Args:
        error: Estimate minus truth, shape (k, d).
        covariance: P, shape (k, d, d).

    Returns:
        NaN where the covariance is not finite; infinite where it is not positive definite.
    """
    squares = np.full(len(error), np.nan)
    given = np.flatnonzero(np.isfinite(covariance).all(axis=(1, 2)))
    spread = np.linalg.eigvalsh(covariance[given])
    regular = (spread[:, 0] > 0) & (spread[:, 0] >= _LEAST_CONDITION * spread[:, -1])
    squares[given[~regular]] = np.inf
    good = given[regular]
    squares[good] = (error[good] * np.linalg.solve(covariance[good], error[good][..., None])[..., 0]).sum(axis=1)
    return squares


def _pair_errors(scored: Scored) -> tuple[Array, Array]:
    """Errors of centre x, centre y, width and height of each pair, shape (m, 4), and its NEES, shape (m,)."""
    vessels, tracks = scored.pairs
    following = scored.following
    error_px = errors_between(following.tracks.boxes_px[tracks], following.truth.boxes_px[vessels])
    return error_px, normalised_squares(error_px[:, :2], following.tracks.covariance_px2[tracks])


def _root_mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
