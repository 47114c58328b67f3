"""Whether what the detector file draws independently is independent in the run.

Each number of a run may be right while the draws together are not: the same errors in both cameras, a run that repeats
itself, false positives at even distances, confidences in order. These checks look at the residuals of each kind of draw
with earlier times, between cameras, within images and in order of time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.persistence import NEVER_CHANGES_S
from modsim3d.verify.error_fit import StateFit
from modsim3d.verify.evidence import Evidence
from modsim3d.verify.measures import CORRELATION, Estimate, Exact, Measure
from modsim3d.verify.pair_sums import PairSums, group_sums, lag_sums
from modsim3d.verify.parameters import Parameter
from modsim3d.verify.pattern_measures import Drift, Strongest
from modsim3d.verify.residuals import Draw, Residuals, residuals_of
from modsim3d.verify.spread_checks import spread_checks

GROUP = "independence"
LEAST_PAIRS = 200
"""Independent pairs of residuals below which their correlation is not tested."""
LEAST_WORTH, LEAST_PERSISTENT_WORTH = 100, 300
"""Independent residuals below which they are not tested; persistent ones come in clumps, so more are needed."""
_LEAST_EVENTS = 10.0
_FORGOTTEN = 10.0
"""Correlation times after which residuals count as independent: 5e-5 of a correlation is left."""
_CANDIDATES = 40


@dataclass(frozen=True)
class Memory:
    """How long residuals stay correlated, on the grid of a run.

    Attributes:
        correlation_s: Time in which a correlation falls to 1/e; 0 for independent residuals.
        turn_s: Least time from one turn of the detector to the next.
        turns: Most turns of a camera.
        step_s: Least time from one step of the scene to the next.
    """

    correlation_s: float
    turn_s: float
    turns: int
    step_s: float

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


Found = tuple[Measure | None, str]
"""A measure, None if too little was seen; and a note."""


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
    if fits and model.persistence.box_s < NEVER_CHANGES_S:
        errors = evidence.true_detections.errors_px[np.concatenate([fit.rows for fit in fits])]
        measure = Exact(len(errors) - len(np.unique(errors, axis=0)), len(errors))
    return Parameter(f"{Draw.BOX_ERROR}: none comes twice", GROUP, measure, in_file=False)


Check = Callable[[Residuals, Evidence, Memory], Found]


def _checks_of(residuals: Residuals, evidence: Evidence) -> Mapping[str, Check]:
    """The checks of a kind of draw, by name."""
    checks: dict[str, Check] = {"correlation with earlier times": _earlier_times}
    if len(evidence.cameras) > 1:
        checks["correlation between cameras"] = _between_cameras
    if residuals.draw != Draw.FALSE_POSITIVES:
        checks["correlation within images"] = _within_images
    return {**checks, "order in time": _order_in_time}


def _earlier_times(residuals: Residuals, evidence: Evidence, memory: Memory) -> Found:
    """The strongest correlation of a vessel in a camera with its own past, over all lags beyond its memory."""
    ours, images = residuals.of_vessels(), evidence.frames
    series = images.camera[ours.image] * (int(ours.vessel.max(initial=0)) + 1) + ours.vessel
    sums = lag_sums(ours.values, ours.variance, ours.third, series, images.step[ours.image])
    inflation = memory.inflation(2)
    lags = np.arange(len(sums.product))
    tested = np.flatnonzero((lags >= memory.first_lag) & (sums.pairs >= LEAST_PAIRS * inflation))
    if not len(tested) or not _worth(ours, memory, 2):
        return None, ""
    z = sums.product[tested] / np.sqrt(sums.variance[tested] * inflation)
    likely = tested[np.argsort(-np.abs(z), kind="stable")[:_CANDIDATES]]
    found = [_estimate(sums, int(lag), inflation, len(tested)) for lag in likely]
    best = min(range(len(found)), key=lambda k: (found[k].p_value(), -abs(found[k].z)))
    return found[best], f"the strongest of {len(tested)} lags, {int(likely[best])} steps back"


def _estimate(sums: PairSums, k: int, inflation: float, trials: int = 1) -> Strongest:
    """The correlation of the k-th kind of pairs."""
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
    """Correlation of what belongs to the same vessel at the same step."""
    ours = residuals.of_vessels()
    step = evidence.frames.step[ours.image]
    return _of_groups(ours, step * (int(ours.vessel.max(initial=0)) + 1) + ours.vessel, memory), ""


def _within_images(residuals: Residuals, evidence: Evidence, memory: Memory) -> Found:
    """Correlation of what is in one image: above zero if it comes in clumps, below if it is spread too evenly."""
    return _of_groups(residuals, residuals.image, memory), ""


def _of_groups(residuals: Residuals, group: Indices, memory: Memory) -> Estimate | None:
    sums = group_sums(residuals.values, residuals.variance, residuals.third, group)
    inflation = memory.inflation(2)
    enough = _worth(residuals, memory, 2) and sums.pairs[0] >= LEAST_PAIRS * inflation
    return _estimate(sums, 0, inflation) if enough else None


def _worth(residuals: Residuals, memory: Memory, power: int) -> float:
    """Independent residuals that are worth as much as these, or as their products (2); 0 if they are too few."""
    inflation, variance = memory.inflation(power), residuals.variance
    if float(variance.sum()) < _LEAST_EVENTS * inflation:
        return 0.0
    worth = float(variance.sum()) ** 2 / float((variance**2).sum()) / inflation
    return worth if worth >= (LEAST_WORTH if memory.correlation_s <= 0 else LEAST_PERSISTENT_WORTH) else 0.0


def _order_in_time(residuals: Residuals, evidence: Evidence, memory: Memory) -> Found:
    """How far the sum of the residuals so far strays from zero; also that of their squares where these say more."""
    worth = _worth(residuals, memory, 1)
    if not worth:
        return None, ""
    columns = residuals.values
    if residuals.continuous:
        columns = np.column_stack([columns, _magnitudes(residuals, evidence)])
    _, moment = np.unique(evidence.frames.time_s[residuals.image], return_inverse=True)
    sums = np.array([np.cumsum(np.bincount(moment, column)) for column in columns.T])
    strays = float(np.abs(sums).max()) / math.sqrt(float(residuals.variance.sum()) * memory.inflation(1))
    return Drift(strays / math.sqrt(worth), worth, len(sums)), ""


def _magnitudes(residuals: Residuals, evidence: Evidence) -> Array:
    """Squares of the values of each row, with mean zero and variance one in each state, shape (n,)."""
    squares = (residuals.values**2).sum(axis=1)
    state = evidence.frames.state[residuals.image]
    result = np.zeros(len(squares))
    for s in np.unique(state):
        rows = state == s
        result[rows] = (squares[rows] - squares[rows].mean()) / max(float(squares[rows].std()), 1e-12)
    return result
