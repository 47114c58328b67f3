"""On a curved sea what is far away lies lower; on a flat one a run says where that would be seen."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from modsim3d.geometry.camera import Distortion, Intrinsics
from modsim3d.geometry.camera_poses import Mount, poses_ashore
from modsim3d.geometry.curved_sea import RADIUS_M, drop_m, horizon_inverse_range, inverse_range, look, lowered, shift_px
from modsim3d.runs.pipeline import simulate_frames
from modsim3d.scene.reading import load_scene
from modsim3d.verify.sources.compare import compare_sources
from tests.scenes import camera_keys, write_scene

LONG_LENS = camera_keys(1800, 1200, focal_length_m=0.05, pose={"position_m": [0, 0, 20]})
HULL_M = [40, 10, 12]
SHIPS = {"near": (HULL_M, [[0, 2000, 50], [10, 2000, 60]]), "far": (HULL_M, [[0, 5000, -100], [10, 5000, -90]])}


def far_scene(folder, steps=4, **keys):
    keys = {"cameras": {"C0": LONG_LENS}, "annotation": {"mode": 0, "source": "analytic"}, **keys}
    return write_scene(folder, SHIPS, steps, **keys)


def test_two_metres_of_drop_at_five_kilometres_and_the_shift_counts_by_the_larger_focal_length():
    # By hand: 5000² / (2 · 6 371 000) = 25 000 000 / 12 742 000 = 1.962 m
    place, camera = np.array([3000.0, 4000.0, 7.0]), np.array([0.0, 0.0, 20.0])
    assert drop_m(place, camera) == pytest.approx(1.962, abs=5e-4)
    # The exact sphere, R − √(R² − d²), is the same to a hundredth of a millimetre.
    exact = RADIUS_M - np.sqrt(RADIUS_M**2 - 5000.0**2)
    assert drop_m(place, camera) == pytest.approx(exact, abs=1e-5)
    for shift in ([900.0, -700.0, 0.0], [0.0, 0.0, 30.0]):
        assert drop_m(place + shift, camera + shift) == pytest.approx(drop_m(place, camera), rel=1e-12)
    assert drop_m(camera, camera) == 0
    places, whole = np.array([[3000, 4000, 7], [0, 100, 0]]), np.array([0, 0, 20])  # whole numbers are places too
    lower = places - np.multiply.outer(drop_m(places, whole), [0, 0, 1])
    np.testing.assert_array_equal(lowered(places, whole), lower)
    # By hand: 6000 · 12 742 / (2 · 6 371 000) = 6.
    for focal in ((6000.0, 900.0), (900.0, 6000.0)):
        assert shift_px(np.array([12_742.0]), focal) == pytest.approx([6.0])
    # By hand: f = 0.05 m / 0.01 mm = 5000 px, and 5000 d / 12 742 000 = 1 at d = 2548.4 m. Its vessels are within
    # 489 m of (1000, 1000), so at most 1933 m away: 0.76 px. Nothing is warned of.
    focal = load_scene("simulation_1", steps=1).cameras[0].intrinsics.focal_px
    assert focal == pytest.approx((5000.0, 5000.0))
    assert shift_px(np.array([2548.0, 2549.0, 1933.0]), focal) == pytest.approx([1.0, 1.0, 0.7585], abs=3e-4)


def test_boxes_on_a_curved_sea_are_lower_by_what_the_formula_says_and_sources_agree(tmp_path, renderer):
    flat, curved = (list(simulate_frames(load_scene(far_scene(tmp_path, sea=sea)))) for sea in ("flat", "curved"))
    for a, b in zip(flat, curved, strict=True):
        assert a.truth.vessels == b.truth.vessels == ("near", "far")
        moved = b.truth.full_boxes_px - a.truth.full_boxes_px
        np.testing.assert_allclose(moved[:, [0, 2]], 0, atol=1e-9)
        distances = np.array([np.hypot(2000, 55), np.hypot(5000, 95)])
        # The bottom corners nearest to the camera are 5 m nearer than the centre that gives the drop.
        expected = 5000 * distances**2 / (2 * RADIUS_M) / (np.array([2000.0, 5000.0]) - 5)
        np.testing.assert_allclose(moved[:, 3], expected, rtol=2e-3)
        assert expected[1] > 1.9
    island = {"polygon_m": [[3000, -200], [3030, -200], [3010, 30]], "height_m": 9}
    keys = {"sea": "curved", "obstacles": {"rock": island}, "annotation": {"mode": 2, "source": "rendered"}}
    figures = compare_sources(load_scene(far_scene(tmp_path, **keys)), renderer).figures
    assert (figures.vessel_frames, figures.unexplained) == (8, 0) and figures.occluded > 0


def test_obstacles_are_lowered_by_their_centre_and_own_ship_is_not(tmp_path):
    island = {"polygon_m": [[5990, -30], [6010, -30], [6010, 30], [5990, 30]], "height_m": 30}
    mounted = {key: value for key, value in LONG_LENS.items() if key != "pose"}
    mounted["mount"] = {"vessel": "near", "position_m": [-30, 0, 40]}
    keys = {"cameras": {"C0": mounted}, "obstacles": {"rock": island}}
    scenes = [load_scene(far_scene(tmp_path, sea=sea, **keys)) for sea in ("flat", "curved")]
    before, after = (scene.sight(scene.cameras[0], np.arange(3)) for scene in scenes)
    np.testing.assert_array_equal(before.camera_poses.positions_m, after.camera_poses.positions_m)
    own, other = (before.poses.positions_m - after.poses.positions_m)[..., 2].T
    assert (own == 0).all()
    places = before.poses.positions_m[:, 1]
    np.testing.assert_allclose(other, drop_m(places, before.camera_poses.positions_m), rtol=1e-12)
    (rock,) = after._obstacle_bodies()
    expected = drop_m(np.array([6000.0, 0.0]), before.camera_poses.positions_m)
    np.testing.assert_allclose(rock.positions_m[:, 0, 2], -expected)
    assert np.all(rock.positions_m[:, 0, :2] == 0)


def test_run_warns_once_with_how_many_and_how_far(call, tmp_path, monkeypatch):
    monkeypatch.setattr("modsim3d.runs.pipeline.MAX_BLOCK_STEPS", 1)  # over several blocks

    def said(sea):
        status, text = call("run", far_scene(tmp_path, sea=sea), "--out", tmp_path / sea, "--no-sheet")
        assert status == 0
        return text, json.loads((tmp_path / sea / "run.json").read_text())["counts"]

    out, counts = said("flat")
    # `far` in each of four frames, by 5000 px · 5000 m / 12 742 000 m = 1.96 px; `near` by 0.8 px is not worth a word.
    assert "the sea is flat: 4 of 8 vessels in images are drawn too high, by up to 2.0 px; set sea: curved" in out
    assert counts["off_by_curvature"] == 4
    assert counts["largest_curvature_px"] == pytest.approx(1.962, abs=1e-3)
    out, counts = said("curved")
    assert "sea" not in out and (counts["off_by_curvature"], counts["largest_curvature_px"]) == (0, 0)


BROWN = Distortion(k1=-0.12, k2=0.03, p1=0.001, p2=-0.002)
PINHOLE = Intrinsics((1000.0, 900.0), (640.0, 400.0), (1280, 800), skew=3.0)
DISTORTED = Intrinsics((1000.0, 900.0), (640.0, 400.0), (1280, 800), distortion=BROWN)
ANGLES = st.tuples(st.floats(-0.3, 0.3), st.floats(-0.05, 0.1), st.floats(-3.1, 3.1))  # roll, pitch and yaw


@pytest.mark.parametrize("lens", [PINHOLE, DISTORTED], ids=["pinhole", "distorted"])
@pytest.mark.parametrize("curved", [False, True])
@given(angles_rad=ANGLES, offset_rad=st.floats(-0.4, 0.4), range_m=st.floats(20, 4000), height_m=st.floats(2, 40))
def test_a_point_of_the_sea_is_found_again(lens, curved, angles_rad, offset_rad, range_m, height_m) -> None:
    bearing = angles_rad[2] + offset_rad
    poses = poses_ashore(Mount((5.0, -3.0, height_m), *angles_rad), 1)
    point = poses.positions_m * [1, 1, 0] + range_m * np.array([[math.cos(bearing), math.sin(bearing), 0.0]])
    if curved:
        point = lowered(point, poses.positions_m)
    found = look(lens, poses, lens.project(poses.to_camera(point)))
    assert math.remainder(found[0, 0] - bearing, math.tau) == pytest.approx(0, abs=1e-8)
    horizon = horizon_inverse_range(np.array([height_m]), curved=curved)
    assert inverse_range(found[:, 1], horizon)[0] == pytest.approx(1 / range_m, rel=1e-5)


@given(st.floats(1, 60), st.lists(st.floats(-3, 6), min_size=2, max_size=20, unique=True))
def test_inverse_range_ascends_through_the_horizon_without_a_jump(height_m: float, in_horizons: list[float]) -> None:
    horizon = horizon_inverse_range(np.array(height_m), curved=True)
    flat = np.sort(in_horizons) * horizon
    found = inverse_range(flat, np.broadcast_to(horizon, flat.shape))
    assert (np.diff(found)[np.diff(flat) > 1e-9 * horizon] > 0).all()
    at = inverse_range(np.array([2 * horizon, 2 * horizon * (1 + 1e-12)]), np.full(2, horizon))
    np.testing.assert_allclose(at, horizon, rtol=1e-5)
    below = found > horizon
    np.testing.assert_allclose(found[below] + 1 / (2 * RADIUS_M * height_m * found[below]), flat[below], rtol=1e-9)


def test_the_horizon_is_where_the_textbook_has_it_and_above_it_the_inverse_range_of_a_flat_sea_is_negative() -> None:
    # d = √(2 R h): from 20 m, 15.96 km
    assert 1 / horizon_inverse_range(np.array([20.0]), curved=True)[0] == pytest.approx(15_964, abs=1)
    assert horizon_inverse_range(np.array([20.0]), curved=False)[0] == 0
    up, down = np.array([[640.0, 300.0]]), np.array([[640.0, 500.0]])
    afloat, sunk = (poses_ashore(Mount((0.0, 0.0, height_m)), 1) for height_m in (5.0, -1.0))
    assert look(PINHOLE, afloat, up)[0, 1] < 0 < look(PINHOLE, afloat, down)[0, 1]
    low = poses_ashore(Mount((0.0, 0.0, 0.5)), 1)  # which sees the same ray meet the sea at a tenth of the distance
    assert 0.5 * look(PINHOLE, low, down)[0, 1] == pytest.approx(5.0 * look(PINHOLE, afloat, down)[0, 1])
    assert 1 / horizon_inverse_range(np.array([0.5]), curved=True)[0] == pytest.approx(2524, abs=1)
    # Under water there is none.
    assert np.isnan(horizon_inverse_range(np.array([-1.0, 0.0]), curved=True)).all()
    assert np.isnan(look(PINHOLE, sunk, down)[0, 1])
    straight_down = poses_ashore(Mount((0.0, 0.0, 5.0), pitch_rad=math.pi / 2), 1)
    assert not look(PINHOLE, straight_down, np.array([[640.0, 400.0]]))[0, 1] < 1e6  # NaN, or right below
