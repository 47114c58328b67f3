"""The performance states: where they start, how they change, how long each takes."""

from __future__ import annotations

import numpy as np

from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import Array, Indices
from modsim3d.learn.evidence import Evidence
from modsim3d.learn.measures import Exact, Occupancy, Rate
from modsim3d.learn.parameters import Parameter

GROUP = "performance state"
_EARLY = 1e-6  # of an interval, as in the detector: 0.6 / 0.2 is a hair below 3
_ANGLES_AT_ONCE = 1 << 16


def state_checks(model: DetectorModel, evidence: Evidence) -> list[Parameter]:
    """Initial state, every entry of the transition matrix, and the share of frames of each state."""
    images = evidence.images
    steps, first = np.unique(images.step, return_index=True)
    states, times_s = images.state[first], images.time_s[first]
    apart = int((images.state != states[np.searchsorted(steps, images.step)]).sum())
    parameters = [
        Parameter("states shared by all cameras", GROUP, Exact(apart, len(images.step)), in_file=False),
    ]
    if steps[0] == 0:
        wrong = Exact(int(states[0] != model.initial_state), 1)
        parameters.append(Parameter("initial_state", GROUP, wrong))
    transitions = transition_counts(model, steps, times_s)
    return [
        *parameters,
        *_transition_checks(model, states, transitions),
        *_occupancy_checks(model, states, transitions),
    ]


def transition_counts(model: DetectorModel, steps: Indices, times_s: Array) -> Indices:
    """Number of transitions from each frame to the next, shape (frames − 1,)."""
    if model.transition_interval_s is None:
        return np.asarray(np.diff(steps), dtype=np.int64)
    due = np.floor(times_s / model.transition_interval_s + _EARLY)
    return np.asarray(np.diff(due), dtype=np.int64)


def _transition_checks(model: DetectorModel, states: Indices, transitions: Indices) -> list[Parameter]:
    """From the pairs of frames with the usual number of transitions between them."""
    moved = transitions > 0
    held = Exact(int((states[1:] != states[:-1])[~moved].sum()), int((~moved).sum()))
    parameters = []
    if not moved.all():
        parameters.append(Parameter("state holds between transitions", GROUP, held, in_file=False))
    usual = int(np.bincount(transitions[moved]).argmax()) if moved.any() else 1
    matrix = np.linalg.matrix_power(model.transition_matrix, usual)
    pairs = np.flatnonzero(transitions == usual)
    size = len(model.states)
    counts = np.zeros((size, size), dtype=np.int64)
    np.add.at(counts, (states[pairs + 1], states[pairs]), 1)
    note = f"over {usual} transitions, as many as there are from frame to frame" if usual > 1 else ""
    for column, before in enumerate(model.states):
        for row, after in enumerate(model.states):
            visits = int(counts[:, column].sum())
            asked = float(np.clip(matrix[row, column], 0, 1))
            measure = Rate(int(counts[row, column]), visits, asked) if visits else None
            name = f"transition_matrix[{after.name}][{before.name}]"
            parameters.append(Parameter(name, GROUP, measure, asked, state=before.name, note=note))
    return parameters


def _occupancy_checks(model: DetectorModel, states: Indices, transitions: Indices) -> list[Parameter]:
    return [
        Parameter(
            f"share of frames in {state.name}",
            GROUP,
            Occupancy(int((states == s).sum()), occupancy_law(model, s, transitions, int(states[0]))),
            state=state.name,
            in_file=False,
        )
        for s, state in enumerate(model.states)
    ]


def occupancy_law(model: DetectorModel, state: int, transitions: Indices, start: int) -> Array:
    """Probability of each number of frames in a state, exactly, shape (frames + 1,).

    The characteristic function of the number is a product of matrices, one for each frame; the inverse Fourier
    transform of its values at as many angles as there are numbers gives their probabilities.

    Args:
        model: The detector.
        state: Whose frames are counted.
        transitions: Number of transitions from each frame to the next.
        start: State of the first frame.
    """
    frames = len(transitions) + 1
    lengths, repeats = _runs(transitions)
    spectrum = np.empty(frames + 1, dtype=np.complex128)
    for first in range(0, frames + 1, _ANGLES_AT_ONCE):
        angles = 2 * np.pi * np.arange(first, min(first + _ANGLES_AT_ONCE, frames + 1)) / (frames + 1)
        mark = np.exp(1j * angles)
        vector = np.zeros((len(angles), len(model.states)), dtype=np.complex128)
        vector[:, start] = mark if start == state else 1
        for length, repeat in zip(lengths, repeats, strict=True):
            step = np.linalg.matrix_power(model.transition_matrix, int(length)).astype(np.complex128)
            marked = np.tile(step, (len(angles), 1, 1))
            marked[:, state, :] *= mark[:, None]
            vector = np.einsum("aij,aj->ai", np.linalg.matrix_power(marked, int(repeat)), vector)
        spectrum[first : first + len(angles)] = vector.sum(axis=1)
    law: Array = np.clip(np.fft.fft(spectrum).real / (frames + 1), 0, 1)
    law /= law.sum()
    return law


def _runs(values: Indices) -> tuple[Indices, Indices]:
    """Values that follow each other, and how often each is repeated."""
    if not len(values):
        return values, values
    starts = np.flatnonzero(np.diff(values, prepend=values[0] - 1))
    return values[starts], np.diff(np.append(starts, len(values)))
