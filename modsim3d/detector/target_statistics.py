"""Counts of what all targets of a scene look like. Two models need them before the first frame. A miss rate that is
anchored to the scene is an average over all targets. False positives that are as large as the scene's vessels take
their sizes from all targets. Only whole numbers are kept: how many targets fall in each narrow range. So the counts are
the same however the scene was split into parts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.boxes import sizes
from modsim3d.core.random_streams import on_grid
from modsim3d.detector.draws import cumulative, log2, low_uniforms
from modsim3d.detector.dropout import Dropout
from modsim3d.detector.records import Targets

LOG_ODDS_STEP = 1 / 4096  # width of a range of log-odds: an anchored rate is off by at most half of it times p·(1 − p)
SIZE_STEPS = 16  # ranges of a side for each doubling, ± 2.2 % each: drawn sides are within 4.4 % of those counted


@dataclass(frozen=True, eq=False)
class Tally:
    """Distinct rows (k, width) of whole numbers in ascending order, and how often each occurred (k,)."""

    rows: Indices
    counts: Indices

    @classmethod
    def of(cls, rows: Indices, counts: Indices | None = None) -> Tally:
        """Count rows of shape (n, width), each once or `counts` times."""
        unique, place = np.unique(rows, axis=0, return_inverse=True)
        totals = np.zeros(len(unique), dtype=np.int64)
        np.add.at(totals, place.ravel(), 1 if counts is None else counts)
        return cls(unique, totals)

    def __add__(self, other: Tally) -> Tally:
        """The rows of both."""
        return Tally.of(np.concatenate([self.rows, other.rows]), np.concatenate([self.counts, other.counts]))


def _nothing(width: int) -> Tally:
    return Tally(np.empty((0, width), dtype=np.int64), np.empty(0, dtype=np.int64))


SHARED = -1  # stands for all states without effects of their own, which have the same log-odds


def tallied(dropout: Dropout, state: int) -> int:
    """The number under which targets count the log-odds of a state."""
    return state if state in dropout.own else SHARED


@dataclass(frozen=True, eq=False)
class TargetStatistics:
    """Counts of a scene's targets that pass the gates, by `tallied` state, label and range of what their look adds to
    the log-odds of a miss there, and by ranges of width and height."""

    log_odds: Tally = field(default_factory=lambda: _nothing(3))
    sides: Tally = field(default_factory=lambda: _nothing(2))

    @classmethod
    def of(cls, dropout: Dropout, targets: Targets) -> TargetStatistics:
        """Count some targets, which have passed the gates."""
        rows = [_log_odds_rows(dropout, state, targets) for state in (SHARED, *dropout.own)]
        sides = np.rint(SIZE_STEPS * log2(np.maximum(sizes(targets.boxes_px), 1.0))).astype(np.int64)
        return cls(Tally.of(np.concatenate(rows)), Tally.of(sides))

    @classmethod
    def total(cls, parts: Iterable[TargetStatistics]) -> TargetStatistics:
        """The statistics of a scene from those of its parts, such as blocks of steps or cameras."""
        return sum(parts, cls())

    def __add__(self, other: TargetStatistics) -> TargetStatistics:
        """The statistics of the targets of both."""
        return TargetStatistics(self.log_odds + other.log_odds, self.sides + other.sides)

    def log_odds_of(self, state: int, label: int) -> tuple[Array, Array]:
        """Log-odds that occurred for a `tallied` state and a label, and how often, shapes (k,)."""
        rows = np.all(self.log_odds.rows[:, :2] == (state, label), axis=1)
        return self.log_odds.rows[rows, 2] * LOG_ODDS_STEP, self.log_odds.counts[rows].astype(np.float64)

    def sizes_px(self, uniforms: Array) -> Array:
        """Width and height of one target for each uniform number of shape (m,), shape (m, 2). They lie anywhere in
        their ranges: a few exact sizes would tell false positives from vessels."""
        distribution = cumulative(self.sides.counts.astype(np.float64))
        ranges = self.sides.rows[np.searchsorted(distribution, uniforms, side="right")]
        return on_grid(np.exp2((ranges + low_uniforms(uniforms) - 0.5) / SIZE_STEPS))


def _log_odds_rows(dropout: Dropout, state: int, targets: Targets) -> Indices:
    """State, label and range of the log-odds of each target in a `tallied` state, shape (n, 3)."""
    states = np.full(len(targets), state)
    ranges = np.rint(dropout.log_odds(states, targets) / LOG_ODDS_STEP).astype(np.int64)
    return np.column_stack([states, targets.label, ranges])
