"""Which performance state the detector is in: a Markov chain, one for all cameras or one for each; or forced."""

from __future__ import annotations

from itertools import accumulate

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.detector.draws import choose, cumulative
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import CameraFrames
from modsim3d.errors import ModsimError
from modsim3d.random_streams import Purpose, Streams

_BLOCK = 1024  # transitions drawn at a time: few enough for a short run, or for the first step of a live one
_MOST_TRANSITIONS = 100_000_000
_EARLY = 1e-6  # of an interval: 0.6 / 0.2 is a hair below 3, and the transition at 0.6 s is due


class PerformanceStates:
    """The states that a detector's cameras are in.

    The chain goes on while the schedule forces a state, so the states after it are those of a run without a schedule.
    """

    def __init__(self, model: DetectorModel, streams: Streams) -> None:
        """Start in the model's initial state."""
        self._model, self._streams = model, streams
        self._chains: dict[tuple[str, ...], StateSequence] = {}

    def at(self, frames: CameraFrames) -> Indices:
        """Index of the state at each frame, shape (S,).

        Raises:
            ModsimError: The transition interval is so short that the transitions cannot be worked through.
        """
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
    """The states of a run, one realisation of the chain.

    Transition k uses the k-th number of one stream, so every camera that shares the chain has the same states at the
    same time. States are kept once they have been computed.
    """

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
        if last > _MOST_TRANSITIONS:
            raise ModsimError(
                f"the detector's state would change {last} times: choose a longer transition_interval_s"
                + (f" than {self._interval_s:g}" if self._interval_s else "")
            )
        pieces = [self._states]
        known = len(self._states)
        while known <= last:
            # Transition k, from step k − 1 to step k, uses row k.
            uniforms = self._streams.uniforms(Purpose.STATE, *self._owner, first=known, count=_BLOCK)[:, 0]
            following = np.stack([choose(column, uniforms) for column in self._columns], axis=1)
            states = accumulate(following.tolist(), lambda state, after: after[state], initial=int(pieces[-1][-1]))
            pieces.append(np.array([*states][1:], dtype=np.int16))
            known += _BLOCK
        self._states = np.concatenate(pieces)
