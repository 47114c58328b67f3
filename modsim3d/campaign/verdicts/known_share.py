"""Approaches of vessels that were known at a distance, of those that came so near."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from modsim3d.campaign.keys import Requirement
from modsim3d.core.arrays import Array, Mask


@dataclass(frozen=True, eq=False)
class ApproachCounts:
    """Numbers of approaches of each of s traffic seeds, of all its runs together."""

    came: Array  # that were in view beyond the distance, and came so near, shape (s,)
    known: Array  # of these, that tracks had followed before, and kept, shape (s,)
    crashed: Mask  # whether a run of the seed crashed, shape (s,)
    appeared_nearer: int  # vessels that were in view only nearer
    never_so_near: int  # vessels that stayed farther away

    @property
    def shares(self) -> Array:
        """Share of its approaches that are known, of each seed that has some; 0 if a run of it crashed, shape (n,)."""
        counted = self.crashed | (self.came > 0)
        return np.where(self.crashed, 0.0, self.known / np.maximum(self.came, 1))[counted]

    @property
    def share(self) -> float | None:
        """Their mean: each traffic seed counts as much as another. None without any."""
        return float(self.shares.mean()) if len(self.shares) else None


def counted_approaches(
    seeds: Sequence[Sequence[dict[str, Any]]], crashed: Mask, distance_m: float, track: str = "one_track_m"
) -> ApproachCounts:
    """Counts at a distance of the approaches of each seed, as rows have them, given which seeds had a run that crashed;
    `track` names the field with the distance from which on a vessel was known."""
    every = [each for seed in seeds for each in seed]
    came = [[each for each in seed if each["closest_m"] <= distance_m <= each["in_view_m"]] for seed in seeds]
    known = [sum(each[track] >= distance_m for each in seed) for seed in came]
    nearer = sum(each["closest_m"] <= distance_m and each["in_view_m"] < distance_m for each in every)
    farther = sum(each["closest_m"] > distance_m for each in every)
    numbers = np.array([[len(seed) for seed in came], known], dtype=np.float64)
    return ApproachCounts(numbers[0], numbers[1], crashed, nearer, farther)


def required_approaches(
    requirement: Requirement, seeds: Sequence[Sequence[dict[str, Any]]], crashed: Mask
) -> ApproachCounts:
    """Counts of the approaches that a lookout requirement is about."""
    assert requirement.known_at_m is not None and requirement.kind is not None
    kind, track = requirement.kind, "one_track_m" if requirement.one_track else "known_m"
    low, high = kind.length_m or (0.0, np.inf)
    of_kind = [
        [each for each in seed if low <= each["length_m"] < high and kind.label in (None, each["label"])]
        for seed in seeds
    ]
    return counted_approaches(of_kind, crashed, requirement.known_at_m, track)
