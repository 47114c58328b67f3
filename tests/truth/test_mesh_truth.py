"""A vessel with a mesh gets its truth from it, whole or cut; solids cut at the near plane, pixels of closed ones."""

import json
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import shapely
from scipy.spatial.transform import Rotation

from modsim3d import InputError, load_scene, open_run, run_scene, simulate_frames
from modsim3d.geometry.camera import clip_triangles, guard_planes, near_plane
from modsim3d.render.id_pass import Region
from modsim3d.truth import outlines as outlines_module
from modsim3d.truth.analytic import image_silhouettes, mask_box
from modsim3d.truth.buffer_drawing import subdivided, triangles_of, within_guard
from modsim3d.truth.full_frame import full_frame_occlusion
from modsim3d.truth.rendered import rendered_occlusion
from modsim3d.truth.scan_conversion import _on_grid, scan_convert
from modsim3d.truth.silhouettes import _Edges, cut_faces, cut_near, doubled_areas, edges_of, spans_of_ids, winding_spans
from modsim3d.world.mesh_reading import load_mesh, shipped_meshes
from modsim3d.world.vessels import Solid, shoebox
from tests.scenes import INTRINSICS, camera_keys, outlines_of, random_places, random_scene, vessel, write_scene
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


LENS = replace(INTRINSICS, near_clip_m=2.0)


def box_across_the_plane(rng):
    """The twelve triangles of a box turned any way about a point near the plane, and where its edges meet the plane."""
    turn = Rotation.random(rng=rng).as_matrix()
    corners = (shoebox().vertices - [0, 0, 0.5]) * rng.uniform(1, 6, 3) @ turn.T + rng.normal([0, 0, 2], [1, 1, 0.9])
    unit = shoebox().vertices
    ends = [(i, j) for i in range(8) for j in range(i) if np.abs(unit[i] - unit[j]).sum() == 1]
    a, b = (corners[[pair[side] for pair in ends]] for side in (0, 1))
    share = (2.0 - a[:, 2]) / (b[:, 2] - a[:, 2])
    crossing = (share > 0) & (share < 1)
    return corners[shoebox().faces], (a + share[:, None] * (b - a))[crossing]


def cut_alone(triangles, solid):
    """What `cut_near` leaves of one solid."""
    return cut_near(triangles[None], LENS, solid)[0]


@pytest.mark.parametrize("convex", [True, False])
def test_section_closes_what_the_plane_cuts_open(convex):
    rng, solid = np.random.default_rng(0), replace(shoebox(), convex=convex)
    sides = set()
    for _ in range(60):
        triangles, met = box_across_the_plane(rng)
        if not len(met):
            continue
        clipped, _ = clip_triangles(triangles, near_plane(LENS))
        section = cut_alone(triangles, solid)[len(clipped) :]
        assert (section[..., 2] == 2.0).all()
        assert not convex or len(section) == len(np.unique(section.reshape(-1, 3), axis=0)) - 2
        parts = shapely.polygons(section[..., :2])
        hull = shapely.convex_hull(shapely.multipoints(met[:, :2]))
        assert shapely.area(parts).sum() == pytest.approx(hull.area, rel=1e-9)
        assert shapely.union_all(parts).symmetric_difference(hull).area < 1e-9 * hull.area
        sides.add(len(met))
    assert sides >= {3, 4, 5, 6}


def test_sections_leave_holes_open_and_without_a_corner_of_the_image_add_nothing_to_a_box():
    outer, inner = ((shoebox().vertices - [0, 0, 0.5]) * size + [0, 0, 2.0] for size in ([6, 6, 4], [2, 3, 5]))
    fan = cut_alone(outer[shoebox().faces], shoebox())[-6:]  # corners on a side of the square share a coordinate
    assert shapely.area(shapely.polygons(fan[..., :2])).sum() == pytest.approx(6 * 6)
    tube = np.concatenate([outer[shoebox().faces], inner[shoebox().faces][:, ::-1]])
    clipped, _ = clip_triangles(tube, near_plane(LENS))
    section = cut_alone(tube, replace(shoebox(), convex=False))[len(clipped) :]
    assert shapely.union_all(shapely.polygons(section[..., :2])).area == pytest.approx(6 * 6 - 2 * 3)
    np.testing.assert_allclose(cut_alone(tube, replace(shoebox(), convex=False, closed=False)), clipped, rtol=1e-9)
    beyond = shoebox().vertices[shoebox().faces] + [0, 0, 5.0]
    for convex in (True, False):
        np.testing.assert_array_equal(cut_alone(beyond, replace(shoebox(), convex=convex)), beyond)
    # Also of tubes, of which the plane leaves a ring around the image or a part of it.
    rng, planes = np.random.default_rng(4), guard_planes(LENS, 0.0)
    left_open = []
    for number in range(150):
        triangles, _ = box_across_the_plane(rng)
        if number % 2:
            triangles = np.concatenate([triangles, (triangles - [0, 0, 2])[:, ::-1] * [0.7, 0.7, 3] + [0, 0, 2]])
        solid, boxes, counts = replace(shoebox(), convex=False), [], []
        for in_image in (False, True):
            faces, _ = cut_near(triangles[None], LENS, solid, in_image=in_image)
            seen = LENS.project(clip_triangles(faces, planes)[0]).reshape(-1, 2)
            boxes.append([*seen.min(axis=0, initial=9e9), *seen.max(axis=0, initial=-9e9)])
            counts.append(len(faces))
        np.testing.assert_allclose(*boxes, atol=1e-6)
        left_open.append(counts[1] < counts[0])
    assert 5 < sum(left_open) < 140


