"""Does a run obey its detector file?"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask, run_starts
from modsim3d.detector.chain import CONFUSION, MARKOV_CHAIN, DetectorPart, used_models
from modsim3d.detector.classification import transitions_before
from modsim3d.detector.model import DetectorModel
from modsim3d.verify.box_error_checks import fit_checks, state_fits
from modsim3d.verify.class_checks import EFFECT_CHECKS, class_checks
from modsim3d.verify.confidence_checks import SCORE_CHECKS, confidence_checks
from modsim3d.verify.error_fit import MomentTable
from modsim3d.verify.error_parameters import LIKELIHOODS
from modsim3d.verify.evidence import Evidence
from modsim3d.verify.false_positive_checks import RATE_CHECKS, false_positive_checks
from modsim3d.verify.independence_checks import independence_checks
from modsim3d.verify.measures import Exact, Rate
from modsim3d.verify.parameters import Occupancy, Parameter, Verification, judge

CHECKED: Mapping[DetectorPart, Collection[str]] = {
    DetectorPart.STATE: {MARKOV_CHAIN},
    DetectorPart.CLASS: {CONFUSION} | EFFECT_CHECKS.keys(),
    DetectorPart.BOX_ERROR: LIKELIHOODS.keys(),
    DetectorPart.FALSE_POSITIVES: RATE_CHECKS.keys(),
    DetectorPart.CONFIDENCE: SCORE_CHECKS.keys(),
}
"""The models of each part that have checks, by the names in `detector.chain.MODELS`."""


def verify_evidence(model: DetectorModel, evidence: Evidence, table: MomentTable | None = None) -> Verification:
    """Hold what a run shows against a detector's parameters; the table saves work of further calls over one truth."""
    fits = state_fits(model, evidence, table or MomentTable())
    # In the order in which the detector works.
    parameters = [
        *state_checks(model, evidence),
        *class_checks(model, evidence),
        *fit_checks(model, evidence, fits),
        *false_positive_checks(model, evidence),
        *confidence_checks(model, evidence),
        *independence_checks(model, evidence, [fit for fit in fits.values() if fit is not None]),
    ]
    return judge([*parameters, *unchecked(model)])


def unchecked(model: DetectorModel) -> list[Parameter]:
    """A row for each model that the detector uses and no check knows."""
    return [
        Parameter(used.key, used.part, None, state=used.state, note=f"no check for model '{used.name}'", checked=False)
        for used in used_models(model)
        if used.name not in CHECKED[used.part]
    ]


# ---- The performance states ----


_ANGLES_AT_ONCE = 1 << 16


@dataclass(frozen=True, eq=False)
class Chain:
    """The states of a chain in a run, frame by frame; shapes (s,)."""

    name: str  # appended to the names of its parameters, empty if it is the only chain
    steps: Indices
    times_s: Array
    states: Indices
    forced: Mask  # whether the schedule, and not the chain, decided
    transitions: Indices  # number of transitions from each frame to the next, shape (s − 1,)

    @property
    def pairs(self) -> tuple[Indices, Indices, Indices]:
        """State before, state after and transitions between, of pairs of frames that are not forced, shapes (k,)."""
        free = ~(self.forced[1:] | self.forced[:-1])
        return self.states[:-1][free], self.states[1:][free], self.transitions[free]


def state_checks(model: DetectorModel, evidence: Evidence) -> list[Parameter]:
    """Initial state, every entry of the transition matrix, and the share of frames of each state."""
    chains = _chains(model, evidence)
    parameters = _shared_check(model, evidence)
    for chain in chains:
        if model.performance.schedule:
            asked = model.performance.forced(chain.times_s, chain.states)
            wrong = Exact(int((chain.states != asked).sum()), int(chain.forced.sum()))
            parameters.append(Parameter(f"performance.schedule{chain.name}", DetectorPart.STATE, wrong))
        if len(chain.steps) and chain.steps[0] == 0 and not chain.forced[0]:
            wrong = Exact(int(chain.states[0] != model.initial_state), 1)
            parameters.append(Parameter(f"initial_state{chain.name}", DetectorPart.STATE, wrong))
    parameters += _transition_checks(model, chains)
    for chain in () if model.performance.schedule else chains:
        for s, state in enumerate(model.states):
            law = occupancy_law(model, s, chain.transitions, int(chain.states[0]))
            share, name = Occupancy(int((chain.states == s).sum()), law), f"share of frames in {state.name}{chain.name}"
            parameters.append(Parameter(name, DetectorPart.STATE, share, state=state.name, in_file=False))
    return parameters


