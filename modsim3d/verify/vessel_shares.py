"""Misses and classes of which each vessel keeps a share of the noise: how far sums of them stray.

Given what a vessel keeps, b, its latent number of a step is √s·b + √(1 − s)·z, with z that of a detector without
shares. So everything that is known of such a detector holds at each b, with other bounds, and expectations are
integrals over b.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Indices
from modsim3d.detector.persistence import Persistence
from modsim3d.verify.pairs import lag_pairs

_NODES = 32


def at_each(share: float, *bounds: Array) -> Iterator[tuple[float, tuple[Array, ...]]]:
    """Weights of values of what a vessel keeps, with the bounds of uniform numbers at it, shapes (n,).

    Gauss and Hermite's quadrature.
    """
    nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES)
    latent = [special.ndtri(np.clip(bound, 0, 1)) for bound in bounds]
    for node, weight in zip(nodes.tolist(), (weights / weights.sum()).tolist(), strict=True):
        kept = np.sqrt(share) * node
        yield weight, tuple(special.ndtr((bound - kept) / np.sqrt(1 - share)) for bound in latent)


def variance_of_sum(
    tracks: Indices, times_s: Array, persistence: Persistence, bounds: tuple[Array, Array], amount: Array
) -> float:
    """Variance of a sum of amounts, shape (n,), where uniform numbers of vessels are between bounds (low, high), (n,).

    Rows (n, k) of `tracks` are equal in one track; times have shape (n,).
    """
    low, high = bounds
    _, track = np.unique(tracks, axis=0, return_inverse=True)
    track = track.ravel()
    first = second = np.zeros(int(track.max(initial=-1)) + 1)
    total = 0.0
    pairs = list(lag_pairs(tracks, times_s, persistence.class_s)) if persistence.class_s > 0 else []
    for weight, (low_b, high_b) in at_each(persistence.class_vessel_share, low, high):
        chance = high_b - low_b
        of_track = np.bincount(track, amount * chance, minlength=len(first))
        first, second = first + weight * of_track, second + weight * of_track**2
        total += weight * float((amount**2 * chance * (1 - chance)).sum())
        for later, earlier, apart_s in pairs:
            common = np.minimum(high_b[later], high_b[earlier]) - np.maximum(low_b[later], low_b[earlier])
            both = np.maximum(common, 0) - chance[later] * chance[earlier]
            kept = np.exp(-apart_s / persistence.class_s) * both * amount[later] * amount[earlier]
            total += 2 * weight * float(kept.sum())
    return total + float((second - first**2).sum())
