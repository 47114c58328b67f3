"""Poses, and the interface of every pose source."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import ClassVar, Protocol

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.vessels.obstacles import Obstacle
from modsim3d.vessels.vessel import Vessel


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of V vessels at S steps.

    Attributes:
        present: Whether each vessel is in the scene, shape (S, V).
        positions_m: Centres of the bottom plane in WCF, shape (S, V, 3); zero where absent.
        headings_rad: Counter-clockwise from w1, shape (S, V); zero where absent.
    """

    present: Mask
    positions_m: Array
    headings_rad: Array

    @classmethod
    def absent(cls, steps: int, vessels: int) -> Poses:
        """Poses to be filled in, in which every vessel is absent at every step."""
        shape = steps, vessels
        return cls(np.zeros(shape, dtype=bool), np.zeros((*shape, 3)), np.zeros(shape))

    def rows(self, rows: Indices | slice) -> Poses:
        """Poses at some of the S steps, by index, shape (n,), or slice."""
        return Poses(self.present[rows], self.positions_m[rows], self.headings_rad[rows])


class PoseSource(Protocol):
    """A source of poses for the vessels of a scene, in the order in which the scene names them."""

    @property
    def timestamps(self) -> Sequence[str]:
        """Texts of the steps' times in seconds, in order."""

    def poses(self, first: int, stop: int) -> Poses:
        """Poses at steps first, first + 1, …, stop − 1, with a column for each vessel."""


@dataclass(frozen=True)
class PoseRequest:
    """What a pose source is told about its scene.

    Attributes:
        folder: Folder of the scene file; paths in it are relative to this.
        names: IDs of the vessels, in the scene's order; None if the vessels cannot be read.
        vessels: The vessels; empty if one of them is wrong.
        steps: Number of time steps, if the scene gives it.
        time_step_s: Interval between steps, if the scene gives it.
        seed: Seed of all random numbers.
        obstacles: The scene's obstacles.
    """

    folder: Path
    names: tuple[str, ...] | None
    vessels: tuple[Vessel, ...] = ()
    steps: int | None = None
    time_step_s: float | None = None
    seed: int = 0
    obstacles: tuple[Obstacle, ...] = ()

    @property
    def timestamps(self) -> tuple[str, ...]:
        """Texts of the times for a source that has none of its own."""
        return generated_timestamps(self.steps or 0, self.time_step_s or 0.0)


class SourceKeys:
    """The keys of a pose source in a scene file, and the way from them to poses: a mixin for a pydantic model.

    Attributes:
        generated: Whether the source uses the scene's times, so that the scene must give `steps` and `time_step_s`.
            Such a source is built only if the rest of the scene is valid; one with its own times is always built.
        drawn: Whether the traffic, that is who is where, depends on the seed.
    """

    generated: ClassVar[bool] = True
    drawn: ClassVar[bool] = True

    @property
    def files(self) -> tuple[str, ...]:
        """Files that the source reads, as the scene file names them."""
        return ()

    def vessels(self, request: PoseRequest) -> Mapping[str, Mapping[str, object]]:
        """Entries of the vessels that the source itself draws, in the form of a vessels file; none by default.

        They are added to those of the scene file, which are all that the request has here. `build` gets both: the
        scene file's, then these.

        Raises:
            InputError: With every problem found.
        """
        return {}

    def build(self, request: PoseRequest) -> PoseSource:
        """The poses of a scene's vessels.

        Raises:
            InputError: With every problem found.
        """
        raise NotImplementedError


def times_s(timestamps: Sequence[str], first: int, stop: int) -> Array:
    """Times of steps first to stop − 1 since the first step, in seconds, shape (stop − first,)."""
    return np.array([float(text) for text in timestamps[first:stop]]) - float(timestamps[0])


def generated_timestamps(steps: int, time_step_s: float, first: int = 0) -> tuple[str, ...]:
    """Exact decimals of step × interval in its shortest form, with at least one decimal: 0.0, 0.2, 0.4, 0.6.

    They are of steps `first` to steps − 1.
    """
    interval = Decimal(repr(float(time_step_s)))
    parts = (f"{interval * step:f}".partition(".") for step in range(first, steps))
    return tuple(f"{whole}.{decimals.rstrip('0') or '0'}" for whole, _, decimals in parts)
