"""Misses that follow what a vessel looks like, otherwise in one state than in another, and hard limits."""

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
from modsim3d.detector.dropout import anchor, size_px
from modsim3d.detector.file.reading import parse_detector, with_miss_rate
from modsim3d.detector.records import TRUE, CameraFrames, Detections, Gates, Targets
from modsim3d.detector.target_statistics import TargetStatistics
from modsim3d.formats.video_labels import check_needs
from modsim3d.verify.class_checks import class_checks
from modsim3d.verify.evidence import CameraEvidence, Evidence
from modsim3d.verify.parameters import judge
from tests.detector import detector_builders as build
from tests.detector.detector_builders import all_bytes, detector_data, make_frames, make_targets, run

FRAMES, VESSELS = 4000, 10
LOGISTIC = {
    "model": "logistic",
    "visible_fraction": {"per_unit": -3, "reference": 1},
    "size_px": {"per_doubling": -1, "reference": 50},
    "distance_m": {"per_doubling": 0.5, "reference": 100},
}
TABLE = {"model": "table", "size_px": {"edges": [20, 60], "odds": [4, 2, 1]}}


def targets_of(side: np.ndarray) -> Targets:
    boxes = np.concatenate([1000 - side, 1000 - side / 2, 1000 + side, 1000 + side / 2], axis=-1)
    return make_targets(boxes, np.arange(side.shape[1]) % 2)


def varied_targets(frames: int = FRAMES) -> Targets:
    random = np.random.default_rng(1)
    targets = targets_of(2 ** random.uniform(2, 9, (frames, VESSELS, 1)))
    depths, seen = 10 ** random.uniform(1, 3.3, len(targets)), random.uniform(0, 1, len(targets))
    return dataclasses.replace(targets, visible_fraction=seen, depth_m=depths)


def model_data(**changes: Any) -> dict[str, Any]:
    return build.one_state_data(box_error=build.no_error(), false_discovery_rate=0) | changes


def labels_of(found: Detections, targets: Targets) -> np.ndarray:
    return build.by_frame(found, found.label, 1, len(targets), -1)[0]


def sides_of(targets: Targets) -> np.ndarray:
    return np.sqrt(np.prod(sizes(targets.boxes_px), axis=1))


def log_odds(targets: Targets) -> np.ndarray:
    """The logistic model once more, by hand."""
    seen = -3 * (targets.visible_fraction - 1)
    return seen - np.log2(sides_of(targets) / 50) + 0.5 * np.log2(targets.depth_m / 100)


def test_logistic_misses_have_the_probability_of_their_looks_and_a_table_multiplies_the_odds():
    targets = varied_targets()
    labels = labels_of(build.run(model_data(dropout=LOGISTIC), build.make_frames(FRAMES), targets), targets)
    missed, hard = labels < 0, log_odds(targets) > 1
    rate = special.expit(special.logit(np.where(targets.label == 0, 0.2, 0.3)) + log_odds(targets))
    for low in np.arange(0, 1, 0.1):
        rows = (rate >= low) & (rate < low + 0.1)
        error = np.sqrt(np.mean(rate[rows] * (1 - rate[rows])) / rows.sum())
        assert rows.sum() > 300 and abs(missed[rows].mean() - rate[rows].mean()) < 4 * error
    for rows in (hard, ~hard):
        for label, share in ((0, 1 / 8), (1, 1 / 7)):  # 0.1 of 0.1 + 0.7; 0.1 of 0.1 + 0.6
            seen = labels[rows & (targets.label == label) & ~missed]
            assert abs(np.mean(seen != label) - share) < 4 * np.sqrt(share * (1 - share) / len(seen))
    missed = labels_of(build.run(model_data(dropout=TABLE), build.make_frames(FRAMES), targets), targets) < 0
    side = sides_of(targets)
    for low, high, odds in ((0, 20, 4), (20, 60, 2), (60, 9999, 1)):
        for label, p in ((0, 0.2), (1, 0.3)):
            rows = (side >= low) & (side < high) & (targets.label == label)
            rate = odds * p / (1 - p + odds * p)
            assert abs(missed[rows].mean() - rate) < 4 * np.sqrt(rate * (1 - rate) / rows.sum())


