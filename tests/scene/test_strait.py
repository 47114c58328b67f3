"""The strait: meshes, obstacles, waves and two cameras of different rates in one shipped scene."""

from itertools import combinations

import numpy as np
import pytest
import shapely
import yaml

from modsim3d.io.input_files import data_folder
from modsim3d.runs.pipeline import truth_block
from modsim3d.scene.reading import load_scene
from modsim3d.verify.sources.compare import compare_sources
from tests.scenes import footprints


@pytest.fixture(scope="module")
def scene():
    return load_scene("strait")


@pytest.fixture(scope="module")
def hulls(scene):
    """Rectangles of all vessels at every fifth step, shape (S, V)."""
    assert scene.poses.poses(0, scene.steps).present.all()
    return footprints(scene, np.arange(0, scene.steps, 5))


def test_no_two_vessels_ever_touch(hulls):
    first, second = np.array(list(combinations(range(hulls.shape[1]), 2))).T
    assert shapely.distance(hulls[:, first], hulls[:, second]).min() > 5


def test_no_vessel_touches_land_or_the_bridge(scene, hulls):
    keys = yaml.safe_load((data_folder("scenes") / "strait.yaml").read_text(encoding="utf-8"))["obstacles"]
    highest = max(vessel.air_draft_m for vessel in scene.vessels)
    for name, obstacle in keys.items():
        if obstacle.get("base_m", 0) > highest + 3:
            assert name == "bridge_deck"
            assert shapely.intersects(hulls, shapely.Polygon(obstacle["polygon_m"])).any()  # they pass below it
            continue
        assert shapely.distance(hulls, shapely.Polygon(obstacle["polygon_m"])).min() > 5, name


def test_every_shipped_mesh_is_there_and_obstacles_and_own_hull_hide(scene, renderer):
    vessels = yaml.safe_load((data_folder("scenes") / "strait.yaml").read_text(encoding="utf-8"))["vessels"]
    shapes = {"ferry", "sailboat", "motorboat", "fishing_vessel", "container_ship", "kayak"}
    assert {entry.get("mesh") for entry in vessels.values()} == {*shapes, None}
    hiders = set()
    for first in range(0, scene.steps, 20):
        truth = truth_block(scene, first, first + 2, renderer)
        hiders |= {scene.occluder_names[index] for index in truth.occluder}
    assert hiders >= {"ferry", "container_ship", "obstacle:breakwater", "obstacle:north_island"}
    outlines = scene.sight(scene.cameras[0], np.arange(3)).outlines()
    own = outlines.occluder == scene.vessel_names.index("own")
    assert own.sum() == 3 and not outlines.boxed[own].any()  # its own foredeck, in each frame


def test_the_cameras_run_at_their_own_rates(scene):
    bow, quay = (scene.frame_steps(camera, 0, scene.steps).tolist() for camera in scene.cameras)
    assert len(bow) == 300 and quay == list(range(1, 300, 2))


def test_compare_finds_nothing_unexplained(scene, renderer):
    figures = compare_sources(scene, renderer, every=20).figures
    assert (figures.frames, figures.unexplained) == (15 + 8, 0) and figures.vessel_frames > 80
