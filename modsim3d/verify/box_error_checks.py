"""Box errors: mean, standard deviations and correlations of each state, and how long they persist."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import clip, move, sizes
from modsim3d.detector.box_error_law import ERROR_DISTRIBUTIONS
from modsim3d.detector.merges_and_splits import LEAST_SPLIT_PX
from modsim3d.detector.model import ERROR_COMPONENTS, DetectorModel, PerformanceState
from modsim3d.detector.parts import Part, model_name
from modsim3d.detector.records import TRUE
from modsim3d.verify.box_persistence_checks import box_persistence, replay
from modsim3d.verify.class_checks import correlation_note
from modsim3d.verify.error_fit import ErrorSample, FitStep, MomentTable, StateFit, fit_step, fitted_law
from modsim3d.verify.error_likelihoods import LIKELIHOODS, PLAIN
from modsim3d.verify.error_parameters import ErrorParameters
from modsim3d.verify.evidence import Evidence, unknown_rest_note
from modsim3d.verify.measures import AMOUNT, ANY, CORRELATION, Estimate, Exact
from modsim3d.verify.parameters import Parameter

LEAST_DETECTIONS = 150
"""Box errors of a state with fewer true detections are not tested."""
LEAST_WORTH = 300
"""Persistent errors are tested where they are worth so many independent ones.

They come in clumps: a few vessels that keep theirs stray farther than a law with their variance and skewness.
"""
MOST_SHAPE_ERROR = 1.0
"""A number of the distribution itself is tested up to this standard error, in its own units."""
_ROUNDING_PX = 1e-6
_CONDITION = 1e8


StateFits = Mapping[int, StateFit | None]
"""The fit of each state that is looked at and whose law has a check; None where too little was seen."""


def state_fits(
    model: DetectorModel, evidence: Evidence, table: MomentTable, states: Collection[str] | None = None
) -> StateFits:
    """Fit the box errors of each of the named states, or of all; the table holds expectations that are known."""
    chosen = [s for s, state in enumerate(model.states) if states is None or state.name in states]
    return {
        s: _fit(model.states[s], evidence, _rows(model, evidence, s), table)
        for s in chosen
        if _has_check(model.states[s])
    }


def box_error_checks(
    model: DetectorModel, evidence: Evidence, table: MomentTable, states: Collection[str] | None = None
) -> list[Parameter]:
    """The checks of the named states' fits, or of all."""
    return fit_checks(model, evidence, state_fits(model, evidence, table, states))


def fit_checks(model: DetectorModel, evidence: Evidence, fits: StateFits) -> list[Parameter]:
    """The parameters of each state that was fitted; the boxes themselves; correlation from frame to frame."""
    found = [fit for fit in fits.values() if fit is not None]
    replayed = replay(model, evidence, found) if model.persistence.box_memory_s > 0 else None
    parameters = []
    for s, fit in fits.items():
        errors = None if replayed is None or fit is None else replayed.errors[found.index(fit)]
        parameters += [
            replace(parameter, note=_limited(model, evidence, s) or parameter.note)
            for parameter in _state_checks(model.states[s], evidence, _rows(model, evidence, s), fit, errors)
        ]
    persistence = box_persistence(model, evidence, found, replayed)
    return [
        *parameters,
        _box_check(evidence),
        Parameter("persistence.box_s", Part.BOX_ERROR, persistence, note=correlation_note(persistence)),
    ]


def _rows(model: DetectorModel, evidence: Evidence, s: int) -> Indices:
    """Rows of the true detections of a state whose errors are tested."""
    if _limited(model, evidence, s):
        return np.empty(0, dtype=np.int64)
    of_state = evidence.instances.state[evidence.true_detections.instance] == s
    return np.flatnonzero(of_state & with_known_errors(model, evidence))


def _limited(model: DetectorModel, evidence: Evidence, s: int) -> str:
    """Why a state cannot be tested: too many of the most confident detections have boxes that came out large."""
    return unknown_rest_note(model, evidence) if model.states[s].confidence.size_slope else ""


def with_known_errors(model: DetectorModel, evidence: Evidence) -> Mask:
    """True detections that are one box of one vessel, chosen independently of their errors, shape (m,).

    Only boxes that come out wide enough are split, and the errors of split boxes are not known. The others alone would
    be too narrow on average, so as large a share of the narrow boxes of long vessels is left out.
    """
    found, rule = evidence.true_detections, model.merges_and_splits
    usable: Mask = found.kind == TRUE
    if not rule.splits:
        return usable
    truth = np.concatenate([seen.targets.boxes_px for seen in evidence.cameras])
    narrow = rule.looks_long(truth[found.instance]) & (sizes(found.boxes_px)[:, 0] < LEAST_SPLIT_PX)
    left_out = np.random.default_rng(0).random(len(narrow)) < rule.splits
    return usable & ~(narrow & left_out)


