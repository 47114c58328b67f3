"""Whether what the detector file draws independently is independent in the run. Each number of a run may be right while
the draws together are not: the same errors in both cameras, a run that repeats itself, false positives at even
distances, confidences in order. These checks look at the residuals of each kind of draw with earlier times, between
cameras, within images and in order of time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft, special

from modsim3d.core.arrays import Array, Indices
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.persistence import NEVER_CHANGES_S
from modsim3d.verify.error_fit import Draw, Residuals, StateFit, n_transient, residuals_of
from modsim3d.verify.evidence import Evidence, unknown_rest_note
from modsim3d.verify.false_positive_checks import RATE_CHECKS, ExpectedFalsePositives, expected_false_positives
from modsim3d.verify.measures import AMOUNT, CORRELATION, POWER, Estimate, Exact, Interval, Measure, Noticed
from modsim3d.verify.parameters import Parameter


@dataclass(frozen=True, eq=False)
class PairSums:
    """Sums over pairs of independent rows, one for each of L lags, or one alone; shapes (L,)."""

    product: Array  # of both rows' values
    spread: Array  # of the products of both rows' standard deviations
    variance: Array  # of `product`
    third: Array  # third cumulant of `product`

    @property
    def pairs(self) -> Array:
        """Pairs of rows of one variance that are worth as much, shape (L,)."""
        return self.spread**2 / np.where(self.variance > 0, self.variance, np.inf)


def group_sums(values: Array, variance: Array, third: Array, group: Indices) -> PairSums:
    """Sums over all pairs of rows of one group, for values and third moments (n, c) and variances and groups (n,). With
    a variance v of each row, the third cumulant has a part from triples: the sum of six times v₁·v₂·v₃."""
    _, group = np.unique(group, return_inverse=True)
    components = values.shape[1]

    def of_groups(column: Array) -> Array:
        return np.bincount(group, column).astype(np.float64)

    def over_pairs(columns: Array) -> float:
        return sum(float((of_groups(column) ** 2 - of_groups(column**2)).sum()) / 2 for column in columns.T)

    deviation = np.sqrt(variance)
    first, second, cube = (of_groups(variance**power) for power in (1, 2, 3))
    triples = float((first**3 - 3 * first * second + 2 * cube).sum())
    return PairSums(
        np.array([over_pairs(values)]),
        np.array([components * over_pairs(deviation[:, None])]),
        np.array([components * over_pairs(variance[:, None])]),
        np.array([over_pairs(third) + components * triples]),
    )


def lag_sums(values: Array, variance: Array, third: Array, series: Indices, step: Indices) -> PairSums:
    """Sums of pairs of rows of one series, by the steps between, from 0; values, third moments (n, c), others (n,)."""
    order = np.lexsort((step, series))
    ends = np.flatnonzero(np.diff(series[order], append=-2))
    spans = [rows for rows in np.split(order, ends[:-1] + 1) if len(rows) > 1]
    sums = np.zeros((4, max((int(step[rows[-1]] - step[rows[0]]) + 1 for rows in spans), default=1)))
    components = values.shape[1]
    for rows in spans:
        place = step[rows] - step[rows[0]]
        length = int(place[-1]) + 1
        moments = (values[rows], np.sqrt(variance[rows])[:, None], variance[rows][:, None], third[rows])
        for k, columns in enumerate(moments):
            sums[k, :length] += _lagged(place, columns, length)
    sums[1:3] *= components
    return PairSums(*sums)


def _lagged(place: Indices, columns: Array, length: int) -> Array:
    """Sum of products of columns (n, c) with themselves at each lag, given each row's place, shape (length,)."""
    size = fft.next_fast_len(2 * length, real=True)
    dense = np.zeros((size, columns.shape[1]))
    dense[place] = columns
    return np.asarray(fft.irfft((np.abs(fft.rfft(dense, axis=0)) ** 2).sum(axis=1), size)[:length])


MIN_STRETCHES = 20  # independent stretches with one false positive each, below which their spread is not tested


def spread_checks(model: DetectorModel, evidence: Evidence, group: str) -> list[Parameter]:
    """Variance over mean of the number of transient false positives of an image, and of a stretch of images."""
    note = unknown_rest_note(model, evidence)
    if model.false_positives.model not in RATE_CHECKS or model.false_positives.persistent_share == 1:
        return []
    expected, counts = expected_false_positives(model, evidence), n_transient(evidence)
    windows = {
        "variance over mean in images": np.arange(len(counts)),
        "variance over mean in stretches": stretches(evidence.frames.camera, expected.transient),
    }
    measures = {name: _spread(expected, evidence.frames.state, counts, window) for name, window in windows.items()}
    return [
        Parameter(f"{Draw.FALSE_POSITIVES}: {name}", group, measure, in_file=False).unless(note)
        for name, measure in measures.items()
    ]


