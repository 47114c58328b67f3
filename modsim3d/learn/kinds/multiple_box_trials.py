"""Vessels and pairs of vessels that could have come out as two boxes or as one, and whether they did."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.formats.labelled import NOBODY
from modsim3d.learn.kinds.detection_shapes import Overlapping, Sought


@dataclass(frozen=True, eq=False)
class Trials:
    """Vessels, or pairs of vessels, that could have come out as too many boxes or too few; shapes (n,).

    Attributes:
        image: Image of each.
        value: What it depends on: width over height, or the share of the smaller vessel in the larger.
        hits: Whether it did; what chance does is taken off, so it may be below 0 or above 1.
        weight: How much it counts as a trial.
        chance: How many look so by chance.
        vessels: The two annotations of a pair, `NOBODY` for a vessel, shape (n, 2).
    """

    image: Indices
    value: Array
    hits: Array
    weight: Array
    chance: Array
    vessels: Indices

    def where(self, chosen: Mask) -> Trials:
        """Some of them, shape (n,)."""
        return Trials(**{name: column[chosen] for name, column in vars(self).items()})


def vessel_trials(
    sought: Sought, tried: Mask, hit: Indices, chance: Array, extra_image: Indices | None = None
) -> Trials:
    """Trials of the vessels that are tried (n,), of which some were hit; hits of unknown vessels by their images."""
    hits = np.zeros(len(sought))
    hits[hit] = 1
    extra = np.empty(0, dtype=np.int64) if extra_image is None else extra_image
    none = np.zeros(len(extra))
    count = int(tried.sum()) + len(extra)
    return Trials(
        image=np.concatenate([sought.image[tried], extra]),
        value=np.concatenate([sought.aspect[tried], none]),
        hits=np.concatenate([(hits - chance)[tried], none + 1]),
        weight=np.concatenate([np.ones(int(tried.sum())), none]),
        chance=np.concatenate([chance[tried], none]),
        vessels=np.full((count, 2), NOBODY),
    )


def pair_trials(
    sought: Sought,
    rows: Indices,
    pairs: Overlapping,
    is_merged: Mask,
    hits: Array,
    chance: Array,
    unambiguous: Mask,
    one_box: Mask,
) -> Trials:
    """Pairs of detected vessels, and pairs with one box that may be around both.

    Of pairs with a vessel in common the one that overlaps most comes first, so another that came out as one box says
    that it did not, and after it the others had no chance. After one that perhaps did, the others tell nothing.
    """
    free = pairs.share > _most(sought, pairs, is_merged)
    detected = sought.found.copy()
    detected[pairs.larger[is_merged]] = detected[pairs.smaller[is_merged]] = True
    told = pairs.share > _most(sought, pairs, ~unambiguous & (detected[pairs.larger] != detected[pairs.smaller]))
    both = detected[pairs.larger] & detected[pairs.smaller] & free & ~is_merged
    single = one_box & free & ~both & ~is_merged
    chosen = unambiguous & told & (is_merged | both | single)
    hits = np.where(both, 0.0, hits)
    weight = np.where(both, 1.0, hits)
    chance, vessels = np.where(both, 0.0, chance), np.column_stack([rows[pairs.larger], rows[pairs.smaller]])
    return Trials(sought.image[pairs.larger], pairs.share, hits, weight, chance, vessels).where(chosen)


def _most(sought: Sought, pairs: Overlapping, chosen: Mask) -> Array:
    """The largest overlap of either vessel of each pair in chosen pairs, 0 without one, shape (p,)."""
    most = np.zeros(len(sought))
    for each in (pairs.larger, pairs.smaller):
        np.maximum.at(most, each[chosen], pairs.share[chosen])
    return np.maximum(most[pairs.larger], most[pairs.smaller])
