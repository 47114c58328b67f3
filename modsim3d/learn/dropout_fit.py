"""Misses: how they depend on what a thing looks like, by logistic regression, and the score behind them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.text import in_percent
from modsim3d.detector.dropout import WHOLLY_VISIBLE
from modsim3d.learn import lags
from modsim3d.learn.bootstrap import SIGNIFICANT, Entry, Key, Resampling, digits, nested
from modsim3d.learn.matches import Outcomes

MISSES_FOR_EACH = 20  # misses, and detections, that a regression needs for each effect (Peduzzi et al. (1996): 10)
LOG_ODDS_QUANTILES = 32  # numbers that stand for the distribution of log-odds over a learning set
REFERENCES = {"visible_fraction": 1.0, "partly_hidden": 0.0}  # of effects by units: a vessel that is wholly visible
_STEPS = 60


@dataclass(frozen=True)
class EffectTerm:
    """An attribute that changes the odds of a miss, by its key in the file; at its reference they are the state's.
    Sizes and distances change them by doublings, or by units where that fits better. An effect of a single state, by
    its index, replaces the shared one of its attribute there."""

    attribute: str
    reference: float
    by_units: bool = False
    state: int | None = None

    @property
    def doublings(self) -> bool:
        """Whether the odds change by doublings of the attribute, or by units."""
        return self.attribute not in REFERENCES and not self.by_units

    @property
    def slope_key(self) -> str:
        """Key of the slope in the detector file."""
        return "per_doubling" if self.doublings else "per_unit"

    def of(self, values: Array) -> Array:
        """Units or doublings beyond the reference, 0 where the value is unknown, shape (n,)."""
        levels = np.where(np.isfinite(values), values, self.reference)
        changed: Array = levels - self.reference
        return np.log2(np.maximum(levels, 1.0) / self.reference) if self.doublings else changed

    def holds_in(self, states: int, effects: tuple[EffectTerm, ...]) -> Mask:
        """Mask of the states in which it holds beside other effects, shape (states,)."""
        others = [term.state for term in effects if term.attribute == self.attribute and term.state is not None]
        numbers = np.arange(states)
        return ~np.isin(numbers, others) if self.state is None else numbers == self.state


def attribute_values(observed: Outcomes) -> dict[str, Array]:
    """Values of each attribute for the annotations that count, NaN where unknown, shapes (n,), by key in the file."""
    annotations = observed.labelled.annotations
    visible = annotations.visible_fraction[observed.rows]
    return {
        "visible_fraction": visible,
        "partly_hidden": np.where(np.isnan(visible), np.nan, visible < WHOLLY_VISIBLE),
        "size_px": annotations.size_px[observed.rows],
        "distance_m": annotations.depth_m[observed.rows],
    }


@dataclass(frozen=True, eq=False)
class MissFit:
    """A regression of misses."""

    slopes: Array  # log-odds for each unit or doubling, the estimate first, shape (1 + replicates, effects)
    errors: Array  # standard errors of the estimate, shape (effects,)
    errors_of_things: Array  # those of things that are missed or seen together, shape (effects,); 0 with few things
    # Miss rate of a label, over all its annotations, in each state, (1 + replicates, states, k), NaN where it had none.
    rates: Array
    # Log-odds of a miss at the references less those of the rate, of the same shape, 0 where all or nothing was missed.
    intercepts: Array
    log_odds: Array  # quantiles of what the effects add, over all annotations of the label, (states, k, quantiles)
    chance: Array  # probability of a miss of each annotation in its own state, shape (n,)

    def log_likelihood(self, missed: Mask) -> float:
        """That of the misses, shape (n,)."""
        return float(np.log(np.maximum(np.where(missed, self.chance, 1 - self.chance), 1e-300)).sum())


def fit_misses(observed: Outcomes, effects: tuple[EffectTerm, ...], resampling: Resampling) -> MissFit | None:
    """Fit intercepts and any slopes by maximum likelihood, replicates by one Newton step; None if not determined."""
    states, k = len(observed.states), len(observed.labelled.labels)
    values = attribute_values(observed)
    amounts, holds = np.empty((len(observed.rows), len(effects))), np.empty((states, len(effects)), dtype=bool)
    scale = np.array([effect.reference if effect.by_units else 1.0 for effect in effects])
    for column, effect in enumerate(effects):
        amounts[:, column] = effect.of(values[effect.attribute]) / scale[column]  # numbers near 1, as doublings are
        holds[:, column] = effect.holds_in(states, effects)
    x = amounts * holds[observed.state]
    group, missed = observed.state * k + observed.label, observed.missed.astype(np.float64)
    unambiguous = observed.unambiguous
    number = np.bincount(group[unambiguous], minlength=states * k)
    hits = np.bincount(group[unambiguous], weights=missed[unambiguous], minlength=states * k)
    usable = (hits > 0) & (hits < number)  # the others have a rate of 0 or 1 whatever the attributes are
    fitted, count = usable[group] & unambiguous, int(usable.sum())
    if count == 0:
        return None
    group_fitted = (np.cumsum(usable) - 1)[group[fitted]]
    maximum = _maximum(missed[fitted], group_fitted, x[fitted], special.logit(hits[usable] / number[usable]))
    if maximum is None:
        return None
    theta, chance, information = maximum
    inverse: Array = np.linalg.inv(information).astype(np.float64)
    image, residual = observed.image[fitted], missed[fitted] - chance
    scores = np.zeros((len(chance), len(theta)))
    scores[np.arange(len(chance)), group_fitted] = residual
    scores[:, count:] = residual[:, None] * x[fitted]
    curvature = _weighted_information(chance * (1 - chance), group_fitted, x[fitted], count, image, resampling)
    thetas = theta + _steps(curvature, resampling.sums(image, scores), inverse)
    every = np.where(number > 0, hits / np.maximum(number, 1), np.nan)
    # Of a label whose every box in a state may be in another's, nobody knows: there it is as elsewhere.
    full = np.where(fitted, 0.0, np.where(number > 0, every, hits.sum() / number.sum())[group])
    full[fitted] = chance
    rates = _mean_rates(observed, amounts, holds, thetas, usable, every, resampling)
    intercepts, learned = np.zeros_like(rates), np.zeros((states, k, LOG_ODDS_QUANTILES))
    for place, cell in enumerate(np.flatnonzero(usable)):
        state, label = divmod(int(cell), k)
        intercepts[:, state, label] = thetas[:, place] - special.logit(rates[:, state, label])
        added = (amounts[observed.label == label] * holds[state]) @ thetas[0, count:]
        learned[state, label] = np.quantile(added, (np.arange(LOG_ODDS_QUANTILES) + 0.5) / LOG_ODDS_QUANTILES)
    errors = np.sqrt(np.diag(inverse))[count:] / scale
    errors_of_things = _errors_of_things(observed, fitted, scores @ inverse)[count:] / scale
    return MissFit(thetas[:, count:] / scale, errors, errors_of_things, rates, intercepts, learned, full)


def _errors_of_things(observed: Outcomes, fitted: Mask, influence: Array) -> Array:
    """Standard errors (p,) where what befalls a thing in one frame may befall it in all, 0 with too few things:
    sandwich over things (Liang and Zeger (1986), "Longitudinal data analysis using generalized linear models"). m
    annotations count, a mask (n,); `influence` is by how much each moves the parameters, shape (m, p)."""
    thing = observed.thing[fitted]
    if len(np.unique(thing[thing >= 0])) < lags.THINGS_NEEDED:
        return np.zeros(influence.shape[1])
    _, cluster = np.unique(np.where(thing >= 0, thing, -1 - np.arange(len(thing))), return_inverse=True)
    sums = np.stack([np.bincount(cluster, column) for column in influence.T])
    clusters = sums.shape[1]
    return np.asarray(np.sqrt((sums**2).sum(axis=1) * clusters / (clusters - 1)))


def _maximum(missed: Array, group: Indices, x: Array, intercepts: Array) -> tuple[Array, Array, Array] | None:
    """Likeliest parameters (p,), chances of a miss (n,) and information (p, p), by Newton's method; None without one.
    `missed` is one for a miss, else 0 (n,), `group` the index of the intercept of each (n,), `x` has the values of the
    effects (n, effects). It begins at these intercepts, and at slopes of 0."""
    count = len(intercepts)
    theta = np.concatenate([intercepts, np.zeros(x.shape[1])])
    for _ in range(_STEPS):
        chance = special.expit(theta[group] + x @ theta[count:])
        information = _information(chance * (1 - chance), group, x, count)
        if not np.all(np.isfinite(information)) or np.linalg.cond(information) > 1e12:
            return None
        residual = missed - chance
        score = np.concatenate([np.bincount(group, weights=residual, minlength=count), x.T @ residual])
        step = np.linalg.solve(information, score)
        theta = theta + step * min(1.0, 2.0 / max(float(np.abs(step).max()), 1e-12))
        if np.abs(step).max() < 1e-9:
            break
    return theta, chance, information


def _information(weight: Array, group: Indices, x: Array, count: int) -> Array:
    size = count + x.shape[1]
    matrix = np.zeros((size, size))
    matrix[:count, :count] = np.diag(np.bincount(group, weights=weight, minlength=count))
    for j in range(x.shape[1]):
        matrix[:count, count + j] = np.bincount(group, weights=weight * x[:, j], minlength=count)
        matrix[count + j, :count] = matrix[:count, count + j]
    matrix[count:, count:] = (x * weight[:, None]).T @ x
    return matrix


def _weighted_information(
    weight: Array, group: Indices, x: Array, count: int, image: Indices, resampling: Resampling
) -> Array:
    """`_information` under each row of weights, shape (rows, p, p)."""
    size = count + x.shape[1]
    columns = [(group, np.ones(len(group)))]
    columns += [(np.full(len(group), count + j), x[:, j]) for j in range(x.shape[1])]
    cells = [(a * size + b, weight * u * v) for a, u in columns for b, v in columns]
    return resampling.counts(
        np.tile(image, len(cells)),
        np.concatenate([cell for cell, _ in cells]),
        (size, size),
        np.concatenate([amount for _, amount in cells]),
    )


def _steps(curvature: Array, scores: Array, inverse: Array) -> Array:
    """One Newton step (rows, p) under each row of weights, from information (rows, p, p) and gradients (rows, p). With
    the curvature of the estimate in place of the row's, effects that few images decide would look better known than
    they are. A singular row takes the estimate's inverse information (p, p). The first row, at the maximum, stays."""
    ridge = 1e-6 * np.eye(len(inverse)) * np.trace(curvature[0]) / len(inverse)
    steps = np.linalg.solve(curvature + ridge, scores[..., None])[..., 0]
    return np.where((np.linalg.cond(curvature + ridge) < 1e6)[:, None], np.clip(steps, -5, 5), scores @ inverse)


