"""Where vessels are beyond the ends of their tracks, how fast, and what a lens shows of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from modsim3d.learn.voyage.registration.boxes_at_times import predict
from modsim3d.learn.voyage.registration.model import BoxModel, HidingBodies, KnownTraffic
from modsim3d.learn.voyage.registration.parameters import Values
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene
from modsim3d.world.poses.base import Poses
from modsim3d.world.poses.replay import RecordedPoses

FERRY, FIRST, LAST = 1, 60, 240
QUAY = 1


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("strait", settings={"annotation.source": "analytic", "waves.apply_to": "ownship"})


def with_places(
    scene: Scene, present: np.ndarray, positions_m: np.ndarray, headings_rad: np.ndarray | None = None
) -> KnownTraffic:
    headings = scene.poses.poses(0, scene.steps).headings_rad if headings_rad is None else headings_rad
    poses = RecordedPoses(scene.poses.timestamps, Poses(present, positions_m, headings))
    changed = replace(scene, poses=poses)
    return KnownTraffic.of(changed, changed.cameras[QUAY])


@pytest.fixture(scope="module")
def cut(scene: Scene) -> KnownTraffic:
    """The ferry is there from step 60 to 240 of 300 alone; where it is absent, its place is written as 0."""
    known = scene.poses.poses(0, scene.steps)
    present, positions = known.present.copy(), known.positions_m.copy()
    present[:FIRST, FERRY] = present[LAST + 1 :, FERRY] = False
    positions[~present] = 0
    return with_places(scene, present, positions)


def test_a_vessel_goes_on_beyond_the_ends_of_its_track_but_is_not_there(scene: Scene, cut: KnownTraffic) -> None:
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


def test_mean_speeds_do_not_follow_the_errors_of_reports(scene: Scene) -> None:
    known = scene.poses.poses(0, scene.steps)
    noise = np.random.default_rng(0).normal(0, 0.5, known.positions_m.shape)
    noisy, exact = (with_places(scene, known.present, known.positions_m + each) for each in (noise, 0 * noise))
    times, ferry = np.linspace(5, 55, 20), np.full(20, FERRY)
    found = noisy.velocities(times, ferry)
    np.testing.assert_allclose(found, exact.velocities(times, ferry), atol=0.08)
    np.testing.assert_allclose(found[:, 0], 4.5, atol=0.2)
    assert np.abs(found[:, 1]).max() < 0.2


def test_a_vessel_that_turns_within_the_time_of_a_mean_keeps_its_speed_ahead(scene: Scene) -> None:
    known, times_s = scene.poses.poses(0, scene.steps), scene.times_s(0, scene.steps)
    radius_m, speed_m_s = 15.0, 3.0
    positions, headings = known.positions_m.copy(), known.headings_rad.copy()
    turned_rad = speed_m_s / radius_m * times_s
    positions[:, FERRY, :2] = radius_m * np.column_stack([np.sin(turned_rad), -np.cos(turned_rad)])
    headings[:, FERRY] = turned_rad
    traffic = with_places(scene, known.present, positions, headings)
    found = traffic.velocities(np.linspace(0, times_s[-1], 20), np.full(20, FERRY))
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
    traffic = with_places(scene, present, positions, headings)
    times, ferry = np.linspace(0, times_s[-1], 20), np.full(20, FERRY)
    np.testing.assert_allclose(traffic.velocities(times, ferry), np.tile([5.0, 0.0], (20, 1)), atol=0.15)
    np.testing.assert_allclose(np.cos(traffic.at(np.array([31.0]), ferry[:1])[1][0, 0, 0]), np.cos(-1.0), atol=0.01)


def test_a_point_that_k1_folds_into_the_image_is_no_edge_to_go_by(scene: Scene) -> None:
    model = BoxModel.of(scene, KnownTraffic.of(scene, scene.cameras[QUAY]))
    none, times = Values.none(len(model.hulls_m)), np.linspace(0, 59, 60)
    folded = predict(model, HidingBodies.of(scene, model), none.changed(k1=-0.25), times)
    by_lens = model.pixels(none, times[folded.frame], folded.vessel, folded.corners_m)
    far = np.any(np.abs(by_lens / scene.cameras[QUAY].intrinsics.image_size_px - 0.5) > 1, axis=-1)
    assert far.sum() > 10
    assert folded.usable.sum() > 100
    assert not np.any(folded.usable & far)
