"""Slopes of misses that states have for themselves, and a score behind misses and confidence, are learned again."""

import dataclasses
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from modsim3d.campaign.drawn_detectors import LearnedUncertainty, drawn_detector
from modsim3d.detector.classification import ConfusionClassifier
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.persistence import LatentScore
from modsim3d.detector.target_statistics import TargetStatistics
from modsim3d.learn.bootstrap import resample
from modsim3d.learn.dropout_fit import EffectTerm, fit_misses
from modsim3d.learn.learned import Learned, uncertainty_text
from modsim3d.learn.matches import Observed
from modsim3d.learn.misses import own_effects
from modsim3d.learn.simulated_results import simulated
from modsim3d.scene.settings import choose_detector
from tests.detector.detector_builders import make_targets
from tests.formats.labelled_sets import images, truth
from tests.learn.one_state import detected, learned_in, observed_as, observed_in, of_boats
from tests.learn.scored_sets import detector

FRAMES, BOATS, STATES = 900, 3, ("clear", "fog")
SLOPES = {"clear": 0.004, "fog": 0.03}


def content(slopes: dict[str, float], anchor: str = "state_rate"):
    """A detector of two states whose misses follow the distance."""
    data = detector({"mean": 0.7, "std": 0.1})
    state = data["states"]["usual"] | {"confusion": [[0.6], [0.4]], "false_discovery_rate": 0.0}
    own = {name: {"distance_m": {"per_unit": slope, "reference": 200}} for name, slope in slopes.items()}
    return data | {
        "initial_state": "clear",
        "transition_matrix": [[0.5, 0.5], [0.5, 0.5]],
        "dropout": {"model": "logistic", "anchor": anchor},
        "states": {name: state | {"dropout": own[name]} for name in slopes},
    }