def stretches(camera: Indices, mean: Array) -> Indices:
    """Numbers that are equal in images of one camera that follow each other until one is expected, shape (s,)."""
    number, total, numbers = 0, 0.0, np.empty(len(mean), dtype=np.int64)
    before = -1
    for row, (now, more) in enumerate(zip(camera.tolist(), mean.tolist(), strict=True)):
        if now != before or total >= 1:
            number, total, before = number + 1, 0.0, now
        total += more
        numbers[row] = number
    return numbers


def _spread(expected: ExpectedFalsePositives, state: Indices, counts: Indices, window: Indices) -> Estimate | None:
    """The variance of the number of a window over its mean. With the number n of an image, its mean m and its variance
    v, (n − m)² − (2v/m − 1)·(n − m) − v has mean zero, does not depend on the rate to first order, and has the variance
    2v² of a Poisson number and 2v²·(1 − (1 − v/m)/m) of a binomial one. Pairs of images of one window add twice the
    product of theirs, with variance 4v₁v₂. The third cumulant is 8V³ + 4V² for a Poisson number with mean V."""
    some = np.flatnonzero(expected.transient > 0)
    state, window, dispersion = state[some], window[some], expected.dispersion[some]
    # With each state's own rate: a wrong one must not look like clumps.
    ratio = np.bincount(state, counts[some]) / np.maximum(np.bincount(state, expected.transient[some]), 1e-300)
    mean = expected.transient[some] * np.where(ratio > 0, ratio, 1)[state]
    rest = counts[some] - mean
    variance = mean * dispersion
    of_windows = np.bincount(window, variance)
    alone = rest**2 - (2 * dispersion - 1) * rest - variance
    together = float((np.bincount(window, rest) ** 2).sum() - (rest**2).sum())
    spread = 2 * float((of_windows**2).sum()) - 2 * float((variance**2 * (1 - dispersion) / mean).sum())
    worth = float(of_windows.sum()) ** 2 / max(float((of_windows**2).sum()), 1e-300)
    if worth < MIN_STRETCHES or spread <= 0:
        return None
    total, asked = float(of_windows.sum()), float(variance.sum() / mean.sum())
    error = spread**0.5
    skewness = float((8 * of_windows**3 + 4 * of_windows**2).sum()) / error**3
    scale = asked / total
    strays = float(alone.sum()) + together
    return Estimate(asked + strays * scale, asked, error * scale, worth, skewness, possible=AMOUNT)


@dataclass(frozen=True)
class Strongest(Estimate):
    """The estimate that stands out most of `trials`, which share the level of the test (Bonferroni)."""

    trials: int = 1

    def p_value(self) -> float:
        """p-value of any of the trials."""
        return min(1.0, self.trials * super().p_value())

    def strength(self) -> float:
        """The normal deviate of as small a p-value."""
        return float(-special.ndtri(max(self.p_value() / 2, 1e-300)))

    def interval(self, alpha: float) -> Interval:
        """At this trial's share of the level."""
        return super().interval(alpha / self.trials)

    def noticed(self, alpha: float) -> Noticed:
        """At this trial's share of the level."""
        return super().noticed(alpha / self.trials)


@dataclass(frozen=True)
class SumDrift:
    """Distance by which the sum of `count` numbers with mean zero and variance one strays from zero, for each of them.
    The numbers sum to zero in the end, so the sum is a Brownian bridge, and the greatest distance times √count follows
    Kolmogorov's distribution (Kolmogorov (1933)). Of `trials` such sums it is the one that strays most."""

    measured: float
    count: float
    trials: int = 1
    asked: float = 0.0

    def p_value(self) -> float:
        """p-value of any of the trials."""
        return min(1.0, self.trials * float(special.kolmogorov(math.sqrt(self.count) * self.measured)))

    def strength(self) -> float:
        """The normal deviate of as small a p-value."""
        return float(-special.ndtri(max(self.p_value() / 2, 1e-300)))

    def _reach(self, share: float) -> float:
        return float(special.kolmogi(share)) / math.sqrt(self.count)

    def interval(self, alpha: float) -> Interval:
        """Distances that are no farther from this one than chance may bring it."""
        reach = self._reach(alpha / self.trials)
        return max(self.measured - reach, 0.0), self.measured + reach

    def noticed(self, alpha: float) -> Noticed:
        """A distance that the test does not miss: what chance may bring, from both sides."""
        return None, self._reach(alpha / self.trials) + self._reach(1 - POWER)


