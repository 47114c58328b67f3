"""What a correlation in time loses because the mean error is taken from the same few sightings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.formats.labelled import Images, LabelledSet


@dataclass(frozen=True, eq=False)
class Stretches:
    """The sightings of each thing in each state: how many, the mean time between them, and the state; shapes (s,)."""

    count: Array
    apart_s: Array
    state: Indices

    def correlation_left(self, times_s: Array) -> Array:
        """Correlation of consecutive deviations from the mean, over that of the noise itself, for times τ, shape (m,).

        The mean of a state is that of all its sightings. With ρ_ij = e^(−|t_i − t_j|/τ) within a thing, C_i the
        correlation of sighting i with the mean and V the variance of the mean, consecutive deviations have the
        expected product ρ_ij − C_i − C_j + V and squares have 1 − 2·C_i + V: for one thing this is the bias of
        Kendall (1954), "Note on bias in the estimation of autocorrelation". Sightings are taken as evenly spaced.
        """
        several = self.count > 1
        if not several.any():
            return np.ones(len(times_s))
        count, state, apart_s = self.count[several], self.state[several], self.apart_s[several]
        kept = np.exp(-apart_s / times_s[:, None])
        away, run = np.maximum(1 - kept, 1e-300), 1 - kept**count
        alone = np.bincount(self.state, self.count * ~several, minlength=self.state.max() + 1)  # a thing seen once
        both = count * (1 + kept) / away - 2 * kept * run / away**2
        size = np.bincount(self.state, self.count)
        whole = np.stack([np.bincount(state, row, minlength=len(size)) for row in both]) + alone
        variance: Array = whole / np.maximum(size, 1) ** 2
        pairs, ours = count - 1, size[state]
        end = run / away / ours
        inside = both / ours
        products = (pairs * kept - 2 * (inside - end) + pairs * variance[:, state]).sum(axis=1)
        squares = (pairs - 2 * (inside - end) + pairs * variance[:, state]).sum(axis=1)
        left: Array = products / squares * pairs.sum() / (pairs * kept).sum(axis=1)
        return left


def stretches_of(labelled: LabelledSet, rows: Indices, state: Indices) -> Stretches:
    """Stretches of annotations (n,) of things with identities in frames with times, given their states (n,)."""
    annotations = labelled.annotations
    return stretches_of_things(labelled.images, annotations.image[rows], annotations.identity[rows], state)


def stretches_of_things(images: Images, image: Indices, identity: Indices, state: Indices) -> Stretches:
    """Stretches of sightings, from their images, identities, −1 where unknown, and states, shapes (n,)."""
    time_s, sequence = images.time_s[image], images.sequence[image]
    known = np.flatnonzero((identity >= 0) & np.isfinite(time_s))
    keys = np.column_stack([sequence, identity, state])[known]
    each, first, place = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    count = np.bincount(place.ravel()).astype(np.float64)
    low, high = np.full(len(each), np.inf), np.full(len(each), -np.inf)
    np.minimum.at(low, place.ravel(), time_s[known])
    np.maximum.at(high, place.ravel(), time_s[known])
    return Stretches(count, (high - low) / np.maximum(count - 1, 1), state[known][first])