@pytest.mark.parametrize("dropout", [LOGISTIC, TABLE], ids=["logistic", "table"])
def test_anchored_misses_have_the_states_rate_on_average_over_the_scene(dropout: dict[str, Any]) -> None:
    targets, frames = varied_targets(), build.make_frames(FRAMES)
    model = parse_detector(model_data(dropout=dropout | {"anchor": "state_rate"}))
    classifier = ConfusionClassifier.from_model(model, target_statistics(model, [(frames, targets)]))
    rates = classifier.miss_rates(np.zeros(len(targets), dtype=np.int64), targets)
    for label, asked in ((0, 0.2), (1, 0.3)):
        assert abs(rates[targets.label == label].mean() - asked) < 3.1e-5
        assert rates[targets.label == label].std() > 0.05
    missed = labels_of(build.run(model_data(dropout=dropout | {"anchor": "state_rate"}), frames, targets), targets) < 0
    assert abs(missed.mean() - 0.25) < 4 * np.sqrt(0.25 * 0.75 / len(missed))


def test_a_score_says_who_is_missed_and_effects_of_nothing_leave_the_chain_as_it_is() -> None:
    targets, frames, model = varied_targets(), build.make_frames(FRAMES), parse_detector(model_data())
    classifier = ConfusionClassifier.from_model(model, TargetStatistics())
    uniforms, states = np.empty(len(targets)), np.zeros(FRAMES, dtype=np.int64)
    for label in (0, 1):
        rows = np.flatnonzero(targets.label == label)
        uniforms[rows] = (np.arange(len(rows)) + 0.5) / len(rows)
    labels, level = classifier.classify_scored(frames, states, targets, uniforms, np.full(len(targets), 0.9))
    for label in (0, 1):
        *column, missed = model.states[0].confusion[:, label]
        rows = targets.label == label
        np.testing.assert_allclose(level[rows], (0.9 - missed) / (1 - missed), atol=1e-6)
        share = np.bincount(labels[rows], minlength=2) / rows.sum()
        np.testing.assert_allclose(share, np.array(column) / (1 - missed), atol=2 / rows.sum())
    assert (classifier.classify_scored(frames, states, targets, uniforms, np.full(len(targets), 0.1))[0] == -1).all()
    plain, frames = varied_targets(400), build.make_frames(400)
    unknown = dataclasses.replace(plain, visible_fraction=np.full(400 * VESSELS, np.nan))
    for targets, effect in (
        (plain, {"size_px": {"per_doubling": 0, "reference": 1}}),
        (unknown, {"visible_fraction": {"per_unit": -9, "reference": 1}}),
    ):
        found = build.run(model_data(dropout={"model": "logistic"} | effect), frames, targets)
        assert np.array_equal(labels_of(found, targets), labels_of(build.run(model_data(), frames, targets), targets))
    assert size_px(build.make_targets([[[0, 0, 0.25, 400], [0, 0, 0.5, 0.5]]])).tolist() == [10, 1]
    assert anchor(0.0, np.ones(3), np.ones(3)) == anchor(1.0, np.ones(3), np.ones(3)) == 0  # which nothing changes
    thin = build.steady_targets(5, 1, [10, 10, 10, 10.5])
    thin.depth_m[:] = -3  # and near
    assert len(build.run(model_data(dropout=LOGISTIC), build.make_frames(5), thin).gated) == 5
    only, targets = {"model": "logistic", "visible_fraction": {"per_unit": -3, "reference": 0}}, varied_targets(50)
    added = parse_detector(model_data(dropout=only)).dropout.log_odds(np.zeros(len(targets), dtype=int), targets)
    np.testing.assert_allclose(added, -3 * targets.visible_fraction)
    parts, model = iter([(build.make_frames(50), targets)]), parse_detector(model_data(dropout=LOGISTIC))
    assert not len(target_statistics(model, parts).sides.counts)
    assert len(list(parts)) == 1 and not model.needs_target_statistics
    assert parse_detector(model_data(dropout=LOGISTIC | {"anchor": "state_rate"})).needs_target_statistics


def gated(**gates: float) -> tuple[Targets, Detections]:
    targets = varied_targets(500)
    data = model_data(gates=gates, states={"only": model_data()["states"]["only"] | {"false_discovery_rate": 0.3}})
    return targets, build.run(data, build.make_frames(500), targets)


