"""When each frame of a film is shown: real time unless asked otherwise, whatever the steps of the run are like."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from modsim3d.arrays import Array, Indices

LEAST_RATE = 5
"""Frames per second; slower films show each frame several times, as some players stumble over long frames."""
SAME_S = 1e-6
"""Steps that differ by less are of the same length."""


@dataclass(frozen=True, eq=False)
class Timetable:
    """A film's pace: pictures a second, and how many show each frame (0 if the film is too fast for it), shape (n,)."""

    rate: Fraction
    repeats: Indices

    @property
    def duration_s(self) -> float:
        """Length of the film in seconds."""
        return float(int(self.repeats.sum()) / self.rate)

    @classmethod
    def of(cls, durations_s: Array, speed: float, most_rate: int) -> Timetable:
        """The pace of frames that stand for given durations.

        Steps of one length, at a rate from `LEAST_RATE` to `most_rate`, give one picture a frame. Otherwise each
        picture shows the frame that is due at its time.

        Args:
            durations_s: Duration of each frame in the run, positive, shape (n,).
            speed: Seconds of the run in one second of the film.
            most_rate: The highest rate, in pictures a second.
        """
        film_s = durations_s / speed
        shortest = float(film_s.min())
        repeats = max(1, math.ceil(LEAST_RATE * shortest - SAME_S))
        rate = min(Fraction(repeats / shortest).limit_denominator(1000), Fraction(most_rate))
        if np.ptp(film_s) <= SAME_S and repeats / shortest <= most_rate + SAME_S:
            return cls(rate, np.full(len(film_s), repeats))
        ends = np.rint(np.cumsum(film_s) * float(rate)).astype(np.int64)
        ends[-1] = max(ends[-1], 1)
        return cls(rate, np.diff(ends, prepend=0))