def _has_check(state: PerformanceState) -> bool:
    return model_name(ERROR_DISTRIBUTIONS, state.box_error.distribution) in LIKELIHOODS


def _is_singular(state: PerformanceState) -> bool:
    covariance, std = state.box_error.covariance, state.box_error.std
    return bool((std <= 0).any() or np.linalg.cond(covariance / np.outer(std, std)) > _CONDITION)


def _fit(state: PerformanceState, evidence: Evidence, rows: Indices, table: MomentTable) -> StateFit | None:
    if len(rows) < LEAST_DETECTIONS or _is_singular(state):
        return None
    law, found, instances = ErrorParameters.of(state.box_error), evidence.true_detections, evidence.instances
    sample = ErrorSample(found.errors_px[rows], found.instance[rows], instances.boxes_px, instances.image_px)
    step = fit_step(law, sample, table)
    return None if step is None else StateFit(law, fitted_law(law, step, sample), step, sample, rows)


def _state_checks(
    state: PerformanceState, evidence: Evidence, rows: Indices, fit: StateFit | None, replayed: Array | None
) -> list[Parameter]:
    """The parameters of a state's law; where errors persist, `replayed` are their standard errors, shape (p,)."""
    if _is_singular(state):
        return _exact_checks(state, evidence, rows)
    law = ErrorParameters.of(state.box_error)
    note = "" if fit is None else _truncation_note(fit.step)
    parameters = []
    for k, (name, asked) in enumerate(zip(law.names(), law.numbers(), strict=True)):
        measure = None if fit is None else _estimate(fit, k, replayed)
        few = measure is not None and replayed is not None and measure.count < LEAST_WORTH
        few |= fit is not None and name in law.likelihood.shape_names and fit.step.errors[k] > MOST_SHAPE_ERROR
        path, unit = f"states.{state.name}.box_error.{name}", "" if k >= 8 else "sides" if law.relative else "px"
        parameters.append(Parameter(path, Part.BOX_ERROR, None if few else measure, float(asked), unit, state.name))
    return [replace(parameters[0], note=note), *parameters[1:]]


def _estimate(fit: StateFit, k: int, replayed: Array | None) -> Estimate:
    """One of the law's numbers; replays say how many independent errors persistent ones are worth."""
    step = fit.step
    error = step.errors[k] if replayed is None else replayed[k]
    wider = error / step.errors[k]
    return Estimate(
        measured=float(fit.found.numbers()[k]),
        asked=float(fit.law.numbers()[k]),
        error=float(error * fit.law.units()[k]),
        count=len(fit.rows) / max(wider, 1.0) ** 2,
        skewness=float(step.skewness[k] * wider),
        statistic=float(step.step[k] / error),
        grows=4 <= k < 8,
        possible=AMOUNT if 4 <= k < 8 else CORRELATION if 8 <= k < PLAIN else ANY,
    )


def _truncation_note(step: FitStep) -> str:
    share = 1 - float(step.acceptance.mean())
    return f"{share:.0%} of first draws leave no box and are drawn anew: taken out" if share >= 0.005 else ""


def _exact_checks(state: PerformanceState, evidence: Evidence, rows: Indices) -> list[Parameter]:
    """Checks of a singular covariance: errors without spread must be their mean."""
    law = ErrorParameters(state.box_error.mean, np.zeros(4), np.eye(4), state.box_error.relative)
    found = evidence.true_detections
    means, _ = law.at(evidence.instances.boxes_px[found.instance[rows]])
    off = np.abs(found.errors_px[rows] - means) > _ROUNDING_PX
    still = (state.box_error.std <= 0) & (state.box_error.growth <= 0)
    parameters = []
    for k, entry in enumerate(ERROR_COMPONENTS):
        path = f"states.{state.name}.box_error.std[{entry}]"
        measure = Exact(int(off[:, k].sum()), len(rows)) if still[k] and len(rows) else None
        note = "" if still[k] else "the covariance is singular: only errors without any spread are looked at"
        parameters.append(Parameter(path, Part.BOX_ERROR, measure, 0.0, "px", state.name, note=note))
    return parameters


def _box_check(evidence: Evidence) -> Parameter:
    """Whether every box is its truth moved by its error and clipped to the image."""
    found, instances = evidence.true_detections, evidence.instances
    single = np.flatnonzero(found.kind == TRUE)
    rows = found.instance[single]
    moved = move(instances.boxes_px[rows], found.errors_px[single])
    off = np.abs(found.boxes_px[single] - clip(moved, instances.image_px[rows]))
    wrong = int((off.max(axis=1, initial=0) > _ROUNDING_PX).sum())
    return Parameter("boxes are truth and error, clipped", Part.BOX_ERROR, Exact(wrong, len(single)), in_file=False)
