"""GOSPA and OSPA: distances between two sets of points, from the distances between their points, in any unit."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from modsim3d.arrays import Array


class GospaParts(NamedTuple):
    """GOSPA with α = 2 and what it consists of; in one frame gospa^p = localisation + missed + false.

    Attributes:
        gospa: The distance, in the unit of the cutoff c.
        localisation: Sum of the p-th powers of the distances of pairs closer than c.
        missed: c^p / 2 for each vessel without a track closer than c.
        false: c^p / 2 for each track without a vessel closer than c.
    """

    gospa: float
    localisation: float
    missed: float
    false: float


def gospa_frame(distance: Array, cutoff: float, power: float = 1.0) -> GospaParts:
    """GOSPA of one frame (Rahmathullah et al. (2017), definition 1 and proposition 1, with α = 2).

    A pair at c or beyond costs c^p, as much as a missed vessel and a false track, and is counted as these.

    Args:
        distance: Of each of n vessels to each of m tracks, shape (n, m); n and m may be 0.
        cutoff: c > 0, in the unit of the distance.
        power: p ≥ 1.
    """
    vessels, tracks = distance.shape
    close = _paired(distance, cutoff, power)
    close = close[close < cutoff]
    alone = cutoff**power / 2
    parts = float((close**power).sum()), alone * (vessels - len(close)), alone * (tracks - len(close))
    return GospaParts(sum(parts) ** (1 / power), *parts)


def ospa_frame(distance: Array, cutoff: float, power: float = 1.0) -> float:
    """OSPA of one frame (Schuhmacher et al. (2008)), at most the cutoff; 0 for two empty sets.

    The arguments are those of `gospa_frame`.
    """
    more, fewer = max(distance.shape), min(distance.shape)
    if not more:
        return 0.0
    paired = float((_paired(distance, cutoff, power) ** power).sum())
    return float(((paired + cutoff**power * (more - fewer)) / more) ** (1 / power))


def mean_gospa(distances: Iterable[Array], cutoff: float, power: float = 1.0) -> GospaParts | None:
    """Means over frames of GOSPA and of each part, which add up to it if p = 1; None without frames.

    With p > 1 the parts are means of p-th powers, and GOSPA the mean of p-th roots, so they do not add up.
    """
    frames = [gospa_frame(distance, cutoff, power) for distance in distances]
    return GospaParts(*np.mean(frames, axis=0).tolist()) if frames else None


def mean_ospa(distances: Iterable[Array], cutoff: float, power: float = 1.0) -> float | None:
    """Mean of OSPA over frames; None without frames."""
    frames = [ospa_frame(distance, cutoff, power) for distance in distances]
    return float(np.mean(frames)) if frames else None


def distances(vessels: Array, tracks: Array) -> Array:
    """Euclidean distances of points (n, 2) and (m, 2), shape (n, m)."""
    offset = vessels[:, None] - tracks
    return np.hypot(offset[..., 0], offset[..., 1])


def _paired(distance: Array, cutoff: float, power: float) -> Array:
    """min(d, c) of the pairs of the assignment with the smallest sum of p-th powers, shape (min(n, m),)."""
    cut = np.minimum(distance, cutoff)
    found: Array = cut[linear_sum_assignment(cut**power)]
    return found