GROUP = "independence"
MIN_PAIRS = 200  # independent pairs of residuals below which their correlation is not tested
MIN_WORTH, MIN_PERSISTENT_WORTH = 100, 300
"""Independent residuals below which they are not tested; persistent ones come in clumps, so more are needed."""
_MIN_EVENTS = 10.0
_FORGOTTEN = 10.0  # correlation times after which residuals count as independent: 5e-5 of a correlation is left
_CANDIDATES = 40


@dataclass(frozen=True)
class Memory:
    """Time for which residuals stay correlated, on the grid of a run."""

    correlation_s: float  # time in which a correlation falls to 1/e; 0 for independent residuals
    turn_s: float  # least time from one turn of the detector to the next
    turns: int  # most turns of a camera
    step_s: float  # least time from one step of the scene to the next

    @classmethod
    def of(cls, model: DetectorModel, evidence: Evidence, correlation_s: float) -> Memory:
        """The memory of residuals with some correlation time."""
        due = [seen.frames.times_s[model.gates.due(seen.frames)] for seen in evidence.cameras]
        turn_s = min((float(np.diff(times).min()) for times in due if len(times) > 1), default=math.inf)
        steps = [np.diff(s.frames.times_s) / np.diff(s.frames.steps) for s in evidence.cameras if len(s.frames) > 1]
        step_s = min((float(apart.min()) for apart in steps), default=math.inf)
        return cls(correlation_s, turn_s, max(len(times) for times in due), step_s)

    def inflation(self, power: int) -> float:
        """Most that a sum's variance grows by the correlation of residuals (1), or of products of two residuals (2)."""
        if self.correlation_s <= 0:
            return 1.0
        lags = np.arange(1, self.turns)
        kept = np.exp(-power * lags * self.turn_s / self.correlation_s)
        return 1 + 2 * float(((1 - lags / self.turns) * kept).sum())

    @property
    def first_lag(self) -> int:
        """Steps after which nothing is left."""
        return max(1, math.ceil(_FORGOTTEN * self.correlation_s / self.step_s))


Found = tuple[Measure | None, str]  # a measure, None if too little was seen; and a note


def independence_checks(model: DetectorModel, evidence: Evidence, fits: Sequence[StateFit]) -> list[Parameter]:
    """The patterns of each kind of draw, box errors that come twice, and the spread of numbers of false positives."""
    parameters = [_repeated_errors(model, evidence, fits)]
    for residuals in residuals_of(model, evidence, fits):
        memory = Memory.of(model, evidence, residuals.correlation_s)
        for name, check in _checks_of(residuals, evidence).items():
            measure, note = check(residuals, evidence, memory) if len(residuals.image) else (None, residuals.note)
            parameters.append(Parameter(f"{residuals.draw}: {name}", GROUP, measure, 0.0, in_file=False, note=note))
    return [*parameters, *spread_checks(model, evidence, GROUP)]


def _repeated_errors(model: DetectorModel, evidence: Evidence, fits: Sequence[StateFit]) -> Parameter:
    """Whether the four errors of a box are those of another box, to the last bit: drawn numbers never are."""
    measure = None
    if fits and (model.persistence.box is not None or model.persistence.box_s < NEVER_CHANGES_S):
        errors = evidence.true_detections.errors_px[np.concatenate([fit.rows for fit in fits])]
        measure = Exact(len(errors) - len(np.unique(errors, axis=0)), len(errors))
    return Parameter(f"{Draw.BOX_ERROR}: none comes twice", GROUP, measure, in_file=False)


Check = Callable[[Residuals, Evidence, Memory], Found]


def _checks_of(residuals: Residuals, evidence: Evidence) -> Mapping[str, Check]:
    checks: dict[str, Check] = {"correlation with earlier times": _earlier_times}
    if len(evidence.cameras) > 1:
        checks["correlation between cameras"] = _between_cameras
    if residuals.draw != Draw.FALSE_POSITIVES:
        checks["correlation within images"] = _within_images
    return {**checks, "order in time": _order_in_time}


