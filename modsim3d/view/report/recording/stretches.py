"""Stretches of steps in which something is so without a break, gathered part by part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Indices


@dataclass(frozen=True, eq=False)
class Stretches:
    """Stretches of shown steps, in order of key and time.

    Attributes:
        key: What is so, of whom: any whole number, shape (n,).
        first: Index of the first step, shape (n,).
        until: Index of the last step, shape (n,).
    """

    key: Indices
    first: Indices
    until: Indices

    def __len__(self) -> int:
        """Number of stretches."""
        return len(self.key)

    def of(self, first_key: int, stop_key: int) -> Stretches:
        """Those with keys first_key to stop_key − 1."""
        here = slice(*np.searchsorted(self.key, (first_key, stop_key)).tolist())
        return Stretches(self.key[here], self.first[here], self.until[here])

    def by_time(self) -> Stretches:
        """The same, in order of their first steps and then of their keys."""
        order = np.lexsort((self.key, self.first))
        return Stretches(self.key[order], self.first[order], self.until[order])


def onsets(begins: Stretches, holds: Stretches) -> Stretches:
    """Stretches of `holds`, each from the first step in it that is in `begins` too; those with none are left out.

    Args:
        begins: Stretches that lie in those of `holds`.
        holds: Longer ones of the same keys.
    """
    span = int(holds.until.max(initial=0)) + 1
    place = np.searchsorted(holds.key * span + holds.first, begins.key * span + begins.first, side="right") - 1
    which, first = np.unique(place, return_index=True)
    return Stretches(holds.key[which], begins.first[first], holds.until[which])


class StretchesBuilder:
    """Stretches of a run that comes in parts."""

    def __init__(self) -> None:
        """Begin with none."""
        self._parts: list[Stretches] = []

    def add(self, key: Indices, index: Indices) -> None:
        """Add steps at which something is so: keys and indices of steps, both of shape (n,), each pair once."""
        order = np.lexsort((index, key))
        self._parts.append(_joined(key[order], index[order], index[order]))

    def stretches(self) -> Stretches:
        """All of them; those that touch across parts are one."""
        none = np.empty(0, dtype=np.int64)
        key, first, until = (
            np.concatenate([none, *(getattr(part, name) for part in self._parts)]) for name in ("key", "first", "until")
        )
        order = np.lexsort((first, key))
        return _joined(key[order], first[order], until[order])


def _joined(key: Indices, first: Indices, until: Indices) -> Stretches:
    """Stretches in order of key and time, those that follow on each other without a gap joined."""
    if not len(key):
        return Stretches(key, first, until)
    begins = np.append(True, (np.diff(key) != 0) | (first[1:] > until[:-1] + 1))
    return Stretches(key[begins], first[begins], until[np.append(begins[1:], True)])
