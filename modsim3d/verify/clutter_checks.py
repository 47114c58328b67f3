"""False positives: how many, of which kind, and with which label."""

from __future__ import annotations

import numpy as np

from modsim3d.detector.merges_and_splits import MergesAndSplits
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.parts import Part
from modsim3d.detector.records import DUPLICATE, FALSE_POSITIVE, FRAGMENT, MERGED, PERSISTENT
from modsim3d.verify.clutter_box_checks import clutter_box_checks
from modsim3d.verify.clutter_rate_checks import RATE_CHECKS, ClutterEvidence, expected_clutter, second_box_candidates
from modsim3d.verify.evidence import Evidence
from modsim3d.verify.max_detections import frames_above_max, max_detections_note
from modsim3d.verify.measures import Exact
from modsim3d.verify.parameters import Parameter
from modsim3d.verify.rate_measures import Rate


def clutter_checks(model: DetectorModel, evidence: Evidence) -> list[Parameter]:
    """The rate of each state and of all, the kinds, and the labels of false positives."""
    note = max_detections_note(model, evidence)
    seen = ClutterEvidence(model, evidence, expected_clutter(model, evidence))
    check = RATE_CHECKS.get(model.clutter.model)
    parameters = []
    if model.gates.max_detections is not None:
        wrong = Exact(frames_above_max(model, evidence), len(evidence.frames.state))
        parameters.append(Parameter("gates.max_detections", Part.FALSE_POSITIVES, wrong))
    for s in range(len(model.states)):
        parameters += [] if check is None else [check.of_state(seen, s).unless(note)]
        parameters += _label_checks(model, evidence, s)
    parameters += [] if check is None else [overall.unless(note) for overall in check.overall(seen)]
    parameters += [] if note else _kind_checks(seen)
    return [*parameters, *clutter_box_checks(model, evidence, seen.expected.persistent)]


def _label_checks(model: DetectorModel, evidence: Evidence, s: int) -> list[Parameter]:
    """The labels of transient ones: a persistent one keeps its label, so only the others are independent."""
    state, clutter = model.states[s], evidence.false_detections
    if len(model.labels) < 2:
        return []
    found = clutter.label[(clutter.state == s) & (clutter.kind == FALSE_POSITIVE)]
    note = "of those that do not persist" if model.clutter.persistent_share else ""
    return [
        Parameter(
            f"states.{state.name}.false_positive_labels[{label}]",
            Part.FALSE_POSITIVES,
            Rate(int((found == i).sum()), len(found), float(state.false_positive_labels[i])) if len(found) else None,
            float(state.false_positive_labels[i]),
            state=state.name,
            note=note,
        )
        for i, label in enumerate(model.labels)
    ]


def _kind_checks(seen: ClutterEvidence) -> list[Parameter]:
    """Second boxes, merged boxes and the share of persistent ones."""
    return [*_second_box_checks(seen), _merge_check(seen), _persistent_share_check(seen)]


def _second_box_checks(seen: ClutterEvidence) -> list[Parameter]:
    rule, kinds = seen.model.merges_and_splits, seen.evidence.false_detections.kind
    if rule == MergesAndSplits() and not np.isin(kinds, (DUPLICATE, FRAGMENT)).any():
        return []
    single, long = second_box_candidates(seen.model, seen.evidence)
    parameters = []
    for name, kind, count in (("duplicates", DUPLICATE, len(single)), ("splits", FRAGMENT, int(long.sum()))):
        asked = float(getattr(rule, name))
        measure = Rate(int((kinds == kind).sum()), count, asked) if count else None
        parameters.append(Parameter(f"false_positives.{name}", Part.FALSE_POSITIVES, measure, asked))
    return parameters


def _merge_check(seen: ClutterEvidence) -> Parameter:
    name, merges, kinds = (
        "false_positives.merges",
        seen.model.merges_and_splits.merges,
        seen.evidence.true_detections.kind,
    )
    if merges == 0:
        return Parameter(name, Part.FALSE_POSITIVES, Exact(int((kinds == MERGED).sum()), len(kinds)))
    note = "which pairs could have been merged depends on others that were: only counted"
    return Parameter(name, Part.FALSE_POSITIVES, None, merges, note=note)


def _persistent_share_check(seen: ClutterEvidence) -> Parameter:
    name, share, kinds = (
        "false_positives.persistence.share",
        seen.model.clutter.persistent_share,
        seen.evidence.false_detections.kind,
    )
    persistent, transient = int((kinds == PERSISTENT).sum()), int((kinds == FALSE_POSITIVE).sum())
    if not share:
        return Parameter(name, Part.FALSE_POSITIVES, Exact(persistent, len(kinds)))
    if not persistent + transient:
        return Parameter(name, Part.FALSE_POSITIVES, None, share)
    expected = seen.expected
    variance = seen.persistent_variance(np.ones(len(expected.persistent), dtype=bool))
    # The variance of the number of persistent ones, and of the rest, over that of a binomial share of them.
    total = float(expected.persistent.sum()) + float(expected.transient.sum())
    spread = (1 - share) ** 2 * variance + share**2 * float(expected.transient.sum())
    factor = spread / max(total * share * (1 - share), 1e-12) if share < 1 else 1.0
    measure = Rate(persistent, persistent + transient, share, max(factor, 1.0))
    return Parameter(name, Part.FALSE_POSITIVES, measure, share)
