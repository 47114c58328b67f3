"""Whether a mesh goes with its vessel: its proportions in the file against length, beam and air draft."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations
from typing import TYPE_CHECKING

import numpy as np

from modsim3d.arrays import Array

if TYPE_CHECKING:
    from modsim3d.vessels.vessel import Solid

MAX_STRETCH, CLEARLY_BETTER = 3.0, 2.0
"""Axes do not fit if their scales differ by more, and others fit if they lessen that by such a factor."""
MAX_SPECK = 1 / 3
"""The vessel is a speck if it is less than this share of its file in some direction."""
UNIT_BOX = 1.01
"""Extents that differ less were made equal on purpose, as those of the shipped meshes; they say nothing about axes."""


@dataclass(frozen=True, eq=False)
class FileBox:
    """Extents of a mesh to the bow, to port and up, shape (3,), in the unit of its file, and its axes to bow and up."""

    extents: Array
    forward: str
    up: str

    @property
    def letters(self) -> str:
        """The file's axes along the extents."""
        forward, up = self.forward[1], self.up[1]
        return forward + "xyz".replace(forward, "").replace(up, "") + up

    def in_words(self, extents: Array) -> str:
        """Extents in the order of the file's axes."""
        return " × ".join(f"{extents[self.letters.index(letter)]:.4g}" for letter in "xyz")


def misfit(solid: Solid, size_m: Array) -> str | None:
    """How a mesh does not fit its length, beam and air draft, shape (3,), as text after its name; None if it does."""
    box = solid.file_box
    if box is None:
        return None
    extents, size = box.extents, " × ".join(f"{side:.4g}" for side in size_m)
    measures = f"measures {box.in_words(extents)} along x, y and z of its file; "
    stretches = _stretches(extents, size_m)
    stretch, order = stretches[0, 1, 2], min(stretches, key=stretches.__getitem__)
    if stretch > MAX_STRETCH:
        faces, rest = _without_farthest_part(solid, extents)
        if (rest < MAX_SPECK * extents).any() and min(_stretches(rest, size_m).values()) <= MAX_STRETCH:
            without = f"without one part of {faces} faces it would measure {box.in_words(rest)}"
            return f"{measures}{without}, which fits {size} m: take that part out of the file"
    fits = stretches[order] <= min(stretch / CLEARLY_BETTER, MAX_STRETCH)
    if extents.max() <= UNIT_BOX * extents.min() or (stretch <= MAX_STRETCH and not fits):
        return None
    forward, _, up = (box.letters[axis] for axis in order)
    better = f'forward: "+{forward}" or "-{forward}", up: "+{up}" would fit'
    return (
        f'{measures}with forward "{box.forward}" and up "{box.up}" it is stretched {stretch:.2g} times as much along '
        f"one axis as along another, to the length × beam × air draft of {size} m: "
        + (better if fits else "look at its axes (forward, up), at these sizes, and at what else is in the file")
    )


def _stretches(extents: Array, size_m: Array) -> dict[tuple[int, ...], float]:
    """Greatest scale of an axis over the least, from extents in the file to sizes, with each order of the axes."""
    scales = {order: size_m / np.maximum(extents[list(order)], 1e-9) for order in permutations(range(3))}
    return {order: float(scale.max() / scale.min()) for order, scale in scales.items()}


def _without_farthest_part(solid: Solid, extents: Array) -> tuple[int, Array]:
    """Faces of the part, of those without common vertices, without which the rest is smallest, and its extents."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components  # takes 0.1 s

    starts, ends = solid.faces[:, [0, 1]].ravel(), solid.faces[:, [1, 2]].ravel()
    links = coo_array((np.ones(len(starts)), (starts, ends)), shape=(len(solid.vertices),) * 2)
    count, part = connected_components(links, directed=False)
    if count == 1:
        return 0, extents
    lows, highs = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(lows, part, solid.vertices)
    np.maximum.at(highs, part, solid.vertices)
    (low, next_low), (high, next_high) = np.sort(lows, axis=0)[:2], np.sort(highs, axis=0)[:-3:-1]
    rests = np.where(highs == high, next_high, high) - np.where(lows == low, next_low, low)
    left_out = int(np.argmin(rests.sum(axis=1)))
    return int((part[solid.faces[:, 0]] == left_out).sum()), rests[left_out] * extents
