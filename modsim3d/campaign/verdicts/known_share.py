"""Approaches of vessels that were known at a distance, of those that came so near."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from modsim3d.campaign.keys import Requirement
from modsim3d.core.arrays import Array

Approaches = Sequence[Sequence[dict[str, Any]]]
"""Approaches of each traffic seed, with the fields of `Approach`."""


@dataclass(frozen=True, eq=False)
class ApproachCounts:
    """Numbers of approaches of each of s traffic seeds, of all its runs together."""

    distance_m: float
    came: Array  # that were in view beyond the distance, and came so near, shape (s,)
    known: Array  # of these, that tracks had followed before, and kept, shape (s,)
    appeared_nearer: int  # vessels that were in view only nearer
    never_so_near: int  # vessels that stayed farther away

    @classmethod
    def of(cls, requirement: Requirement, found: Approaches) -> Self:
        """The counts of a lookout requirement."""
        assert requirement.known_at_m is not None and requirement.kind is not None
        low, high = requirement.kind.length_m or (0.0, np.inf)
        label, track = requirement.kind.label, "one_track_m" if requirement.one_track else "known_m"
        kind = [
            [each for each in seed if low <= each["length_m"] < high and label in (None, each["label"])]
            for seed in found
        ]
        return cls.at(requirement.known_at_m, kind, track)

    @classmethod
    def at(cls, distance_m: float, found: Approaches, track: str = "known_m") -> Self:
        """The counts at a distance; `track` names the field with the distance from which on a vessel was known."""
        came = [[each for each in seed if each["closest_m"] <= distance_m <= each["in_view_m"]] for seed in found]
        every = [each for seed in found for each in seed]
        return cls(
            distance_m,
            np.array([len(seed) for seed in came], dtype=np.float64),
            np.array([sum(each[track] >= distance_m for each in seed) for seed in came], dtype=np.float64),
            sum(each["closest_m"] <= distance_m and each["in_view_m"] < distance_m for each in every),
            sum(each["closest_m"] > distance_m for each in every),
        )

    @property
    def share(self) -> float | None:
        """Share of the approaches that are known; None without any."""
        return float(self.known.sum() / self.came.sum()) if self.came.sum() else None

    @property
    def text(self) -> str:
        """The counts in words."""
        said = f"{self.known.sum():,.0f} of {self.came.sum():,.0f} approaches are known at {self.distance_m:g} m"
        return f"{said} ({self.appeared_nearer:,} appeared nearer, {self.never_so_near:,} never came so near)"
