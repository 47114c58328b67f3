"""Misses that follow what a vessel looks like, and hard limits."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy import special

from modsim3d.core.boxes import sizes
from modsim3d.detector.chain import target_statistics
from modsim3d.detector.classification import ConfusionClassifier
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.records import TRUE, Detections, Gates, Targets
from tests.detector import detector_builders as build

FRAMES, VESSELS = 4000, 10
LOGISTIC = {
    "model": "logistic",
    "visible_fraction": {"per_unit": -3, "reference": 1},
    "size_px": {"per_doubling": -1, "reference": 50},
    "distance_m": {"per_doubling": 0.5, "reference": 100},
}
TABLE = {"model": "table", "size_px": {"edges": [20, 60], "odds": [4, 2, 1]}}


def varied_targets(frames: int = FRAMES) -> Targets:
    random = np.random.default_rng(1)
    side = 2 ** random.uniform(2, 9, (frames, VESSELS, 1))
    boxes = np.concatenate([1000 - side, 1000 - side / 2, 1000 + side, 1000 + side / 2], axis=-1)
    targets = build.make_targets(boxes, np.arange(VESSELS) % 2)
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


def test_logistic_misses_have_the_probability_of_their_looks_and_labels_of_the_detected_keep_their_shares() -> None:
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


def test_table_multiplies_the_odds_in_each_range() -> None:
    targets = varied_targets()
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


def test_effects_of_nothing_and_of_unknown_visibility_leave_the_chain_as_it_is() -> None:
    plain, frames = varied_targets(400), build.make_frames(400)
    unknown = dataclasses.replace(plain, visible_fraction=np.full(400 * VESSELS, np.nan))
    for targets, effect in (
        (plain, {"size_px": {"per_doubling": 0, "reference": 1}}),
        (unknown, {"visible_fraction": {"per_unit": -9, "reference": 1}}),
    ):
        found = build.run(model_data(dropout={"model": "logistic"} | effect), frames, targets)
        assert np.array_equal(labels_of(found, targets), labels_of(build.run(model_data(), frames, targets), targets))


def test_a_slope_may_start_at_nothing_seen_and_without_an_anchor_no_part_of_a_scene_is_read() -> None:
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


def test_gates_keep_out_what_is_far_small_or_hidden_and_nothing_at_the_limit_or_of_unknown_visibility() -> None:
    targets, found = gated(max_range_m=500, min_box_px=12, max_occlusion=0.8)
    out = (targets.depth_m > 500) | (sizes(targets.boxes_px).min(axis=1) < 12) | (targets.visible_fraction < 0.2)
    assert 0.3 < out.mean() < 0.9 and np.array_equal(found.gated, out)
    assert not out[found.target[found.kind == TRUE]].any()
    targets = build.make_targets([[[0, 0, 50, side] for side in (20.5, 20.0, 19.5)]])
    targets.depth_m[:], targets.visible_fraction[:] = [99.0, 100.0, 100.5], [np.nan, 0.75, 0.7]
    for gates in (Gates(min_box_px=20.0), Gates(max_range_m=100.0), Gates(max_occlusion=0.25)):
        assert gates.passed(build.make_frames(1), targets).tolist() == [True, True, False], gates


def test_gates_change_nothing_in_what_passes_and_a_detector_without_gates_passes_everything() -> None:
    targets, some = gated(max_range_m=500)
    _, every = gated()
    some_near, every_near = (
        found.boxes_px[(found.kind == TRUE) & (targets.depth_m[found.target] <= 500)] for found in (some, every)
    )
    assert np.array_equal(some_near, every_near) and not every.gated.any()
    plain = model_data(states={"only": model_data()["states"]["only"] | {"false_discovery_rate": 0.3}})
    assert build.all_bytes(every) == build.all_bytes(build.run(plain, build.make_frames(500), targets))


def test_the_surest_detections_of_a_frame_are_put_out() -> None:
    _, every = gated()
    _, some = gated(max_detections=4)
    assert np.bincount(some.frame).max() == 4
    for frame in range(500):
        surest = np.sort(every.confidence[every.frame == frame])[::-1][:4]
        assert np.array_equal(np.sort(some.confidence[some.frame == frame])[::-1], surest)
    lost = np.setdiff1d(every.target[every.kind == TRUE], some.target[some.kind == TRUE])
    assert np.array_equal(np.flatnonzero(some.gated), lost)


def test_a_detector_with_an_interval_runs_at_the_first_frame_of_each() -> None:
    targets, data = varied_targets(200), model_data(gates={"update_interval_s": 0.6})
    for first_step, time_step_s in ((0, 0.2), (7, 0.2), (3, 0.7), (0, 1.3)):
        frames = build.make_frames(200, first_step=first_step, time_step_s=time_step_s)
        found = build.run(data, frames, targets)
        times_s = np.append(frames.previous_s, frames.times_s)
        number = [-1 if time_s == -np.inf else int(time_s / 0.6 + 1e-6) for time_s in times_s]
        due = np.flatnonzero(np.diff(number) > 0)
        assert set(found.frame) <= set(due) and len(set(found.frame)) > 0.9 * len(due), (first_step, time_step_s)
        assert np.array_equal(found.gated, ~np.isin(targets.frame, due)), (first_step, time_step_s)


def test_thin_and_near_targets_have_finite_odds() -> None:
    targets = build.steady_targets(5, 1, [10, 10, 10, 10.5])
    targets.depth_m[:] = -3
    assert len(build.run(model_data(dropout=LOGISTIC), build.make_frames(5), targets).gated) == 5
