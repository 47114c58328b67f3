"""Changes of one parameter of a detector file, as somebody might make them after a run."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from modsim3d.core.arrays import read_only
from modsim3d.detector.confidence import NormalScores
from modsim3d.detector.model import ERROR_COMPONENTS, DetectorModel, PerformanceState

PART, SIGMAS, CORRELATION = 0.2, 0.2, 0.1
"""Of a rate or standard deviation; of a mean in standard deviations; of a correlation."""


@dataclass(frozen=True, eq=False)
class Change:
    """One change of a parameter."""

    kind: str  # for tables
    name: str  # as `verify` calls it
    size: float  # positive: the file asks for so much more than the run was made with, or less
    up: bool  # whether the file asks for more
    model: DetectorModel  # with the change


def with_entry(column: np.ndarray, row: int, value: float) -> np.ndarray:
    """A distribution with one entry set and the others in the same proportions."""
    changed = np.array(column, dtype=np.float64)
    others = np.arange(len(changed)) != row
    changed[others] *= (1 - value) / changed[others].sum()
    changed[row] = value
    return changed


def with_state(model: DetectorModel, index: int, **changes: object) -> DetectorModel:
    states = list(model.states)
    states[index] = replace(states[index], **changes)
    return replace(model, states=tuple(states))


def with_error(model: DetectorModel, index: int, **changes: object) -> DetectorModel:
    return with_state(model, index, box_error=replace(model.states[index].box_error, **changes))


def single_changes(model: DetectorModel, frame_s: float) -> Iterator[Change]:
    """Each parameter of what a run was made with changed once, every other one up and every other one down where both
    can be; correlations in time are taken over the seconds from one frame to the next."""
    up = True
    for change in _every_pair(model, frame_s):
        wanted, other = change if up else change[::-1]
        chosen = wanted or other
        if chosen is not None:
            yield chosen
            up = not up


Pair = tuple[Change | None, Change | None]


def _every_pair(model: DetectorModel, frame_s: float) -> Iterator[Pair]:
    for index, state in enumerate(model.states):
        if len(model.states) > 1:
            yield from _stay_rate(model, index)
        yield from _state_changes(model, index, state)
    yield from _persistence(model, frame_s)


def _persistence(model: DetectorModel, frame_s: float) -> Iterator[Pair]:
    """How much stays from one frame to the next; none is there to begin with unless the model has it."""
    for key in ("class_s", "box_s"):
        time_s = getattr(model.persistence, key)
        kept = math.exp(-frame_s / time_s) if time_s else 0.0

        def lasting(value: float, key: str = key) -> DetectorModel:
            times = {key: -frame_s / math.log(value) if value > 1e-12 else 0.0}
            return replace(model, persistence=replace(model.persistence, **times))

        yield _pair("correlation in time", f"persistence.{key}", kept, CORRELATION, lasting, low=-1e-9, high=1.0)


def _stay_rate(model: DetectorModel, index: int) -> Iterator[Pair]:
    name = model.states[index].name
    stays = float(model.transition_matrix[index, index])

    def with_stay(value: float) -> DetectorModel:
        matrix = np.array(model.transition_matrix)
        matrix[:, index] = with_entry(matrix[:, index], index, value)
        return replace(model, transition_matrix=read_only(matrix))

    path = f"transition_matrix[{name}][{name}]"
    yield _pair("stay-rate", path, stays, PART * stays, with_stay, low=0.0, high=1.0)


def _state_changes(model: DetectorModel, index: int, state: PerformanceState) -> Iterator[Pair]:
    path = f"states.{state.name}"
    for column, label in enumerate(model.labels):
        rate = float(state.confusion[-1, column])

        def missed(value: float, column: int = column) -> DetectorModel:
            confusion = np.array(state.confusion)
            confusion[:, column] = with_entry(confusion[:, column], len(confusion) - 1, value)
            return with_state(model, index, confusion=read_only(confusion))

        name = f"{path}.confusion[background][{label}]"
        yield _pair("false negative rate", name, rate, PART * rate, missed, low=0.0, high=1.0)
    rate, true = state.false_discovery_rate, state.confidence.true
    mean, std = (true.mean, true.std) if isinstance(true, NormalScores) else (math.nan, math.nan)

    def false(value: float) -> DetectorModel:
        return with_state(model, index, false_discovery_rate=value)

    def confident(mean: float, std: float) -> DetectorModel:
        scores = NormalScores(mean, std)
        return with_state(model, index, confidence=replace(state.confidence, true=scores, false=scores))

    name = f"{path}.false_discovery_rate"
    yield _pair("false discovery rate", name, rate, PART * rate, false, low=0.0, high=0.99)
    name = f"{path}.confidence.mean"
    yield _pair("confidence mean", name, mean, SIGMAS * std, lambda value: confident(value, std))
    name = f"{path}.confidence.std"
    yield _pair("confidence standard deviation", name, std, PART * std, lambda value: confident(mean, value))
    yield from _box_changes(model, index, state)


def _box_changes(model: DetectorModel, index: int, state: PerformanceState) -> Iterator[Pair]:
    path = f"states.{state.name}.box_error"
    means, covariance = np.array(state.box_error.mean), np.array(state.box_error.covariance)
    stds = np.sqrt(np.diag(covariance))
    for i, component in enumerate(ERROR_COMPONENTS):

        def shifted(value: float, i: int = i) -> DetectorModel:
            changed = means.copy()
            changed[i] = value
            return with_error(model, index, mean=read_only(changed))

        def spread(value: float, i: int = i) -> DetectorModel:
            scale = np.ones(4)
            scale[i] = value / stds[i]
            return with_error(model, index, covariance=read_only(covariance * np.outer(scale, scale)))

        mean_size, std_size = SIGMAS * float(stds[i]), PART * float(stds[i])
        yield _pair("box error mean", f"{path}.mean[{component}]", float(means[i]), mean_size, shifted)
        yield _pair("box error standard deviation", f"{path}.std[{component}]", float(stds[i]), std_size, spread)
    for i in range(4):
        for j in range(i + 1, 4):

            def tied(value: float, i: int = i, j: int = j) -> DetectorModel | None:
                changed = covariance.copy()
                changed[i, j] = changed[j, i] = value * stds[i] * stds[j]
                if np.linalg.eigvalsh(changed / np.outer(stds, stds))[0] < 0.01:
                    return None  # no errors can have it
                return with_error(model, index, covariance=read_only(changed))

            name = f"{path}.correlation[{ERROR_COMPONENTS[i]},{ERROR_COMPONENTS[j]}]"
            asked = float(covariance[i, j] / stds[i] / stds[j])
            yield _pair("box error correlation", name, asked, CORRELATION, tied, low=-0.99, high=0.99)


def _pair(kind, name, asked, size, make, low=-np.inf, high=np.inf) -> Pair:
    """The change up and the change down, None where it cannot be."""

    def change(up: bool) -> Change | None:
        value = asked + size if up else asked - size
        if not low < value < high or size == 0:
            return None
        model = make(value)
        return None if model is None else Change(kind, name, size, up, model)

    return change(True), change(False)
