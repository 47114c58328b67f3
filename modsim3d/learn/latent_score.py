"""The score behind misses and confidence: whether there is one, and how long it is remembered."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices
from modsim3d.learn import lags
from modsim3d.learn.bootstrap import SIGNIFICANT, Entry, Key, Resampling, digits, nested
from modsim3d.learn.matches import Observed

# ---- Misses of which each thing keeps a share of the noise for as long as it is seen ----


def miss_lags(observed: Observed, chance: Array, slopes: int) -> lags.LagTable:
    """Products of the residuals of misses at all times between, given the fitted chance of each to be missed (n,), and
    the number of slopes that were fitted beside the rates of each state and label."""
    residual, variance = observed.missed - chance, np.maximum(chance * (1 - chance), 1e-12)
    size = residual**2 / variance

    def compare(earlier: Indices, later: Indices) -> tuple[Array, Array]:
        """A miss that is read from the same number as another, scaled by how large both squares are."""
        first, second = chance[earlier], chance[later]
        same = np.minimum(first, second) - first * second
        return residual[earlier] * residual[later], same * (size[earlier] + size[later]) / 2

    group = observed.state * len(observed.labelled.labels) + observed.label
    return lags.LagTable.of(observed.labelled, observed.rows, group, compare, slopes)


# ---- Whether confidence falls before a miss ----

_LOST_NEEDED = 20  # detections followed by a miss, from which a score is told from two numbers that are drawn apart
_NODES = (np.arange(400) + 0.5) / 400


def behaves_like_a_score(observed: Observed, chance: Array, notes: list[str]) -> bool:
    """Whether detections before a miss are unsure as one score makes them, and not as sure as any other. Each
    annotation had a fitted chance to be missed (n,). Why there is no score is added to the notes."""
    if not observed.labelled.scored or {"score", "confidence"} & observed.without:
        return False
    level = np.full(len(observed.rows), np.nan)
    confidence = observed.labelled.results.confidence[observed.detection[observed.found]]
    for state in range(len(observed.states)):
        ours = observed.state[observed.found] == state
        rank = np.argsort(np.argsort(confidence[ours], kind="stable"))
        level[observed.found[ours]] = (rank + 0.5) / max(int(ours.sum()), 1)
    earlier, later = observed.steps.earlier, observed.steps.later
    known = np.isfinite(level[earlier])
    lost = known & (observed.missed[later] > 0)
    if lost.sum() < _LOST_NEEDED:
        notes.append(f"persistence.score: none; had {lost.sum()} detections before a miss, needs {_LOST_NEEDED}")
        return False
    p = float(chance[earlier[lost]].mean())
    correlation = _correlation_of_losses(float(observed.missed[later[known]].mean()), p)
    expected, found = _mean_level_before_a_miss(p, correlation), float(level[earlier[lost]].mean())
    if found < (0.5 + expected) / 2:
        return True
    notes.append(
        f"persistence.score: none; detections before a miss are surer than {found:.0%} of all, with a score than "
        f"{expected:.0%}"
    )
    return False


def _correlation_of_losses(lost: float, p: float) -> float:
    """Correlation of two scores with which a share of the found with a chance p of a miss is lost a frame later."""
    return float(np.interp(-lost, -(p - lags.both_missed(np.array([p]))) / (1 - p), lags.LATENT_SHARES))


def _mean_level_before_a_miss(p: float, correlation: float) -> float:
    """Mean level of confidence where the score, with a chance p of a miss, is below it one frame later."""
    z = special.ndtri(p + (1 - p) * _NODES)
    lost = special.ndtr((special.ndtri(p) - correlation * z) / np.sqrt(1 - correlation**2))
    return float((lost * _NODES).sum() / lost.sum())


# ---- How long the score is remembered ----


@dataclass(frozen=True, eq=False)
class LearnedScore:
    """Shares of the score that things keep and that are forgotten in some times."""

    vessel_share: Entry
    shares: Entry
    times_s: tuple[float, ...]
    level: float  # correlation of residuals of misses that stays
    label_s: float  # correlation time of labels, which the score does not draw; 0 if they do not persist

    def section(self) -> dict[str, Any]:
        """The score in a detector file."""
        return {
            "vessel_share": digits(self.vessel_share.estimate),
            "shares": nested(np.floor(self.shares.estimate * 1e6) / 1e6),
            "times_s": [digits(time_s) for time_s in self.times_s],
        }


def learned_score(observed: Observed, chance: Array, slopes: int, resampling: Resampling) -> LearnedScore:
    """Shares of the score with replicates, from the tetrachoric correlation of misses at each lag. Times of the
    autoregressive parts are fixed, each four times the one before: a sum of them comes near any memory that only fades,
    and shares that are not negative (Lawson and Hanson (1974), "Solving least squares problems") need no test."""
    table = miss_lags(observed, chance, slopes)
    times_s, found = lags.memory_shares(table, lags.latent_share(chance), resampling)
    path = ("persistence", "score")
    kept, shares = (lags.replace_values(found, found.values[:, 0]), lags.replace_values(found, found.values[:, 1:]))
    level = float(
        lags.level_of(chance)[np.searchsorted(lags.LATENT_SHARES, min(float(kept.estimate), lags.LATENT_SHARES[-1]))]
    )
    return LearnedScore(
        Entry(Key((*path, "vessel_share")), kept),
        Entry(Key((*path, "shares"), axes=(lags.in_seconds(times_s),)), shares),
        tuple(times_s.tolist()),
        level,
        label_memory_s(observed),
    )


def label_memory_s(observed: Observed) -> float:
    """Correlation time of the labels of detections; 0 if those of consecutive ones agree no more than by chance. A
    label is kept with probability κ = e^(−Δt/τ), else drawn anew, so a share κ + (1 − κ)·Σ p² of them agrees."""
    earlier, later, apart_s = observed.steps.earlier, observed.steps.later, observed.steps.apart_s
    seen_as, labels = observed.seen_as, len(observed.labelled.labels)
    both = (seen_as[earlier] < labels) & (seen_as[later] < labels)
    cell = observed.state * labels + observed.label
    counts = np.zeros((len(observed.states) * labels, labels))
    found = seen_as < labels
    np.add.at(counts, (cell[found], seen_as[found]), 1)
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    by_chance = float((shares[cell[later[both]]] ** 2).sum(axis=1).mean()) if both.any() else 1.0
    if by_chance >= 1 - 1e-9:
        return 0.0
    agree = float((seen_as[earlier[both]] == seen_as[later[both]]).mean())
    kept = min((agree - by_chance) / (1 - by_chance), lags.GREATEST_SHARE)
    errors = np.sqrt(by_chance * (1 - by_chance) / both.sum()) / (1 - by_chance)
    return float(-np.median(apart_s[both]) / np.log(kept)) if kept > SIGNIFICANT * errors else 0.0
