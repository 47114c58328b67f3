"""The basin of Simulations 2 and 3: made by agents that never touch, shipped, and run."""

import gzip
import json
import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import shapely

from modsim3d.core.errors import InputError
from modsim3d.io.input_files import data_folder
from modsim3d.scene.reading import load_scene
from modsim3d.verify.sources.compare import compare_sources
from modsim3d.world.poses.agents import AgentsKeys, drive_agents
from modsim3d.world.vessels import Vessel
from tests.scenes import rectangles

ROOT = Path(__file__).resolve().parents[2]
BASIN = data_folder("scenes") / "basin"


@pytest.fixture(scope="module")
def scene():
    return load_scene("simulation_2")


def hulls_of(poses):
    return rectangles(poses.positions_m[..., :2], poses.headings_rad, (8.0, 4.0))


def closest_m(hulls):
    first, second = np.triu_indices(hulls.shape[1], 1)
    return shapely.distance(hulls[:, first], hulls[:, second]).min()


def test_no_two_boxes_ever_intersect_and_none_leaves_the_basin(scene):
    hulls = hulls_of(scene.poses.poses(0, scene.steps))
    assert hulls.shape == (5000, 6)
    assert closest_m(hulls) > 0.5
    assert shapely.within(hulls, shapely.box(0, 0, 150, 70)).all()


def test_vessels_drive_and_turn(scene):
    poses = scene.poses.poses(0, scene.steps)
    step = np.diff(poses.positions_m[..., :2], axis=0)
    assert (np.linalg.norm(step, axis=-1).sum(axis=0) > 400).all()  # in 500 s
    assert (np.abs(np.diff(poses.headings_rad, axis=0)).sum(axis=0) > 4 * np.pi).all()
    ahead = np.stack([np.cos(poses.headings_rad), np.sin(poses.headings_rad)], -1)[:-1]
    assert ((step * ahead).sum(-1) > -0.01).all()  # never astern


def test_agents_are_repeatable_and_never_touch_in_a_crowd_and_those_that_do_not_fit_are_an_error():
    boats = [Vessel(f"v{i}", "Vessel", 8, 4, 1) for i in range(30)]
    keys = AgentsKeys(size_m=(80, 50))
    paths = [drive_agents(boats[:3], 30, 0.1, keys, seed).recorded.positions_m for seed in (1, 1, 2)]
    np.testing.assert_array_equal(paths[0], paths[1])
    assert (paths[0] != paths[2]).any()
    assert closest_m(hulls_of(drive_agents(boats[:7], 150, 0.1, AgentsKeys(size_m=(60, 40)), 4).recorded)) > 0
    with pytest.raises(InputError, match="no free place for vessel"):
        drive_agents(boats, 1, 0.1, AgentsKeys(size_m=(20, 20)), 0)


def test_first_steps_of_the_shipped_file_are_what_the_agents_drive(scene):
    make = SimpleNamespace(**runpy.run_path(str(ROOT / "script" / "make_basin")))
    driven = drive_agents(make.VESSELS, 200, make.TIME_STEP_S, make.BASIN, make.SEED).recorded
    shipped = scene.poses.poses(0, 200)
    np.testing.assert_allclose(shipped.positions_m, driven.positions_m, atol=6e-4)
    np.testing.assert_allclose(shipped.headings_rad, driven.headings_rad, atol=6e-6)


def test_simulation_2_follows_the_tables_and_its_file_is_the_source_s_json(scene):
    assert (scene.steps, scene.timestamps(0, 3)) == (5000, ("0.0", "0.1", "0.2"))
    (camera,) = scene.cameras
    np.testing.assert_allclose(camera.intrinsics.focal_px, (2370, 0.0237 / 0.83e-5))
    assert (camera.mount.vessel, camera.mount.position_m) == ("vehicle1", (4, 0, 1))
    assert camera.mount.pitch_rad == pytest.approx(np.pi / 200)
    poses = json.loads(gzip.decompress((BASIN / "poses.json.gz").read_bytes()))
    assert list(poses)[:2] == ["0.0", "0.1"]
    assert set(poses["0.0"]) == {f"vehicle{i}" for i in range(1, 7)}
    assert set(poses["0.0"]["vehicle1"]) == {"center_position_m", "heading_rad"}
    assert (BASIN / "poses.json.gz").stat().st_size < 1_000_000


def test_cameras_of_simulation_3_overlap_and_share_a_vessel_that_rolls_the_same_for_both():
    scene, steps = load_scene("simulation_3", steps=300), np.arange(0, 300, 7)
    left, right = scene.cameras
    assert left.mount.vessel == right.mount.vessel == "vehicle1"
    assert left.mount.yaw_rad == -right.mount.yaw_rad == pytest.approx(np.pi / 8)
    half_view = np.degrees(np.arctan(1232 / left.intrinsics.focal_px[0]))
    assert (2 * half_view, 2 * (half_view - 22.5)) == pytest.approx((55, 10), abs=0.1)
    port, starboard = (scene.sight(camera, steps).camera_poses for camera in scene.cameras)
    between = port.camera_R_world @ np.swapaxes(starboard.camera_R_world, 1, 2)
    np.testing.assert_allclose(between, np.broadcast_to(between[0], between.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(port.positions_m - starboard.positions_m, axis=1), 4.0)


@pytest.mark.parametrize("name", ["simulation_2", "simulation_3"])
def test_rendered_and_analytic_truth_agree_in_the_basin(renderer, name):
    figures = compare_sources(load_scene(name, steps=1500, mode=2), renderer, every=15).figures
    assert figures.vessel_frames > 50 and figures.occluded > 0 and figures.unexplained == 0


def test_waves_of_all_vessels_turn_their_boxes():
    turned = []
    for apply_to in ("ownship", "all"):
        scene = load_scene("simulation_2", steps=300, settings={"waves.level": "huge", "waves.apply_to": apply_to})
        turned.append(scene.sight(scene.cameras[0], np.array([100, 200])).world_R_vessel)
    assert (turned[0][:, 0, 2, :2] != 0).all()  # own ship, in anybody's picture
    assert (turned[0][:, 1:, 2, :2] == 0).all()  # upright
    assert (turned[1][..., 2, :2] != 0).all()