def _shared_check(model: DetectorModel, evidence: Evidence) -> list[Parameter]:
    if model.performance.per_camera:
        return []
    images = evidence.frames
    steps, first = np.unique(images.step, return_index=True)
    apart = int((images.state != images.state[first][np.searchsorted(steps, images.step)]).sum())
    shared = Exact(apart, len(images.step))
    return [Parameter("states shared by all cameras", DetectorPart.STATE, shared, in_file=False)]


def _chains(model: DetectorModel, evidence: Evidence) -> list[Chain]:
    images, cameras = evidence.frames, evidence.cameras
    if model.performance.per_camera:
        groups = [(f", {seen.frames.camera}", np.flatnonzero(images.camera == i)) for i, seen in enumerate(cameras)]
    else:
        groups = [("", np.unique(images.step, return_index=True)[1])]
    chains = []
    for name, rows in groups:
        steps, times_s = images.step[rows], images.time_s[rows]
        # The schedule decides whatever the chain does: it leaves only the states of other frames at −1.
        forced = model.performance.forced(times_s, np.full(len(rows), -1)) >= 0
        transitions = np.diff(transitions_before(model.transition_interval_s, steps, times_s)).astype(np.int64)
        chains.append(Chain(name, steps, times_s, images.state[rows], forced, transitions))
    return chains


def _transition_checks(model: DetectorModel, chains: list[Chain]) -> list[Parameter]:
    """The transition matrix, from pairs of frames of all chains with the usual number of transitions between them."""
    pairs_of_chains = zip(*(chain.pairs for chain in chains), strict=True)
    before, after, transitions = (np.concatenate(columns) for columns in pairs_of_chains)
    moved = transitions > 0
    parameters = []
    if not moved.all():
        held = Exact(int((after != before)[~moved].sum()), int((~moved).sum()))
        parameters.append(Parameter("state holds between transitions", DetectorPart.STATE, held, in_file=False))
    usual = int(np.bincount(transitions[moved]).argmax()) if moved.any() else 1
    matrix = np.linalg.matrix_power(model.transition_matrix, usual)
    pairs = transitions == usual
    counts = np.zeros((len(model.states), len(model.states)), dtype=np.int64)
    np.add.at(counts, (after[pairs], before[pairs]), 1)
    note = f"over {usual} transitions, as many as there are from frame to frame" if usual > 1 else ""
    for column, earlier in enumerate(model.states):
        # The rate of staying first: where only one other state can follow, both entries say the same.
        for row in sorted(range(len(model.states)), key=lambda row: row != column):
            later = model.states[row]
            visits = int(counts[:, column].sum())
            asked = float(np.clip(matrix[row, column], 0, 1))
            measure = Rate(int(counts[row, column]), visits, asked) if visits else None
            name = f"transition_matrix[{later.name}][{earlier.name}]"
            parameters.append(Parameter(name, DetectorPart.STATE, measure, asked, state=earlier.name, note=note))
    return parameters


def occupancy_law(model: DetectorModel, state: int, transitions: Indices, start: int) -> Array:
    """Exact probability of each number of frames in a state, (frames + 1,), from the state of the first frame. The
    number has a characteristic function that is a product of matrices, one for each frame, of which the inverse Fourier
    transform at as many angles gives the probabilities. `transitions` are those to the next frame, (frames − 1,)."""
    frames = len(transitions) + 1
    starts = run_starts(transitions)
    lengths, repeats = transitions[starts], np.diff(np.append(starts, len(transitions)))
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
