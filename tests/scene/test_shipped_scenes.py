"""Scenes as shipped: Simulation 1 by the source's tables, the harbour from its script, and the strait."""

import subprocess
import sys
from functools import cache
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest
import shapely
import yaml

from modsim3d.io.input_files import data_folder
from modsim3d.runs.pipeline import truth_block
from modsim3d.scene.reading import load_scene
from modsim3d.truth.rendered import rendered_occlusion
from modsim3d.verify.sources.compare import compare_sources
from modsim3d.world.poses.circular import swept_ring
from tests.scenes import footprints

SCENES = data_folder("scenes")
scene_named = cache(load_scene)


def keys_of(name):
    return yaml.safe_load((SCENES / f"{name}.yaml").read_text(encoding="utf-8"))


def test_simulation_1_follows_tables_9_4_and_9_5_of_the_source():
    """Jessen & Mohr (2023)."""
    simulation = scene_named("simulation_1")
    assert (simulation.steps, simulation.annotation.mode, simulation.detector.confidence_threshold) == (1500, 0, 0.2)
    assert simulation.timestamps(0, 4) == ("0.0", "0.2", "0.4", "0.6")
    sizes = [(v.air_draft_m, v.beam_m, v.length_m) for v in simulation.vessels]
    assert sizes == [(20, 4, 14)] * 2 + [(4, 3, 7)] * 3 and {v.label for v in simulation.vessels} == {"Vessel"}
    (camera,) = simulation.cameras
    lens, mount = camera.intrinsics, camera.mount
    assert (lens.image_size_px, lens.principal_point_px) == ((3600, 2400), (1800, 1200))
    np.testing.assert_allclose(lens.focal_px, (5000, 5000))
    angles_rad = mount.roll_rad, mount.pitch_rad, mount.yaw_rad
    assert (mount.position_m, angles_rad) == ((2444, 1000, 20), (0, 0.008, np.pi))
    assert [state.name for state in simulation.detector.states] == ["excellent", "good", "bad", "terrible"]
    ships = zip(simulation.poses.radii_m, simulation.vessels, strict=True)
    rings = sorted(swept_ring(radius, v.length_m, v.beam_m) for radius, v in ships)
    assert all(outer < inner for (_, outer), (inner, _) in pairwise(rings))  # hulls can never touch


def test_rendered_and_projected_full_boxes_agree_within_a_pixel_over_the_whole_simulation_1(renderer):
    simulation = scene_named("simulation_1")
    (camera,) = simulation.cameras
    worst, compared = 0.0, 0
    for first in range(0, simulation.steps, 250):
        outlines = simulation.sight(camera, np.arange(first, first + 250)).outlines()
        seen = rendered_occlusion(outlines, camera.intrinsics, renderer)
        difference = np.abs(seen.full_boxes_px - outlines.boxes_px)
        worst, compared = max(worst, float(difference.max())), compared + len(outlines)
    assert compared > 7000 and worst <= 1.0


def test_script_writes_the_very_harbour_that_is_shipped(tmp_path):
    script, written = Path(__file__).resolve().parents[2] / "script" / "make_harbour", tmp_path / "harbour.yaml"
    subprocess.run([sys.executable, script, written], check=True)
    assert written.read_bytes() == (SCENES / "harbour.yaml").read_bytes()


@pytest.mark.parametrize(("name", "apart_m"), [("harbour", 1), ("strait", 5)])
def test_vessels_are_there_throughout_and_no_two_ever_touch(name, apart_m):
    scene = scene_named(name)
    hulls = footprints(scene, np.arange(0, scene.steps, 5))
    assert scene.poses.poses(0, scene.steps).present.all()
    np.testing.assert_allclose(
        shapely.area(hulls), np.tile([v.length_m * v.beam_m for v in scene.vessels], (len(hulls), 1))
    )
    first, second = np.array(list(combinations(range(hulls.shape[1]), 2))).T
    assert shapely.distance(hulls[:, first], hulls[:, second]).min() > apart_m


def test_thirty_vessels_of_the_harbour_have_every_shipped_shape_from_kayak_to_large_ship():
    harbour = scene_named("harbour")
    lengths = [vessel.length_m for vessel in harbour.vessels]
    assert len(lengths) == 30 and min(lengths) < 5 and 200 < max(lengths) <= 300
    assert {vessel.name.rstrip("0123456789") for vessel in harbour.vessels} >= {"kayak", "yacht", "ferry", "ship"}
    meshes = yaml.safe_load((data_folder("meshes") / "meshes.yaml").read_text(encoding="utf-8"))
    assert {vessel.shape for vessel in harbour.vessels} == set(meshes)
    for vessel in harbour.vessels:  # about as the mesh was designed, by length
        designed = meshes[vessel.shape]
        for name in ("beam_m", "air_draft_m"):
            stretched = getattr(vessel, name) / vessel.length_m / (designed[name] / designed["length_m"])
            assert 0.7 < stretched < 1.45, (vessel.name, name, stretched)


def test_at_least_a_third_of_the_vessel_frames_in_the_harbour_are_partly_hidden(renderer):
    harbour = scene_named("harbour")
    truths = (truth_block(harbour, step, step + 1, renderer) for step in range(0, harbour.steps, 10))
    fractions = np.concatenate([truth.visible_fraction for truth in truths])
    assert len(fractions) > 500 and (fractions == 0).any()
    assert ((fractions > 0) & (fractions < 1)).mean() >= 1 / 3


def test_no_vessel_of_the_strait_touches_land_or_the_bridge():
    strait = scene_named("strait")
    hulls, highest = footprints(strait, np.arange(0, strait.steps, 5)), max(v.air_draft_m for v in strait.vessels)
    for name, obstacle in keys_of("strait")["obstacles"].items():
        shape = shapely.Polygon(obstacle["polygon_m"])
        if obstacle.get("base_m", 0) > highest + 3:  # they pass below it
            assert name == "bridge_deck" and shapely.intersects(hulls, shape).any()
        else:
            assert shapely.distance(hulls, shape).min() > 5, name


def test_every_shipped_mesh_is_in_the_strait_and_obstacles_and_own_hull_hide(renderer):
    strait = scene_named("strait")
    shapes = {"ferry", "sailboat", "motorboat", "fishing_vessel", "container_ship", "kayak"}
    assert {entry.get("mesh") for entry in keys_of("strait")["vessels"].values()} == {*shapes, None}
    hiders = set()
    for first in range(0, strait.steps, 20):
        hiders |= {strait.occluder_names[index] for index in truth_block(strait, first, first + 2, renderer).occluder}
    assert hiders >= {"ferry", "container_ship", "obstacle:breakwater", "obstacle:north_island"}
    outlines = strait.sight(strait.cameras[0], np.arange(3)).outlines()
    own = outlines.occluder == strait.vessel_names.index("own")
    assert own.sum() == 3 and not outlines.boxed[own].any()  # its own foredeck, in each frame


def test_cameras_of_the_strait_run_at_their_own_rates_and_sources_agree(renderer):
    strait = scene_named("strait")
    bow, quay = (strait.frame_steps(camera, 0, strait.steps).tolist() for camera in strait.cameras)
    assert len(bow) == 300 and quay == list(range(1, 300, 2))
    figures = compare_sources(strait, renderer, every=20).figures
    assert (figures.frames, figures.unexplained) == (15 + 8, 0) and figures.vessel_frames > 80
