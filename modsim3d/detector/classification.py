"""Dropout and class: one draw from the column of the confusion matrix."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.errors import ModsimError
from modsim3d.core.random_streams import GRID, Purpose, Streams, on_grid
from modsim3d.detector.draws import choose, cumulative
from modsim3d.detector.dropout import Dropout, anchor, shifted_rate
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import CameraFrames, Targets
from modsim3d.detector.target_statistics import TargetStatistics, tallied


@dataclass(frozen=True, eq=False)
class ConfusionClassifier:
    """Inverts the distribution of the target's label in the current state at a uniform number."""

    distributions: Array  # distribution function over labels and background, shape (states, labels, labels + 1)
    dropout: Dropout
    intercepts: Array  # log-odds added to all misses of a state and label, shape (states, labels)

    @classmethod
    def from_model(cls, model: DetectorModel, statistics: TargetStatistics) -> ConfusionClassifier:
        """The classifier of a detector whose anchored miss rates hold on average over the scene of the targets."""
        distributions = cumulative(np.swapaxes(model.column("confusion"), 1, 2))
        misses = _miss_rates(distributions)
        intercepts = np.zeros_like(misses)
        for state, of_labels in model.dropout.intercepts.items():
            intercepts[state] = of_labels
        if model.dropout.anchored:
            for state, label in np.ndindex(*misses.shape):
                intercepts[state, label] = anchor(
                    float(misses[state, label]), *statistics.log_odds_of(tallied(model.dropout, state), label)
                )
        return cls(distributions, model.dropout, intercepts)

    def miss_rates(self, states: Indices, targets: Targets) -> Array:
        """Probability that each target is missed in a state of its own, shapes (n,)."""
        added = self.intercepts[states, targets.label] + self.dropout.log_odds(states, targets)
        return shifted_rate(_miss_rates(self.distributions)[states, targets.label], added)

    def classify(self, frames: CameraFrames, states: Indices, targets: Targets, uniforms: Array) -> Indices:
        """Detected label of each target from one uniform number each, −1 where it is missed, shapes (n,). A changed
        rate of misses keeps the shares of the labels among detected targets."""
        state = states[targets.frame]
        if self.dropout.every_effect:
            seen = 1 - self.miss_rates(state, targets)
            usual = 1 - _miss_rates(self.distributions)[state, targets.label]
            detected = uniforms < seen
            # Up to `seen` the number is stretched over the labels' share of the column, which it must not leave.
            stretched = np.minimum(uniforms * (usual / np.maximum(seen, _MIN_CHANCE)), np.nextafter(usual, 0))
            uniforms = np.where(detected, stretched, 1.0)
        label = choose(self.distributions[state, targets.label], uniforms)
        return np.where(label >= self.distributions.shape[1], -1, label)

    def classify_scored(
        self, frames: CameraFrames, states: Indices, targets: Targets, uniforms: Array, scores: Array
    ) -> tuple[Indices, Array]:
        """Detected label of each target, −1 where it is missed, and how sure the detector is of it, from 0 to 1. Below
        the chance of a miss p its score, uniform in (0, 1), misses it; else the detector is as sure as
        (score − p) / (1 − p). The label comes from another number, with its share of the column. Shapes (n,)."""
        state = states[targets.frame]
        missed = self.miss_rates(state, targets)
        usual = 1 - _miss_rates(self.distributions)[state, targets.label]
        label = choose(self.distributions[state, targets.label], np.minimum(uniforms * usual, np.nextafter(usual, 0)))
        hits = (scores >= missed) & (missed < 1)
        level = (scores - missed) / np.where(hits, 1 - missed, 1.0)
        return np.where(hits, label, -1), on_grid(np.clip(level, 0, 1 - GRID))


_MIN_CHANCE = 1e-300


def _miss_rates(distributions: Array) -> Array:
    return 1 - distributions[..., -2]


# ---- Which performance state the detector is in ----

_BLOCK = 1024  # transitions drawn at a time: few enough for a short run, or for the first step of a live one
_MAX_TRANSITIONS = 100_000_000
_EARLY = 1e-6  # of an interval: 0.6 / 0.2 is a hair below 3, and the transition at 0.6 s is due


class PerformanceStates:
    """States of a detector's cameras. The chain goes on while the schedule forces a state, as without a schedule."""

    def __init__(self, model: DetectorModel, streams: Streams) -> None:
        """Start in the model's initial state."""
        self._model, self._streams = model, streams
        self._chains: dict[tuple[str, ...], StateSequence] = {}

    def at(self, frames: CameraFrames) -> Indices:
        """Index of the state at each frame, shape (S,). Raises ModsimError if the transition interval is so short that
        the transitions cannot be worked through."""
        performance = self._model.performance
        owner = (frames.camera,) if performance.per_camera else ()
        if owner not in self._chains:
            self._chains[owner] = StateSequence(self._model, self._streams, *owner)
        return performance.forced(frames.times_s, self._chains[owner].at(frames))


def transitions_before(interval_s: float | None, steps: Indices, times_s: Array) -> Indices:
    """Number of transitions up to each frame, shapes (S,): one at each step unless there is an interval."""
    if interval_s is None:
        return steps
    return np.floor(times_s / interval_s + _EARLY).astype(np.int64)


class StateSequence:
    """The states of a run, one realisation of the chain. Transition k uses the k-th number of one stream, so every
    camera that shares the chain has the same states at the same time. States are kept once they have been computed."""

    def __init__(self, model: DetectorModel, streams: Streams, *owner: str) -> None:
        """Start in the model's initial state; `owner` is the camera that has the chain for itself, if one has."""
        self._streams, self._owner = streams, owner
        self._interval_s = model.transition_interval_s
        self._columns = cumulative(model.transition_matrix.T)
        self._states = np.array([model.initial_state], dtype=np.int16)

    def at(self, frames: CameraFrames) -> Indices:
        """Index of the chain's state at each frame, shape (S,)."""
        transitions = transitions_before(self._interval_s, frames.steps, frames.times_s)
        if len(transitions):
            self._extend(int(transitions.max()))
        return self._states[transitions].astype(np.int64)

    def _extend(self, last: int) -> None:
        if last > _MAX_TRANSITIONS:
            raise ModsimError(
                f"the detector's state would change {last} times: choose a longer transition_interval_s"
                + (f" than {self._interval_s:g}" if self._interval_s else "")
            )
        pieces = [self._states]
        step = len(self._states)
        while step <= last:
            # Transition k, from step k − 1 to step k, uses row k.
            uniforms = self._streams.uniforms(Purpose.STATE, *self._owner, first=step, count=_BLOCK)[:, 0]
            following = np.stack([choose(column, uniforms) for column in self._columns], axis=1)
            states = accumulate(following.tolist(), lambda state, after: after[state], initial=int(pieces[-1][-1]))
            pieces.append(np.array([*states][1:], dtype=np.int16))
            step += _BLOCK
        self._states = np.concatenate(pieces)
