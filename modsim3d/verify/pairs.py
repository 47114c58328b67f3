"""Pairs of rows of one track, and how much the noise that they share adds to a variance."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.detector.model import DetectorModel
from modsim3d.verify.evidence import Evidence

_FORGOTTEN = 10.0
"""Correlation times after which a correlation is neglected: 5e-5 of it is left."""


def lag_pairs(tracks: Indices, times_s: Array, correlation_s: float) -> Iterator[tuple[Indices, Indices, Array]]:
    """Pairs of rows of one track that are near enough in time to be correlated, neighbours first.

    Rows (n, k) of `tracks` are equal in one track; times have shape (n,). The correlation falls to 1/e in
    `correlation_s`. Yields later rows, earlier rows, and seconds between, shapes (m,).
    """
    order = np.lexsort((times_s, *tracks.T[::-1]))
    ordered, times = tracks[order], times_s[order]
    for lag in range(1, len(order)):
        same = (ordered[lag:] == ordered[:-lag]).all(axis=1)
        apart = times[lag:] - times[:-lag]
        near = np.flatnonzero(same & (apart <= _FORGOTTEN * correlation_s))
        if not len(near):
            return
        yield order[near + lag], order[near], apart[near]


def turn_before(model: DetectorModel, evidence: Evidence) -> Indices:
    """Row of the same vessel in the last frame at which the camera's detector ran, −1 if there is none, shape (n,)."""
    instances = evidence.instances
    if model.gates.update_interval_s is None:
        return instances.before
    turn, ran = np.empty(len(instances.frame), dtype=np.int64), np.empty(len(instances.frame), dtype=bool)
    for camera, seen in enumerate(evidence.cameras):
        ours = np.flatnonzero(instances.camera == camera)
        due = model.gates.due(seen.frames)
        turn[ours], ran[ours] = np.cumsum(due)[instances.frame[ours]], due[instances.frame[ours]]
    rows = np.flatnonzero(ran)
    tracks, _ = instances.tracks(rows)
    order = np.lexsort((turn[rows], *tracks.T[::-1]))
    same = (tracks[order][1:] == tracks[order][:-1]).all(axis=1)
    follows = same & (np.diff(turn[rows[order]]) == 1)
    before = np.full(len(turn), -1)
    before[rows[order[1:][follows]]] = rows[order[:-1][follows]]
    return before


def inflation(
    tracks: Indices,
    times_s: Array,
    correlation_s: float,
    variances: Array,
    covariance: Callable[[Indices, Indices], Array],
) -> float:
    """Variance of the sum of rows whose noise persists, over that of independent rows with variances of shape (n,).

    Two rows of a track, see `lag_pairs`, have kept the same noise with probability e^(−Δt / correlation_s).
    `covariance` is that of later and earlier rows that have kept it.
    """
    alone = float(variances.sum())
    if correlation_s <= 0 or alone <= 0:
        return 1.0
    total = alone
    for later, earlier, apart in lag_pairs(tracks, times_s, correlation_s):
        total += 2 * float((np.exp(-apart / correlation_s) * covariance(later, earlier)).sum())
    return total / alone