def test_gates_keep_out_what_is_far_small_or_hidden_and_detections_that_are_too_many():
    targets, found = gated(max_range_m=500, min_box_px=12, max_occlusion=0.8)
    out = (targets.depth_m > 500) | (sizes(targets.boxes_px).min(axis=1) < 12) | (targets.visible_fraction < 0.2)
    assert 0.3 < out.mean() < 0.9 and np.array_equal(found.gated, out)
    assert not out[found.target[found.kind == TRUE]].any()
    targets = build.make_targets([[[0, 0, 50, side] for side in (20.5, 20.0, 19.5)]])
    targets.depth_m[:], targets.visible_fraction[:] = [99.0, 100.0, 100.5], [np.nan, 0.75, 0.7]
    for gates in (Gates(min_box_px=20.0), Gates(max_range_m=100.0), Gates(max_occlusion=0.25)):
        assert gates.passed(build.make_frames(1), targets).tolist() == [True, True, False], gates
    targets, some = gated(max_range_m=500)
    _, every = gated()
    near = ((found.kind == TRUE) & (targets.depth_m[found.target] <= 500) for found in (some, every))
    some_near, every_near = (found.boxes_px[rows] for found, rows in zip((some, every), near, strict=True))
    assert np.array_equal(some_near, every_near) and not every.gated.any()
    plain = model_data(states={"only": model_data()["states"]["only"] | {"false_discovery_rate": 0.3}})
    assert build.all_bytes(every) == build.all_bytes(build.run(plain, build.make_frames(500), targets))
    _, every = gated()
    _, some = gated(max_detections=4)
    assert np.bincount(some.frame).max() == 4
    for frame in range(500):
        surest = np.sort(every.confidence[every.frame == frame])[::-1][:4]
        assert np.array_equal(np.sort(some.confidence[some.frame == frame])[::-1], surest)
    lost = np.setdiff1d(every.target[every.kind == TRUE], some.target[some.kind == TRUE])
    assert np.array_equal(np.flatnonzero(some.gated), lost)
    targets, data = varied_targets(200), model_data(gates={"update_interval_s": 0.6})
    for first_step, time_step_s in ((0, 0.2), (7, 0.2), (3, 0.7), (0, 1.3)):
        frames = build.make_frames(200, first_step=first_step, time_step_s=time_step_s)
        found = build.run(data, frames, targets)
        times_s = np.append(frames.previous_s, frames.times_s)
        number = [-1 if time_s == -np.inf else int(time_s / 0.6 + 1e-6) for time_s in times_s]
        due = np.flatnonzero(np.diff(number) > 0)
        assert set(found.frame) <= set(due) and len(set(found.frame)) > 0.9 * len(due), (first_step, time_step_s)
        assert np.array_equal(found.gated, ~np.isin(targets.frame, due)), (first_step, time_step_s)


SCENE_FRAMES, SCENE_VESSELS = 3000, 6
SHARED = {"per_unit": 0.002, "reference": 200}
FOG = {"per_unit": 0.03, "reference": 200}
SIZE = {"per_doubling": -0.5, "reference": 50}
FOG_STATE = 1
OWN, FOG_TABLE = {"distance_m": FOG}, {"distance_m": {"edges": [1], "odds": [1, 2]}}
NONE, INTERCEPT = {"model": "confusion", "size_px": None}, {"intercept": [0.1, 0.2]}


def data_with(dropout: dict[str, Any], fog: dict[str, Any]) -> dict[str, Any]:
    data = detector_data(dropout={"model": "logistic", **dropout})
    data["states"]["fog"]["dropout"] = fog
    return data


def own_data(**dropout: Any) -> dict[str, Any]:
    return data_with({"size_px": SIZE, "distance_m": SHARED, **dropout}, {"distance_m": FOG})


def scene(frames: int = SCENE_FRAMES) -> tuple[CameraFrames, Targets]:
    random = np.random.default_rng(1)
    targets = targets_of(2 ** random.uniform(3, 8, (frames, SCENE_VESSELS, 1)))
    return make_frames(frames), dataclasses.replace(targets, depth_m=random.uniform(50, 400, len(targets)))


def added_log_odds(targets: Targets, per_m: Any) -> np.ndarray:
    """What size and distance add, by hand."""
    return -0.5 * np.log2(sides_of(targets) / 50) + per_m * (targets.depth_m - 200)


