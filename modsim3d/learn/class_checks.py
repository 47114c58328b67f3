"""Dropout and class: the columns of the confusion matrix, and whether misses persist."""

from __future__ import annotations

import numpy as np

from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import Array
from modsim3d.learn.evidence import Evidence
from modsim3d.learn.measures import Estimate, Rate
from modsim3d.learn.parameters import Parameter

GROUP = "dropout and class"
BACKGROUND = "background"
LEAST_CHANCES = 30
"""Chances to see a label in a state, below which its column is not tested."""


def class_checks(model: DetectorModel, evidence: Evidence) -> list[Parameter]:
    """Every entry of every state's confusion matrix that is free: of a column with two entries only the dropout."""
    chances = evidence.chances
    parameters = []
    for s, state in enumerate(model.states):
        for column, label in enumerate(model.labels):
            outcomes = chances.outcome[(chances.state == s) & (chances.label == column)]
            names = [*model.labels, BACKGROUND]
            tested = range(len(names)) if len(names) > 2 else [len(names) - 1]
            for row in tested:
                asked = float(state.confusion[row, column])
                hits = int((outcomes == (row if row < len(model.labels) else -1)).sum())
                measure = Rate(hits, len(outcomes), asked) if len(outcomes) >= LEAST_CHANCES else None
                name = f"states.{state.name}.confusion[{names[row]}][{label}]"
                parameters.append(Parameter(name, GROUP, measure, asked, state=state.name))
    return [*parameters, *overall_checks(model, evidence)]


def miss_probabilities(model: DetectorModel, evidence: Evidence) -> Array:
    """Asked probability that each chance is missed, shape (n,)."""
    chances = evidence.chances
    missed: Array = model.column("confusion")[chances.state, -1, chances.label]
    return missed


def overall_checks(model: DetectorModel, evidence: Evidence) -> list[Parameter]:
    """Dropout of all states together, and whether a miss says anything about the next frame."""
    missed = (evidence.chances.outcome < 0).astype(np.float64)
    asked = miss_probabilities(model, evidence)
    spread = asked * (1 - asked)
    overall = None
    if spread.sum() > 0:
        variance = float(spread.sum())
        skewness = float((spread * (1 - 2 * asked)).sum()) / variance**1.5
        size = len(missed)
        overall = Estimate(float(missed.mean()), float(asked.mean()), variance**0.5 / size, size, skewness)
    persistence = lag_correlation(missed - asked, spread, evidence.chances.before)
    return [
        Parameter("dropout, all states", GROUP, overall, in_file=False),
        Parameter("misses, correlation from frame to frame", GROUP, persistence, 0.0, in_file=False),
    ]


LEAST_PAIRS = 100


def lag_correlation(residuals: Array, variances: Array, before: np.ndarray) -> Estimate | None:
    """Correlation of numbers that have mean zero and are independent as asked, with those one frame before.

    Args:
        residuals: Shape (n,).
        variances: As asked, shape (n,).
        before: Row of the one before, −1 if there is none, shape (n,).
    """
    now = np.flatnonzero((before >= 0) & (variances > 0))
    now = now[variances[before[now]] > 0]
    if len(now) < LEAST_PAIRS:
        return None
    earlier = before[now]
    scaled = residuals / np.sqrt(np.where(variances > 0, variances, 1))
    # A rate that is off would look like a correlation: the mean is taken out as it was found.
    scaled = scaled - scaled[variances > 0].mean()
    products = scaled[now] * scaled[earlier]
    return Estimate(float(products.mean()), 0.0, 1 / len(now) ** 0.5, len(now))
