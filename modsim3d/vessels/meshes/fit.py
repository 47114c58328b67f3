"""Whether a mesh goes with its vessel: its proportions in the file against length, beam and air draft."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import permutations
from typing import TYPE_CHECKING

import numpy as np

from modsim3d.arrays import Array

if TYPE_CHECKING:
    from modsim3d.vessels.obstacles import Obstacle
    from modsim3d.vessels.vessel import Solid, Vessel

MAX_STRETCH = 3.0
"""Scales of two axes that differ by more are a mesh with other axes, or with more in it than the vessel."""
CLEARLY_BETTER = 2.0
"""Other axes fit if they lessen the stretch by this factor."""
MAX_SPECK = 1 / 3
"""The vessel is a speck if it is less than this share of its file in some direction."""
UNIT_BOX = 1.01
"""Extents that differ less were made equal on purpose, as those of the shipped meshes; they say nothing about axes."""


@dataclass(frozen=True)
class FileBox:
    """The bounding box of a mesh in its file.

    Attributes:
        extents: Towards the bow, to port and up, in the unit of the file.
        forward: The file's axis towards the bow, such as `+x`.
        up: The file's axis upwards.
    """

    extents: tuple[float, float, float]
    forward: str
    up: str

    @property
    def letters(self) -> tuple[str, str, str]:
        """The file's axes along the extents."""
        forward, up = self.forward[1], self.up[1]
        return forward, "xyz".replace(forward, "").replace(up, ""), up

    def in_words(self, extents: Array) -> str:
        """Extents towards the bow, to port and up, in the order of the file's axes."""
        by_letter = dict(zip(self.letters, extents, strict=True))
        return " × ".join(f"{by_letter[letter]:.4g}" for letter in "xyz")


def misfits(vessels: Iterable[Vessel], obstacles: Iterable[Obstacle]) -> list[str]:
    """One sentence for each mesh that does not fit a vessel or an obstacle; it names the first of them."""
    bodies = [(f"vessel '{v.name}'", f"the mesh {v.shape}", v.solid, v.extents_m) for v in vessels]
    bodies += [
        (f"obstacle '{o.name}'", "the mesh", s, _size_m(s, corners)) for o in obstacles for s, corners in o.solids
    ]
    found: dict[Solid, list[tuple[str, str]]] = {}
    for name, mesh, solid, size_m in bodies:
        if problem := misfit(solid, size_m):
            found.setdefault(solid, []).append((name, f"{mesh} {problem}"))
    return [
        f"{rows[0][0]}{f' and {len(rows) - 1} more' if len(rows) > 1 else ''}: {rows[0][1]}" for rows in found.values()
    ]


def misfit(solid: Solid, size_m: Array) -> str | None:
    """How a mesh does not fit its length, beam and air draft, shape (3,), as text after its name; None if it does."""
    box = solid.file_box
    if box is None:
        return None
    extents = np.array(box.extents)
    stretch = _stretch(extents, size_m)
    size = f"length × beam × air draft of {' × '.join(f'{side:.4g}' for side in size_m)} m"
    if stretch > MAX_STRETCH:
        faces, rest = _without_farthest_part(solid, extents)
        if (rest < MAX_SPECK * extents).any() and min(_stretches(rest, size_m).values()) <= MAX_STRETCH:
            return (
                f"measures {box.in_words(extents)} along x, y and z of its file; without one part of {faces} faces it "
                f"would measure {box.in_words(rest)}, which fits the {size}: take that part out of the file"
            )
    if extents.max() <= UNIT_BOX * extents.min():
        return None
    stretches = _stretches(extents, size_m)
    order = min(stretches, key=stretches.__getitem__)
    has_better = stretches[order] * CLEARLY_BETTER <= stretch and stretches[order] <= MAX_STRETCH
    if stretch <= MAX_STRETCH and not has_better:
        return None
    forward, _, up = (box.letters[axis] for axis in order)
    return (
        f'measures {box.in_words(extents)} along x, y and z of its file; with forward "{box.forward}" and up '
        f'"{box.up}" it is stretched {stretch:.2g} times as much along one axis as along another, to the {size}: '
        + (
            f'forward: "+{forward}" or "-{forward}", up: "+{up}" would fit'
            if has_better
            else "look at its axes (forward, up), at these sizes, and at what else is in the file"
        )
    )


def _stretch(extents: Array, size_m: Array) -> float:
    """Greatest scale of an axis over the least, from extents in the file to sizes, shape (3,) each."""
    scales = size_m / np.maximum(extents, 1e-9 * extents.max())
    return float(scales.max() / scales.min())


def _stretches(extents: Array, size_m: Array) -> dict[tuple[int, ...], float]:
    """The stretch with each order of the axes."""
    return {order: _stretch(extents[list(order)], size_m) for order in permutations(range(3))}


def _without_farthest_part(solid: Solid, extents: Array) -> tuple[int, Array]:
    """Faces of the part without which the rest is smallest, and the extents of the rest, shape (3,).

    Parts have no common vertex. Nothing is left out where there is one part.
    """
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
    rests = np.where(highs == high, next_high, highs.max(axis=0)) - np.where(lows == low, next_low, low)
    left_out = int(np.argmin(rests.sum(axis=1)))
    return int((part[solid.faces[:, 0]] == left_out).sum()), rests[left_out] * extents


def _size_m(solid: Solid, corners_m: Array) -> Array:
    """Length, beam and height to which a solid was scaled before it was turned and placed, shape (3,)."""
    linear = np.linalg.lstsq(np.column_stack([solid.vertices, np.ones(len(corners_m))]), corners_m)[0]
    sides: Array = np.linalg.norm(linear[:3], axis=1)
    return sides
