"""A vessel under way on her path, and places of hulls at many times."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from modsim3d.core.arrays import Array, Mask
from modsim3d.io.strict_text import load_yaml
from modsim3d.io.validation import Strict
from modsim3d.world.traffic.paths import VesselPath
from modsim3d.world.vessels import Extent, MeshName

TABLE = Path(__file__).with_name("kinds.yaml")
SPREAD = 0.08  # beam and air draft vary by this share about what the length says
LATERAL_M_S2 = 1.0  # greatest acceleration across the course: nobody turns a fast boat as tightly as her rudder would

Speed = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.1, le=40)]


def one_as_range(value: object) -> object:
    """A number as a range from it to itself; anything else as it is."""
    return (value, value) if isinstance(value, int | float) and not isinstance(value, bool) else value


def rising(values: tuple[float, ...]) -> tuple[float, ...]:
    """Refuse a range whose values fall."""
    if any(low > high for low, high in pairwise(values)):
        raise ValueError(f"must not fall: least first, greatest last (got {list(values)})")
    return values


# One speed, or least and greatest.
SpeedRange = Annotated[tuple[Speed, Speed], BeforeValidator(one_as_range), AfterValidator(rising)]


class KindKeys(Strict):
    """A kind of vessel."""

    length_m: Annotated[tuple[Extent, Extent, Extent], AfterValidator(rising)]  # least, most frequent and greatest
    beam_m: tuple[Extent, Extent]  # at the least and at the greatest length
    air_draft_m: tuple[Extent, Extent]  # at the least and at the greatest length
    speed_m_s: SpeedRange
    # Diameter of the turning circle in lengths.
    turning_lengths: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1.5, le=20)] = 3.0
    label: str
    mesh: MeshName | None = None  # a box without it
    sails: bool = False  # whether she does not sail into the wind
    near_shore: bool = False  # whether she keeps close to the shore


@dataclass(frozen=True)
class DrawnHull:
    """A vessel that was drawn: her kind, dimensions, speed and least turning radius; `half_m` is half length, beam."""

    kind: str
    length_m: float
    beam_m: float
    air_draft_m: float
    turning_radius_m: float

    @property
    def half_m(self) -> tuple[float, float]:
        """Half length and half beam."""
        return self.length_m / 2, self.beam_m / 2

    @property
    def reach_m(self) -> float:
        """Half the diagonal."""
        return math.sqrt(self.length_m**2 + self.beam_m**2) / 2


@cache
def shipped_kinds() -> dict[str, dict[str, Any]]:
    """The entries of `kinds.yaml`."""
    table: dict[str, dict[str, Any]] = load_yaml(TABLE, "table of kinds")
    return table


def draw_hull(name: str, kind: KindKeys, speed_m_s: float, rng: np.random.Generator) -> DrawnHull:
    """A vessel of a kind that is to make a speed."""
    share, beam, height = rng.random(3)
    least, _, greatest = kind.length_m
    length = _triangular(kind.length_m, float(share))
    size = (length - least) / (greatest - least) if greatest > least else 0.5
    low, high = kind.beam_m
    beam_m = (low + (high - low) * size) * (1 + SPREAD * (2 * float(beam) - 1))
    low, high = kind.air_draft_m
    air_m = (low + (high - low) * size) * (1 + SPREAD * (2 * float(height) - 1))
    return DrawnHull(
        kind=name,
        length_m=max(round(length, 2), 0.01),
        beam_m=max(round(beam_m, 2), 0.01),
        air_draft_m=max(round(air_m, 2), 0.01),
        turning_radius_m=turning_radius_m(kind.turning_lengths, length, speed_m_s),
    )


def turning_radius_m(turning_lengths: float, length_m: float, speed_m_s: float) -> float:
    """Least radius of a turn at a speed."""
    return max(turning_lengths * length_m / 2, speed_m_s**2 / LATERAL_M_S2)


def draw_one(weights: Mapping[str, float], uniform: float) -> str:
    """A name by its weight, from a uniform number."""
    names, mark = list(weights), uniform * sum(weights.values())
    for name in names:
        mark -= weights[name]
        if mark < 0:
            return name
    return next(name for name in reversed(names) if weights[name] > 0)


def _triangular(corners: tuple[float, float, float], uniform: float) -> float:
    low, mode, high = corners
    if high <= low:
        return low
    if uniform * (high - low) < mode - low:
        return low + math.sqrt(uniform * (high - low) * (mode - low))
    return high - math.sqrt((1 - uniform) * (high - low) * (high - mode))


@dataclass(frozen=True, eq=False)
class Track:
    """A hull that follows a path at constant speed; she starts along it at `start_s`, and is absent before and after.
    `cost` says how far the track is from what was drawn at first."""

    hull: DrawnHull
    path: VesselPath
    speed_m_s: float
    start_s: float
    cost: float = 0.0

    @property
    def end_s(self) -> float:
        """Time when she reaches the end of the path."""
        return self.start_s + self.path.length_m / self.speed_m_s

    def at(self, times_s: Array) -> tuple[Array, Array]:
        """Places, shape (n, 2), and headings, shape (n,), at any times; straight on beyond the path's ends."""
        return self.path.at(self.speed_m_s * (times_s - self.start_s))

    def present(self, times_s: Array, margin_s: float = 0.0) -> Mask:
        """Whether she is there at each of n times."""
        return (times_s >= self.start_s - margin_s) & (times_s <= self.end_s + margin_s)


@dataclass(frozen=True, eq=False)
class Sweep:
    """C tracks of one hull at T times: what is compared with other hulls and with land."""

    tracks: Sequence[Track]
    present: Mask  # whether she is there, or enters or has left within an interval: (C, T)
    places_m: Array  # (C, T, 2)
    axes: Array  # unit vectors along the hull: (C, T, 2)
    speeds_m_s: Array  # (C,)

    @classmethod
    def of(cls, tracks: Sequence[Track], times_s: Array, interval_s: float) -> Sweep:
        """The tracks, at least one, at times an interval apart."""
        placed = [track.at(times_s) for track in tracks]
        headings = np.stack([heading for _, heading in placed])
        return cls(
            tracks=tracks,
            present=np.stack([track.present(times_s, interval_s) for track in tracks]),
            places_m=np.stack([place for place, _ in placed]),
            axes=np.stack([np.cos(headings), np.sin(headings)], axis=-1),
            speeds_m_s=np.array([track.speed_m_s for track in tracks]),
        )

    @property
    def hull(self) -> DrawnHull:
        """The hull that all the tracks have."""
        return self.tracks[0].hull

    def during(self, steps: slice) -> Sweep:
        """The tracks at some of the times."""
        present, places, axes = self.present[:, steps], self.places_m[:, steps], self.axes[:, steps]
        return Sweep(self.tracks, present, places, axes, self.speeds_m_s)

    def row(self, index: int) -> Sweep:
        """One track alone."""
        one = slice(index, index + 1)
        return Sweep(self.tracks[one], self.present[one], self.places_m[one], self.axes[one], self.speeds_m_s[one])
