"""The boxes of the model, and what hides their edges, against the truth of the same scene; vessels beyond the ends of
their tracks, how fast they are, and what a lens shows of them."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.voyages.wrong_camera import Voyage, really
from modsim3d import Scene, load_scene
from modsim3d.learn.voyage.registration.icp import BoxesAtTimes, match, predict
from modsim3d.learn.voyage.registration.model import BoxModel, HidingBodies, KnownTraffic, crosses, planes_of
from modsim3d.learn.voyage.registration.parameters import Values
from modsim3d.truth.record import Truth
from modsim3d.world.poses.replay import RecordedPoses

QUAY, FERRY, FIRST, LAST = 1, 1, 60, 240


@pytest.fixture(scope="module")
def quay() -> Voyage:
    return Voyage.of(load_scene("strait", settings={"annotation.source": "analytic"}), "quay", {})


@pytest.fixture(scope="module")
def model(quay: Voyage) -> BoxModel:
    return BoxModel.of(quay.scene, KnownTraffic.of(quay.scene, quay.scene.cameras[0]))


@pytest.fixture(scope="module")
def none(model: BoxModel) -> Values:
    return Values.none(len(model.hulls_m))


def times_of(quay: Voyage, truth: Truth) -> np.ndarray:
    return quay.scene.times_s(0, quay.scene.steps)[truth.step]


def test_boxes_and_hidden_edges_are_those_of_the_truth_where_the_image_does_not_cut_them(quay, model, none) -> None:
    whole = quay.truth.take(quay.truth.in_frame_fraction == 1)
    boxes, corners = model.boxes(none, times_of(quay, whole), whole.vessel)
    assert len(whole) > 200
    np.testing.assert_allclose(boxes, whole.full_boxes_px, atol=1e-6)
    np.testing.assert_allclose(model.edges(none, times_of(quay, whole), whole.vessel, corners), boxes)
    known = quay.truth.take(np.isfinite(quay.truth.visible_boxes_px).all(axis=1))
    gone = np.abs(known.full_boxes_px - known.visible_boxes_px) > 1
    predicted = predict(model, HidingBodies.of(quay.scene, model), none, np.unique(times_of(quay, known)))
    frame = np.searchsorted(np.unique(known.step), known.step)
    rows = {pair: row for row, pair in enumerate(zip(predicted.frame.tolist(), predicted.vessel.tolist(), strict=True))}
    pairs = list(zip(frame.tolist(), known.vessel.tolist(), strict=True))
    # A vessel is not predicted if all its edges are behind the box around another, whose mesh may show some of it.
    usable = np.array([predicted.usable[rows[pair]] if pair in rows else np.zeros(4, bool) for pair in pairs])
    assert np.mean([pair in rows for pair in pairs]) > 0.99 and gone.sum() > 30
    assert not np.any(usable & gone) and usable.mean() > 0.6


def test_parameters_do_what_changing_the_camera_or_a_vessel_does(quay, model, none) -> None:
    changes = {"roll_deg": 2.0, "pitch_deg": -1.0, "yaw_deg": 3.0, "height_m": 2.0, "focal_share": 0.05}
    real = really(quay.scene, "quay", changes)
    times_s, vessel = np.repeat([5.0, 20.0], 9), np.tile(np.arange(9), 2)
    expected, _ = BoxModel.of(real, KnownTraffic.of(real, real.cameras[0])).boxes(none, times_s, vessel)
    found, _ = model.boxes(none.changed(clock_s=1.5, **changes), times_s - 1.5, vessel)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    # A delayed vessel is where it reports to be later, and an antenna is off its centre.
    times_s, vessel, values = np.array([10.0]), np.array([3]), Values.none(len(model.hulls_m))
    values.vessels[3] = 4.0, 1.0, 2.0
    (point,) = model.points_world(values, times_s, vessel, np.zeros((1, 1, 3)))[0]
    (late, rotation) = (part[0] for part in model.traffic.at(times_s + 2.0, vessel))
    np.testing.assert_allclose(point, late - rotation @ (4.0, 1.0, 0.0))


def test_two_vessels_that_a_detection_may_be_are_not_matched(model, quay, none) -> None:
    time_s = np.array([10.0])
    predicted = predict(model, HidingBodies.of(quay.scene, model), none, time_s)
    box, gates = predicted.boxes_px[:1], np.full((len(predicted.frame), 2), 50.0)
    found = BoxesAtTimes(time_s, np.array([0]), box)
    assert match(found, predicted, (1920, 1080), gates).vessel.tolist() == predicted.vessel[:1].tolist()
    twice = BoxesAtTimes(time_s, np.array([0, 0]), np.concatenate([box - 5, box + 5]))
    assert not len(match(twice, predicted, (1920, 1080), gates))


def test_a_ray_is_hidden_by_a_solid_on_its_way_and_by_none_before_or_behind_it() -> None:
    block = planes_of(np.array([(x, y, z) for x in (4.0, 6.0) for y in (-1.0, 1.0) for z in (0.0, 3.0)]))
    assert block is not None
    ends = np.array([[10.0, 0.0, 1.0], [3.0, 0.0, 1.0], [10.0, 5.0, 1.0], [10.0, 0.0, 9.0], [-10.0, 0.0, 1.0]])
    assert crosses(np.zeros((5, 3)), ends, block).tolist() == [True, False, False, False, False]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("strait", settings={"annotation.source": "analytic", "waves.apply_to": "ownship"})


def with_places(scene: Scene, **changes: np.ndarray) -> KnownTraffic:
    poses = replace(scene.poses.poses(0, scene.steps), **changes)
    changed = replace(scene, poses=RecordedPoses(scene.poses.timestamps, poses))
    return KnownTraffic.of(changed, changed.cameras[QUAY])


def test_a_vessel_goes_on_beyond_the_ends_of_its_track_but_is_not_there(scene: Scene) -> None:
    """The ferry is there from step 60 to 240 of 300 alone; where it is absent, its place is written as 0."""
    known = scene.poses.poses(0, scene.steps)
    present, positions = known.present.copy(), known.positions_m.copy()
    present[:FIRST, FERRY] = present[LAST + 1 :, FERRY] = False
    positions[~present] = 0
    cut = with_places(scene, present=present, positions_m=positions)
    steps_s = scene.times_s(0, scene.steps)
    whole = KnownTraffic.of(scene, scene.cameras[QUAY])
    times = np.array([steps_s[FIRST] - 2.0, steps_s[FIRST], steps_s[LAST], steps_s[LAST] + 2.0])
    ferry = np.full(4, FERRY)
    np.testing.assert_allclose(cut.at(times, ferry)[0], whole.at(times, ferry)[0], atol=0.05)
    assert cut.there(times, ferry).tolist() == [False, True, True, False]
    ends = np.array([-1.0, 0.0, steps_s[-1], steps_s[-1] + 1.0])
    assert whole.there(ends, ferry).tolist() == [False, True, True, False]
    moved = np.diff(whole.at(ends, ferry)[0], axis=0)
    assert np.linalg.norm(moved[[0, 2]], axis=1) == pytest.approx([4.5, 4.5], abs=0.3)


def test_mean_speeds_do_not_follow_the_errors_of_reports_and_are_ahead_in_a_turn(scene: Scene) -> None:
    known, times_s = scene.poses.poses(0, scene.steps), scene.times_s(0, scene.steps)
    noise = np.random.default_rng(0).normal(0, 0.5, known.positions_m.shape)
    noisy, exact = (with_places(scene, positions_m=known.positions_m + each) for each in (noise, 0 * noise))
    times, ferry = np.linspace(5, 55, 20), np.full(20, FERRY)
    found = noisy.velocities(times, ferry)
    np.testing.assert_allclose(found, exact.velocities(times, ferry), atol=0.08)
    np.testing.assert_allclose(found[:, 0], 4.5, atol=0.2)
    assert np.abs(found[:, 1]).max() < 0.2
    positions, headings, radius_m, speed_m_s = known.positions_m.copy(), known.headings_rad.copy(), 15.0, 3.0
    turned_rad = speed_m_s / radius_m * times_s  # within the time of a mean
    positions[:, FERRY, :2] = radius_m * np.column_stack([np.sin(turned_rad), -np.cos(turned_rad)])
    headings[:, FERRY] = turned_rad
    turning = with_places(scene, positions_m=positions, headings_rad=headings)
    found = turning.velocities(np.linspace(0, times_s[-1], 20), ferry)
    np.testing.assert_allclose(found, np.tile([speed_m_s, 0.0], (20, 1)), atol=0.01)


def test_a_vessel_that_heads_west_and_is_away_for_a_while_does_not_turn_meanwhile(scene: Scene) -> None:
    """Where it is absent its heading is written as 0, between others to either side of ±π."""
    known, times_s = scene.poses.poses(0, scene.steps), scene.times_s(0, scene.steps)
    present, positions, headings = known.present.copy(), known.positions_m.copy(), known.headings_rad.copy()
    positions[:, FERRY, :2] = np.column_stack([-5.0 * times_s, 0 * times_s])
    headings[:, FERRY] = np.where(times_s < 30, np.pi - 0.02, 0.02 - np.pi)
    away = (times_s > 28) & (times_s < 34)
    present[away, FERRY] = False
    headings[away, FERRY] = 0
    traffic = with_places(scene, present=present, positions_m=positions, headings_rad=headings)
    times, ferry = np.linspace(0, times_s[-1], 20), np.full(20, FERRY)
    np.testing.assert_allclose(traffic.velocities(times, ferry), np.tile([5.0, 0.0], (20, 1)), atol=0.15)
    np.testing.assert_allclose(np.cos(traffic.at(np.array([31.0]), ferry[:1])[1][0, 0, 0]), np.cos(-1.0), atol=0.01)


def test_a_point_that_k1_folds_into_the_image_is_no_edge_to_go_by(scene: Scene) -> None:
    model = BoxModel.of(scene, KnownTraffic.of(scene, scene.cameras[QUAY]))
    none, times = Values.none(len(model.hulls_m)), np.linspace(0, 59, 60)
    folded = predict(model, HidingBodies.of(scene, model), none.changed(k1=-0.25), times)
    by_lens = model.pixels(none, times[folded.frame], folded.vessel, folded.corners_m)
    far = np.any(np.abs(by_lens / scene.cameras[QUAY].intrinsics.image_size_px - 0.5) > 1, axis=-1)
    assert far.sum() > 10 and folded.usable.sum() > 100
    assert not np.any(folded.usable & far)