def test_misses_follow_the_distance_by_state_and_a_miss_rate_is_the_mean_over_the_learning_set() -> None:
    frames, targets = scene()
    found = run(own_data(), frames, targets)
    missed, state = labels_of(found, targets) < 0, found.states[targets.frame]
    usual = special.logit(np.array([[0.2, 0.3], [0.4, 0.4]])[state, targets.label])
    rate = special.expit(usual + added_log_odds(targets, np.where(state == FOG_STATE, 0.03, 0.002)))
    for number in range(2):
        for low in range(50, 400, 50):
            rows = (state == number) & (targets.depth_m >= low) & (targets.depth_m < low + 50)
            error = np.sqrt(np.mean(rate[rows] * (1 - rate[rows])) / rows.sum())
            assert rows.sum() > 300 and abs(missed[rows].mean() - rate[rows].mean()) < 4 * error
    model = parse_detector(own_data(anchor="state_rate"))
    halves = [select(targets, rows) for rows in np.array_split(np.arange(len(targets)), [7000])]
    classifier = ConfusionClassifier.from_model(model, target_statistics(model, [(frames, half) for half in halves]))
    for state, asked in enumerate([(0.2, 0.3), (0.4, 0.4)]):
        rates = classifier.miss_rates(np.full(len(targets), state), targets)
        for label in range(2):
            assert abs(rates[targets.label == label].mean() - asked[label]) < 3.1e-5
    model = parse_detector(own_data(intercept=[0.4, -1.0]))
    assert not model.needs_target_statistics
    near = dataclasses.replace(targets, depth_m=targets.depth_m / 4)
    for seen in (targets, near):
        classifier = ConfusionClassifier.from_model(model, target_statistics(model, [(frames, seen)]))
        odds = special.logit(0.4) + np.array([0.4, -1.0])[seen.label] + added_log_odds(seen, 0.03)
        rates = classifier.miss_rates(np.full(len(seen), FOG_STATE), seen)
        assert np.allclose(rates, special.expit(odds), atol=1e-9)
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


@pytest.mark.parametrize(("dropout", "fog", "message"), [
    ({}, {"distanc_m": FOG}, "states.fog.dropout.distanc_m: unknown key (did you mean 'distance_m'?)"),
    ({}, {"model": "table"}, "states.fog.dropout.model: unknown key"),
    ({}, {"distance_m": {"per_unit": 1}}, "states.fog.dropout.distance_m: give exactly one of per_unit and"),
    ({}, FOG_TABLE, "states.fog.dropout: distance_m: model logistic needs per_unit or per_doubling, and reference"),
    (NONE, OWN, "states.fog.dropout: model confusion has no distance_m: choose model logistic or table"),
    ({"intercept": [0.1]}, OWN, "has 1 entries, must have one for each of the labels"),
    (INTERCEPT | {"anchor": "state_rate"}, OWN, "dropout.intercept: anchor state_rate holds"),
    ({"partly_hidden": {"per_doubling": 1, "reference": 1}}, OWN, "partly_hidden: is 0 or 1, which nothing doubles"),
    ({"learned_log_odds": [[0.0], [0.0]]}, OWN, "learned_log_odds goes with an intercept"),
    (NONE | INTERCEPT, {}, "has no intercept"),
])  # fmt: skip
def test_a_bad_effect_or_intercept_is_told_with_its_path(dropout, fog, message):
    with pytest.raises(InputError) as error:
        parse_detector(data_with({"size_px": SIZE, **dropout}, fog))
    assert message in str(error.value) and len(str(error.value).splitlines()) <= 2


def test_a_state_may_be_the_only_one_with_effects_and_verify_tests_it_there() -> None:
    model = parse_detector(data_with({"anchor": "state_rate"}, {"distance_m": FOG}))
    assert model.dropout.anchored and model.dropout.effects_of(0) == ()
    used = {each.key: each for each in used_models(model)}["states.fog.dropout.distance_m"]
    assert (used.name, used.state) == ("logistic", "fog")
    frames, targets = scene(100)
    own = run(data_with({}, {"distance_m": FOG}), frames, targets)
    assert all_bytes(own) != all_bytes(run(detector_data(), frames, targets))
    model = parse_detector(data_with({"size_px": SIZE}, {"distance_m": FOG}))
    with pytest.raises(InputError, match=r"settings=\{.detector\.states\.fog\.dropout\.distance_m.: None\}$"):
        check_needs(model, "detector", np.array([100.0, np.nan]), np.array([0.0, 1.0, -100.0]))
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
