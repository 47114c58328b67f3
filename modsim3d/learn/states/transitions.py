"""How performance states follow each other (Jessen & Mohr (2023), section 6.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Indices
from modsim3d.learn.numbers.entries import Interval, Key, columns_of_one, digits


@dataclass(frozen=True, eq=False)
class Transitions:
    """A Markov chain of performance states.

    Attributes:
        counts: Transitions to state i from state j, shape (n, n).
        initial: Index of the state at the first step.
        interval_s: Time between transitions; None for one at each step.
        notes: Why the chain is not learned.
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
        """(N_ij + 1) / (Σ_i N_ij + n), shape (n, n): one transition of each kind is added, as in eq. 6.21.

        Columns sum to one. Those of eq. 6.21 do not, because it divides by the length of the whole sequence. Without
        a sequence, every state stays as it is.
        """
        n = len(self.counts)
        if not self.observed:
            return np.eye(n)
        result: Array = (self.counts + 1) / (self.counts.sum(axis=0) + n)
        return result

    def interval(self, level: float, states: tuple[str, ...]) -> Interval:
        """Credible intervals of the matrix, whose entries have Beta distributions; `states` names its axes."""
        n, key = len(self.counts), Key(("transition_matrix",), axes=(states, states))
        if n == 1:
            return Interval(key, self.matrix, self.matrix, self.matrix)
        if not self.observed:
            return Interval(key, self.matrix, np.zeros((n, n)), np.ones((n, n)))
        hits, tail = self.counts + 1, (1 - level) / 2
        rest = self.counts.sum(axis=0) + n - hits
        return Interval(key, self.matrix, *(special.betaincinv(hits, rest, p) for p in (tail, 1 - tail)))

    def sections(self, states: tuple[str, ...]) -> dict[str, Any]:
        """What the detector file says of the chain, whose states have these names."""
        sections = {"initial_state": states[self.initial], "transition_matrix": columns_of_one(self.matrix)}
        if self.interval_s is not None and len(states) > 1:
            sections["transition_interval_s"] = digits(self.interval_s)
        return sections


def count_transitions(sequences: Sequence[Indices], states: int, interval_s: float | None = None) -> Transitions:
    """The chain that sequences of so many states show, each of shape (any,), whose entries are an interval apart."""
    counts = np.zeros((states, states))
    for sequence in sequences:
        np.add.at(counts, (sequence[1:], sequence[:-1]), 1)
    total = int(counts.sum())
    notes: tuple[str, ...] = ()
    if states > 1 and not total:
        notes = ("transition_matrix: a state stays what it is; had 0 transitions, needs a sequence of states",)
    initial = int(sequences[0][0]) if sequences and len(sequences[0]) else 0
    return Transitions(counts, initial, interval_s if total else None, notes)
