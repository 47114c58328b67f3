"""Misses that follow what a vessel looks like otherwise in one state than in another."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy import special

from modsim3d.core.boxes import sizes
from modsim3d.core.errors import InputError
from modsim3d.detector.chain import target_statistics, used_models
from modsim3d.detector.classification import ConfusionClassifier
from modsim3d.detector.draws import select
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.file.writing import with_miss_rate
from modsim3d.detector.records import TRUE, CameraFrames, Targets
from modsim3d.formats.labelled_video.detect_truth import check_needs
from modsim3d.verify.class_checks import class_checks
from modsim3d.verify.evidence import CameraEvidence, Evidence
from modsim3d.verify.parameters import judge
from tests.detector.detector_builders import all_bytes, detector_data, make_frames, make_targets, run

FRAMES, VESSELS = 3000, 6
SHARED = {"per_unit": 0.002, "reference": 200}
FOG = {"per_unit": 0.03, "reference": 200}
SIZE = {"per_doubling": -0.5, "reference": 50}
FOG_STATE = 1
OWN, TABLE = {"distance_m": FOG}, {"distance_m": {"edges": [1], "odds": [1, 2]}}
NONE, INTERCEPT = {"model": "confusion", "size_px": None}, {"intercept": [0.1, 0.2]}


def data_with(dropout: dict[str, Any], fog: dict[str, Any]) -> dict[str, Any]:
    data = detector_data(dropout={"model": "logistic", **dropout})
    data["states"]["fog"]["dropout"] = fog
    return data


def own_data(**dropout: Any) -> dict[str, Any]:
    return data_with({"size_px": SIZE, "distance_m": SHARED, **dropout}, {"distance_m": FOG})


def scene(frames: int = FRAMES) -> tuple[CameraFrames, Targets]:
    random = np.random.default_rng(1)
    side = 2 ** random.uniform(3, 8, (frames, VESSELS, 1))
    boxes = np.concatenate([1000 - side, 1000 - side / 2, 1000 + side, 1000 + side / 2], axis=-1)
    targets = make_targets(boxes, np.arange(VESSELS) % 2)
    return make_frames(frames), dataclasses.replace(targets, depth_m=random.uniform(50, 400, len(targets)))


def log_odds(targets: Targets, per_m: Any) -> np.ndarray:
    """What size and distance add, by hand."""
    side = np.sqrt(np.prod(sizes(targets.boxes_px), axis=1))
    return -0.5 * np.log2(side / 50) + per_m * (targets.depth_m - 200)


def test_misses_follow_the_distance_as_each_state_says() -> None:
    frames, targets = scene()
    found = run(own_data(), frames, targets)
    missed = np.ones(len(targets), dtype=bool)
    missed[found.target[found.kind == TRUE]] = False
    state = found.states[targets.frame]
    usual = special.logit(np.array([[0.2, 0.3], [0.4, 0.4]])[state, targets.label])
    rate = special.expit(usual + log_odds(targets, np.where(state == FOG_STATE, 0.03, 0.002)))
    for number in range(2):
        for low in range(50, 400, 50):
            rows = (state == number) & (targets.depth_m >= low) & (targets.depth_m < low + 50)
            error = np.sqrt(np.mean(rate[rows] * (1 - rate[rows])) / rows.sum())
            assert rows.sum() > 300 and abs(missed[rows].mean() - rate[rows].mean()) < 4 * error


def test_anchored_misses_have_the_rate_of_each_state_on_average_over_the_scene() -> None:
    frames, targets = scene()
    model = parse_detector(own_data(anchor="state_rate"))
    halves = [select(targets, rows) for rows in np.array_split(np.arange(len(targets)), [7000])]
    classifier = ConfusionClassifier.from_model(model, target_statistics(model, [(frames, half) for half in halves]))
    for state, asked in enumerate([(0.2, 0.3), (0.4, 0.4)]):
        rates = classifier.miss_rates(np.full(len(targets), state), targets)
        for label in range(2):
            assert abs(rates[targets.label == label].mean() - asked[label]) < 3.1e-5


def test_an_intercept_makes_the_chance_of_a_miss_the_same_in_every_scene() -> None:
    frames, targets = scene()
    model = parse_detector(own_data(intercept=[0.4, -1.0]))
    assert not model.needs_target_statistics
    near = dataclasses.replace(targets, depth_m=targets.depth_m / 4)
    for seen in (targets, near):
        classifier = ConfusionClassifier.from_model(model, target_statistics(model, [(frames, seen)]))
        odds = special.logit(0.4) + np.array([0.4, -1.0])[seen.label] + log_odds(seen, 0.03)
        rates = classifier.miss_rates(np.full(len(seen), FOG_STATE), seen)
        assert np.allclose(rates, special.expit(odds), atol=1e-9)


def test_a_miss_rate_is_the_mean_over_the_learning_set() -> None:
    learned = [[-2.0, 0.0, 3.0], [-1.0, 1.0, 1.0]]
    data = own_data(intercept=[0.4, -1.0], learned_log_odds=learned)
    data["states"]["fog"]["dropout"] |= {"intercept": [0.1, 0.2]}
    changed = with_miss_rate(data, 0.7, "fog", "detector.states.fog.miss_rate")
    assert changed["states"]["clear"] == data["states"]["clear"]
    dropout = changed["states"]["fog"]["dropout"]
    assert dropout["distance_m"] == FOG
    odds = special.logit(0.7) + np.array(dropout["intercept"])[:, None] + np.array(learned)
    assert np.allclose(special.expit(odds).mean(axis=1), 0.7, atol=1e-9)
    assert parse_detector(changed).dropout.intercepts == {0: (0.4, -1.0), 1: tuple(dropout["intercept"])}
    for wrong in ([-1.0, 0.0], [[0.1], []], "x"):
        assert with_miss_rate(own_data(learned_log_odds=wrong), 0.3, None, "x")["dropout"]["learned_log_odds"] == wrong
    without = with_miss_rate(own_data(intercept=[0.4, -1.0]), 0.7, None, "detector.miss_rate")
    assert parse_detector(without).dropout.intercepts[FOG_STATE] == (0.4, -1.0)


@pytest.mark.parametrize("anchor", ["none", "state_rate"])
def test_an_own_effect_that_equals_the_shared_one_changes_nothing(anchor: str) -> None:
    frames, targets = scene(500)
    shared = data_with({"distance_m": SHARED, "anchor": anchor}, {})
    same = data_with({"distance_m": SHARED, "anchor": anchor}, {"distance_m": SHARED})
    assert all_bytes(run(shared, frames, targets)) == all_bytes(run(same, frames, targets))


def test_a_state_may_be_the_only_one_with_effects() -> None:
    model = parse_detector(data_with({"anchor": "state_rate"}, {"distance_m": FOG}))
    assert model.dropout.anchored and model.dropout.effects_of(0) == ()
    used = {each.key: each for each in used_models(model)}["states.fog.dropout.distance_m"]
    assert (used.name, used.state) == ("logistic", "fog")
    frames, targets = scene(100)
    own = run(data_with({}, {"distance_m": FOG}), frames, targets)
    assert all_bytes(own) != all_bytes(run(detector_data(), frames, targets))


@pytest.mark.parametrize(
    ("dropout", "fog", "message"),
    [
        ({}, {"distanc_m": FOG}, "states.fog.dropout.distanc_m: unknown key (did you mean 'distance_m'?)"),
        ({}, {"model": "table"}, "states.fog.dropout.model: unknown key"),
        ({}, {"distance_m": {"per_unit": 1}}, "states.fog.dropout.distance_m: give exactly one of per_unit and"),
        ({}, TABLE, "states.fog.dropout: distance_m: model logistic needs per_unit or per_doubling, and reference"),
        (NONE, OWN, "states.fog.dropout: model confusion has no distance_m: choose model logistic or table"),
        ({"size_px": None}, {}, "dropout: model logistic needs at least one of visible_fraction, partly_hidden"),
        ({"intercept": [0.1]}, OWN, "has 1 entries, must have one for each of the labels"),
        (INTERCEPT | {"anchor": "state_rate"}, OWN, "dropout.intercept: anchor state_rate holds"),
        (
            {"partly_hidden": {"per_doubling": 1, "reference": 1}},
            OWN,
            "partly_hidden: is 0 or 1, which nothing doubles",
        ),
        ({"learned_log_odds": [[0.0], [0.0]]}, OWN, "learned_log_odds goes with an intercept"),
        (NONE | INTERCEPT, {}, "has no intercept"),
    ],
)
def test_a_bad_effect_or_intercept_is_told_with_its_path(dropout, fog, message):
    with pytest.raises(InputError) as error:
        parse_detector(data_with({"size_px": SIZE, **dropout}, fog))
    assert message in str(error.value) and len(str(error.value).splitlines()) <= 2


def test_verify_tests_the_effect_of_a_state_there_and_the_shared_one_elsewhere() -> None:
    frames, targets = scene()
    drawn = run(own_data(anchor="state_rate"), frames, targets)
    evidence = Evidence.of([CameraEvidence(frames, targets, drawn)])
    honest = judge(class_checks(parse_detector(own_data(anchor="state_rate")), evidence))
    assert [each.parameter.name for each in honest.failed] == []
    parameters = [each.parameter for each in honest.verdicts]
    tested = {each.name: each.state for each in parameters if "dropout." in each.name}
    fogs = "states.fog.dropout.distance_m.per_unit"
    assert tested == {"dropout.size_px.per_doubling": None, "dropout.distance_m.per_unit": None, fogs: "fog"}
    wrong = own_data(anchor="state_rate")
    wrong["states"]["fog"]["dropout"]["distance_m"] = FOG | {"per_unit": 0.02}
    failed = {each.parameter.name for each in judge(class_checks(parse_detector(wrong), evidence)).failed}
    assert fogs in failed and "dropout.distance_m.per_unit" not in failed


def test_boxes_without_a_distance_are_refused_with_what_leaves_out_the_effect_of_the_state() -> None:
    model = parse_detector(data_with({"size_px": SIZE}, {"distance_m": FOG}))
    with pytest.raises(InputError, match=r"--set detector\.states\.fog\.dropout\.distance_m=null$"):
        check_needs(model, "detector", np.array([100.0, np.nan]), np.array([0.0, 1.0, -100.0]))
