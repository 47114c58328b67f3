"""A vessel with a mesh gets its truth from the mesh, whole, cut by the image or by the near plane."""

import json
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapely

from modsim3d import InputError, load_scene, open_run, run_scene, simulate_frames
from modsim3d.render.id_pass import Region
from modsim3d.truth.analytic import image_silhouettes, mask_box
from modsim3d.truth.full_frame import full_frame_occlusion
from modsim3d.truth.rendered import rendered_occlusion
from modsim3d.world.mesh_reading import load_mesh, shipped_meshes
from modsim3d.world.vessels import shoebox
from tests.scenes import INTRINSICS, camera_keys, outlines_of, random_scene, vessel, write_scene
from tests.truth.test_regions_against_full import assert_same


@cache
def mesh(name):
    return load_mesh(name, Path())


def with_solids(places, solids):
    return [(replace(ship, solid=solids[i % len(solids)]), *rest) for i, (ship, *rest) in enumerate(places)]


@pytest.mark.parametrize("seed", range(24))
def test_shoebox_as_a_mesh_gives_the_truth_of_the_shoebox(renderer, seed):
    places, intrinsics, mount = random_scene(np.random.default_rng(70_000 + seed))
    boxes = outlines_of(places, intrinsics, mount)
    not_known_to_be_convex = replace(shoebox(), convex=False)
    meshes = outlines_of(with_solids(places, [not_known_to_be_convex, shoebox()]), intrinsics, mount)
    np.testing.assert_array_equal(meshes.occluder, boxes.occluder)
    np.testing.assert_allclose(meshes.boxes_px, boxes.boxes_px, rtol=0, atol=1e-6)
    np.testing.assert_allclose(meshes.depth_m, boxes.depth_m)
    np.testing.assert_allclose(meshes.in_frame_fraction, boxes.in_frame_fraction, rtol=1e-6)
    seen = [rendered_occlusion(outlines, intrinsics, renderer) for outlines in (meshes, boxes)]
    # A silhouette without a pixel keeps its projected box, which rounding may change.
    drawn = np.flatnonzero(seen[1].silhouette_px > 0)
    assert_same(*(occlusion.take(drawn) for occlusion in seen))


@pytest.mark.parametrize("seed", range(16))
def test_drawing_regions_gives_the_truth_of_drawing_everything(renderer, seed):
    places, intrinsics, mount = random_scene(np.random.default_rng(80_000 + seed))
    solids = [mesh(name) for name in shipped_meshes()]
    outlines = outlines_of(with_solids(places, [*solids, shoebox()]), intrinsics, mount)
    fast, plain = (draw(outlines, intrinsics, renderer) for draw in (rendered_occlusion, full_frame_occlusion))
    drawn = np.flatnonzero(plain.silhouette_px > 0)
    assert_same(fast.take(drawn), plain.take(drawn))


@pytest.mark.parametrize("name", shipped_meshes())
def test_pixels_of_a_mesh_are_those_inside_its_exact_silhouette(renderer, name):
    outlines = outlines_of([(replace(vessel("ship", 40, 9, 14), solid=mesh(name)), (120.0, 3.0), 0.7)])
    (polygon,), seen = image_silhouettes(outlines, INTRINSICS), rendered_occlusion(outlines, INTRINSICS, renderer)
    x, y = np.meshgrid(np.arange(800) + 0.5, np.arange(600) + 0.5)
    sure, perhaps = (shapely.contains_xy(polygon.buffer(band), x, y) for band in (-1 / 128, 1 / 128))
    assert sure.sum() <= seen.silhouette_px[0] <= perhaps.sum() < 1.02 * sure.sum()
    least, greatest = (mask_box(mask, Region(0, 0, 800, 600)) for mask in (sure, perhaps))
    assert (seen.full_boxes_px[0, :2] <= least[:2]).all() and (seen.full_boxes_px[0, 2:] >= least[2:]).all()
    assert (seen.full_boxes_px[0, :2] >= greatest[:2]).all() and (seen.full_boxes_px[0, 2:] <= greatest[2:]).all()
    assert np.abs(outlines.boxes_px[0] - polygon.bounds).max() < 1e-9
    assert seen.silhouette_px[0] < 0.97 * shapely.box(*polygon.bounds).area


def test_something_is_seen_between_a_sailboats_mast_and_sail(renderer):
    ship = replace(vessel("yacht", 12, 4, 16), solid=mesh("sailboat"))
    # Far behind: its box is covered by the yacht's box, and yet a part of it is seen beside the sails.
    outlines = outlines_of([(ship, (60.0, 0.0), np.pi / 2), (vessel("boat", 2, 2, 3), (90.0, 6.5), 0.0)])
    seen = rendered_occlusion(outlines, INTRINSICS, renderer)
    assert (outlines.boxes_px[1, :2] >= outlines.boxes_px[0, :2]).all()
    assert (outlines.boxes_px[1, 2:] <= outlines.boxes_px[0, 2:]).all() and seen.visible_px[1] > 0


# At the stern, above deck, looking over the whole boat.
OWN_CAMERA = camera_keys(mount={"vessel": "own", "position_m": [-6, 0, 6], "pitch_rad": 0.15})
WRECK = {"mesh": "container_ship", "size_m": [90, 15, 30], "position_m": [150, 0, -2], "heading_rad": 1.57}


