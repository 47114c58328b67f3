"""Conditions that make a performance state, and how states follow each other."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.errors import InputError
from modsim3d.formats.labelled import Images
from modsim3d.io.validation import nearest
from modsim3d.learn.bootstrap import Interval, Key, columns_of_one, digits

# ---- How performance states follow each other ----


@dataclass(frozen=True, eq=False)
class Transitions:
    """A Markov chain of performance states."""

    counts: Array  # transitions to state i from state j, shape (n, n)
    initial: int = 0  # index of the state at the first step
    interval_s: float | None = None  # time between transitions; None for one at each step
    notes: tuple[str, ...] = ()  # why the chain is not learned

    @property
    def observed(self) -> bool:
        """Whether any transition was seen, a state that stays what it is included."""
        return bool(self.counts.sum() > 0)

    @property
    def matrix(self) -> Array:
        """(N_ij + 1) / (Σ_i N_ij + n), shape (n, n): one transition of each kind is added, as in eq. 6.21, but columns
        sum to one, as it divides by the whole sequence's length. Without a sequence, every state stays as it is."""
        n = len(self.counts)
        if not self.observed:
            return np.eye(n)
        return np.asarray((self.counts + 1) / (self.counts.sum(axis=0) + n))

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
        """Section of the detector file on the chain, whose states have these names."""
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


NAMES = {  # names of clusters, the largest F1 first; four have the thesis's names
    1: ("usual",),
    2: ("good", "bad"),
    3: ("excellent", "good", "bad"),
    4: ("excellent", "good", "bad", "terrible"),
}


@dataclass(frozen=True)
class StateMap:
    """Names of the conditions of each performance state, by the name of the state."""

    states: Mapping[str, tuple[str, ...]]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(self.states)

    def of_images(self, images: Images, conditions: Sequence[str]) -> Indices:
        """State of each image, −1 where its condition is in none, shape (I,)."""
        state_of = {condition: k for k, names in enumerate(self.states.values()) for condition in names}
        return np.array([state_of.get(condition, -1) for condition in conditions], dtype=np.int64)[images.condition]


def parse_states(given: Sequence[str], conditions: Sequence[str]) -> StateMap:
    """States from texts such as `good=day,cloudy`; conditions that no text names take no part. Raises InputError if a
    text has another form, or its conditions are unknown or in another state already."""
    problems: list[str] = []
    states: dict[str, tuple[str, ...]] = {}
    used: dict[str, str] = {}
    for text in given:
        name, equals, listed = text.partition("=")
        parts = tuple(part.strip() for part in listed.split(",") if part.strip())
        if not name.strip() or not equals or not parts:
            problems.append(f"--states {text}: must be NAME=CONDITION,CONDITION,...")
            continue
        if name.strip() in states:
            problems.append(f"--states {text}: state '{name.strip()}' is given twice")
        for part in parts:
            if part not in conditions:
                problems.append(f"--states {text}: unknown condition '{part}' ({nearest(part, conditions)})")
            elif part in used:
                problems.append(f"--states {text}: condition '{part}' is already in state '{used[part]}'")
            used[part] = name.strip()
        states[name.strip()] = parts
    if problems:
        raise InputError("states", problems)
    return StateMap(states)


def each_its_own(conditions: Sequence[str]) -> StateMap:
    """A state for each condition."""
    return StateMap({condition: (condition,) for condition in conditions})


def cluster(f1: Mapping[str, float], count: int) -> StateMap:
    """Cluster conditions by F1 into so many intervals with the least sum of squares within, by dynamic programming over
    all (Fisher (1958)), unlike k-means from random starts. Raises InputError with fewer conditions than states."""
    if count > len(f1):
        raise InputError("states", [f"--states {count}: there are only {len(f1)} conditions"])
    names = sorted(f1, key=lambda name: (-f1[name], name))
    edges = _best_split(np.array([f1[name] for name in names]), count)
    titles = NAMES.get(count) or tuple(f"state_{k + 1}" for k in range(count))
    return StateMap({title: tuple(names[a:b]) for title, (a, b) in zip(titles, edges, strict=True)})


def _best_split(values: Array, count: int) -> list[tuple[int, int]]:
    """First and last + 1 place of each interval of sorted values (n,); none is empty."""
    n = len(values)

    def cost(a: int, b: int) -> float:
        return float(((values[a:b] - values[a:b].mean()) ** 2).sum())

    best = [[np.inf] * (n + 1) for _ in range(count + 1)]
    cut = [[0] * (n + 1) for _ in range(count + 1)]
    best[0][0] = 0.0
    for k in range(1, count + 1):
        for b in range(k, n + 1):
            best[k][b], cut[k][b] = min((best[k - 1][a] + cost(a, b), a) for a in range(k - 1, b))
    edges, b = [], n
    for k in range(count, 0, -1):
        edges.append((cut[k][b], b))
        b = cut[k][b]
    return edges[::-1]


def transitions_of(images: Images, image_state: Indices, states: int, interval_s: float | None = None) -> Transitions:
    """The chain that frames show whose condition changes while they run; sets of one condition show none. Cameras with
    the same states at the same times count once. States of images (I,) are −1 for none. If the time between transitions
    is None, there is one at each frame, with the usual time between."""
    changing = [s for s in np.unique(images.source) if len(np.unique(image_state[images.source == s])) > 1]
    frames = []
    for sequence in np.unique(images.sequence):
        rows = np.flatnonzero((images.sequence == sequence) & np.isfinite(images.time_s) & (image_state >= 0))
        if len(rows) and images.source[rows[0]] in changing:
            frames.append(rows[np.argsort(images.time_s[rows], kind="stable")])
    usual_s = interval_s or _usual_gap_s([images.time_s[rows] for rows in frames])
    chains: dict[tuple[bytes, bytes, int], list[Indices]] = {}
    for rows in frames if usual_s else []:
        times = images.time_s[rows]
        if interval_s is None:  # gap by gap: rounded times make the usual gap slightly wrong, which would add up
            number = np.cumsum(np.rint(np.diff(times, prepend=times[0]) / usual_s))
        else:  # a state changes at multiples of an interval
            number = np.floor(times / usual_s + 1e-6)
        numbers, first = np.unique(number, return_index=True)
        history = image_state[rows[first]]
        key = (times[first].tobytes(), history.tobytes(), int(images.source[rows[0]]))
        chains[key] = np.split(history, np.flatnonzero(np.diff(numbers) != 1) + 1)  # states between are not known
    return count_transitions([part for parts in chains.values() for part in parts], states, usual_s or None)


def _usual_gap_s(times_s: Sequence[Array]) -> float:
    """Median time between frames, given the times of each sequence; 0 if no frame follows another."""
    gaps = np.concatenate([np.diff(times) for times in times_s]) if times_s else np.zeros(0)
    gaps = gaps[gaps > 0]
    return float(f"{np.median(gaps):.6g}") if len(gaps) else 0.0


def parse_sequence(text: str, states: Sequence[str], source: str) -> Indices:
    """Indices of states that a text names, one a line, (lines,). Raises InputError with the lines of unknown names."""
    lines = [line.strip() for line in text.splitlines()]
    places = {name: index for index, name in enumerate(states)}
    if not any(line in places for line in lines):
        raise InputError(source, [f"names no state in any line: one of {', '.join(states)} is needed on each"])
    wrong = [(k, line) for k, line in enumerate(lines, start=1) if line and line not in places]
    if wrong:
        problems = [f"line {k}: unknown state '{line}' ({nearest(line, states)})" for k, line in wrong[:20]]
        raise InputError(source, problems)
    return np.array([places[line] for line in lines if line], dtype=np.int64)
