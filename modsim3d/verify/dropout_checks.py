"""Checks of dropout's effects: slopes and tables of visible fraction, size and distance."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from modsim3d.arrays import Array, Mask
from modsim3d.detector.draws import log2
from modsim3d.detector.dropout import ATTRIBUTES, EFFECTS, Slope, Table
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.parts import Part, model_name
from modsim3d.verify.evidence import Evidence
from modsim3d.verify.measures import Estimate
from modsim3d.verify.pairs import lag_pairs
from modsim3d.verify.parameters import Parameter

LEAST_MISSES = 30


def dropout_checks(model: DetectorModel, evidence: Evidence, passed: Mask, missed: Array) -> list[Parameter]:
    """Each slope, and each range of each table, with the rates of all states and labels free.

    Args:
        model: The detector file.
        evidence: The truth and the detections of the run.
        passed: Instances that the gates let pass, shape (n,).
        missed: Asked probability of a miss, shape (n,).
    """
    parameters = []
    for effect in model.dropout.effects:
        check = EFFECT_CHECKS.get(model_name(EFFECTS, effect))
        if check is None:
            continue
        values = np.concatenate([ATTRIBUTES[effect.attribute](seen.targets) for seen in evidence.cameras])
        for name, asked, column in check(effect, values):
            measure = _effect(model, evidence, passed, missed, column, asked)
            parameters.append(Parameter(f"dropout.{effect.attribute}.{name}", Part.CLASS, measure, asked))
    return parameters


Column = tuple[str, float, Array]
"""Name and asked value of a number of an effect, and the derivative of the log-odds by it at each chance."""


def _slope_columns(effect: Slope, values: Array) -> list[Column]:
    filled = np.where(np.isnan(values), effect.reference, values)
    amount = log2(filled / effect.reference) if effect.doublings else filled - effect.reference
    return [("per_doubling" if effect.doublings else "per_unit", effect.log_odds, amount)]


def _table_columns(effect: Table, values: Array) -> list[Column]:
    known, place = ~np.isnan(values), np.searchsorted(effect.edges, values, side="right")
    return [(f"odds[{k}]", odds, np.where(known & (place == k), 1 / odds, 0.0)) for k, odds in enumerate(effect.odds)]


EFFECT_CHECKS: Mapping[str, Callable[..., list[Column]]] = {"logistic": _slope_columns, "table": _table_columns}
"""From an effect and the attribute of each chance, by the name of the effect's model."""


def _effect(
    model: DetectorModel,
    evidence: Evidence,
    passed: Mask,
    missed: Array,
    column: Array,
    asked: float,
) -> Estimate | None:
    """One step of a logistic regression from the asked probabilities, with an intercept for each state and label."""
    instances = evidence.instances
    rows = np.flatnonzero(passed & (missed > 0) & (missed < 1))
    p = missed[rows]
    happened = instances.outcome[rows] == -1
    if happened.sum() < LEAST_MISSES:
        return None
    spread, amount = p * (1 - p), column[rows]
    group = instances.state[rows] * len(model.labels) + instances.label[rows]
    weight = np.bincount(group, spread)
    mean = np.bincount(group, spread * amount) / np.where(weight > 0, weight, 1)
    free = amount - mean[group]  # what no change of the states' rates could explain
    information = float((spread * free**2).sum())
    if information < 1e-9 * max(float((spread * amount**2).sum()), 1e-300):
        return None
    variance = information
    if model.persistence.class_s > 0:
        tracks = np.stack([instances.camera[rows], instances.vessel[rows]], axis=1)
        for later, earlier, apart in lag_pairs(tracks, instances.time_s[rows], model.persistence.class_s):
            kept = np.minimum(p[later], p[earlier]) - p[later] * p[earlier]
            shared = np.exp(-apart / model.persistence.class_s) * kept * free[later] * free[earlier]
            variance += 2 * float(shared.sum())
    step = float(((happened - p) * free).sum()) / information
    error = max(variance, 0.1 * information) ** 0.5 / information
    skewness = float((spread * (1 - 2 * p) * free**3).sum()) / information**1.5
    return Estimate(asked + step, asked, error, len(rows) * information / variance, skewness)
