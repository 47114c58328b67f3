"""Runs of frames in which a vessel is missed: how long they are, and how long they should be."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.detector.model import DetectorModel
from modsim3d.verify.evidence import Evidence
from modsim3d.verify.vessel_shares import at_each


def run_lengths(evidence: Evidence) -> Indices:
    """Number of runs of misses by length from 0 on, shape (most + 1,).

    A run ends where the vessel is detected or not annotated.
    """
    instances = evidence.instances
    missed = instances.outcome == -1  # −2 is detected in another's box
    length = missed.astype(np.int64)
    order = np.lexsort((instances.frame, instances.camera))  # each row after the one before it
    for row in order[missed[order] & (instances.before[order] >= 0)]:
        length[row] += length[instances.before[row]]
    goes_on = np.zeros(len(missed), dtype=bool)
    follows = np.flatnonzero(missed & (instances.before >= 0))
    goes_on[instances.before[follows]] = True
    return np.bincount(length[missed & ~goes_on], minlength=2)


def asked_run_lengths(model: DetectorModel, evidence: Evidence, miss_probability: Array, most: int) -> Array:
    """Expected number of runs of 1, 2, ... `most` misses, shape (most,), given the probability of each miss, (n,)."""
    before, share = evidence.instances.before, model.persistence.class_vessel_share
    if not share:
        again = missed_again(model, evidence, miss_probability)
        return expected_run_lengths(miss_probability, again, before, most)
    expected = np.zeros(most)
    for weight, (found,) in at_each(share, 1 - miss_probability):
        again = missed_again(model, evidence, 1 - found)
        expected += weight * expected_run_lengths(1 - found, again, before, most)
    return expected


def missed_again(model: DetectorModel, evidence: Evidence, miss_probability: Array) -> Array:
    """Probability of a miss given that the frame before was one, shape (n,); the plain one without a frame before."""
    instances, tau = evidence.instances, model.persistence.class_s
    if tau <= 0:
        return miss_probability
    before = np.where(instances.before >= 0, instances.before, 0)
    kept = np.exp(-(instances.time_s - instances.time_s[before]) / tau)
    earlier = miss_probability[before]
    same = np.minimum(1.0, miss_probability / np.where(earlier > 0, earlier, 1))
    return np.where(instances.before >= 0, kept * same + (1 - kept) * miss_probability, miss_probability)


def expected_run_lengths(miss_probability: Array, again: Array, before: Indices, most: int) -> Array:
    """Expected number of runs of 1, 2, ... `most` misses, shape (most,).

    Instances have a probability of a miss, one given that the frame before was a miss, and the row of the same vessel
    in the frame before, −1 if there is none; shapes (n,).
    """
    after = np.full(len(before), -1)
    follows = np.flatnonzero(before >= 0)
    after[before[follows]] = follows
    ends = np.where(after >= 0, 1 - again[after], 1.0)
    chance = miss_probability - np.where(before >= 0, miss_probability[before] * again, 0.0)
    expected = np.zeros(most)
    row, alive = np.arange(len(before)), np.ones(len(before), dtype=bool)
    for k in range(most):
        expected[k] = (chance * ends[row])[alive].sum()
        onwards = after[row]
        alive &= onwards >= 0
        row = np.where(onwards >= 0, onwards, row)
        chance = chance * np.where(alive, again[row], 0)
    return expected
