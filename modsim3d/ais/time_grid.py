"""The steps of a scene: its first time and an even grid from there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.ais.messages import Positions
from modsim3d.ais.options import Options, time_text
from modsim3d.ais.resampling import ROUNDING_S
from modsim3d.arrays import Array, Mask
from modsim3d.errors import ModsimError
from modsim3d.motion.poses.base import generated_timestamps

MAX_STEPS = 1_000_000


@dataclass(frozen=True, eq=False)
class TimeGrid:
    """Times of a scene's steps.

    Attributes:
        start_s: Unix time of the first step.
        times_s: Time of each step since the first, shape (S,); `timestamps` has them as text.
    """

    start_s: float
    times_s: Array
    timestamps: tuple[str, ...]

    @property
    def end_s(self) -> float:
        """Unix time of the last step."""
        return self.start_s + float(self.times_s[-1])

    def within(self, unix_s: Array, margin_s: float) -> Mask:
        """Which times are within the scene's, widened by a margin at both ends, shape (n,)."""
        return np.asarray((unix_s >= self.start_s - margin_s) & (unix_s <= self.end_s + margin_s))


def time_grid(positions: Positions, options: Options) -> TimeGrid:
    """The steps that the user asked for; by default they reach from the first report to the last.

    Raises:
        ModsimError: There would be too many steps.
    """
    start = float(positions.time_s.min()) if options.start_s is None else options.start_s
    end = float(positions.time_s.max()) if options.end_s is None else options.end_s
    span = end - start if options.duration_s is None else options.duration_s
    steps = int(np.floor(span / options.time_step_s + ROUNDING_S)) + 1 if span >= 0 else 1
    if steps > MAX_STEPS:
        raise ModsimError(
            f"from {time_text(start)} to {time_text(start + span)} in steps of {options.time_step_s:g} s would be "
            f"{steps:,} steps, more than {MAX_STEPS:,}: choose --start and --duration, or a larger --time-step"
        )
    timestamps = generated_timestamps(steps, options.time_step_s)
    return TimeGrid(start, np.array([float(text) for text in timestamps]), timestamps)
