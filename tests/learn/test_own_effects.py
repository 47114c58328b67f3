"""Slopes of misses that performance states have for themselves: simulated, and learned again."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import yaml

from modsim3d.campaign.drawn_detectors import LearnedUncertainty, drawn_detector
from modsim3d.detector.classification import ConfusionClassifier
from modsim3d.detector.file.reading import parse_detector
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
from tests.learn.one_state import learned_in, observed_as, of_boats
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


def observed_in(slopes: dict[str, float], seed: int, without: frozenset[str] = frozenset(), far_m: float = 400,
                anchor: str = "state_rate") -> Observed:  # fmt: skip
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
    return learned_in(observed_in(slopes, seed, without), replicates=60)


@pytest.fixture(scope="module")
def learned() -> Learned:
    return learned_again(SLOPES, 3)


def test_slopes_that_differ_are_those_of_the_states_again(learned) -> None:
    intervals = {each.key.path: each for each in learned.intervals(0.99)}
    for name, slope in SLOPES.items():
        interval = intervals[f"states.{name}.dropout.distance_m.per_unit"]
        assert interval.low <= slope <= interval.high
        missed = intervals[f"states.{name}.confusion"]
        assert missed.low[-1, 0] <= 0.4 <= missed.high[-1, 0]
        assert missed.high[-1, 0] - missed.low[-1, 0] < 0.2
    file = learned.detector()
    assert "distance_m" not in file["dropout"]
    own = {"distance_m", "intercept", "learned_log_odds"}
    assert [state["dropout"].keys() for state in file["states"].values()] == [own] * 2
    assert not parse_detector(file).needs_target_statistics
    assert any("states.NAME.dropout.distance_m: a slope for each state" in note for note in learned.notes)


def test_a_learned_detector_misses_as_much_as_the_true_one_in_a_scene_of_other_distances() -> None:
    near = observed_in(SLOPES, 5, far_m=280, anchor="none")
    learned = learned_in(near, replicates=60)
    far = observed_in(SLOPES, 6, anchor="none")
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


def test_slopes_that_do_not_differ_are_one(learned) -> None:
    same = learned_again(dict.fromkeys(STATES, 0.01), 4)
    assert same.detector()["dropout"].keys() == {"model", "distance_m"}
    assert not any("distance_m" in state["dropout"] for state in same.detector()["states"].values())
    assert any("states.NAME.dropout.distance_m: the same in all states" in note for note in same.notes)


def test_misses_that_persist_count_for_fewer() -> None:
    observed, effects = observed_in(SLOPES, 3), (EffectTerm("distance_m", 200.0),)
    fit = fit_misses(observed, effects, resample(observed.labelled.images, 0, 0))
    found = [own_effects(observed, effects, fit, {"distance_m": inflation}, [])[0] for inflation in (1.0, 100.0)]
    assert [effect.state for effect in found[0]] == [0, 1]
    assert found[1] == effects


def test_without_effects_no_state_has_any() -> None:
    file = learned_again(SLOPES, 3, frozenset({"effects"})).detector()
    assert "dropout" not in file and not any("dropout" in state for state in file["states"].values())


def test_a_campaign_draws_the_slopes_of_states(learned, tmp_path) -> None:
    text = yaml.safe_dump(learned.detector())
    path = tmp_path / "learned.yaml"
    path.write_text(text)
    known = LearnedUncertainty.model_validate(json.loads(uncertainty_text(learned, text)))
    drawn = [drawn_detector(known, seed) for seed in range(50)]
    slopes = np.array([each["detector.states.fog.dropout.distance_m.per_unit"] for each in drawn])
    assert 0 < slopes.std() < 0.01
    assert abs(slopes.mean() - learned.detector()["states"]["fog"]["dropout"]["distance_m"]["per_unit"]) < 0.004
    model, _ = choose_detector(path, settings=drawn[0], may_be_unread=True)
    assert model.dropout.own[1][0].log_odds == slopes[0]