def own_ship_scene(folder, own_mesh="fishing_vessel", **keys):
    boats = {
        "own": ([14, 5, 5], [[0, 0, 0], [10, 20, 0]]),
        "near": ([6, 3, 1], [[0, 22, 0.5], [10, 42, 0.5]]),
        "far": ([40, 9, 14], [[0, 200, -10], [10, 200, 10]]),
    }
    path = write_scene(folder, boats, 6, cameras={"stern": OWN_CAMERA}, **keys)
    scene = json.loads(path.read_text())
    if own_mesh:
        scene["vessels"]["own"]["mesh"] = own_mesh
    scene["vessels"]["far"]["mesh"] = "ferry"
    path.write_text(json.dumps(scene))
    return path


def test_hull_turns_with_its_ship_so_that_waves_do_not_move_it_in_its_own_image(tmp_path):
    scene = load_scene(own_ship_scene(tmp_path, waves={"level": "huge", "interval_s": 0.01}))
    (camera,) = scene.cameras
    outlines = scene.sight(camera, np.arange(6)).outlines()
    (hull,) = [part for part in outlines.parts if not outlines.boxed[part.rows].any()]
    np.testing.assert_allclose(hull.vertices_camera - hull.vertices_camera[:1], 0, atol=1e-9)
    assert np.abs(np.diff(scene.motion.at(np.arange(6)).angles_rad[:, 0], axis=0)).max() > 1e-3


def test_run_with_meshes_has_a_copy_of_the_scene_that_is_the_same_and_repeats_from_it(tmp_path):
    source = tmp_path / "source"
    for folder, name in (("one", "kayak"), ("other", "ferry")):
        (source / folder).mkdir(parents=True)
        shutil.copy(shipped_meshes()[name], source / folder / "motorboat.glb")
    pier = {"size_m": [9, 2, 2], "position_m": [300, 0, 0]}
    obstacles = {
        "one": {"mesh": "one/motorboat.glb", **pier},
        "again": {"mesh": {"file": "one/motorboat.glb", "forward": "-z"}, **pier},
        "other": {"mesh": "other/motorboat.glb", **pier},
    }
    scene = load_scene(own_ship_scene(source, own_mesh="motorboat", obstacles=obstacles))
    assert len([name for name in scene.copy.files if name.startswith("meshes/")]) == 4
    run_scene(scene, tmp_path / "run")
    shutil.rmtree(source)
    copied = open_run(tmp_path / "run").scene
    assert dict(copied.copy.document) == dict(scene.copy.document) and copied.sha256 == scene.sha256
    run_scene(copied, tmp_path / "again")
    for name in ("truth.parquet", "detections.parquet"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "run" / name).read_bytes()


def test_compare_compares_meshes_and_says_how_much_looser_their_shoeboxes_are(call, tmp_path):
    status, said = call("check", "truth", own_ship_scene(tmp_path), "--out", tmp_path / "out")
    assert status == 0 and "Shoebox against mesh" in said and "far" in said, said
    figures = json.loads((tmp_path / "out" / "compare.json").read_text())
    assert figures["unexplained"] == 0
    for part in ("full_box", "visible_box"):
        assert figures[part]["verdicts"]["agree within a pixel"] == 12
        assert figures[part]["verdicts"]["left to pixels: no plane between two hulls"] == 0
    ((name, loose),) = figures["shoebox_against_mesh"].items()
    assert (name, loose["frames"]) == ("far", 6)
    assert 1.0 <= loose["mean_area_ratio"] <= loose["max_area_ratio"] < 1.5


def test_rule_of_rectangles_takes_vessels_for_their_shoeboxes_and_it_and_a_shoebox_leave_own_ships_hull_out(tmp_path):
    exact = list(simulate_frames(load_scene(own_ship_scene(tmp_path), source="analytic")))
    frames = list(simulate_frames(load_scene(tmp_path / "scene.yaml", source="rectangles")))
    for ruled, other in zip(frames, exact, strict=True):
        loose, tight = ruled.truth.full_boxes_px[1], other.truth.full_boxes_px[1]
        assert (loose[:2] <= tight[:2]).all() and (loose[2:] >= tight[2:]).all() and (loose != tight).any()
    frames += simulate_frames(load_scene(own_ship_scene(tmp_path, own_mesh=None)))
    assert all("own" not in entry for frame in frames for entry in frame.truth.occluded_by)


def test_camera_inside_its_own_ships_mesh_and_a_wrong_mesh_are_refused_and_one_in_its_shoebox_is_not(tmp_path):
    with pytest.raises(InputError, match=r"vessels\.own\.mesh: 'hulk\.glb' does not exist"):
        load_scene(own_ship_scene(tmp_path, own_mesh="hulk.glb"))
    path = own_ship_scene(tmp_path)
    scene = json.loads(path.read_text())
    scene["cameras"]["stern"]["mount"]["position_m"] = [0, 0, 0.5]
    path.write_text(json.dumps(scene))
    with pytest.raises(InputError, match=r"cameras\.stern: is inside vessel 'own' at time 0\.0 s: move one of them"):
        load_scene(path)
    del scene["vessels"]["own"]["mesh"]
    path.write_text(json.dumps(scene))
    load_scene(path)
