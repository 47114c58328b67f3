"""What every pose source gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from modsim3d.frames import Array


@dataclass(frozen=True, eq=False)
class Poses:
    """Where V vessels are at S steps.

    Attributes:
        present: Whether a vessel is in the scene, shape (S, V).
        positions_m: Centres of the bottom plane in WCF, shape (S, V, 3); zero where absent.
        headings_rad: Counter-clockwise from w1, shape (S, V); zero where absent.
    """

    present: NDArray[np.bool_]
    positions_m: Array
    headings_rad: Array


class PoseSource(Protocol):
    """A source of poses for the vessels of a scene, in the order in which the scene names them."""

    @property
    def timestamps(self) -> Sequence[str]:
        """The text of each step's time in seconds, in order."""

    def poses(self, first: int, stop: int) -> Poses:
        """Poses at steps first, first + 1, …, stop − 1."""


def generated_timestamps(steps: int, time_step_s: float) -> tuple[str, ...]:
    """Exact decimals of step × interval with at least one decimal: 0.0, 0.2, 0.4, 0.6.

    Args:
        steps: Number of steps.
        time_step_s: Interval; its shortest decimal form is what is multiplied.
    """
    interval = Decimal(repr(float(time_step_s)))
    return tuple(_plain(interval * step) for step in range(steps))


def _plain(number: Decimal) -> str:
    text = f"{number:f}"
    whole, _, decimals = text.partition(".")
    return f"{whole}.{decimals.rstrip('0') or '0'}"
