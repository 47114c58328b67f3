"""A detector file out of estimates, and estimates out of labelled sets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.learn.estimates import Columns, estimate
from modsim3d.learn.figures import covariance
from modsim3d.learn.form import QUANTILES, Form, choose_form, first_times
from modsim3d.learn.labelled import LabelledSet
from modsim3d.learn.matching import Rule, match
from modsim3d.learn.observed import Observed
from modsim3d.learn.resampling import Resampling, resample
from modsim3d.learn.transitions import Transitions

_RUN_TIMES = 12.0
_LEAST_RUNS = 24
Values = dict[str, Array]


@dataclass(frozen=True)
class Settings:
    """How to learn.

    Attributes:
        rule: How boxes are matched.
        threshold: Least confidence that counts.
        replicates: Of the bootstrap.
        seed: Everything random comes from it.
        clutter: Model of false positives, or `auto`.
        run_s: Length of the runs of frames that are drawn; None to find it.
    """

    rule: Rule = field(default_factory=Rule)
    threshold: float = 0.2
    replicates: int = 300
    seed: int = 0
    clutter: str = "auto"
    run_s: float | None = None


@dataclass(frozen=True, eq=False)
class Learned:
    """What was learned.

    Attributes:
        observed: The data, matched.
        form: The models.
        columns: The numbers, by path.
        units: Of what was drawn to resample, by how paths begin; the longest counts, "" is what all states share.
        resampling: Weights of images.
        run_s: Length of the runs of frames that were drawn; 0 for single images.
        transitions: Of the states.
    """

    observed: Observed
    form: Form
    columns: Columns
    units: Mapping[str, int]
    resampling: Resampling
    run_s: float
    transitions: Transitions

    def values(self) -> Values:
        """The estimates, by path."""
        return {path: column.estimate for path, column in self.columns.items()}

    def intervals(self, level: float) -> dict[str, tuple[Array, Array]]:
        """Both ends for each number, by path; with those of the transition matrix."""
        found = {
            path: column.interval(level, self.units[max(filter(path.startswith, self.units), key=len)])
            for path, column in self.columns.items()
        }
        return found | {"transition_matrix": self.transitions.interval(level)}

    def detector(self, values: Values | None = None) -> dict[str, Any]:
        """The content of a detector file, of other values than the estimates if given."""
        return detector_content(self.form, self.values() if values is None else values, self.transitions)


def observe(labelled: LabelledSet, states: Sequence[str], image_state: Indices, settings: Settings) -> Observed:
    """Match, and put in columns."""
    matched = match(labelled, settings.rule, settings.threshold)
    return Observed.of(labelled, matched, tuple(states), image_state, settings.threshold)


def learn(
    labelled: LabelledSet, states: Sequence[str], image_state: Indices, transitions: Transitions, settings: Settings
) -> Learned:
    """Learn a detector.

    Args:
        labelled: Images, truth and detections.
        states: Names of the performance states.
        image_state: Of each image, −1 for images that take no part, shape (I,).
        transitions: Of the states.
        settings: How.
    """
    observed = observe(labelled, states, image_state, settings)
    form = choose_form(observed, settings.clutter)
    run_s = _run_s(observed, form) if settings.run_s is None else settings.run_s
    resampling = resample(labelled.images, settings.replicates, settings.seed, run_s)
    units = {f"states.{name}.": resampling.units(image_state == index) for index, name in enumerate(states)}
    units[""] = resampling.units(image_state >= 0)
    columns = estimate(observed, form, resampling)
    form = replace(form, notes=(*form.notes, *_empty(observed), *transitions.notes))
    return Learned(observed, form, columns, units, resampling, run_s, transitions)


def learn_again(learned: Learned, labelled: LabelledSet, image_state: Indices, settings: Settings) -> Values:
    """The same numbers from other data, the models as they were."""
    observed = observe(labelled, learned.form.states, image_state, settings)
    columns = estimate(observed, learned.form, resample(labelled.images, 0, 0))
    return {path: column.estimate for path, column in columns.items()}


def _run_s(observed: Observed, form: Form) -> float:
    """Many times the time that noise persists, but so that some runs are left."""
    longest = max(first_times(observed, form))
    if longest <= 0:
        return 0.0
    images = observed.labelled.images
    spans = [float(np.ptp(images.time_s[images.sequence == s])) for s in np.unique(images.sequence)]
    return min(_RUN_TIMES * longest, float(np.nansum(spans)) / _LEAST_RUNS)


def _empty(observed: Observed) -> list[str]:
    """Labels that a state has not seen."""
    notes = []
    k = len(observed.labelled.labels)
    counts = np.bincount(observed.state * k + observed.label, minlength=len(observed.states) * k).reshape(-1, k)
    for state, label in np.argwhere(counts == 0):
        if counts[:, label].any():
            instead = "that of all states"
        else:
            instead = "found as often as the other labels, always by its name"
        column = f"column {observed.labelled.labels[label]}"
        notes.append(f"states.{observed.states[state]}.confusion, {column}: {instead}; had 0 of it")
    return notes


def detector_content(form: Form, values: Values, transitions: Transitions) -> dict[str, Any]:
    """The content of a detector file.

    Args:
        form: The models.
        values: Their numbers, by path.
        transitions: Of the states.
    """
    content: dict[str, Any] = {
        "labels": list(form.labels),
        "confidence_threshold": form.threshold,
        "initial_state": form.states[transitions.initial],
        "transition_matrix": _columns_of_one(transitions.matrix),
    }
    if transitions.interval_s is not None:
        content["transition_interval_s"] = _digits(transitions.interval_s)
    if form.effects:
        content["dropout"] = {"model": "logistic", "anchor": "state_rate"}
        for effect in form.effects:
            key = "per_doubling" if effect.doublings else "per_unit"
            slope = _digits(values[f"dropout.{effect.attribute}.{key}"])
            content["dropout"][effect.attribute] = {key: slope, "reference": _digits(effect.reference)}
    persistence = {
        name: _digits(values[f"persistence.{name}"])
        for name in ("class_s", "box_s")
        if f"persistence.{name}" in values and values[f"persistence.{name}"] > 0
    }
    if persistence:
        content["persistence"] = persistence
    content["false_positives"] = _clutter(form, values)
    content["states"] = {name: _state(form, name, values) for name in form.states}
    return content


def _clutter(form: Form, values: Values) -> dict[str, Any]:
    section: dict[str, Any] = {"model": form.clutter}
    if form.grid:
        density = values["false_positives.density"]
        section |= {"placement": "density", "density": _nested(density / density.max())}
    if form.sizes:
        log_std = _digits(values["false_positives.size.log_std"])
        section["size"] = {"model": "lognormal", "px": _nested(values["false_positives.size.px"]), "log_std": log_std}
    return section


def _state(form: Form, name: str, values: Values) -> dict[str, Any]:
    path = f"states.{name}"
    section: dict[str, Any] = {
        "confusion": _columns_of_one(_filled(values[f"{path}.confusion"])),
        "false_positive_labels": _columns_of_one(values[f"{path}.false_positive_labels"]),
        "false_discovery_rate": _digits(min(float(values[f"{path}.false_discovery_rate"]), 0.99)),
    }
    if form.clutter == "per_image":
        section["false_positives_per_image"] = _digits(values[f"{path}.false_positives_per_image"])
    mean, std = np.nan_to_num(values[f"{path}.box_error_mean"]), np.nan_to_num(values[f"{path}.box_error_std"])
    matrix = _positive(covariance(std, np.nan_to_num(values[f"{path}.box_error_correlation"])))
    unit = form.units[name].split()[-1]
    section["box_error"] = {"unit": unit, "mean": _nested(mean), "covariance": _nested(matrix)}
    section["confidence"] = {kind: _scores(form, f"{path}.confidence.{kind}", values) for kind in ("true", "false")}
    return section


def _scores(form: Form, path: str, values: Values) -> dict[str, Any]:
    if f"{path}.quantiles" in values:
        quantiles = np.maximum.accumulate(np.clip(values[f"{path}.quantiles"], form.threshold, 1))
        return {"quantiles": _nested(quantiles[:QUANTILES])}
    mean, std = float(values[f"{path}.mean"]), float(values[f"{path}.std"])
    if not np.isfinite(mean):  # none were seen anywhere: anything the detector may say
        return {"quantiles": [form.threshold, 1.0]}
    return {"mean": _digits(mean), "std": _digits(std)}


def _filled(confusion: Array) -> Array:
    """Labels that never occurred are found as often as the others on average, by their own name."""
    table = confusion.copy()
    k = table.shape[1]
    unseen = ~np.isfinite(table).all(axis=0)
    miss = float(table[k, ~unseen].mean()) if not unseen.all() else 0.0
    for label in np.flatnonzero(unseen):
        table[:, label] = 0.0
        table[label, label], table[k, label] = 1 - miss, miss
    return table


def _positive(matrix: Array) -> Array:
    """A covariance: what rounding or a correction has made negative is taken for zero."""
    values, vectors = np.linalg.eigh(matrix)
    return matrix if values[0] >= 0 else (vectors * np.maximum(values, 0)) @ vectors.T


def _digits(value: Any) -> float:
    return float(f"{float(value):.6g}")


def _nested(values: Array) -> Any:
    return _digits(values) if np.ndim(values) == 0 else [_nested(each) for each in values]


def _columns_of_one(matrix: Array) -> Any:
    """Columns that sum to one in the digits that are written: the largest entry takes what rounding leaves."""
    clean = np.clip(np.array(matrix, dtype=np.float64), 0, 1)
    rounded = np.round(clean / clean.sum(axis=0), 7)
    columns = rounded.reshape(len(rounded), -1)
    largest = columns.argmax(axis=0), np.arange(columns.shape[1])
    columns[largest] += 1 - columns.sum(axis=0)
    return np.round(columns.reshape(rounded.shape), 7).tolist()