def _mean_rates(
    observed: Outcomes, amounts: Array, holds: Mask, thetas: Array, usable: Mask, every: Array, resampling: Resampling
) -> Array:
    """Mean probability of a miss in each state over all annotations of a label; replicates to first order. Effects have
    amounts (n, effects), and hold in states (states, effects)."""
    states, k = len(observed.states), len(observed.labelled.labels)
    rates = np.full((len(thetas), states, k), np.nan)
    count = int(usable.sum())
    for place, cell in enumerate(np.flatnonzero(usable)):
        of_label = observed.label == cell % k
        x = amounts[of_label] * holds[cell // k]
        chance = special.expit(thetas[0, place] + x @ thetas[0, count:])
        change = chance * (1 - chance)
        sums = resampling.sums(observed.image[of_label], np.column_stack([np.ones(len(chance)), chance]))
        moved = thetas - thetas[0]
        slope = moved[:, place] * change.mean() + moved[:, count:] @ (change[:, None] * x).mean(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            rates[:, cell // k, cell % k] = np.clip(sums[:, 1] / sums[:, 0] + slope, 1e-9, 1 - 1e-9)
    flat = rates.reshape(len(thetas), -1)
    flat[:, ~usable] = every[~usable]
    return rates


def miss_lags(observed: Outcomes, chance: Array, slopes: int) -> lags.LagTable:
    """Products of residuals of misses at all times between, given fitted chances (n,), and so many fitted slopes."""
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


def behaves_like_a_score(observed: Outcomes, chance: Array, notes: list[str]) -> bool:
    """Whether detections before a miss are unsure as one score makes them, and not as sure as any other. Each
    annotation had a fitted chance to be missed (n,). Why there is no score is added to the notes."""
    if not observed.labelled.scored or {"score", "confidence"} & observed.without:
        return False
    level = np.full(len(observed.rows), np.nan)
    confidence = observed.labelled.results.confidence[observed.detection[observed.found]]
    for state in range(len(observed.states)):
        in_state = observed.state[observed.found] == state
        rank = np.argsort(np.argsort(confidence[in_state], kind="stable"))
        level[observed.found[in_state]] = (rank + 0.5) / max(int(in_state.sum()), 1)
    earlier, later = observed.steps.earlier, observed.steps.later
    known = np.isfinite(level[earlier])
    lost = known & (observed.missed[later] > 0)
    if lost.sum() < _LOST_NEEDED:
        notes.append(f"persistence.score: none; had {lost.sum()} detections before a miss, needs {_LOST_NEEDED}")
        return False
    p = float(chance[earlier[lost]].mean())
    correlation = _correlation_of_losses(float(observed.missed[later[known]].mean()), p)
    expected, mean = _mean_level_before_a_miss(p, correlation), float(level[earlier[lost]].mean())
    if mean < (0.5 + expected) / 2:
        return True
    notes.append(
        f"persistence.score: none; detections before a miss are surer than {in_percent(mean)} of all, with a score "
        f"than {in_percent(expected)}"
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


def learned_score(observed: Outcomes, chance: Array, slopes: int, resampling: Resampling) -> LearnedScore:
    """Shares of the score with replicates, from the tetrachoric correlation of misses at each lag. Times of the
    autoregressive parts are fixed, each four times the one before: a sum of them comes near any memory that only fades,
    and shares that are not negative (Lawson and Hanson (1974), "Solving least squares problems") need no test."""
    times_s, column = lags.memory_shares(miss_lags(observed, chance, slopes), lags.latent_share(chance), resampling)
    path = ("persistence", "score")
    kept, shares = (lags.replace_values(column, values) for values in (column.values[:, 0], column.values[:, 1:]))
    place = np.searchsorted(lags.LATENT_SHARES, min(float(kept.estimate), lags.LATENT_SHARES[-1]))
    return LearnedScore(
        Entry(Key((*path, "vessel_share")), kept),
        Entry(Key((*path, "shares"), axes=(lags.in_seconds(times_s),)), shares),
        tuple(times_s.tolist()),
        float(lags.level_of(chance)[place]),
        label_memory_s(observed),
    )


def label_memory_s(observed: Outcomes) -> float:
    """Correlation time of the labels of detections; 0 if consecutive ones agree no more than by chance. With κ =
    e^(−Δt/τ) kept, else drawn anew, a share κ + (1 − κ)·Σ p² of them agrees."""
    earlier, later, apart_s = observed.steps.earlier, observed.steps.later, observed.steps.apart_s
    detected_label, labels = observed.detected_label, len(observed.labelled.labels)
    both = (detected_label[earlier] < labels) & (detected_label[later] < labels)
    cell = observed.state * labels + observed.label
    counts = np.zeros((len(observed.states) * labels, labels))
    hits = detected_label < labels
    np.add.at(counts, (cell[hits], detected_label[hits]), 1)
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    by_chance = float((shares[cell[later[both]]] ** 2).sum(axis=1).mean()) if both.any() else 1.0
    if by_chance >= 1 - 1e-9:
        return 0.0
    agree = float((detected_label[earlier[both]] == detected_label[later[both]]).mean())
    kept = min((agree - by_chance) / (1 - by_chance), lags.MAX_SHARE)
    errors = np.sqrt(by_chance * (1 - by_chance) / both.sum()) / (1 - by_chance)
    return float(-np.median(apart_s[both]) / np.log(kept)) if kept > SIGNIFICANT * errors else 0.0
