"""What the scene's targets look like, all of them: what rates are held over, and where sizes come from.

Only whole numbers of how many fall in each narrow range are kept, so that it does not matter how a scene was split
when they were counted.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.boxes import sizes
from modsim3d.detector.draws import cumulative, log2
from modsim3d.detector.dropout import Dropout
from modsim3d.detector.records import CameraFrames, Targets

LOG_ODDS_STEP = 1 / 4096
"""Width of a range of log-odds: a rate held over them is off by at most half of it times p·(1 − p), so 3e-5."""
SIZE_STEPS = 16
"""Ranges of a side for each doubling: sides are within 2.2 % of those counted."""


@dataclass(frozen=True, eq=False)
class Tally:
    """How often each row of whole numbers occurred.

    Attributes:
        rows: Each once, in ascending order, shape (k, width).
        counts: Shape (k,).
    """

    rows: Indices
    counts: Indices

    @classmethod
    def of(cls, rows: Indices, counts: Indices | None = None) -> Tally:
        """Count rows of shape (n, width), each once or `counts` times."""
        unique, place = np.unique(rows, axis=0, return_inverse=True)
        weights = np.ones(len(rows), dtype=np.int64) if counts is None else counts
        totals = np.zeros(len(unique), dtype=np.int64)
        np.add.at(totals, place.ravel(), weights)
        return cls(unique, totals)

    def __add__(self, other: Tally) -> Tally:
        """Both together."""
        return Tally.of(np.concatenate([self.rows, other.rows]), np.concatenate([self.counts, other.counts]))


def _nothing() -> Tally:
    return Tally(np.empty((0, 2), dtype=np.int64), np.empty(0, dtype=np.int64))


@dataclass(frozen=True, eq=False)
class Reference:
    """The targets of a scene that a detector's gates let pass, counted.

    Attributes:
        log_odds: Of rows (label, range of the log-odds that their looks add).
        sides: Of rows (range of the width, range of the height).
    """

    log_odds: Tally = field(default_factory=_nothing)
    sides: Tally = field(default_factory=_nothing)

    @classmethod
    def of(cls, dropout: Dropout, frames: CameraFrames, targets: Targets) -> Reference:
        """Count some targets, which have passed the gates.

        Args:
            dropout: Whose log-odds are counted.
            frames: The frames.
            targets: Theirs.
        """
        ranges = np.rint(dropout.log_odds(targets) / LOG_ODDS_STEP).astype(np.int64)
        sides = np.rint(SIZE_STEPS * log2(np.maximum(sizes(targets.boxes_px), 1.0))).astype(np.int64)
        return cls(Tally.of(np.column_stack([targets.label, ranges])), Tally.of(sides))

    def __add__(self, other: Reference) -> Reference:
        """Both together."""
        return Reference(self.log_odds + other.log_odds, self.sides + other.sides)

    def log_odds_of(self, label: int) -> tuple[Array, Array]:
        """Log-odds that occurred for a label, and how often, shapes (k,)."""
        ours = self.log_odds.rows[:, 0] == label
        return self.log_odds.rows[ours, 1] * LOG_ODDS_STEP, self.log_odds.counts[ours].astype(np.float64)

    def sizes_px(self, uniforms: Array) -> Array:
        """Width and height of a target each, from one uniform number each, shape (m, 2)."""
        distribution = cumulative(self.sides.counts.astype(np.float64))
        sides = np.exp2(self.sides.rows / SIZE_STEPS)
        return sides[np.searchsorted(distribution, uniforms, side="right")]
