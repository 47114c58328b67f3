"""Solids cut at the near plane, what needs no clipping, and triangles whose edges are halved."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
import shapely
from scipy.spatial.transform import Rotation

from modsim3d.geometry.camera import clip_triangles, guard_planes, near_plane
from modsim3d.truth import outlines as outlines_module
from modsim3d.truth.buffer_drawing import subdivided, triangles_of, within_guard
from modsim3d.truth.scan_conversion import _on_grid
from modsim3d.truth.silhouettes import cut_faces, cut_near, doubled_areas
from modsim3d.world.vessels import shoebox
from tests.scenes import INTRINSICS, outlines_of, random_places, vessel

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


def test_section_leaves_holes_open_and_surfaces_without_an_inside_and_solids_beyond_the_plane_get_none():
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


def test_sections_without_a_corner_of_the_image_add_nothing_to_the_box_of_what_is_in_it():
    """Also of tubes, of which the plane leaves a ring around the image or a part of it."""
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


def test_solids_that_the_near_plane_cuts_beside_the_image_are_left_out_as_nothing_of_them_is_in_it(monkeypatch):
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


def test_triangles_on_both_sides_of_an_edge_are_cut_at_the_same_points():
    rng = np.random.default_rng(21)
    for a, b, c, d in rng.uniform([-2, -2, 6], [2, 2, 9], (60, 4, 3)):
        along = [
            {tuple(p) for p in subdivided(triangle[None], INTRINSICS, 90.0)[0].reshape(-1, 3) if on_segment(p, a, b)}
            for triangle in (np.array([a, b, c]), np.array([b, a, d]), np.array([d, b, a]), np.array([c, a, b]))
        ]
        assert along[0] == along[1] == along[2] == along[3]


def on_segment(point, a, b):
    return np.linalg.norm(point - a) + np.linalg.norm(point - b) <= np.linalg.norm(b - a) + 1e-12


def test_only_long_edges_are_cut():
    """Edges of 300, 300 and 30 px: the short one stays whole, as it is no longer than 40 px."""
    corners = np.array([[-0.3, -0.3, 20.0], [0.3, -0.3, 20.0], [0.0, 5.7, 20.0]])
    for turn in range(3):
        small, _ = subdivided(np.roll(corners, turn, axis=0)[None], INTRINSICS, 40.0)
        assert len(small[np.isclose(small[..., 1], -0.3).sum(axis=1) == 2]) == 1


@pytest.mark.parametrize("factor", [1, 3])
def test_without_faces_turned_away_the_others_are_the_same(factor):
    outlines = outlines_of(random_places(np.random.default_rng(22), 60, near_m=5.0, far_m=150.0))
    every, some = (triangles_of(outlines, INTRINSICS, factor, **only) for only in ({}, {"facing_only": True}))
    kept = ~every.of_whole | (doubled_areas(_on_grid(every.corners_px * factor)) > 0)
    assert (every.of_whole & kept).sum() > 100 and len(some.row) < len(every.row) * 0.7
    for name in ("row", "corners_px", "inverse_depth", "of_whole"):
        np.testing.assert_array_equal(getattr(some, name), getattr(every, name)[kept], err_msg=name)
