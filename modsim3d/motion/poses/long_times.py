"""Texts of the times of a long scene, which would take more memory than the run of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from typing import overload

from modsim3d.motion.poses.base import generated_timestamps

TOGETHER = 1024
"""Steps whose texts are worked out together."""


@dataclass(frozen=True)
class LongTimes(Sequence[str]):
    """What `generated_timestamps` gives, worked out where it is asked for; slices are tuples."""

    steps: int
    time_step_s: float

    def __len__(self) -> int:
        """The number of steps."""
        return self.steps

    @overload
    def __getitem__(self, index: int) -> str: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[str, ...]: ...
    def __getitem__(self, index: int | slice) -> str | tuple[str, ...]:
        """The text of a step, or of some."""
        chosen = range(self.steps)[index]
        if isinstance(chosen, int):
            return _texts(self.time_step_s, chosen // TOGETHER)[chosen % TOGETHER]
        if not chosen:
            return ()
        low, high = min(chosen[0], chosen[-1]), max(chosen[0], chosen[-1])
        first = low // TOGETHER
        pieces = (_texts(self.time_step_s, number) for number in range(first, high // TOGETHER + 1))
        texts, before = tuple(chain.from_iterable(pieces)), first * TOGETHER
        return texts[low - before : high - before + 1][:: chosen.step]


@lru_cache(maxsize=8)
def _texts(time_step_s: float, number: int) -> tuple[str, ...]:
    return generated_timestamps((number + 1) * TOGETHER, time_step_s, first=number * TOGETHER)
