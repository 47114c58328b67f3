"""Misses of which each thing keeps a share of the noise for as long as it is seen: some things are always harder."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Indices
from modsim3d.learn.observed.observed import Observed
from modsim3d.learn.persistence.vessel_noise import LagTable

_SHARES = np.linspace(0, 0.99, 100)
_CHANCES = 50


def miss_lags(observed: Observed, chance: Array, slopes: int) -> LagTable:
    """Products of the residuals of misses at all times between.

    Args:
        observed: The misses.
        chance: Fitted chance of each to be missed, shape (n,).
        slopes: Number of slopes that were fitted beside the rates of each state and label.
    """
    residual, variance = observed.missed - chance, np.maximum(chance * (1 - chance), 1e-12)
    size = residual**2 / variance

    def compare(earlier: Indices, later: Indices) -> tuple[Array, Array]:
        """A miss that is read from the same number as another, scaled by how large both squares are."""
        first, second = chance[earlier], chance[later]
        same = np.minimum(first, second) - first * second
        return residual[earlier] * residual[later], same * (size[earlier] + size[later]) / 2

    group = observed.state * len(observed.labelled.labels) + observed.label
    return LagTable.of(observed.labelled, observed.rows, group, compare, slopes)


def latent_share(chance: Array) -> Callable[[Array], Array]:
    """What share of the latent normal number things keep, from the correlation of misses that it leaves.

    With a share s two misses of a chance p have the probability p − 2·T(z, √((1 − s)/(1 + s))), with z the normal
    number of p and T the function of Owen (1956), "Tables for computing bivariate normal probabilities".
    """
    varied = chance[(chance > 0) & (chance < 1)]
    p = np.quantile(varied, (np.arange(_CHANCES) + 0.5) / _CHANCES)[:, None]
    both = p - 2 * special.owens_t(special.ndtri(p), np.sqrt((1 - _SHARES) / (1 + _SHARES)))
    level = (both - p**2).sum(axis=0) / (p - p**2).sum()
    return lambda found: np.interp(found, level, _SHARES)


def crowds(observed: Observed, labels: int) -> Array:
    """Mean number of sightings of the same thing in the same state, of each sighting, shape (states, labels)."""
    thing = np.where(observed.thing >= 0, observed.thing, -1 - np.arange(len(observed.rows)))
    cell = observed.state * labels + observed.label
    keys, count = np.unique(np.column_stack([cell, thing]), axis=0, return_counts=True)
    size = len(observed.states) * labels
    squares, whole = (np.bincount(keys[:, 0], count**power, minlength=size) for power in (2, 1))
    result: Array = (squares / np.maximum(whole, 1)).reshape(len(observed.states), labels)
    return result
