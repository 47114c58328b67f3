"""Slopes of misses that states have for themselves, and a score behind misses and confidence, are learned again."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modsim3d.detector.classification import ConfusionClassifier
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.persistence import BoxMemory, LatentScore
from modsim3d.detector.target_statistics import TargetStatistics
from modsim3d.learn.bootstrap import resample
from modsim3d.learn.dropout_fit import EffectTerm, fit_misses
from modsim3d.learn.learned_detector import Estimates
from modsim3d.learn.match_types import NAMES
from modsim3d.learn.matches import Outcomes
from modsim3d.learn.misses import own_effects
from modsim3d.learn.self_check import simulated
from tests.detector.detector_builders import make_targets
from tests.learn.one_state import IOU, detected, detector, drawn_models, learned_from, learned_in, moored, observed_as

FRAMES, BOATS, STATES = 900, 3, ("clear", "fog")
SLOPES = {"clear": 0.004, "fog": 0.03}


def content(slopes: dict[str, float], anchor: str = "state_rate"):
    """A detector of two states whose misses follow the distance."""
    data = detector({"mean": 0.7, "std": 0.1})
    state = data["states"]["usual"] | {"confusion": [[0.6], [0.4]], "false_discovery_rate": 0.0}
    own = {name: {"distance_m": {"per_unit": slope, "reference": 200}} for name, slope in slopes.items()}
    chain = {"initial_state": "clear", "transition_matrix": [[0.5, 0.5], [0.5, 0.5]]}
    states = {name: state | {"dropout": own[name]} for name in slopes}
    return data | chain | {"dropout": {"model": "logistic", "anchor": anchor}, "states": states}


def observed_boats(slopes: dict[str, float], seed, without=frozenset(), far_m=400, anchor="state_rate") -> Outcomes:
    """A simulated run of 900 images, two thirds of them in clear air, of boats up to a distance."""
    rng = np.random.default_rng(seed)
    labelled = moored(FRAMES, BOATS, columns=BOATS, size_px=(1000.0, 800.0), top_px=300.0)
    depth_m = rng.uniform(50, far_m, len(labelled.annotations))
    labelled = replace(labelled, conditions=STATES, annotations=replace(labelled.annotations, depth_m=depth_m))
    state = (np.arange(FRAMES) >= FRAMES * 2 // 3).astype(np.int64)
    labelled = simulated(labelled, state, parse_detector(content(slopes, anchor)), seed)
    return observed_as(labelled, STATES, state, without=without)


def learned_again(slopes: dict[str, float], seed: int, without: frozenset[str] = frozenset()) -> Estimates:
    return learned_in(observed_boats(slopes, seed, without), replicates=60)


def test_slopes_that_differ_are_those_of_the_states_again_and_drawn_by_a_campaign(tmp_path) -> None:
    learned = learned_again(SLOPES, 3)
    intervals = {each.key.path: each for each in learned.intervals(0.99)}
    for name, slope in SLOPES.items():
        interval = intervals[f"states.{name}.dropout.distance_m.per_unit"]
        assert interval.low <= slope <= interval.high
        missed = intervals[f"states.{name}.confusion"]
        assert missed.low[-1, 0] <= 0.4 <= missed.high[-1, 0] and missed.high[-1, 0] - missed.low[-1, 0] < 0.2
    file = learned.detector()
    assert "distance_m" not in file["dropout"]
    own = {"distance_m", "intercept", "learned_log_odds"}
    assert [state["dropout"].keys() for state in file["states"].values()] == [own] * 2
    assert not parse_detector(file).needs_target_statistics
    assert any("states.NAME.dropout.distance_m: a slope for each state" in note for note in learned.notes)
    slopes = [model.dropout.own[1][0].log_odds for model in drawn_models(learned, tmp_path, 50)]
    assert 0 < np.std(slopes) < 0.01
    assert abs(np.mean(slopes) - learned.detector()["states"]["fog"]["dropout"]["distance_m"]["per_unit"]) < 0.004


def test_a_learned_detector_misses_as_much_as_the_true_one_in_a_scene_of_other_distances() -> None:
    learned = learned_in(observed_boats(SLOPES, 5, far_m=280, anchor="none"), replicates=60)
    far = observed_boats(SLOPES, 6, anchor="none")
    annotations = far.labelled.annotations
    targets = replace(make_targets(annotations.boxes_px[:, None], [0]), depth_m=annotations.depth_m)
    rates = [
        ConfusionClassifier.from_model(model, TargetStatistics()).miss_rates(far.state, targets)
        for model in (parse_detector(content(SLOPES, "none")), parse_detector(learned.detector()))
    ]
    for state, name in enumerate(STATES):
        true, again = (each[far.state == state].mean() for each in rates)
        mean_of_learning = learned.detector()["states"][name]["confusion"][-1][0]
        assert mean_of_learning < true - 0.06  # near boats were found more often
        assert again == pytest.approx(true, abs=0.05)


def test_slopes_that_do_not_differ_are_one_and_without_effects_there_are_none() -> None:
    same = learned_again(dict.fromkeys(STATES, 0.01), 4)
    assert same.detector()["dropout"].keys() == {"model", "distance_m"}
    assert not any("distance_m" in state["dropout"] for state in same.detector()["states"].values())
    assert any("states.NAME.dropout.distance_m: the same in all states" in note for note in same.notes)
    without = learned_again(SLOPES, 3, frozenset({"effects"})).detector()
    assert "dropout" not in without and not any("dropout" in state for state in without["states"].values())


def test_misses_that_persist_count_for_fewer() -> None:
    observed, effects = observed_boats(SLOPES, 3), (EffectTerm("distance_m", 200.0),)
    fit = fit_misses(observed, effects, resample(observed.labelled.images, 0, 0))
    found = [own_effects(observed, effects, fit, {"distance_m": inflation}, [])[0] for inflation in (1.0, 100.0)]
    assert [effect.state for effect in found[0]] == [0, 1] and found[1] == effects


APART_S = np.array([0.5, 1, 2, 4, 8, 16])
MISS_RATE = 0.3
ASKED = {"vessel_share": 0.3, "shares": [0.2, 0.4], "times_s": [1.0, 6.0]}
PLAIN = frozenset({"relative", "mixed", "student_t", *NAMES})
"""Of boxes alone: misses and confidences are learned without them."""


def scored_again(persistence: dict[str, Any], seed: int, without: frozenset[str] = frozenset(),
                 confusion: tuple[tuple[float, ...], ...] = ((1 - MISS_RATE,), (MISS_RATE,))) -> Estimates:  # fmt: skip
    names = ("boat", "ship")[: len(confusion[0])]
    labelled = moored(500, 40, columns=8, size_px=(2200.0, 1600.0))
    label = labelled.annotations.identity % len(names)
    labelled = replace(labelled, labels=names, annotations=replace(labelled.annotations, label=label))
    data = detector({"mean": 0.6, "std": 0.15}) | {"persistence": persistence, "labels": list(names)}
    usual = {"confusion": [list(row) for row in confusion], "false_discovery_rate": 0.05}
    data["states"]["usual"] |= usual | {"false_positive_labels": [1 / len(names)] * len(names)}
    return learned_from(detected(labelled, data, seed), IOU, without | PLAIN, replicates=40)


def test_the_memory_of_a_score_is_learned_again_and_drawn_by_a_campaign(tmp_path) -> None:
    scored = scored_again({"score": ASKED}, 1)
    model = parse_detector(scored.detector())
    score = model.persistence.score
    assert score is not None and model.persistence.confidence_s == model.persistence.class_s == 0
    asked = LatentScore(0.3, (0.2, 0.4), (1.0, 6.0))
    assert np.abs(score.correlation(APART_S) - asked.correlation(APART_S)).max() < 0.08
    intervals = {each.key.path: each for each in scored.intervals(0.99)}
    kept = intervals["persistence.score.vessel_share"]
    assert kept.low <= 0.3 <= kept.high < 0.6
    assert intervals["states.usual.confusion"].high[-1, 0] > MISS_RATE > intervals["states.usual.confusion"].low[-1, 0]
    shares = [model.persistence.score.vessel_share for model in drawn_models(scored, tmp_path, 40)]
    assert 0.02 < np.std(shares) < 0.2


def test_labels_that_persist_do_so_beside_a_score() -> None:
    two = ((0.5, 0.2), (0.2, 0.5), (0.3, 0.3))
    scored = scored_again({"score": ASKED, "class_s": 5.0}, 3, confusion=two)
    persistence = parse_detector(scored.detector()).persistence
    assert persistence.score is not None and persistence.class_s == pytest.approx(5, rel=0.3)
    assert parse_detector(scored_again({"score": ASKED}, 3, confusion=two).detector()).persistence.class_s == 0


def test_misses_and_confidences_that_are_drawn_apart_have_no_score_and_it_can_be_left_out() -> None:
    apart = scored_again({"class_s": 2.0, "confidence_s": 2.0}, 2)
    persistence = parse_detector(apart.detector()).persistence
    assert persistence.score is None and persistence.class_s == pytest.approx(2, rel=0.2)
    assert persistence.confidence_s == pytest.approx(2, rel=0.2)
    assert any(note.startswith("persistence.score: none; detections before a miss") for note in apart.notes)
    left_out = parse_detector(scored_again({"score": ASKED}, 1, frozenset({"score"})).detector()).persistence
    assert left_out.score is None and left_out.class_s > 0 and left_out.confidence_s > 0


HEAVY = {"unit": "px", "law": "student_t", "degrees_of_freedom": 5}
ERRORS = {**HEAVY, "mean": [0, 1, 0, 0], "covariance": np.diag([4.0, 3.0, 6.0, 3.0]).tolist()}
SHARES = [[0.5, 0.05, 0.4, 0.3, 0.2], [0.1, 0.4, 0.1, 0.4, 0.4]]
MEMORY = {"vessel_share": [0.05, 0.45, 0.1, 0.2, 0.2], "shares": SHARES, "times_s": [0.6, 5.0]}


def errors_learned_again(persistence: dict[str, Any], seed: int, boats: int = 60) -> Estimates:
    data = detector({"mean": 0.6, "std": 0.15}, persistence=persistence)
    data["states"]["usual"] |= {"false_discovery_rate": 0.02, "box_error": ERRORS}
    labelled = moored(400, boats, columns=10, size_px=(2700.0, 1800.0), side_px=80.0)
    return learned_from(detected(labelled, data, seed), IOU, ("relative", "mixed", *NAMES), replicates=40)


def test_the_memory_of_each_component_is_learned_again_and_one_time_of_those_that_last_alike(tmp_path: Path) -> None:
    learned = errors_learned_again({"box": MEMORY}, 1)
    memory = parse_detector(learned.detector()).persistence.box
    assert memory is not None
    asked = BoxMemory(np.array(MEMORY["vessel_share"]), np.array(MEMORY["shares"]), np.array(MEMORY["times_s"]))
    off = np.abs(memory.correlation(APART_S) - asked.correlation(APART_S))
    assert off[:, :4].max() < 0.09
    assert off[:, 4].max() < 0.15  # of how large errors are, which is seen through those that are large
    kept = {each.key.path: each for each in learned.intervals(0.99)}["persistence.box.vessel_share"]
    assert np.all(kept.low <= asked.vessel_share) and np.all(asked.vessel_share <= kept.high)
    drawn = [model.persistence.box.vessel_share[1] for model in drawn_models(learned, tmp_path, 40)]
    assert 0.02 < np.std(drawn) < 0.2  # by a campaign
    alike = parse_detector(errors_learned_again({"box_s": 2.0}, 2, boats=20).detector()).persistence
    assert alike.box is None and alike.box_s == pytest.approx(2.0, rel=0.25)
