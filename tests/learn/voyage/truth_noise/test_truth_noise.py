"""Errors of truth, and learned box errors without them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from modsim3d.core.boxes import errors_between
from modsim3d.detector.model import ERROR_PAIRS
from modsim3d.geometry.camera_poses import world_R_vehicle
from modsim3d.learn.bootstrap import Column, Entry, Key
from modsim3d.learn.model_selection import RICHER
from modsim3d.learn.voyage.deconvolution import less_noise, share_left, take_off_truth_noise, time_left
from modsim3d.learn.voyage.reference_error import PARAMETERS, TruthErrors, TruthNoise, box_jacobians
from modsim3d.scene.ais.scene_folder import REPORT
from tests.learn.voyage.truth_noise.noisy_truth import boxes_of, learned_from, moved, noisy_set, roads, view_of

EVERY, LASTING_S, SEEDS = 6, 60.0, 20
STD_PX = np.array([6.0, 2.0, 2.0, 2.0])


@pytest.fixture(scope="module")
def watched():
    """The scene, its view in every sixth step, and the times."""
    scene = roads()
    steps = np.arange(0, scene.steps, EVERY)
    return scene, view_of(scene, steps), scene.times_s(0, scene.steps)[steps]


def noise_of(scene, position_m, **parameters):
    std = np.zeros((len(scene.vessels), len(PARAMETERS)))
    std[:, :2] = position_m
    for name, value in parameters.items():
        std[:, PARAMETERS.index(name.replace("_", " "))] = value
    return TruthNoise(std, LASTING_S, {})


def test_derivatives_are_those_of_the_projects_own_outlines(watched):
    scene, view, _ = watched
    rng = np.random.default_rng(0)
    boxes = boxes_of(scene, view, view.poses)
    frame, vessel = np.nonzero(np.isfinite(boxes).all(axis=-1))
    jacobians = box_jacobians(scene, view, frame, vessel)
    offset_m = rng.normal(0, 1, (*boxes.shape[:2], 2))
    turn_rad = rng.normal(0, 0.003, boxes.shape[:2])
    moves = replace(moved(view.poses, offset_m), world_R_vessel=world_R_vehicle(turn_rad) @ view.poses.world_R_vessel)
    found = errors_between(boxes_of(scene, view, moves)[frame, vessel], boxes[frame, vessel])
    change = np.column_stack([offset_m[frame, vessel], turn_rad[frame, vessel]])
    expected = np.einsum("nij,nj->ni", jacobians[..., :3], change)
    inside = np.isfinite(found).all(axis=1)
    assert inside.sum() > 500
    np.testing.assert_allclose(found[inside], expected[inside], atol=0.03)


def test_derivatives_by_sizes_are_those_of_larger_vessels(watched):
    scene, view, _ = watched
    boxes = boxes_of(scene, view, view.poses)
    frame, vessel = np.nonzero(np.isfinite(boxes).all(axis=-1))
    jacobians = box_jacobians(scene, view, frame, vessel)
    larger = tuple(replace(v, length_m=v.length_m + 0.4, air_draft_m=v.air_draft_m + 0.2) for v in scene.vessels)
    again = boxes_of(replace(scene, vessels=larger), view, view.poses)[frame, vessel]
    inside = np.isfinite(again).all(axis=1)
    found = errors_between(again, boxes[frame, vessel])[inside]
    expected = jacobians[inside][..., 3] * 0.4 + jacobians[inside][..., 5] * 0.2
    np.testing.assert_allclose(found, expected, atol=0.01)


def test_draws_have_the_covariance_of_independent_errors_where_these_are(watched):
    scene, _, _ = watched
    rng = np.random.default_rng(1)
    count = 3000
    jacobians = rng.normal(size=(count, 4, len(PARAMETERS)))
    fleeting = replace(noise_of(scene, 2.0, heading=0.1), position_s=1e-3)
    vessel, still = rng.integers(0, 12, count), np.full(count, -1)
    errors = TruthErrors(jacobians, np.arange(count) * 1.0, vessel, fleeting, np.ones((count, 4)), still)
    drawn = errors.covariances(20, 0).mean(axis=0)
    part = jacobians[..., :3] * fleeting.std[0, :3]
    np.testing.assert_allclose(drawn, (part @ np.swapaxes(part, 1, 2)).mean(axis=0), rtol=0.05, atol=0.1)


def test_what_all_boxes_share_is_in_their_mean_and_not_in_the_covariance(watched):
    scene, _, _ = watched
    one = TruthErrors(
        np.tile(np.eye(4, len(PARAMETERS)), (50, 1, 1)),
        np.arange(50.0),
        np.zeros(50, dtype=np.int64),
        replace(noise_of(scene, 10.0), position_s=1e9),
        np.ones((50, 4)),
        np.full(50, -1),
    )
    assert np.abs(one.covariances(20, 0)).max() < 1e-3


def test_of_a_vessel_that_was_put_in_its_place_only_what_changes_is_left(watched):
    scene, view, times = watched
    frame, vessel = (each.ravel() for each in np.mgrid[: len(times), : len(scene.vessels)])
    jacobians = box_jacobians(scene, view, frame, vessel)
    told = np.isfinite(jacobians).all(axis=(1, 2))
    columns = jacobians[told], times[frame[told]], vessel[told]
    ones, still = np.ones((int(told.sum()), 4)), np.full(int(told.sum()), -1)
    wide = noise_of(scene, 10.0, antenna_along=20.0, antenna_across=5.0)
    std = [
        [np.sqrt(np.diag(TruthErrors(*columns, noise, ones, fit).covariances(20, 0).mean(axis=0)))[0] for fit in fits]
        for noise, fits in ((replace(wide, position_s=1e9), (still, vessel[told])), (wide, (still, vessel[told])))
    ]
    assert std[0][1] < 0.02 * std[0][0]  # what never changes was found
    assert 0.2 * std[1][0] < std[1][1] < 0.9 * std[1][0]


def test_intervals_hold_the_detectors_errors_and_the_plain_ones_do_not(watched):
    scene, view, times = watched
    held, plain, taken = np.zeros(4), np.zeros(4), np.zeros(4)
    for seed in range(SEEDS):
        labelled = noisy_set(scene, view, times, seed, 10.0, LASTING_S, np.diag(STD_PX**2))
        learned = learned_from(labelled, 40, RICHER)
        found = take_off_truth_noise(learned, scene, [view], noise_of(scene, 10.0), seed=seed)
        sure = found.states[0].taken_off
        low, high = found.learned.numbers.box_errors.states[0].std.column.interval(0.95, 50)
        held += (high >= STD_PX) & (~sure | (low <= STD_PX))
        taken += sure
        low, high = learned.numbers.box_errors.states[0].std.column.interval(0.95, 50)
        plain += (low <= STD_PX) & (high >= STD_PX)
        assert found.states[0].at_least[0] < 1.3 * STD_PX[0]
    assert (held >= 16).all()  # of 20, of which each holds with a chance of 95 %: fewer by chance once in 390 times
    assert taken[1:].tolist() == [SEEDS] * 3
    assert plain[0] == 0
    assert plain[2] < 10


def test_an_upper_bound_is_the_learned_covariance_and_is_said(watched):
    scene, view, times = watched
    labelled = noisy_set(scene, view, times, 0, 10.0, LASTING_S, np.diag([0.5, 2.0, 2.0, 2.0]) ** 2)
    learned = learned_from(labelled, 40, RICHER)
    found = take_off_truth_noise(learned, scene, [view], noise_of(scene, 10.0))
    (state,) = found.states
    assert state.bounds == ("e_x",)
    before, after = (each.detector()["states"]["all"]["box_error"] for each in (learned, found.learned))
    assert after["covariance"][0][0] == pytest.approx(before["covariance"][0][0], rel=1e-6)
    assert after["covariance"][2][2] < before["covariance"][2][2]
    assert any("an upper bound in e_x" in said for said in found.sentences())
    assert [row[-1] for row in found.rows()] == ["upper bound", "", "", ""]
    assert [each.upper_bound for each in found.components()] == [True, False, False, False]
    learned_std, _, _, written_std = zip(*(each.std for each in found.components()), strict=True)
    assert [a == b for a, b in zip(learned_std, written_std, strict=True)] == [True, False, False, False]
    low, high = found.learned.numbers.box_errors.states[0].correlation.column.interval(0.95, 50)
    assert ((low == -1) & (high == 1)).tolist() == [0 in pair for pair in ERROR_PAIRS]
    assert any(said.endswith("correlations with it are unknown") for said in found.sentences())


def test_a_vessel_that_two_logs_have_moved_is_one(watched):
    scene, view, times = watched
    learned = learned_from(noisy_set(scene, view, times, 0, 10.0, LASTING_S, np.diag(STD_PX**2)), 20, RICHER)
    moves = np.arange(len(scene.vessels)) < 3
    steps, middle = np.arange(0, scene.steps, EVERY), len(times) // 2
    halves = [
        replace(view_of(scene, steps[part]), images=view.images[part], moved=moves)
        for part in (slice(middle), slice(middle, None))
    ]
    found = take_off_truth_noise(learned, scene, halves, noise_of(scene, 10.0))
    assert "; less what registration found of 3 vessels" in next(found.sentences())


def test_a_camera_without_known_pairs_takes_nothing_off(watched):
    scene, view, times = watched
    labelled = noisy_set(scene, view, times, 0, 10.0, LASTING_S, np.diag(STD_PX**2))
    unknown = np.full(len(labelled.annotations.identity), -1)
    labelled = replace(labelled, annotations=replace(labelled.annotations, identity=unknown))
    learned = learned_from(labelled, 20, RICHER)
    found = take_off_truth_noise(learned, scene, [view], noise_of(scene, 10.0))
    assert found.learned.detector() == learned.detector()


def test_no_noise_changes_nothing(watched):
    scene, view, times = watched
    learned = learned_from(noisy_set(scene, view, times, 0, 0.0, LASTING_S, np.diag(STD_PX**2)), 20, RICHER)
    found = take_off_truth_noise(learned, scene, [view], noise_of(scene, 0.0))
    assert found.learned is learned
    assert list(found.sentences()) == ["errors of truth: none are assumed"]


def test_a_scene_from_ais_knows_what_was_missing(tmp_path, watched):
    scene = replace(watched[0], path=tmp_path / "scene.yaml")
    assert not TruthNoise.of(scene).std[:, 2:].any()
    vessels = {}
    for vessel in scene.vessels:
        sizes = {f"{name}_m": getattr(vessel, f"{name}_m") for name in ("length", "beam", "air_draft")}
        vessels[vessel.name] = {"messages": 10, "defaults": ["air_draft"], "replaced": {}, **sizes}
    vessels["v0"] |= {"defaults": ["length", "antenna", "air_draft"], "replaced": {"heading_from_course": 10}}
    vessels["v1"]["air_draft_m"] = 99.0  # the user has put another in the scene
    (tmp_path / REPORT).write_text(json.dumps({"vessels": vessels}))
    noise = TruthNoise.of(scene, 7.0)
    assert noise.position_m == 7.0
    assert noise.std[0, 2] == pytest.approx(np.radians(6))
    assert noise.std[2, 2] == pytest.approx(np.radians(1))
    assert noise.std[0, 3] == pytest.approx(0.3 * scene.vessels[0].length_m)
    assert noise.std[2, 3] == pytest.approx(np.sqrt(2 / 12))
    assert noise.std[1, 5] == 0
    assert noise.std[0, 6] > 0 == noise.std[2, 6]
    assert noise.reasons == {"length": 1, "antenna's place": 1, "air draft": len(scene.vessels) - 1}


def test_what_persists_of_truth_is_taken_off_what_persists_of_errors():
    gap_s, part, rest_s, rest_share = 0.5, np.array([0.3, 0.2]), 4.0, np.array([0.25, 0.1])
    seen = part + (1 - part) * np.exp(-gap_s / rest_s)
    time = Entry(Key(("persistence", "box_s")), Column(-gap_s / np.log(seen), "positive", np.array(9.0)))
    np.testing.assert_allclose(time_left(time, part, gap_s).column.values, rest_s, rtol=1e-9)
    share = Entry(Key(("persistence", "box_vessel_share")), Column(part + (1 - part) * rest_share, "capped", seen[0]))
    np.testing.assert_allclose(share_left(share, part).column.values, rest_share, rtol=1e-9)
    np.testing.assert_array_equal(time_left(time, 0 * part, gap_s).column.values, time.column.values)
    gone = time_left(time, np.array([0.95, 0.95]), gap_s).column.values
    assert gone[0] == 0
    assert gone[1] == pytest.approx(-gap_s / np.log(0.01))  # or intervals on a logarithmic scale have no end


def test_errors_that_last_come_back_with_their_time():
    scene = roads()
    steps, times = np.arange(scene.steps), scene.times_s(0, scene.steps)
    view, plain = view_of(scene, steps), tuple(set(RICHER) - {"persistence"})
    slow = replace(noise_of(scene, 5.0), position_s=1e5)
    labelled = noisy_set(scene, view, times, 0, 5.0, 1e5, np.diag([8.0, 2, 2, 2]) ** 2, box_s=6.0)
    learned = learned_from(labelled, 40, plain)
    found = take_off_truth_noise(learned, scene, [view], slow)
    before, after = (each.numbers.box_errors.box_s for each in (learned, found.learned))
    assert abs(after.estimate - 6) < abs(before.estimate - 6)
    low, high = after.column.interval(0.95, learned.units[None])
    assert low <= 6 <= high
    quick = take_off_truth_noise(learned, scene, [view], replace(slow, position_s=5.0))
    assert quick.learned.numbers.box_errors.box_s is before
    assert any("box_s: an upper bound" in said for said in quick.sentences())


def test_wrong_matches_among_the_measured_errors_do_not_pull(watched):
    scene, view, times = watched
    learned = learned_from(noisy_set(scene, view, times, 0, 0.0, LASTING_S, np.diag(STD_PX**2)), 20, RICHER)
    errors, sides = learned.numbers.box_errors.states[0], np.full((50, 4), 40.0)
    noise = np.tile(np.diag([4.0, 0.5, 0.5, 0.5]), (21, 1, 1))
    measured = np.tile(np.diag(0.99 * errors.std.estimate) ** 2, (21, 1, 1))
    std = [
        less_noise(errors, noise, sides, 0.95, each, np.full(4, np.nan)).errors.std.estimate
        for each in (None, measured, 30 * measured)
    ]
    assert std[1][0] == pytest.approx(np.sqrt(measured[0, 0, 0] - 4), rel=1e-6)
    np.testing.assert_allclose(std[2], std[0], rtol=1e-9)
    assert (std[2] < errors.std.estimate).all()


def test_one_component_far_from_the_law_leaves_the_others_as_measured(watched):
    """A vessel that is off its reports widens the tails of the law, which all components share."""
    scene, view, times = watched
    learned = learned_from(noisy_set(scene, view, times, 0, 0.0, LASTING_S, np.diag(STD_PX**2)), 20, RICHER)
    errors, sides = learned.numbers.box_errors.states[0], np.full((50, 4), 40.0)
    noise = np.tile(np.diag(0.1 * errors.std.estimate**2), (21, 1, 1))
    measured = np.tile(np.diag(np.array([3, 0.9, 0.9, 0.9]) * errors.std.estimate) ** 2, (21, 1, 1))
    found = less_noise(errors, noise, sides, 0.95, measured, np.full(4, np.nan))
    share = np.sqrt(np.array([1, 0.81, 0.81, 0.81]) - 0.1)
    np.testing.assert_allclose(found.errors.std.estimate, share * errors.std.estimate, rtol=1e-6)


def test_wide_tails_of_a_law_are_no_errors_of_the_detector(watched):
    scene, view, times = watched
    learned = learned_from(noisy_set(scene, view, times, 0, 0.0, LASTING_S, np.diag(STD_PX**2)), 20, RICHER)
    errors, sides = learned.numbers.box_errors.states[0], np.full((50, 4), 40.0)
    noise = np.tile(np.diag(0.8 * errors.std.estimate**2), (21, 1, 1))
    measured = np.tile(np.diag(0.7 * errors.std.estimate**2), (21, 1, 1))
    taken = [less_noise(errors, noise, sides, 0.95, each, np.full(4, np.nan)).taken_off for each in (None, measured)]
    assert taken[0].any()
    assert not taken[1].any()


def test_mixed_errors_lose_the_mean_covariance_of_truth(watched):
    scene, view, times = watched
    learned = learned_from(noisy_set(scene, view, times, 0, 0.0, LASTING_S, np.diag(STD_PX**2)), 20, RICHER)
    errors, sides = learned.numbers.box_errors.states[0], np.random.default_rng(0).uniform(20, 200, (500, 4))
    growth = replace(errors.std, column=replace(errors.std.column, values=0.02 + 0 * errors.std.column.values))
    mixed = replace(errors, unit="mixed", growth=growth)
    noise = np.tile(np.diag([4.0, 1.0, 1.0, 1.0]) + 0.3, (21, 1, 1))
    found = less_noise(mixed, noise, sides, 0.95, None, np.full(4, np.nan))
    assert found.taken_off.all()

    def mean_covariance(law):
        std = law.std.estimate + law.growth.estimate * sides
        matrix = np.eye(4)
        i, j = np.triu_indices(4, 1)
        matrix[i, j] = matrix[j, i] = law.correlation.estimate
        return (std[:, :, None] * std[:, None, :] * matrix).mean(axis=0)

    np.testing.assert_allclose(mean_covariance(found.errors), mean_covariance(mixed) - noise[0], rtol=1e-9, atol=1e-9)
