"""Whether cameras share a chain of performance states, and when a schedule forces a state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices

_EARLY_S = 1e-9  # a time read from text and one worked out may differ by rounding


@dataclass(frozen=True)
class Performance:
    """Whether each camera has a chain of its own, and which states are forced.

    The schedule has ascending times in seconds and the state forced from each on; −1 returns to the chain.
    """

    per_camera: bool = False
    schedule: tuple[tuple[float, int], ...] = ()

    def forced(self, times_s: Array, states: Indices) -> Indices:
        """The states at times in seconds, given those of the chain, all of shape (S,)."""
        if not self.schedule:
            return states
        starts = [time_s for time_s, _ in self.schedule]
        entry = np.searchsorted(starts, times_s + _EARLY_S, side="right")
        schedule = np.array([-1, *(state for _, state in self.schedule)])[entry]
        return np.where(schedule >= 0, schedule, states)
