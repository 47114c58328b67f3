"""Shapes that are painted: closed lines of corners, many of them in a few arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Indices, Mask


@dataclass(frozen=True, eq=False)
class Shapes:
    """Silhouettes, or pieces of an obstacle between which nothing else is painted: s shapes of l closed lines.

    Attributes:
        frame: Frame of each shape, shape (s,).
        occluder: Whose it is, shape (s,).
        lines: Number of lines of each shape, shape (s,).
        count: Number of corners of each line, shape after shape, shape (l,).
        corners: Corners of the lines in quanta, line after line, shape (k, 2).
    """

    frame: Indices
    occluder: Indices
    lines: Indices
    count: Indices
    corners: NDArray[np.uint16]

    def __len__(self) -> int:
        """Number of shapes."""
        return len(self.frame)

    @cached_property
    def first_line(self) -> Indices:
        """The first line of each shape, and the number of lines, shape (s + 1,)."""
        return np.concatenate([[0], np.cumsum(self.lines)])

    @cached_property
    def first_corner(self) -> Indices:
        """The first corner of each shape, and the number of corners, shape (s + 1,)."""
        corners: Indices = np.concatenate([[0], np.cumsum(self.count)])[self.first_line]
        return corners

    def take(self, chosen: Mask) -> Shapes:
        """The shapes that are chosen by a mask, shape (s,)."""
        lines, corners = (np.repeat(chosen, np.diff(first)) for first in (self.first_line, self.first_corner))
        frame, occluder = self.frame[chosen], self.occluder[chosen]
        return Shapes(frame, occluder, self.lines[chosen], self.count[lines], self.corners[corners])

    def pieces(self) -> Iterator[tuple[Indices, NDArray[np.uint16]]]:
        """The counts and the corners of each shape."""
        for shape in range(len(self)):
            lines, corners = (slice(*first[shape : shape + 2]) for first in (self.first_line, self.first_corner))
            yield self.count[lines], self.corners[corners]

    def equal(self, others: Indices) -> Mask:
        """Whether each shape has the same lines as another, by index, −1 for none, shape (s,)."""
        same: Mask = (others >= 0) & (self.lines == self.lines[others])
        size = np.diff(self.first_corner)
        same &= size == size[others]
        for values, first in ((self.count, self.first_line), (self.corners, self.first_corner)):
            rows = np.flatnonzero(same)
            long = np.diff(first)[rows]
            which = np.repeat(np.arange(len(rows)), long)
            place = np.arange(len(which)) - np.repeat(np.cumsum(long) - long, long)
            mine, other = (values[first[shapes][which] + place] for shapes in (rows, others[rows]))
            differ = (mine != other).any(axis=tuple(range(1, mine.ndim)))  # also of no shapes at all
            same[rows[np.unique(which[differ])]] = False
        return same


def concatenated(some: Sequence[Shapes]) -> Shapes:
    """Shapes one after the other."""
    names = ("frame", "occluder", "lines", "count", "corners")
    return Shapes(*(np.concatenate([getattr(part, name) for part in some]) for name in names))


_NONE = np.empty(0, dtype=np.int64)
NO_SHAPES = Shapes(_NONE, _NONE, _NONE, _NONE, np.empty((0, 2), dtype=np.uint16))
