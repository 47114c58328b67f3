"""What every pose source gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import ClassVar, Protocol

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.vessels import Vessel


@dataclass(frozen=True, eq=False)
class Poses:
    """Where V vessels are at S steps.

    Attributes:
        present: Whether a vessel is in the scene, shape (S, V).
        positions_m: Centres of the bottom plane in WCF, shape (S, V, 3); zero where absent.
        headings_rad: Counter-clockwise from w1, shape (S, V); zero where absent.
    """

    present: Mask
    positions_m: Array
    headings_rad: Array

    def rows(self, rows: Indices | slice) -> Poses:
        """Poses at some of the steps, by index."""
        return Poses(self.present[rows], self.positions_m[rows], self.headings_rad[rows])


class PoseSource(Protocol):
    """A source of poses for the vessels of a scene, in the order in which the scene names them."""

    @property
    def timestamps(self) -> Sequence[str]:
        """The text of each step's time in seconds, in order."""

    def poses(self, first: int, stop: int) -> Poses:
        """Poses at steps first, first + 1, …, stop − 1."""


@dataclass(frozen=True)
class PoseRequest:
    """What a scene asks of its pose source.

    Attributes:
        folder: Paths in the scene file are relative to it.
        names: IDs of the scene's vessels, in its order; None if its vessels cannot be read.
        vessels: The vessels themselves; none if one of them is wrong.
        steps: Number of time steps, if the scene gives it.
        time_step_s: Interval between them, if the scene gives it.
        seed: Everything random comes from it.
    """

    folder: Path
    names: tuple[str, ...] | None
    vessels: tuple[Vessel, ...] = ()
    steps: int | None = None
    time_step_s: float | None = None
    seed: int = 0

    @property
    def timestamps(self) -> tuple[str, ...]:
        """The times of a source that has none of its own."""
        return generated_timestamps(self.steps or 0, self.time_step_s or 0.0)


class SourceKeys:
    """The keys of a pose source in a scene file, and what makes its poses: a mixin for a pydantic model.

    Attributes:
        generated: Whether its times are the scene's, which must then give `steps` and `time_step_s`. Such a source is
            built only from a scene that is right otherwise; one with times of its own is looked at in any case.
    """

    generated: ClassVar[bool] = True

    @property
    def files(self) -> tuple[str, ...]:
        """The files that it reads, as the scene file names them."""
        return ()

    def build(self, request: PoseRequest) -> PoseSource:
        """The poses of a scene's vessels.

        Raises:
            InputError: With every problem found.
        """
        raise NotImplementedError


def times_s(timestamps: Sequence[str], first: int, stop: int) -> Array:
    """Times of steps first to stop − 1 since the first step, in seconds, shape (stop − first,)."""
    return np.array([float(text) for text in timestamps[first:stop]]) - float(timestamps[0])


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
