"""False positives: the false discovery rate and their labels."""

from __future__ import annotations

import numpy as np

from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import Indices
from modsim3d.learn.evidence import Evidence
from modsim3d.learn.measures import DiscoveryRate, Rate
from modsim3d.learn.parameters import Parameter

GROUP = "false positives"


def clutter_checks(model: DetectorModel, evidence: Evidence) -> list[Parameter]:
    """The false discovery rate of each state and of all, and the labels of false positives."""
    parameters, expected_in_all, promised_in_all = [], 0.0, 0.0
    thesis = model.false_positives == "thesis"
    for s, state in enumerate(model.states):
        kept = evidence.images.n_kept[evidence.images.state == s]
        found = evidence.clutter.label[evidence.clutter.state == s]
        rate = state.false_discovery_rate
        asked_mean = float(kept.sum()) * rate / (1 - rate)
        expected = float(thesis_trials(model, kept, rate).sum()) * rate if thesis else asked_mean
        inflation = 1 - rate if thesis else 1.0
        measure = DiscoveryRate(len(found), float(kept.sum()), expected, inflation) if kept.sum() else None
        parameters.append(
            Parameter(
                f"states.{state.name}.false_discovery_rate",
                GROUP,
                measure,
                rate,
                state=state.name,
                promised=rate if thesis else None,
                note="asked: what the rule of eq. 7.35 gives here" if thesis else "",
            )
        )
        parameters += _label_checks(model, s, found)
        expected_in_all += expected
        promised_in_all += asked_mean
    true, false = float(evidence.images.n_kept.sum()), float(evidence.images.n_false.sum())
    overall = DiscoveryRate(false, true, expected_in_all) if true else None
    promised = promised_in_all / (promised_in_all + true) if thesis and true else None
    parameters.append(Parameter("false discovery rate, all states", GROUP, overall, in_file=False, promised=promised))
    return parameters


def thesis_trials(model: DetectorModel, kept: Indices, rate: float) -> Indices:
    """Trials that the original rule makes in frames with so many detections (Jessen & Mohr (2023), eq. 7.35)."""
    trials = np.maximum(np.rint(rate * kept - model.confidence_threshold), 0)
    return np.asarray(trials, dtype=np.int64)


def _label_checks(model: DetectorModel, s: int, found: Indices) -> list[Parameter]:
    state = model.states[s]
    if len(model.labels) < 2:
        return []
    return [
        Parameter(
            f"states.{state.name}.false_positive_labels[{label}]",
            GROUP,
            Rate(int((found == i).sum()), len(found), float(state.false_positive_labels[i])) if len(found) else None,
            float(state.false_positive_labels[i]),
            state=state.name,
        )
        for i, label in enumerate(model.labels)
    ]
