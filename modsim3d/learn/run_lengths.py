"""How many frames in a row a vessel is missed."""

from __future__ import annotations

import numpy as np

from modsim3d.detector.records import Array, Indices
from modsim3d.learn.evidence import Evidence


def run_lengths(evidence: Evidence) -> Indices:
    """Number of runs of misses by length, from 0 on; a run ends where the vessel is detected or not annotated."""
    chances = evidence.chances
    missed = chances.outcome < 0
    length = missed.astype(np.int64)
    order = np.lexsort((chances.frame, chances.camera))  # each row after the one before it
    for row in order[missed[order] & (chances.before[order] >= 0)]:
        length[row] += length[chances.before[row]]
    goes_on = np.zeros(len(missed), dtype=bool)
    follows = np.flatnonzero(missed & (chances.before >= 0))
    goes_on[chances.before[follows]] = True
    return np.bincount(length[missed & ~goes_on], minlength=2)


def expected_run_lengths(miss_probability: Array, before: Indices, most: int) -> Array:
    """Expected number of runs of 1, 2, ... `most` misses if misses are independent, shape (most,).

    Args:
        miss_probability: Of each chance, shape (n,).
        before: Row of the same vessel in the frame before, −1 if there is none, shape (n,).
        most: Greatest length.
    """
    after = np.full(len(before), -1)
    follows = np.flatnonzero(before >= 0)
    after[before[follows]] = follows
    ends = np.where(after >= 0, 1 - miss_probability[after], 1.0)
    starts = np.where(before >= 0, 1 - miss_probability[before], 1.0)
    expected = np.zeros(most)
    chance, row, alive = miss_probability * starts, np.arange(len(before)), np.ones(len(before), dtype=bool)
    for k in range(most):
        expected[k] = (chance * ends[row])[alive].sum()
        onwards = after[row]
        alive &= onwards >= 0
        row = np.where(onwards >= 0, onwards, row)
        chance = chance * np.where(alive, miss_probability[row], 0)
    return expected