def _earlier_times(residuals: Residuals, evidence: Evidence, memory: Memory) -> Found:
    """The strongest correlation of a vessel in a camera with its own past, over all lags beyond its memory."""
    subset, images = residuals.of_vessels(), evidence.frames
    series = images.camera[subset.image] * (int(subset.vessel.max(initial=0)) + 1) + subset.vessel
    sums = lag_sums(subset.values, subset.variance, subset.third, series, images.step[subset.image])
    inflation = memory.inflation(2)
    lags = np.arange(len(sums.product))
    tested = np.flatnonzero((lags >= memory.first_lag) & (sums.pairs >= MIN_PAIRS * inflation))
    if not len(tested) or not _worth(subset, memory, 2):
        return None, ""
    z = sums.product[tested] / np.sqrt(sums.variance[tested] * inflation)
    likely = tested[np.argsort(-np.abs(z), kind="stable")[:_CANDIDATES]]
    estimates = [_estimate(sums, int(lag), inflation, len(tested)) for lag in likely]
    best = min(range(len(estimates)), key=lambda k: (estimates[k].p_value(), -abs(estimates[k].z)))
    return estimates[best], f"the strongest of {len(tested)} lags, {int(likely[best])} steps back"


def _estimate(sums: PairSums, k: int, inflation: float, trials: int = 1) -> Strongest:
    error = math.sqrt(sums.variance[k] * inflation)
    return Strongest(
        measured=float(sums.product[k] / sums.spread[k]),
        asked=0.0,
        error=error / float(sums.spread[k]),
        count=float(sums.pairs[k]) / inflation,
        skewness=float(sums.third[k]) * inflation**2 / error**3,
        trials=trials,
        possible=CORRELATION,
    )


def _between_cameras(residuals: Residuals, evidence: Evidence, memory: Memory) -> Found:
    subset = residuals.of_vessels()
    step = evidence.frames.step[subset.image]
    return _of_groups(subset, step * (int(subset.vessel.max(initial=0)) + 1) + subset.vessel, memory), ""


def _within_images(residuals: Residuals, evidence: Evidence, memory: Memory) -> Found:
    """Correlation of what is in one image: above zero if it comes in clumps, below if it is spread too evenly."""
    return _of_groups(residuals, residuals.image, memory), ""


def _of_groups(residuals: Residuals, group: Indices, memory: Memory) -> Estimate | None:
    sums = group_sums(residuals.values, residuals.variance, residuals.third, group)
    inflation = memory.inflation(2)
    enough = _worth(residuals, memory, 2) and sums.pairs[0] >= MIN_PAIRS * inflation
    return _estimate(sums, 0, inflation) if enough else None


def _worth(residuals: Residuals, memory: Memory, power: int) -> float:
    """Independent residuals that are worth as much as these, or as their products (2); 0 if they are too few."""
    inflation, variance = memory.inflation(power), residuals.variance
    if float(variance.sum()) < _MIN_EVENTS * inflation:
        return 0.0
    worth = float(variance.sum()) ** 2 / float((variance**2).sum()) / inflation
    return worth if worth >= (MIN_WORTH if memory.correlation_s <= 0 else MIN_PERSISTENT_WORTH) else 0.0


def _order_in_time(residuals: Residuals, evidence: Evidence, memory: Memory) -> Found:
    """Farthest that the sum of residuals, or of their squares where these say more, strays from zero."""
    worth = _worth(residuals, memory, 1)
    if not worth:
        return None, ""
    columns = residuals.values
    if residuals.continuous:
        columns = np.column_stack([columns, _magnitudes(residuals, evidence)])
    _, moment = np.unique(evidence.frames.time_s[residuals.image], return_inverse=True)
    sums = np.array([np.cumsum(np.bincount(moment, column)) for column in columns.T])
    strays = float(np.abs(sums).max()) / math.sqrt(float(residuals.variance.sum()) * memory.inflation(1))
    return SumDrift(strays / math.sqrt(worth), worth, len(sums)), ""


def _magnitudes(residuals: Residuals, evidence: Evidence) -> Array:
    """Squares of the values of each row, with mean zero and variance one in each state, shape (n,)."""
    squares = (residuals.values**2).sum(axis=1)
    state = evidence.frames.state[residuals.image]
    result = np.zeros(len(squares))
    for s in np.unique(state):
        rows = state == s
        result[rows] = (squares[rows] - squares[rows].mean()) / max(float(squares[rows].std()), 1e-12)
    return result
