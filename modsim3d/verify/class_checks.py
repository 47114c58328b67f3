"""Checks of dropout and class: confusion matrices, the effects on misses, and how long misses persist."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.detector.chain import DetectorPart, model_name
from modsim3d.detector.classification import ConfusionClassifier
from modsim3d.detector.draws import cumulative, log2
from modsim3d.detector.dropout import ATTRIBUTES, EFFECTS, Effect, FactorTable, Slope
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.persistence import LatentScore, Persistence
from modsim3d.verify.evidence import MERGED, Evidence, unknown_rest_note
from modsim3d.verify.measures import CORRELATION, SHARE, Estimate, Exact, Measure, Rate
from modsim3d.verify.parameters import Parameter

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)
LAGS = (1, 4, 16)  # numbers of frames between the misses whose correlation is tested
MIN_MISSES = 30  # misses, and finds, below which their correlation is not tested
_REPLAYS, _AT_A_TIME = 200, 50


def miss_covariance(first: Array, second: Array, correlation: Array) -> Array:
    """Covariance of misses of chances (m,) whose scores have a correlation from 0 to 1, shape (m,). The derivative of
    the bivariate normal distribution function by the correlation is its density (Plackett (1954), "A reduction formula
    for normal multivariate integrals"), integrated over the arc sine of the correlation."""
    a, b = (special.ndtri(np.clip(chance, 1e-12, 1 - 1e-12)) for chance in (first, second))
    reach = np.arcsin(np.clip(correlation, 0, 1 - 1e-9)) / 2
    total = np.zeros(len(a))
    for node, weight in zip(_NODES.tolist(), _WEIGHTS.tolist(), strict=True):
        angle = reach * (1 + node)
        total += weight * np.exp(-(a**2 + b**2 - 2 * a * b * np.sin(angle)) / (2 * np.cos(angle) ** 2))
    return reach * total / (2 * np.pi)


def sum_over_pairs(tracks: Indices, times_s: Array, value: Callable[[Indices, Indices, Array], Array]) -> Array:
    """Sums of values of all pairs of rows of one track, a vessel in a camera, shape (k,). Rows (n, c) of `tracks` are
    equal in one track; times have shape (n,). `value` takes later and earlier rows and the seconds between, shapes
    (m,), to values (m, k). Their mean is taken at some lags: it changes little between them, as memory only fades."""
    order = np.lexsort((times_s, *tracks.T[::-1]))
    _, series = np.unique(tracks[order], axis=0, return_inverse=True)
    series, count = series.ravel(), np.bincount(series.ravel())
    most = int(count.max(initial=1))
    lags, means = [0], [np.zeros(value(order[:1], order[:1], times_s[:1]).shape[1])]
    for lag in sorted({base << power for base in (2, 3) for power in range(most.bit_length())} | {1}):
        near = np.flatnonzero(series[lag:] == series[:-lag]) if lag < most else np.empty(0, dtype=np.int64)
        if len(near):
            later, earlier = order[near + lag], order[near]
            lags.append(lag)
            means.append(value(later, earlier, times_s[later] - times_s[earlier]).mean(axis=0))
    every = np.arange(1, most)
    pairs = np.array([np.maximum(count - lag, 0).sum() for lag in every])
    columns = np.array(means).reshape(len(lags), -1).T
    return np.array([float((pairs * np.interp(every, lags, column)).sum()) for column in columns])


def off_diagonal(tracks: Indices, times_s: Array, score: LatentScore, chance: Array, amount: Array) -> float:
    """Part of the variance of a sum of amounts of misses (n,) that their correlation along tracks makes."""

    def value(later: Indices, earlier: Indices, apart_s: Array) -> Array:
        covariance = miss_covariance(chance[later], chance[earlier], score.correlation(apart_s))
        return (amount[later] * amount[earlier] * covariance)[:, None]

    if len(chance) < 2:
        return 0.0
    return 2 * float(sum_over_pairs(tracks, times_s, value).sum())


def memory_checks(tracks: Indices, times_s: Array, score: LatentScore, chance: Array, missed: Array) -> list[Parameter]:
    """Correlation of misses some frames apart, which strays as simulated scores do. Rows (n, c) of `tracks` are equal
    for a vessel in a camera; times, chances of a miss, and misses (1 or 0) are (n,)."""
    if not len(chance):
        return []
    order = np.lexsort((times_s, *tracks.T[::-1]))
    _, series = np.unique(tracks[order], axis=0, return_inverse=True)
    series, times_s, chance = series.ravel(), times_s[order], chance[order]
    spread = chance * (1 - chance)
    pairs = [np.flatnonzero((series[lag:] == series[:-lag]) & (spread[lag:] * spread[:-lag] > 0)) for lag in LAGS]
    rng = np.random.default_rng(len(series))
    draws = (_scores(series, times_s, score, rng, _AT_A_TIME) for _ in range(_REPLAYS // _AT_A_TIME))
    replayed = np.concatenate([_products(scores < chance, chance, pairs) for scores in draws])
    products = _products((missed[order] > 0)[None], chance, pairs)[0]
    parameters = []
    for k, (lag, near) in enumerate(zip(LAGS, pairs, strict=True)):
        later, measure = near + lag, None
        if float(spread[near].sum()) >= MIN_MISSES:
            apart_s, whole = times_s[later] - times_s[near], float(np.sqrt(spread[later] * spread[near]).sum())
            expected = float(miss_covariance(chance[later], chance[near], score.correlation(apart_s)).sum())
            strays, error = replayed[:, k] - replayed[:, k].mean(), float(replayed[:, k].std(ddof=1))
            skewness = float((strays**3).mean()) / error**3 if error > 0 else 0.0
            if error > 0:
                numbers = products[k] / whole, expected / whole, error / whole
                measure = Estimate(*numbers, len(near), skewness, possible=CORRELATION)
        name = f"persistence.score: correlation of misses, {lag} {'frame' if lag == 1 else 'frames'} apart"
        parameters.append(Parameter(name, DetectorPart.CLASS, measure, in_file=False))
    return parameters


def _products(missed: Mask, chance: Array, pairs: Sequence[Indices]) -> Array:
    """Sums of products of residuals of misses (r, n) at each lag, shape (r, lags)."""
    rest = missed - chance
    sums = [(rest[:, near + lag] * rest[:, near]).sum(axis=1) for lag, near in zip(LAGS, pairs, strict=True)]
    return np.stack(sums, axis=1)


def _scores(series: Indices, times_s: Array, score: LatentScore, rng: np.random.Generator, count: int) -> Array:
    """Probabilities of scores of rows in order of series and time, as the detector draws them, shape (count, n)."""
    apart_s = np.where(np.diff(series, prepend=-1) > 0, np.inf, np.diff(times_s, prepend=0.0))
    total = np.sqrt(score.vessel_share) * rng.standard_normal((count, int(series.max()) + 1))[:, series]
    total += np.sqrt(score.white_share) * rng.standard_normal(total.shape)
    for share, time_s in zip(score.shares, score.times_s, strict=True):
        decay, part = np.exp(-apart_s / time_s), np.zeros(count)
        for row, kept in enumerate(decay.tolist()):
            part = kept * part + math.sqrt(1 - kept * kept) * rng.standard_normal(count)
            total[:, row] += math.sqrt(share) * part
    return np.asarray(special.ndtr(total))


_FORGOTTEN = 10.0  # correlation times after which a correlation is neglected: 5e-5 of it is left


def lag_pairs(tracks: Indices, times_s: Array, correlation_s: float) -> Iterator[tuple[Indices, Indices, Array]]:
    """Pairs of rows of one track that are near enough in time to be correlated, neighbours first. Rows (n, k) of
    `tracks` are equal in one track; times have shape (n,). The correlation falls to 1/e in `correlation_s`. Yields
    later rows, earlier rows, and seconds between, shapes (m,)."""
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
        own_rows = np.flatnonzero(instances.camera == camera)
        due = model.gates.due(seen.frames)
        turn[own_rows], ran[own_rows] = np.cumsum(due)[instances.frame[own_rows]], due[instances.frame[own_rows]]
    rows = np.flatnonzero(ran)
    tracks, _ = instances.tracks(rows)
    order = np.lexsort((turn[rows], *tracks.T[::-1]))
    follows = (tracks[order][1:] == tracks[order][:-1]).all(axis=1) & (np.diff(turn[rows[order]]) == 1)
    before = np.full(len(turn), -1)
    before[rows[order[1:][follows]]] = rows[order[:-1][follows]]
    return before


def turn_pairs(model: DetectorModel, evidence: Evidence, instance: Indices) -> tuple[Indices, Indices]:
    """Pairs (k,) of detections of one vessel, a turn apart, as places, given rows of `Instances` of detections (m,)."""
    place = np.full(len(evidence.instances.state) + 1, -1)  # the last for −1: no turn before
    place[instance] = np.arange(len(instance))
    before = place[turn_before(model, evidence)[instance]]
    now = np.flatnonzero(before >= 0)
    return now, before[now]


def inflation(
    tracks: Indices, times_s: Array, lasts_s: float, variances: Array, covariance: Callable[[Indices, Indices], Array]
) -> float:
    """Variance of the sum of rows whose noise persists, over that of independent rows with variances of shape (n,). Two
    rows of a track, see `lag_pairs`, have kept the same noise with probability e^(−Δt / lasts_s). `covariance` is
    that of later and earlier rows that have kept it."""
    alone = float(variances.sum())
    if lasts_s <= 0 or alone <= 0:
        return 1.0
    total = alone
    for later, earlier, apart in lag_pairs(tracks, times_s, lasts_s):
        total += 2 * float((np.exp(-apart / lasts_s) * covariance(later, earlier)).sum())
    return total / alone


def at_each(share: float, *bounds: Array) -> Iterator[tuple[float, tuple[Array, ...]]]:
    """Weights of values that a vessel keeps, and bounds of uniform numbers there, (n,): Gauss-Hermite quadrature."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(32)
    latent = [special.ndtri(np.clip(bound, 0, 1)) for bound in bounds]
    for node, weight in zip(nodes.tolist(), (weights / weights.sum()).tolist(), strict=True):
        kept = np.sqrt(share) * node
        yield weight, tuple(special.ndtr((bound - kept) / np.sqrt(1 - share)) for bound in latent)


def variance_of_sum(
    tracks: Indices, times_s: Array, persistence: Persistence, bounds: tuple[Array, Array], amount: Array
) -> float:
    """Variance of a sum of amounts, shape (n,), where uniform numbers of vessels are between bounds (low, high), (n,).
    Rows (n, k) of `tracks` are equal in one track; times have shape (n,)."""
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


BACKGROUND = "background"
MIN_CHANCES = 30  # independent instances of a label in a state, below which its column is not tested
MIN_PAIRS = 100
_SHARED_NOTE = "not tested where vessels keep a share of their noise"


@dataclass(frozen=True, eq=False)
class ExpectedOutcomes:
    """Expectation of the detector file for every annotated box."""

    passed: Mask  # by the gates, shape (n,)
    tested: Mask  # those of them that are not in another's box, so that their draw is known, shape (n,)
    edges: Array  # ends of the ranges of uniform numbers that mean each label, then a miss, shape (n, labels + 2)

    @property
    def missed(self) -> Array:
        """Probability of a miss, shape (n,)."""
        return 1 - self.edges[:, -2]


def expected_outcomes(model: DetectorModel, evidence: Evidence) -> ExpectedOutcomes:
    """Expectation of a detector for every annotated box."""
    passed = [model.gates.passed(seen.frames, seen.targets) for seen in evidence.cameras]
    classifier = ConfusionClassifier.from_model(model, evidence.target_statistics(model))
    instances = evidence.instances
    edges = cumulative(np.swapaxes(model.column("confusion"), 1, 2))[instances.state, instances.label]
    usual = edges[:, -2].copy()
    missed = 1 - usual
    if model.dropout.every_effect:
        missed = np.concatenate(
            [classifier.miss_rates(s.detections.states[s.targets.frame], s.targets) for s in evidence.cameras]
        )
        edges[:, :-1] *= ((1 - missed) / np.where(usual > 0, usual, 1))[:, None]
    through = np.concatenate(passed)
    ends = np.concatenate([np.zeros((len(edges), 1)), edges], axis=1)
    return ExpectedOutcomes(through, through & (instances.outcome != MERGED), ends)


_BY_LOOKS = "asked: the mean over the chances that there were, by what they look like"


def class_checks(model: DetectorModel, evidence: Evidence) -> list[Parameter]:
    """Every free entry of every state's confusion matrix; of a column with two entries only the dropout."""
    expected = expected_outcomes(model, evidence)
    note = unknown_rest_note(model, evidence)
    parameters = []
    if not expected.passed.all():
        seen = int(((evidence.instances.outcome != -1) & ~expected.passed).sum())
        measure = Exact(seen, int((~expected.passed).sum()))
        parameters.append(Parameter("gates: nothing seen beyond them", DetectorPart.CLASS, measure, in_file=False))
    for s, state in enumerate(model.states):
        for column, label in enumerate(model.labels):
            members = (evidence.instances.state == s) & (evidence.instances.label == column) & expected.tested
            names = [*model.labels, BACKGROUND]
            # Misses first: where only one label can be given, both entries say the same.
            for row in [len(names) - 1, *(range(len(names) - 1) if len(names) > 2 else [])]:
                value = float(state.confusion[row, column])
                entry = None if note else _entry(model, evidence, expected, np.flatnonzero(members), row)
                name = f"states.{state.name}.confusion[{names[row]}][{label}]"
                remark = note or (_BY_LOOKS if entry is not None and model.dropout.every_effect else "")
                parameters.append(Parameter(name, DetectorPart.CLASS, entry, value, state=state.name, note=remark))
    return [*parameters, *_overall_checks(model, evidence, expected, note)]


def _entry(
    model: DetectorModel, evidence: Evidence, expected: ExpectedOutcomes, rows: Indices, row: int
) -> Measure | None:
    """One entry of a column; rows are the instances of its state and label."""
    background = len(model.labels)
    outcome = evidence.instances.outcome[rows]
    low, high = expected.edges[rows, row], expected.edges[rows, row + 1]
    happened = outcome == (-1 if row == background else row)
    return _share(model, evidence, rows, happened, (low, high), expected.missed[rows])


def _share(
    model: DetectorModel, evidence: Evidence, rows: Indices, happened: Mask, bounds: tuple[Array, Array], missed: Array
) -> Measure | None:
    """Share of rows whose uniform number was between bounds (low, high), given their chances of a miss, all (n,)."""
    low, high = bounds
    if len(rows) < MIN_CHANCES:
        return None
    probability = high - low
    spread = probability * (1 - probability)

    def covariance(later: Indices, earlier: Indices) -> Array:
        """Covariance of pairs of rows that have kept a number, shapes (m,)."""
        common = np.minimum(high[later], high[earlier]) - np.maximum(low[later], low[earlier])
        return np.asarray(np.maximum(common, 0) - probability[later] * probability[earlier])

    score = model.persistence.score
    if score is not None and bool((high >= 1).all()):
        factor = 1.0  # misses come from the score alone
    elif model.persistence.class_vessel_share:
        if model.merges_and_splits.merges and not low.any():  # which vessels merge changes what the others keep
            return None
        amount, alone = np.ones(len(rows)), max(float(spread.sum()), 1e-300)
        asked = variance_of_sum(*evidence.instances.tracks(rows), model.persistence, (low, high), amount)
        factor = max(asked / alone, 1.0)
    else:
        factor = inflation(*evidence.instances.tracks(rows), model.persistence.class_s, spread, covariance)
    if score is not None and spread.any():
        # A label's share of the detected is drawn apart: its number strays as that of the detected does.
        amount = np.where(high >= 1, 1.0, probability / np.maximum(1 - missed, 1e-12))
        factor += max(off_diagonal(*evidence.instances.tracks(rows), score, missed, amount) / float(spread.sum()), 0.0)
    if len(rows) / factor < MIN_CHANCES:
        return None
    mean, count = float(probability.mean()), int(happened.sum())
    if np.ptp(probability) < 1e-12:
        return Rate(count, len(rows), mean, factor)
    variance = float(spread.sum()) * factor
    if variance <= 0:
        return None
    skewness = float((spread * (1 - 2 * probability)).sum()) * factor**2 / variance**1.5
    return Estimate(count / len(rows), mean, variance**0.5 / len(rows), len(rows) / factor, skewness, possible=SHARE)


def miss_probabilities(model: DetectorModel, evidence: Evidence) -> Array:
    """Expected probability that each instance is missed, (n,): 1 if a gate hides it, 0 if it is in another's box."""
    expected = expected_outcomes(model, evidence)
    return np.where(expected.tested, expected.missed, np.where(expected.passed, 0.0, 1.0))


def _overall_checks(model: DetectorModel, evidence: Evidence, expected: ExpectedOutcomes, note: str) -> list[Parameter]:
    rows = np.flatnonzero(expected.tested)
    missed = evidence.instances.outcome[rows] == -1
    low, high, chance = expected.edges[rows, -2], expected.edges[rows, -1], expected.missed[rows]
    overall = None if note else _share(model, evidence, rows, missed, (low, high), chance)
    parameters = [Parameter("dropout, all states", DetectorPart.CLASS, overall, in_file=False, note=note)]
    parameters += [] if note else dropout_checks(model, evidence, expected.tested, expected.missed)
    score = model.persistence.score
    if score is not None:
        tracks = evidence.instances.tracks(rows)
        return [*parameters, *([] if note else memory_checks(*tracks, score, chance, missed.astype(np.float64)))]
    shared = bool(model.persistence.class_vessel_share)
    persistence = None if note or shared else _persistence(model, evidence, expected)
    remark = _SHARED_NOTE if shared else correlation_note(persistence)
    return [*parameters, Parameter("persistence.class_s", DetectorPart.CLASS, persistence, note=remark)]


def correlation_note(measure: Estimate | None) -> str:
    """A note on the unit of the numbers beside a correlation time."""
    if measure is None or not measure.asked:
        return ""
    return "as the correlation from one frame at which the detector runs to the next"


def _persistence(model: DetectorModel, evidence: Evidence, expected: ExpectedOutcomes) -> Estimate | None:
    """Probability κ that a vessel keeps its uniform number from one frame to the next. Given whether it was missed one
    frame before, a vessel is missed with a probability that is linear in κ: κ times that of the kept number, and 1 − κ
    times that of a new one. One step along the score estimates κ."""
    instances = evidence.instances
    rows_before = turn_before(model, evidence)
    now = np.flatnonzero((rows_before >= 0) & expected.tested)
    before = rows_before[now]
    some = expected.tested[before] & (expected.missed[now] > 0) & (expected.missed[now] < 1)
    now, before = now[some], before[some]
    if len(now) < MIN_PAIRS:
        return None
    p, p_before = expected.missed[now], expected.missed[before]
    was_missed = instances.outcome[before] == -1
    with np.errstate(divide="ignore", invalid="ignore"):
        kept = np.where(was_missed, np.minimum(1, p / p_before), np.maximum(0, (p - p_before) / (1 - p_before)))
    kept = np.where(np.isfinite(kept), kept, p)
    apart = instances.time_s[now] - instances.time_s[before]
    tau = model.persistence.class_s
    kappa = np.exp(-apart / tau) if tau > 0 else np.zeros(len(now))
    q = np.clip(kappa * kept + (1 - kappa) * p, 1e-9, 1 - 1e-9)
    slope, spread = kept - p, q * (1 - q)
    information = float((slope**2 / spread).sum())
    if information <= 0:
        return None
    residual = (instances.outcome[now] == -1) - q
    asked_kappa = float(kappa.mean())
    step = float((residual * slope / spread).sum()) / information
    skewness = float((slope**3 * (1 - 2 * q) / spread**2).sum()) / information**1.5
    error = 1 / math.sqrt(information)
    return Estimate(asked_kappa + step, asked_kappa, error, len(now), skewness, possible=CORRELATION)


def dropout_checks(model: DetectorModel, evidence: Evidence, passed: Mask, missed: Array) -> list[Parameter]:
    """Each slope, and each range of each table, in the states where it holds, with all rates free, given the instances
    that the gates let pass and the asked probability of a miss, (n,)."""
    parameters = []
    for whose, states, effect in _held_effects(model):
        check = EFFECT_CHECKS.get(model_name(EFFECTS, effect))
        if check is None:
            continue
        subset = passed & np.isin(evidence.instances.state, states)
        key = f"{'' if whose is None else f'states.{whose}.'}dropout.{effect.attribute}"
        values = np.concatenate([ATTRIBUTES[effect.attribute](seen.targets) for seen in evidence.cameras])
        for name, asked, column in check(effect, values):
            measure = _effect(model, evidence, subset, missed, column, asked)
            parameters.append(Parameter(f"{key}.{name}", DetectorPart.CLASS, measure, asked, state=whose))
    return parameters


def _held_effects(model: DetectorModel) -> Iterator[tuple[str | None, list[int], Effect]]:
    """Each effect with the name of the state that has it for itself, if one has, and the states where it holds."""
    for effect in model.dropout.effects:
        yield None, [s for s in range(len(model.states)) if effect in model.dropout.effects_of(s)], effect
    for state, effects in model.dropout.own.items():
        for effect in effects:
            yield model.states[state].name, [state], effect


Column = tuple[str, float, Array]  # name and asked value of a number of an effect, and the derivative of log-odds by it


def _slope_columns(effect: Slope, values: Array) -> list[Column]:
    filled = np.where(np.isnan(values), effect.reference, values)
    amount = log2(filled / effect.reference) if effect.doublings else filled - effect.reference
    return [("per_doubling" if effect.doublings else "per_unit", effect.log_odds, amount)]


def _table_columns(effect: FactorTable, values: Array) -> list[Column]:
    finite, place = ~np.isnan(values), np.searchsorted(effect.edges, values, side="right")
    return [(f"odds[{k}]", odds, np.where(finite & (place == k), 1 / odds, 0.0)) for k, odds in enumerate(effect.odds)]


EFFECT_CHECKS: Mapping[str, Callable[..., list[Column]]] = {"logistic": _slope_columns, "table": _table_columns}
"""The columns of an effect, given the attribute of each instance, by the name of the effect's model."""


def _effect(
    model: DetectorModel, evidence: Evidence, passed: Mask, missed: Array, column: Array, asked: float
) -> Estimate | None:
    """One step of a logistic regression from the asked probabilities, with an intercept for each state and label."""
    instances = evidence.instances
    rows = np.flatnonzero(passed & (missed > 0) & (missed < 1))
    p = missed[rows]
    happened = instances.outcome[rows] == -1
    if happened.sum() < MIN_MISSES:
        return None
    spread, amount = p * (1 - p), column[rows]
    group = instances.state[rows] * len(model.labels) + instances.label[rows]
    weight = np.bincount(group, spread)
    mean = np.bincount(group, spread * amount) / np.where(weight > 0, weight, 1)
    free = amount - mean[group]  # changes of the states' rates cannot explain this part
    information = float((spread * free**2).sum())
    if information < 1e-9 * max(float((spread * amount**2).sum()), 1e-300):
        return None
    variance = information
    if model.persistence.score is not None:
        variance += off_diagonal(*instances.tracks(rows), model.persistence.score, p, free)
    elif model.persistence.class_vessel_share:
        variance = variance_of_sum(*instances.tracks(rows), model.persistence, (1 - p, np.ones(len(p))), free)
    elif model.persistence.class_s > 0:
        for later, earlier, apart in lag_pairs(*instances.tracks(rows), model.persistence.class_s):
            kept = np.minimum(p[later], p[earlier]) - p[later] * p[earlier]
            shared = np.exp(-apart / model.persistence.class_s) * kept * free[later] * free[earlier]
            variance += 2 * float(shared.sum())
    step = float(((happened - p) * free).sum()) / information
    error = max(variance, 0.1 * information) ** 0.5 / information
    skewness = float((spread * (1 - 2 * p) * free**3).sum()) / information**1.5
    return Estimate(asked + step, asked, error, len(rows) * information / variance, skewness)
