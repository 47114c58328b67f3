"""Errors of tracks in the world: for each vessel first, then over vessels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.tracking.intervals import half_interval
from modsim3d.tracking.scores.errors import nees_or_infinity
from modsim3d.tracking.world.following import WorldFollowing


@dataclass(frozen=True)
class OverVessels:
    """A mean over vessels, each with one value, however long it was followed.

    Attributes:
        mean: None without vessels.
        low: Lower end of the 95 % t-interval of the mean; None with fewer than two vessels, or if all have one value.
        high: Upper end.
        vessels: Number of vessels.
    """

    mean: float | None
    low: float | None
    high: float | None
    vessels: int

    @classmethod
    def of(cls, values: Array) -> Self:
        """The mean of the values of n vessels, shape (n,); NaN for a vessel that has none."""
        values = values[~np.isnan(values)]
        mean, half = float(values.mean()) if len(values) else None, half_interval(values)
        if mean is None or half is None:
            return cls(mean, None, None, len(values))
        return cls(mean, mean - half, mean + half, len(values))


@dataclass(frozen=True)
class WorldErrors:
    """Errors of the tracks that follow a scored vessel, as means over vessels.

    Attributes:
        rmse_m: Root of a vessel's mean squared error of position.
        rmse_m_s: The same of velocity, where tracks have one.
        nees: A vessel's mean squared error of position over its covariance, e' P⁻¹ e: 2 if the covariance is right.
        nees_velocity: The same of velocity: 2.
        nees_state: The same of position and velocity together, where tracks have the whole covariance: 4.
        pairs: Number of estimates that are compared, over all vessels and steps.
    """

    rmse_m: OverVessels
    rmse_m_s: OverVessels
    nees: OverVessels
    nees_velocity: OverVessels
    nees_state: OverVessels
    pairs: int


def world_errors(following: WorldFollowing) -> WorldErrors:
    """The errors of all pairs."""
    truth, tracks = following.truth, following.tracks
    step, vessel = np.nonzero(following.found)
    row = following.followed_by[step, vessel]
    times_s = tracks.time_s[row]
    position = tracks.position_m[row] - truth.positions_at(times_s, vessel)
    velocity = tracks.velocity_m_s[row] - truth.velocities_at(times_s, vessel)
    covariance = tracks.covariance[row]

    def by_vessel(values: Array) -> Array:
        return mean_by(vessel, values, len(truth.names))

    whole = nees_or_infinity(np.concatenate([position, velocity], axis=1), covariance)
    return WorldErrors(
        rmse_m=OverVessels.of(np.sqrt(by_vessel((position**2).sum(axis=1)))),
        rmse_m_s=OverVessels.of(np.sqrt(by_vessel((velocity**2).sum(axis=1)))),
        nees=OverVessels.of(by_vessel(nees_or_infinity(position, covariance[:, :2, :2]))),
        nees_velocity=OverVessels.of(by_vessel(nees_or_infinity(velocity, covariance[:, 2:, 2:]))),
        nees_state=OverVessels.of(by_vessel(whole)),
        pairs=len(row),
    )


def mean_by(group: Indices, values: Array, groups: int) -> Array:
    """Mean of the values of each group that are not NaN, NaN for none, shape (groups,)."""
    known = ~np.isnan(values)
    count = np.bincount(group[known], minlength=groups)
    total = np.bincount(group[known], values[known], minlength=groups)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
