"""Does the ranking of trackers by a score come out the same on simulated detections as on real ones?"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array

DRAWS = 4000
_SEED = 20


def ranking(real: Array, simulated: Array, trackers: tuple[str, ...]) -> dict[str, Any]:
    """Compare the order of T trackers over F films.

    Args:
        real: Score of each film and tracker, shape (F, T).
        simulated: The same of S seeds, shape (F, T, S).
        trackers: Their names.

    Returns:
        `real` and `simulated`: names by mean score, the best first. `tau`: mean over films and seeds of Kendall's tau
        of the orders within a film. `tau_of_seeds`: the same of one simulated seed against another, which is as much
        as tau can be; None with one seed. `same_order` and `same_best`: share of draws of films, with replacement, in
        which all trackers have the same order by their mean scores, and in which the best one is the same. `pairs`:
        those of which the real data surely say which is better, with both paired differences.
    """
    whole = ~np.isnan(real).any(axis=1) & ~np.isnan(simulated).any(axis=(1, 2))
    real, simulated = real[whole], simulated[whole]
    films, seeds = len(real), simulated.shape[2]
    if not films:
        return {"films": 0}
    means = simulated.mean(axis=2)
    drawn = np.random.default_rng(_SEED).integers(films, size=(DRAWS, films))
    orders = [np.argsort(-each[drawn].mean(axis=1), axis=1, kind="stable") for each in (real, means)]
    same = orders[0] == orders[1]
    pairs = list(combinations(range(seeds), 2))
    return {
        "films": films,
        "real": _named(real.mean(axis=0), trackers),
        "simulated": _named(means.mean(axis=0), trackers),
        "tau": float(np.mean([tau(real, simulated[:, :, seed]) for seed in range(seeds)])),
        "tau_of_seeds": float(np.mean([tau(simulated[:, :, a], simulated[:, :, b]) for a, b in pairs]))
        if pairs
        else None,
        "same_order": float(same.all(axis=1).mean()),
        "same_best": float(same[:, 0].mean()),
        "pairs": list(_pairs(real, means, trackers)),
    }


def _pairs(real: Array, simulated: Array, trackers: tuple[str, ...]) -> Iterator[dict[str, Any]]:
    """Paired differences over films of two trackers that are surely apart on real detections, the better one first."""
    half = float(special.stdtrit(len(real) - 1, 0.975)) if len(real) > 1 else np.inf
    for i, j in combinations(range(len(trackers)), 2):
        apart = [each[:, i] - each[:, j] for each in (real, simulated)]
        reach = [half * float(each.std(ddof=1)) / np.sqrt(len(each)) if len(each) > 1 else np.inf for each in apart]
        means = [float(each.mean()) for each in apart]
        if abs(means[0]) > reach[0]:
            names = (trackers[i], trackers[j]) if means[0] > 0 else (trackers[j], trackers[i])
            sign = 1 if means[0] > 0 else -1
            yield {
                "better": names[0],
                "worse": names[1],
                "real": sign * means[0],
                "real_half": reach[0],
                "simulated": sign * means[1],
                "simulated_half": reach[1],
            }


def tau(a: Array, b: Array) -> float:
    """Kendall's tau of the orders of T scores, mean over F films; a tie counts as neither, shapes (F, T)."""
    signs = [np.sign(a[:, i] - a[:, j]) * np.sign(b[:, i] - b[:, j]) for i, j in combinations(range(a.shape[1]), 2)]
    return float(np.mean(signs))


def _named(means: Array, trackers: tuple[str, ...]) -> list[str]:
    return [trackers[k] for k in np.argsort(-means, kind="stable")]
