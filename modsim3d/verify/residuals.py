"""What is left of each random draw of a run once its law is taken away: numbers that nothing in the file ties together.

Whatever a detector file says, the draws of two vessels, of two cameras and of two distant times are independent of each
other, given the performance states and, where they persist, their own past.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Indices
from modsim3d.detector.confidence import SCORES
from modsim3d.detector.confidence_levels import LEVELS, drawn_levels
from modsim3d.detector.draws import poisson_quantile
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.parts import model_name
from modsim3d.detector.records import FALSE_POSITIVE
from modsim3d.verify.class_checks import expected_outcomes
from modsim3d.verify.clutter_checks import RATE_CHECKS, expected_clutter
from modsim3d.verify.confidence_checks import scored
from modsim3d.verify.error_fit import StateFit
from modsim3d.verify.evidence import Evidence, unknown_rest_note

NO_VESSEL = -1
_LEAST_OF_STATE = 30
"""Rows of a state with fewer are left out: they cannot show the state's own mean and spread."""
_LEAST_LEVEL = 1e-12
_MANY, _NO_CAP = 10.0, 1 << 30
_CAP = 0.9
"""Level at which small Poisson numbers are capped: products of rare large ones have no nearly normal sum."""


class Draw(StrEnum):
    """What was drawn."""

    BOX_ERROR = "box errors"
    MISS = "misses"
    CONFIDENCE = "confidence"
    FALSE_POSITIVES = "false positives"


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of one kind of draw; n rows, of c numbers each.

    Attributes:
        image: Row of `FrameTable`, shape (n,).
        vessel: `NO_VESSEL` for a false positive, 0 for a number of false positives, shape (n,).
        values: Less their expectation, shape (n, c).
        variance: Of each number of a row, shape (n,).
        third: Third central moments, shape (n, c).
        correlation_s: Time in which a vessel's correlation falls to 1/e; 0 for independent draws.
        continuous: Whether squares of the values say anything that the values do not.
        note: Why there are none; empty if there are.
    """

    draw: Draw
    image: Indices
    vessel: Indices
    values: Array
    variance: Array
    third: Array
    correlation_s: float = 0.0
    continuous: bool = False
    note: str = ""

    def of_vessels(self) -> Residuals:
        """The rows that belong to a vessel."""
        rows = np.flatnonzero(self.vessel != NO_VESSEL)
        names = ("image", "vessel", "values", "variance", "third")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})


def none_of(draw: Draw, note: str) -> Residuals:
    """No residuals, and why."""
    nobody, nothing = np.empty(0, dtype=np.int64), np.empty((0, 1))
    return Residuals(draw, nobody, nobody, nothing, np.empty(0), nothing, note=note)


def residuals_of(model: DetectorModel, evidence: Evidence, fits: Sequence[StateFit]) -> list[Residuals]:
    """The residuals of every kind of draw, given the fits of box errors."""
    return [
        box_error_residuals(model, evidence, fits),
        miss_residuals(model, evidence),
        confidence_residuals(model, evidence),
        clutter_residuals(model, evidence),
    ]


def box_error_residuals(model: DetectorModel, evidence: Evidence, fits: Sequence[StateFit]) -> Residuals:
    """Whitened box errors, four of each detection that is one box of one vessel."""
    if not fits:
        return none_of(Draw.BOX_ERROR, "")
    instance = evidence.true_detections.instance[np.concatenate([fit.rows for fit in fits])]
    values = np.concatenate([fit.step.whitened for fit in fits])
    return _standardised(
        Draw.BOX_ERROR,
        evidence,
        evidence.images_of(instance),
        evidence.instances.vessel[instance],
        values,
        model.persistence.box_memory_s,
    )


def miss_residuals(model: DetectorModel, evidence: Evidence) -> Residuals:
    """Whether a vessel was missed less its probability, of each chance that could have gone either way."""
    note = unknown_rest_note(model, evidence)
    if note:
        return none_of(Draw.MISS, note)
    expected, instances = expected_outcomes(model, evidence), evidence.instances
    rows = np.flatnonzero(expected.passed & (expected.missed > 0) & (expected.missed < 1))
    p = expected.missed[rows]
    variance = p * (1 - p)
    values = _centred((instances.outcome[rows] == -1) - p, variance, instances.state[rows])
    return Residuals(
        Draw.MISS,
        evidence.images_of(rows),
        instances.vessel[rows],
        values[:, None],
        variance,
        (variance * (1 - 2 * p))[:, None],
        model.persistence.class_memory_s,
    )


def clutter_residuals(model: DetectorModel, evidence: Evidence) -> Residuals:
    """Number of transient false positives of each image, small numbers capped, less its expectation."""
    note = unknown_rest_note(model, evidence)
    if note or model.clutter.model not in RATE_CHECKS:
        return none_of(Draw.FALSE_POSITIVES, note)
    expected, images = expected_clutter(model, evidence), evidence.frames
    rows = np.flatnonzero(expected.transient > 0)
    mean, dispersion = expected.transient[rows], expected.dispersion[rows]
    poisson = (dispersion == 1) & (mean < _MANY)
    found, cap = n_transient(evidence)[rows], np.full(len(rows), _NO_CAP)
    cap[poisson] = np.maximum(poisson_quantile(np.full(int(poisson.sum()), _CAP), mean[poisson]), 1)
    variance = mean * dispersion
    third = variance * (2 * dispersion - 1)
    mean[poisson], variance[poisson], third[poisson] = capped_poisson(mean[poisson], cap[poisson])
    values = _centred(np.minimum(found, cap) - mean, variance, images.state[rows])
    return Residuals(
        Draw.FALSE_POSITIVES, rows, np.zeros(len(rows), dtype=np.int64), values[:, None], variance, third[:, None]
    )


def capped_poisson(means: Array, caps: Indices) -> tuple[Array, Array, Array]:
    """Mean, variance and third central moment of Poisson numbers cut down to caps of 1 or more, shapes (n,)."""
    counts = np.arange(int(caps.max(initial=0)) + 1)
    chances = np.where(counts < caps[:, None], special.pdtr(counts, means[:, None]), 1.0)
    chances = np.diff(chances, axis=1, prepend=0.0)
    mean: Array = chances @ counts.astype(np.float64)
    rest = counts - mean[:, None]
    return mean, (chances * rest**2).sum(axis=1), (chances * rest**3).sum(axis=1)


def n_transient(evidence: Evidence) -> Indices:
    """Number of false positives of each image that are no second boxes and do not persist, shape (s,)."""
    false = evidence.false_detections
    transient = false.frame_row[false.kind == FALSE_POSITIVE]
    return np.bincount(transient, minlength=len(evidence.frames.state))


def confidence_residuals(model: DetectorModel, evidence: Evidence) -> Residuals:
    """Normal numbers at the levels that confidences have in their laws; at the ends of the range they are drawn."""
    note = unknown_rest_note(model, evidence)
    if note:
        return none_of(Draw.CONFIDENCE, note)
    rng, true, false = np.random.default_rng(0), evidence.true_detections, evidence.false_detections
    parts: list[tuple[Indices, Indices, Array]] = []
    for s, state in enumerate(model.states):
        law = state.confidence
        instance = true.instance[evidence.instances.state[true.instance] == s]
        row = false.frame_row[false.state == s]
        places = (
            (evidence.images_of(instance), evidence.instances.vessel[instance]),
            (row, np.full(len(row), NO_VESSEL)),
        )
        for scores, found, place in zip((law.true, law.false), scored(evidence, s, law), places, strict=True):
            check = LEVELS.get(model_name(SCORES, scores))
            shift = -law.visibility_slope * found.hidden - law.size_slope * found.halvings
            levels = None if check is None else check(scores, found.scores, shift)
            if levels is not None:
                level = drawn_levels(levels, found.scores, model.confidence_threshold, rng)
                parts.append((*place, special.ndtri(np.clip(level, _LEAST_LEVEL, 1 - _LEAST_LEVEL))))
    if not parts:
        return none_of(Draw.CONFIDENCE, "")
    image, vessel, values = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    kept_s = model.persistence.confidence_s
    return _standardised(Draw.CONFIDENCE, evidence, image, vessel, values[:, None], kept_s)


def _standardised(
    draw: Draw, evidence: Evidence, image: Indices, vessel: Indices, values: Array, correlation_s: float
) -> Residuals:
    """Residuals with mean zero and variance one in each state: a state's wrong mean must not look like a pattern."""
    state = evidence.frames.state[image]
    scaled, kept = np.zeros_like(values), np.zeros(len(values), dtype=bool)
    for s in np.unique(state):
        rows = np.flatnonzero(state == s)
        spread = values[rows].std(axis=0)
        if len(rows) >= _LEAST_OF_STATE and (spread > 0).all():
            scaled[rows], kept[rows] = (values[rows] - values[rows].mean(axis=0)) / spread, True
    if not kept.any():
        return none_of(draw, "")
    scaled = scaled[kept]
    third = np.tile((scaled**3).mean(axis=0), (len(scaled), 1))
    return Residuals(draw, image[kept], vessel[kept], scaled, np.ones(len(scaled)), third, correlation_s, True)


def _centred(values: Array, variance: Array, state: Indices) -> Array:
    """Values less what a wrong rate of their state explains, shapes (n,)."""
    weight = np.bincount(state, variance)
    slope = np.bincount(state, values) / np.where(weight > 0, weight, 1)
    centred: Array = values - slope[state] * variance
    return centred
