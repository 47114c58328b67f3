"""Poses that arrive while a scene runs, one step at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from modsim3d.arrays import Array
from modsim3d.errors import InputError, ModsimError
from modsim3d.motion.poses.base import Poses
from modsim3d.motion.poses.replay import time_problems

Step = tuple[str, Poses]
"""Text of a step's time, and the poses of that one step."""


class LivePoses:
    """Keeps the steps that have arrived, and waits for the others.

    The next step is read only when it is needed. Steps that have arrived stay in memory: 40 bytes for each vessel and
    step.

    Attributes:
        timestamps: Texts of the times of the steps that have arrived.
        source: Name of the source in errors.
        steps: Steps that have not arrived.
    """

    def __init__(self, steps: Iterable[Step], vessels: int, source: str) -> None:
        """Read nothing yet. `steps` yields each step when it arrives; `vessels` is the number of vessels."""
        self.timestamps: list[str] = []
        self.source = source
        self.steps: Iterator[Step] = iter(steps)
        self._rows: Array = np.zeros((64, vessels, 5))

    def wait(self, step: int) -> bool:
        """Wait until a step has arrived; return False if the source ends before it.

        Raises:
            ModsimError: A step that arrived is wrong.
        """
        while len(self.timestamps) <= step:
            arrived = next(self.steps, None)
            if arrived is None:
                return False
            self._keep(*arrived)
        return True

    def _keep(self, timestamp: str, poses: Poses) -> None:
        if problems := time_problems([*self.timestamps[-1:], timestamp]):
            raise InputError(self.source, [f"step {len(self.timestamps) + 1}: {problems[0]}"])
        count = len(self.timestamps)
        if count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        row = self._rows[count]
        row[:, 0], row[:, 1:4], row[:, 4] = poses.present[0], poses.positions_m[0], poses.headings_rad[0]
        self.timestamps.append(timestamp)

    def poses(self, first: int, stop: int) -> Poses:
        """Poses at steps first to stop − 1; waits for steps that have not arrived.

        Raises:
            ModsimError: The source ends before them.
        """
        if stop > first and not self.wait(stop - 1):
            raise ModsimError(f"{self.source}: ended after {len(self.timestamps)} steps; step {stop} was asked for")
        rows = self._rows[first:stop]
        return Poses(rows[..., 0] > 0, rows[..., 1:4].copy(), rows[..., 4].copy())