def observed_boats(slopes: dict[str, float], seed, without=frozenset(), far_m=400, anchor="state_rate") -> Observed:
    """A simulated run of 900 images, two thirds of them in clear air, of boats up to a distance."""
    rng = np.random.default_rng(seed)
    image, boat = np.repeat(np.arange(FRAMES), BOATS), np.tile(np.arange(BOATS), FRAMES)
    corner = np.column_stack([100 + 250.0 * boat, np.full(len(boat), 300.0)])
    annotations = truth(image, 0 * image, np.hstack([corner, corner + 60]), identity=boat)
    annotations = dataclasses.replace(annotations, depth_m=rng.uniform(50, far_m, len(image)))
    labelled = of_boats(images(FRAMES, (1000.0, 800.0), np.arange(FRAMES) / 2.0), annotations)
    labelled = dataclasses.replace(labelled, conditions=STATES)
    state = (np.arange(FRAMES) >= FRAMES * 2 // 3).astype(np.int64)
    labelled = simulated(labelled, state, parse_detector(content(slopes, anchor)), seed)
    return observed_as(labelled, STATES, state, without=without)


def learned_again(slopes: dict[str, float], seed: int, without: frozenset[str] = frozenset()) -> Learned:
    return learned_in(observed_boats(slopes, seed, without), replicates=60)


@pytest.fixture(scope="module")
def learned() -> Learned:
    return learned_again(SLOPES, 3)


def test_slopes_that_differ_are_those_of_the_states_again(learned) -> None:
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


def test_a_learned_detector_misses_as_much_as_the_true_one_in_a_scene_of_other_distances() -> None:
    near = observed_boats(SLOPES, 5, far_m=280, anchor="none")
    learned = learned_in(near, replicates=60)
    far = observed_boats(SLOPES, 6, anchor="none")
    annotations = far.labelled.annotations
    targets = dataclasses.replace(make_targets(annotations.boxes_px[:, None], [0]), depth_m=annotations.depth_m)
    rates = [
        ConfusionClassifier.from_model(model, TargetStatistics()).miss_rates(far.state, targets)
        for model in (parse_detector(content(SLOPES, "none")), parse_detector(learned.detector()))
    ]
    for state, name in enumerate(STATES):
        true, again = (each[far.state == state].mean() for each in rates)
        mean_of_learning = learned.detector()["states"][name]["confusion"][-1][0]
        assert mean_of_learning < true - 0.06  # near boats were found more often
        assert again == pytest.approx(true, abs=0.05)


def test_slopes_that_do_not_differ_are_one() -> None:
    same = learned_again(dict.fromkeys(STATES, 0.01), 4)
    assert same.detector()["dropout"].keys() == {"model", "distance_m"}
    assert not any("distance_m" in state["dropout"] for state in same.detector()["states"].values())
    assert any("states.NAME.dropout.distance_m: the same in all states" in note for note in same.notes)


def test_misses_that_persist_count_for_fewer() -> None:
    observed, effects = observed_boats(SLOPES, 3), (EffectTerm("distance_m", 200.0),)
    fit = fit_misses(observed, effects, resample(observed.labelled.images, 0, 0))
    found = [own_effects(observed, effects, fit, {"distance_m": inflation}, [])[0] for inflation in (1.0, 100.0)]
    assert [effect.state for effect in found[0]] == [0, 1] and found[1] == effects


def test_without_effects_no_state_has_any() -> None:
    file = learned_again(SLOPES, 3, frozenset({"effects"})).detector()
    assert "dropout" not in file and not any("dropout" in state for state in file["states"].values())


def written(learned: Learned, folder: Path) -> tuple[Path, LearnedUncertainty]:
    """The file of a learned detector, and how well its numbers are known."""
    path, text = folder / "learned.yaml", yaml.safe_dump(learned.detector())
    path.write_text(text)
    return path, LearnedUncertainty.model_validate_json(uncertainty_text(learned, text))


def test_a_campaign_draws_the_slopes_of_states(learned, tmp_path) -> None:
    path, known = written(learned, tmp_path)
    drawn = [drawn_detector(known, seed) for seed in range(50)]
    slopes = np.array([each["detector.states.fog.dropout.distance_m.per_unit"] for each in drawn])
    assert 0 < slopes.std() < 0.01
    assert abs(slopes.mean() - learned.detector()["states"]["fog"]["dropout"]["distance_m"]["per_unit"]) < 0.004
    model, _ = choose_detector(path, settings=drawn[0], may_be_unread=True)
    assert model.dropout.own[1][0].log_odds == slopes[0]


SCORED_FRAMES, SCORED_BOATS, STEP_S, MISS_RATE = 500, 40, 0.5, 0.3
ASKED = {"vessel_share": 0.3, "shares": [0.2, 0.4], "times_s": [1.0, 6.0]}


def scored_again(persistence: dict[str, Any], seed: int, without: frozenset[str] = frozenset(),
                  confusion: tuple[tuple[float, ...], ...] = ((1 - MISS_RATE,), (MISS_RATE,))) -> Learned:  # fmt: skip
    image, boat = np.repeat(np.arange(SCORED_FRAMES), SCORED_BOATS), np.tile(np.arange(SCORED_BOATS), SCORED_FRAMES)
    corner = np.column_stack([100 + 250.0 * (boat % 8), 200 + 250.0 * (boat // 8)])
    names = ("boat", "ship")[: len(confusion[0])]
    annotations = truth(image, boat % len(names), np.hstack([corner, corner + 60]), identity=boat)
    frames = images(SCORED_FRAMES, (2200.0, 1600.0), np.arange(SCORED_FRAMES) * STEP_S)
    labelled = replace(of_boats(frames, annotations), labels=names)
    data = detector({"mean": 0.6, "std": 0.15}) | {"persistence": persistence, "labels": list(names)}
    of_false = [1 / len(names)] * len(names)
    usual = {"confusion": [list(row) for row in confusion], "false_discovery_rate": 0.05}
    data["states"]["usual"] |= usual | {"false_positive_labels": of_false}
    return learned_in(observed_in(detected(labelled, data, seed), without=without), replicates=40)


@pytest.fixture(scope="module")
def scored() -> Learned:
    return scored_again({"score": ASKED}, 1)


def test_the_memory_of_a_score_is_learned_again(scored: Learned) -> None:
    model = parse_detector(scored.detector())
    score = model.persistence.score
    assert score is not None and model.persistence.confidence_s == model.persistence.class_s == 0
    asked = LatentScore(0.3, (0.2, 0.4), (1.0, 6.0))
    apart_s = np.array([0.5, 1, 2, 4, 8, 16])
    assert np.abs(score.correlation(apart_s) - asked.correlation(apart_s)).max() < 0.08
    intervals = {each.key.path: each for each in scored.intervals(0.99)}
    kept = intervals["persistence.score.vessel_share"]
    assert kept.low <= 0.3 <= kept.high < 0.6
    assert intervals["states.usual.confusion"].high[-1, 0] > MISS_RATE > intervals["states.usual.confusion"].low[-1, 0]


def test_labels_that_persist_do_so_beside_a_score() -> None:
    two = ((0.5, 0.2), (0.2, 0.5), (0.3, 0.3))
    scored = scored_again({"score": ASKED, "class_s": 5.0}, 3, confusion=two)
    persistence = parse_detector(scored.detector()).persistence
    assert persistence.score is not None and persistence.class_s == pytest.approx(5, rel=0.3)
    assert parse_detector(scored_again({"score": ASKED}, 3, confusion=two).detector()).persistence.class_s == 0


def test_misses_and_confidences_that_are_drawn_apart_have_no_score() -> None:
    apart = scored_again({"class_s": 2.0, "confidence_s": 2.0}, 2)
    persistence = parse_detector(apart.detector()).persistence
    assert persistence.score is None and persistence.class_s == pytest.approx(2, rel=0.2)
    assert persistence.confidence_s == pytest.approx(2, rel=0.2)
    assert any(note.startswith("persistence.score: none; detections before a miss") for note in apart.notes)


def test_a_score_can_be_left_out() -> None:
    found = parse_detector(scored_again({"score": ASKED}, 1, frozenset({"score"})).detector()).persistence
    assert found.score is None and found.class_s > 0 and found.confidence_s > 0


def test_a_campaign_draws_scores_that_can_be(scored: Learned, tmp_path) -> None:
    path, known = written(scored, tmp_path)
    drawn = (choose_detector(path, settings=drawn_detector(known, seed), may_be_unread=True)[0] for seed in range(40))
    assert 0.02 < np.std([model.persistence.score.vessel_share for model in drawn]) < 0.2
