"""How performance states follow each other (Jessen & Mohr (2023), section 6.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Indices


@dataclass(frozen=True, eq=False)
class Transitions:
    """A Markov chain.

    Attributes:
        counts: Transitions to i from j, shape (n, n).
        initial: State at the first step.
        interval_s: Time between transitions; None for one at each step.
        notes: Why it is not learned.
    """

    counts: Array
    initial: int = 0
    interval_s: float | None = None
    notes: tuple[str, ...] = ()

    @property
    def observed(self) -> bool:
        """Whether any transition was seen, a state that stays what it is included."""
        return bool(self.counts.sum() > 0)

    @property
    def matrix(self) -> Array:
        """(N_ij + 1) / (Σ_i N_ij + n): one transition of each kind is made up, as in eq. 6.21, and columns sum to one.

        Eq. 6.21 divides by the length of the whole sequence instead, so that its columns do not. Where no sequence
        was seen, a state stays what it is.
        """
        n = len(self.counts)
        if not self.observed:
            return np.eye(n)
        result: Array = (self.counts + 1) / (self.counts.sum(axis=0) + n)
        return result

    def interval(self, level: float) -> tuple[Array, Array]:
        """Credible intervals: with those made up an entry is Beta's, and its mean is the matrix's."""
        n = len(self.counts)
        if n == 1:
            return self.matrix, self.matrix
        if not self.observed:
            return np.zeros((n, n)), np.ones((n, n))
        hits = self.counts + 1
        rest = self.counts.sum(axis=0) + n - hits
        tail = (1 - level) / 2
        return special.betaincinv(hits, rest, tail), special.betaincinv(hits, rest, 1 - tail)


def count_transitions(sequences: Sequence[Indices], states: int, interval_s: float | None = None) -> Transitions:
    """From sequences of states; one each time step or interval.

    Args:
        sequences: Of states, shapes (any,).
        states: How many there are.
        interval_s: Time between entries.
    """
    counts = np.zeros((states, states))
    for sequence in sequences:
        np.add.at(counts, (sequence[1:], sequence[:-1]), 1)
    total = int(counts.sum())
    notes: tuple[str, ...] = ()
    if states > 1 and not total:
        notes = ("transition_matrix: a state stays what it is; had 0 transitions, needs a sequence of states",)
    initial = int(sequences[0][0]) if sequences and len(sequences[0]) else 0
    return Transitions(counts, initial, interval_s if total else None, notes)
