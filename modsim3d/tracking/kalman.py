"""A Kalman filter of many coordinates at once, each with a place and a rate, independent of the others."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask

_Level = float | Array


@dataclass(frozen=True, eq=False)
class MotionEstimates:
    """Gaussian estimates of coordinates and of their rates, in units of the coordinate per second: arrays of one shape.
    A coordinate's rate is a random walk (white-noise acceleration, Bar-Shalom, Li & Kirubarajan (2001), section 6.2.2),
    so that the estimate at a time does not depend on the times in between."""

    place: Array  # mean of the coordinate
    rate: Array  # mean of its rate
    place_variance: Array
    mixed_variance: Array  # covariance of the coordinate and its rate
    rate_variance: Array

    @classmethod
    def at(cls, place: Array, place_variance: Array, rate_variance: _Level) -> Self:
        """At rest at a measured place, as far as is known."""
        zero = np.zeros_like(place)
        return cls(place, zero, place_variance, zero, zero + rate_variance)

    def predicted(self, time_s: _Level, rate_walk: _Level, place_walk: _Level = 0.0) -> Self:
        """After some time. `rate_walk` is the standard deviation of the change of the rate in one second, `place_walk`
        that of what the place changes by in one second beside its rate."""
        walk = rate_walk**2 * time_s
        return type(self)(
            self.place + self.rate * time_s,
            self.rate,
            self.place_variance
            + time_s * (2 * self.mixed_variance + time_s * (self.rate_variance + walk / 3) + place_walk**2),
            self.mixed_variance + time_s * (self.rate_variance + walk / 2),
            self.rate_variance + walk,
        )

    def corrected(self, measured: Array, variance: Array) -> Self:
        """After measuring the places, with noise of a variance."""
        total = self.place_variance + variance
        gain, rate_gain, surprise = self.place_variance / total, self.mixed_variance / total, measured - self.place
        return type(self)(
            self.place + gain * surprise,
            self.rate + rate_gain * surprise,
            gain * variance,
            self.mixed_variance * variance / total,
            self.rate_variance - rate_gain * self.mixed_variance,
        )

    def smoothed(self, predicted: Self, later: Self, time_s: _Level) -> Self:
        """With what was measured later (Rauch, Tung & Striebel (1965)). `predicted` is this after the time, `later` the
        smoothed estimate at that time."""
        cross = self._with_rates(self.place_variance + time_s * self.mixed_variance, self.mixed_variance)
        cross[..., 1, 0] = self.mixed_variance + time_s * self.rate_variance
        cross[..., 1, 1] = self.rate_variance
        gain = cross @ np.linalg.inv(predicted.covariance)
        change = np.stack([later.place - predicted.place, later.rate - predicted.rate], axis=-1)
        place, rate = np.moveaxis((gain @ change[..., None])[..., 0], -1, 0)
        covariance = self.covariance + gain @ (later.covariance - predicted.covariance) @ np.swapaxes(gain, -1, -2)
        return type(self)(
            self.place + place, self.rate + rate, covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
        )

    @property
    def covariance(self) -> Array:
        """Covariance of each coordinate and its rate, shape (..., 2, 2)."""
        matrix = self._with_rates(self.place_variance, self.mixed_variance)
        matrix[..., 1, 0], matrix[..., 1, 1] = self.mixed_variance, self.rate_variance
        return matrix

    def take(self, chosen: Mask | Indices) -> Self:
        """The chosen rows."""
        return type(self)(*(array[chosen] for array in vars(self).values()))

    def with_rows(self, chosen: Mask | Indices, others: Self) -> Self:
        """Estimates with others in the chosen rows."""
        arrays = [array.copy() for array in vars(self).values()]
        for array, other in zip(arrays, vars(others).values(), strict=True):
            array[chosen] = other
        return type(self)(*arrays)

    def joined(self, more: Self) -> Self:
        """These rows and more after them."""
        pairs = zip(vars(self).values(), vars(more).values(), strict=True)
        return type(self)(*(np.concatenate(pair) for pair in pairs))

    @staticmethod
    def _with_rates(first: Array, second: Array) -> Array:
        """Matrices with a first row, shape (..., 2, 2)."""
        matrix = np.empty((*first.shape, 2, 2))
        matrix[..., 0, 0], matrix[..., 0, 1] = first, second
        return matrix
