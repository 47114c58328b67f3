"""Distributions on real and on simulated detections: lengths of gaps, of runs and of tracks, and confidence.

Values of one film are alike, so a test that takes each value as one of its own would find differences that are none.
Here the film's outputs are exchanged: if simulation is a good stand-in, the real output of a film is one like the
simulated ones, and which of them is called real is chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.stand_in.scores import OpenFilm, found_vessels, track_lengths_s
from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.tracking.scores.continuity import false_track_lengths_s
from modsim3d.tracking.scores.scored_run import stretches

if TYPE_CHECKING:
    from modsim3d.runs.tracker_view import TrackerDetections
    from modsim3d.tracking.scores.scored_run import ScoredRun

Samples = dict[str, Array]
OF_DETECTIONS = {
    "gap_s": "gap between two sightings of a vessel, s",
    "run_s": "unbroken run of sightings of a vessel, s",
    "true_confidence": "confidence of a detection of a vessel",
    "false_confidence": "confidence of a false positive",
    "false_by_frame": "false positives in a frame",
}
OF_TRACKS = {"track_s": "length of a track, s", "false_track_s": "length of a false track, s"}
TITLES = OF_DETECTIONS | OF_TRACKS
EXCHANGES = 999
POINTS = 400
"""At most so many values at which two distributions are compared."""
_SEED = 21
_SAME = 1e-9
"""Distances of exchanges that are equal but for rounding count as equal."""


def of_detections(opened: OpenFilm, detections: TrackerDetections) -> Samples:
    """The values of each of `OF_DETECTIONS` in a film."""
    found, row = found_vessels(opened, detections)
    gaps, runs = gaps_and_runs(opened.truth.identity, opened.truth.frame, opened.truth.scored, found)
    false = row < 0
    right = ~false & np.append(opened.truth.scored, False)[row]
    return {
        "gap_s": gaps * opened.period_s,
        "run_s": runs * opened.period_s,
        "true_confidence": detections.confidence[right],
        "false_confidence": detections.confidence[false],
        "false_by_frame": np.bincount(detections.frame[false], minlength=len(opened.sequence.steps)).astype(float),
    }


def of_tracks(opened: OpenFilm, scored: ScoredRun) -> Samples:
    """The values of each of `OF_TRACKS` in a film."""
    return {
        "track_s": track_lengths_s(opened, scored.following.tracks),
        "false_track_s": false_track_lengths_s(scored),
    }


def gaps_and_runs(identity: Indices, frame: Indices, scored: Mask, found: Mask) -> tuple[Indices, Indices]:
    """Numbers of frames of each gap between two sightings of an identity, and of each run of sightings.

    Frames in which a vessel is not scored count for neither, and break neither.

    Args:
        identity: Number of the appearance of n vessel-frames, shape (n,).
        frame: Number of the frame, shape (n,).
        scored: Whether it is scored, shape (n,).
        found: Whether it is detected, shape (n,).
    """
    rows = np.flatnonzero(scored)
    rows = rows[np.lexsort((frame[rows], identity[rows]))]
    whose, seen, place = identity[rows], found[rows], np.arange(len(rows))
    runs, misses = (stretches(whose[chosen], place[chosen]) for chosen in (seen, ~seen))
    first, last = (place[~seen][each] for each in misses)
    before, after = np.append(whose, -1)[first - 1] == whose[first], np.append(whose, -1)[last + 1] == whose[last]
    return (last - first + 1)[before & after & (first > 0)], runs.last - runs.first + 1


def compared(real: Sequence[Array], simulated: Sequence[Sequence[Array]]) -> dict[str, Any]:
    """Compare a distribution on F films.

    Args:
        real: The values on each film, F arrays.
        simulated: The values with each of S seeds, F lists of S arrays.

    Returns:
        Numbers of values, means and quartiles of both; `ks`: the largest distance of the two distribution functions;
        `wasserstein`: how far the values must be moved on average to make one of the other; `p_value`: the share of
        exchanges of real and simulated within films that have at least this `ks`; None where one side has no values.
    """
    both = np.concatenate(real), np.concatenate([values for seeds in simulated for values in seeds])
    found: dict[str, Any] = {
        name: {"values": len(values), "mean": _mean(values), "quartiles": _quartiles(values)}
        for name, values in zip(("real", "simulated"), both, strict=True)
    }
    if not all(map(len, both)):
        return found | {"ks": None, "wasserstein": None, "p_value": None}
    points = _points(np.concatenate(both))
    counts = np.array([[_counts(values, points) for values in (r, *s)] for r, s in zip(real, simulated, strict=True)])
    chosen = _exchanges(len(real), counts.shape[1])
    apart = _largest_distances(counts, chosen)
    rounded = np.array(apart) + _SAME
    return found | {
        "ks": apart[0],
        "wasserstein": wasserstein(*both),
        "p_value": float(np.mean(rounded >= apart[0])),
    }


def wasserstein(a: Array, b: Array) -> float:
    """The area between two empirical distribution functions, in the unit of the values."""
    a, b, every = np.sort(a), np.sort(b), np.sort(np.concatenate([a, b]))
    at = (np.searchsorted(each, every[:-1], side="right") / len(each) for each in (a, b))
    return float(np.sum(np.abs(np.subtract(*at)) * np.diff(every)))


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """p-values adjusted for their number by Holm's method; None stays None."""
    known = sorted((p, k) for k, p in enumerate(p_values) if p is not None)
    adjusted: list[float | None] = [None] * len(p_values)
    largest = 0.0
    for rank, (p, k) in enumerate(known):
        largest = max(largest, min(1.0, (len(known) - rank) * p))
        adjusted[k] = largest
    return adjusted


def _points(values: Array) -> Array:
    """The values at which distribution functions are compared: all different ones, or quantiles of them."""
    different = np.unique(values)
    return different if len(different) <= POINTS else np.unique(np.quantile(values, np.linspace(0, 1, POINTS)))


def _counts(values: Array, points: Array) -> Array:
    """Numbers of values up to each point."""
    return np.searchsorted(np.sort(values), points, side="right").astype(float)


def _exchanges(films: int, outputs: int) -> Indices:
    """Which output of each film is called real: as it is first, then drawn, shape (1 + EXCHANGES, films)."""
    drawn = np.random.default_rng(_SEED).integers(outputs, size=(EXCHANGES, films))
    return np.vstack([np.zeros((1, films), dtype=np.int64), drawn])


def _largest_distances(counts: Array, chosen: Indices) -> list[float]:
    """The largest distance of the two distribution functions in each exchange.

    Args:
        counts: Values up to each of P points of each film's outputs, the real one first, shape (F, 1 + S, P).
        chosen: Which output is called real, shape (E, F).
    """
    total, films, found = counts.sum(axis=(0, 1)), np.arange(len(counts)), []
    for outputs in chosen:
        real = counts[films, outputs].sum(axis=0)
        rest = total - real
        empty = not real[-1] or not rest[-1]
        found.append(0.0 if empty else float(np.abs(real / real[-1] - rest / rest[-1]).max()))
    return found


def _mean(values: Array) -> float | None:
    return float(values.mean()) if len(values) else None


def _quartiles(values: Array) -> list[float] | None:
    return np.quantile(values, (0.25, 0.5, 0.75)).tolist() if len(values) else None