@pytest.mark.parametrize(("convex", "faces", "together"), [(True, 100, 8), (False, 10, 1)])
def test_solids_are_cut_together_as_each_by_itself(convex, faces, together, monkeypatch):
    """Bit for bit, also in portions: those that the plane does not cross are left as they are."""
    rng, solid = np.random.default_rng(5), replace(shoebox(), convex=convex)
    vertices = shoebox().vertices * rng.uniform(1, 6, (40, 1, 3)) @ Rotation.random(40, rng=rng).as_matrix()
    vertices += rng.normal([0, 0, 4], [1, 1, 2], (40, 1, 3))
    vertices = vertices[(vertices[..., 2] > 2.0).any(axis=1)]
    crosses = (vertices[..., 2] < 2.0).any(axis=1)
    assert 5 < crosses.sum() < len(crosses) - 5
    monkeypatch.setattr("modsim3d.truth.silhouettes.PORTION_FACES", faces)
    portions = list(cut_faces(vertices, crosses, LENS, solid))
    assert len(portions) == -(-len(crosses) // together)
    triangles, member = (np.concatenate(parts) for parts in zip(*portions, strict=True))
    for index, cut in enumerate(crosses):
        faces = vertices[index, shoebox().faces]
        np.testing.assert_array_equal(triangles[member == index], cut_alone(faces, solid) if cut else faces)


def test_solids_cut_beside_the_image_are_left_out_and_only_long_edges_are_cut(monkeypatch):
    rng = np.random.default_rng(8)
    places = [
        (vessel("boat", *rng.uniform(2, 30, 3)), tuple(rng.uniform(-25, 25, 2)), rng.uniform(0, 6)) for _ in range(80)
    ]
    camera = replace(INTRINSICS, near_clip_m=1.0)
    some = outlines_of(places, camera)
    none_beside = Mock(side_effect=lambda vertices, _: np.zeros(len(vertices), bool))
    monkeypatch.setattr(outlines_module, "_beside_image", none_beside)
    every, beside = outlines_of(places, camera), [len(call.args[0]) for call in none_beside.call_args_list]
    assert some.crosses_near.sum() > 5 and beside[0] - some.crosses_near.sum() > 5
    for name in ("occluder", "boxes_px", "areas_px", "in_frame_fraction", "crosses_near"):
        np.testing.assert_array_equal(getattr(some, name), getattr(every, name))
    rng = np.random.default_rng(21)
    for a, b, c, d in rng.uniform([-2, -2, 6], [2, 2, 9], (60, 4, 3)):
        along = [
            {tuple(p) for p in subdivided(triangle[None], INTRINSICS, 90.0)[0].reshape(-1, 3) if on_segment(p, a, b)}
            for triangle in (np.array([a, b, c]), np.array([b, a, d]), np.array([d, b, a]), np.array([c, a, b]))
        ]
        assert along[0] == along[1] == along[2] == along[3]
    # Edges of 300, 300 and 30 px: the short one stays whole, as it is no longer than 40 px.
    corners = np.array([[-0.3, -0.3, 20.0], [0.3, -0.3, 20.0], [0.0, 5.7, 20.0]])
    for turn in range(3):
        small, _ = subdivided(np.roll(corners, turn, axis=0)[None], INTRINSICS, 40.0)
        assert len(small[np.isclose(small[..., 1], -0.3).sum(axis=1) == 2]) == 1


def test_pieces_of_triangles_name_the_triangle_that_they_are_of():
    triangles = np.random.default_rng(6).normal([0, 0, 2], 1.5, (50, 3, 3))
    for cut in (
        lambda some: clip_triangles(some, np.concatenate([near_plane(LENS), [[1.0, 0.0, 0.0, -0.5]]])),
        lambda some: subdivided(some + np.array([0, 0, 9.0]), INTRINSICS, 15.0),
    ):
        pieces, source = cut(triangles)
        assert set(np.bincount(source)) - {1}
        for index in range(len(triangles)):
            np.testing.assert_array_equal(pieces[source == index], cut(triangles[[index]])[0])


@pytest.mark.parametrize("factor", [1, 3])
@pytest.mark.parametrize("guard", [0.0, 50.0, 200.0])
def test_rows_within_the_guard_are_those_with_every_vertex_in_it(factor, guard):
    outlines = outlines_of(random_places(np.random.default_rng(20), 60, near_m=5.0, far_m=150.0))
    inside, size = within_guard(outlines, INTRINSICS, factor, guard), np.array(INTRINSICS.image_size_px)
    for part in outlines.parts:
        for row, vertices in zip(part.rows, part.vertices_px, strict=True):
            assert inside[row] == np.all(np.maximum(-vertices, vertices - size) * factor <= guard)
    assert inside.any()
    assert guard or not inside.all()
    drawn = triangles_of(outlines, INTRINSICS, factor, guard)
    assert sorted(set(drawn.row[drawn.of_whole].tolist())) == np.flatnonzero(inside).tolist()
    low, high = drawn.corners_px.min(axis=(0, 1)), drawn.corners_px.max(axis=(0, 1))
    assert (low >= -guard / factor - 1e-6).all() and (high <= size + guard / factor + 1e-6).all()


def on_segment(point, a, b):
    return np.linalg.norm(point - a) + np.linalg.norm(point - b) <= np.linalg.norm(b - a) + 1e-12


@pytest.mark.parametrize("factor", [1, 3])
def test_without_faces_turned_away_the_others_are_the_same(factor):
    outlines = outlines_of(random_places(np.random.default_rng(22), 60, near_m=5.0, far_m=150.0))
    every, some = (triangles_of(outlines, INTRINSICS, factor, **only) for only in ({}, {"facing_only": True}))
    kept = ~every.of_whole | (doubled_areas(_on_grid(every.corners_px * factor)) > 0)
    assert (every.of_whole & kept).sum() > 100 and len(some.row) < len(every.row) * 0.7
    for name in ("row", "corners_px", "inverse_depth", "of_whole"):
        np.testing.assert_array_equal(getattr(some, name), getattr(every, name)[kept], err_msg=name)


SIZE = INTRINSICS.image_size_px
MESHES = ("ferry", "sailboat", "container_ship")


def tube() -> Solid:
    """Walls around a hole along v2, through which one sees what is behind."""
    outer, inner = (shoebox().vertices * (side, side, 1.0) for side in (1.0, 0.6))
    vertices = np.concatenate([outer, inner])
    side = [0, 2, 6, 4]  # around the bottom; the top has the next numbers
    walls = []
    for a, b in zip(side, side[1:] + side[:1], strict=True):
        upright = (b, a, a + 1, b + 1), (a + 8, b + 8, b + 9, a + 9)  # outside, and in the hole
        level = (a, b, b + 8, a + 8), (b + 1, a + 1, a + 9, b + 9)  # below and above
        for c, d, e, f in upright + level:
            walls += [(c, d, e), (c, e, f)]
    return Solid(vertices[:, [1, 2, 0]] + [0, -0.5, 0.5], np.array(walls), convex=False)


def seen(solid, seed, count=40):
    """The vertices of vessels with a solid that lie wholly near the image, in pixels, and their outlines."""
    places = random_places(np.random.default_rng(seed), count, near_m=8.0, far_m=150.0)
    outlines = outlines_of([(replace(ship, solid=solid), *rest) for ship, *rest in places])
    outlines = outlines.take(np.flatnonzero(within_guard(outlines, INTRINSICS)))
    (part,) = outlines.parts
    return part.vertices_px, outlines


@pytest.mark.parametrize("most", [300, 200_000])
def test_convex_solids_have_the_spans_of_convex_scan_conversion(monkeypatch, most):
    monkeypatch.setattr("modsim3d.truth.silhouettes.MAX_CROSSINGS", most)
    pixels, _ = seen(shoebox(), 1)
    assert (len(_Edges.of(pixels, shoebox(), SIZE[1]).portions()) > 1) == (most == 300)
    expected, odd = scan_convert(pixels, shoebox(), SIZE)
    assert len(odd) == 0 and len(np.unique(expected.row)) > 15
    for name, column in vars(winding_spans(pixels, shoebox(), SIZE)).items():
        np.testing.assert_array_equal(column, getattr(expected, name), err_msg=name)


@pytest.mark.parametrize("name", [*MESHES, "tube"])
def test_meshes_have_the_pixels_that_are_drawn(renderer, name):
    solid = tube() if name == "tube" else load_mesh(name, Path())
    pixels, outlines = seen(solid, 2)
    triangles, found = triangles_of(outlines, INTRINSICS), winding_spans(pixels, solid, SIZE)
    several = 0
    for row in range(len(outlines)):
        own = triangles.take(triangles.row == row)
        ids = np.ones(len(own.row), dtype=np.int64)
        drawn = spans_of_ids(renderer.draw(own.corners_px, own.inverse_depth, ids, Region(0, 0, *SIZE)))
        spans = found.take(found.row == row)
        for column in ("y", "start", "stop"):
            np.testing.assert_array_equal(getattr(spans, column), getattr(drawn, column), err_msg=column)
        several += len(spans.y) > len(np.unique(spans.y))
    assert several  # scan lines with a gap


def test_every_edge_has_a_face_on_each_side():
    for solid in (shoebox(), tube(), *(load_mesh(name, Path()) for name in MESHES)):
        start, end, left, right = edges_of(solid)
        assert len(start) == 3 * len(solid.faces) / 2
        for face in (left, right):
            assert (solid.faces[face] == start[:, None]).any(axis=1).all()
            assert (solid.faces[face] == end[:, None]).any(axis=1).all()
