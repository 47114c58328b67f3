"""Box errors: mean, standard deviations and correlations of each state, and whether they persist."""

from __future__ import annotations

import numpy as np

from modsim3d.detector.boxes import clip, move
from modsim3d.detector.model import ERROR_COMPONENTS, DetectorModel
from modsim3d.detector.records import Array, Indices
from modsim3d.learn.class_checks import lag_correlation
from modsim3d.learn.error_fit import PAIRS, ErrorFit, ErrorSample, MomentTable, NormalLaw, fit_step, fitted_law
from modsim3d.learn.evidence import Evidence
from modsim3d.learn.measures import Estimate, Exact
from modsim3d.learn.parameters import Parameter

GROUP = "box error"
LEAST_DETECTIONS = 150
"""True detections in a state, below which its box errors are not tested."""
_ROUNDING_PX = 1e-6


def box_error_checks(model: DetectorModel, evidence: Evidence, table: MomentTable) -> list[Parameter]:
    """Fourteen parameters for each state; the boxes themselves; correlation from frame to frame."""
    chances, hits = evidence.chances, evidence.hits
    state_of_hits = chances.state[hits.chance]
    residuals, variances = np.zeros((len(hits.chance), 4)), np.zeros((len(hits.chance), 4))
    parameters = []
    for s, state in enumerate(model.states):
        rows = np.flatnonzero(state_of_hits == s)
        covariance = np.array(state.box_error_covariance_px2)
        free = np.diag(covariance) > 0
        if not free.all() or np.linalg.cond(covariance / np.outer(*[np.sqrt(np.diag(covariance))] * 2)) > 1e8:
            parameters += _exact_checks(state.name, state.box_error_mean_px, free, hits.errors_px[rows])
            continue
        law = NormalLaw.of(state.box_error_mean_px, covariance)
        fit = None
        if len(rows) >= LEAST_DETECTIONS:
            fit = _fit(law, evidence, rows, table)
        if fit is not None:
            residuals[rows], variances[rows] = fit[0].residuals, fit[0].variances
        parameters += _law_checks(state.name, law, fit, len(rows))
    return [*parameters, _box_check(evidence), *_persistence_checks(evidence, residuals, variances)]


def _fit(law: NormalLaw, evidence: Evidence, rows: Indices, table: MomentTable) -> tuple[ErrorFit, NormalLaw] | None:
    hits, chances = evidence.hits, evidence.chances
    sample = ErrorSample(hits.errors_px[rows], hits.chance[rows], chances.boxes_px, chances.image_px)
    fit = fit_step(law, sample, table)
    return None if fit is None else (fit, fitted_law(law, fit, sample))


def _law_checks(name: str, law: NormalLaw, fit: tuple[ErrorFit, NormalLaw] | None, count: int) -> list[Parameter]:
    names = [f"mean[{c}]" for c in ERROR_COMPONENTS] + [f"std[{c}]" for c in ERROR_COMPONENTS]
    names += [f"correlation[{ERROR_COMPONENTS[i]},{ERROR_COMPONENTS[j]}]" for i, j in PAIRS]
    asked = law.numbers()
    units = np.concatenate([law.std, law.std, np.ones(6)])
    parameters = []
    for k, entry in enumerate(names):
        measure = None
        if fit is not None:
            step, found = fit
            error = np.sqrt(step.covariance[k, k])
            measure = Estimate(
                measured=float(found.numbers()[k]),
                asked=float(asked[k]),
                error=float(error * units[k]),
                count=count,
                skewness=float(step.skewness[k]),
                statistic=float(step.step[k] / error),
                grows=4 <= k < 8,
            )
        path = f"states.{name}.box_error.{entry}"
        note = _truncation_note(fit[0]) if fit is not None and k == 0 else ""
        unit = "px" if k < 8 else ""
        parameters.append(Parameter(path, GROUP, measure, float(asked[k]), unit, name, note=note))
    return parameters


def _truncation_note(fit: ErrorFit) -> str:
    share = 1 - float(fit.acceptance.mean())
    return f"{share:.0%} of first draws leave no box and are drawn anew: taken out" if share >= 0.005 else ""


def _exact_checks(name: str, mean: Array, free: np.ndarray, errors_px: Array) -> list[Parameter]:
    """Of a covariance without an inverse: errors that have no spread are their mean."""
    parameters = []
    for k, entry in enumerate(ERROR_COMPONENTS):
        path = f"states.{name}.box_error.std[{entry}]"
        wrong = int((np.abs(errors_px[:, k] - mean[k]) > _ROUNDING_PX).sum())
        measure = None if free[k] or not len(errors_px) else Exact(wrong, len(errors_px))
        note = "" if measure else "the covariance is singular: only errors without any spread are looked at"
        parameters.append(Parameter(path, GROUP, measure, 0.0, "px", name, note=note))
    return parameters


def _box_check(evidence: Evidence) -> Parameter:
    """Whether every box is its truth moved by its error and clipped to the image."""
    hits, chances = evidence.hits, evidence.chances
    truth, images = chances.boxes_px[hits.chance], chances.image_px[hits.chance]
    wrong = 0
    for image in np.unique(images, axis=0):
        rows = np.flatnonzero((images == image).all(axis=1))
        width, height = (int(side) for side in image)
        expected = clip(move(truth[rows], hits.errors_px[rows]), (width, height))
        wrong += int((np.abs(hits.boxes_px[rows] - expected).max(axis=1) > _ROUNDING_PX).sum())
    return Parameter("boxes are truth and error, clipped", GROUP, Exact(wrong, len(truth)), in_file=False)


def _persistence_checks(evidence: Evidence, residuals: Array, variances: Array) -> list[Parameter]:
    chances = evidence.hits.chance
    hit_of = np.full(len(evidence.chances.state), -1)
    hit_of[chances] = np.arange(len(chances))
    before = evidence.chances.before[chances]
    before = np.where(before >= 0, hit_of[before], -1)
    return [
        Parameter(
            f"{name}, correlation from frame to frame",
            GROUP,
            lag_correlation(residuals[:, k], np.maximum(variances[:, k], 0), before),
            0.0,
            in_file=False,
        )
        for k, name in enumerate(ERROR_COMPONENTS)
    ]
