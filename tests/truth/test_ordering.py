"""Which of two vessels is in front: a plane between them decides, not the distance of their centres."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import shapely
from scipy.optimize import linprog

from modsim3d.geometry.camera_poses import rotation, world_R_vehicle
from modsim3d.truth import occlusion_order
from modsim3d.truth.analytic import analytic_occlusion, image_silhouettes, rectangle_occlusion
from modsim3d.truth.occlusion_order import axis_count, candidate_axes, order_of, widest_gap_axis
from modsim3d.truth.rendered import rendered_occlusion
from modsim3d.verify.sources.agreement import compare_with_analytic
from modsim3d.world.vessels import shoebox
from tests import scenes
from tests.scenes import INTRINSICS, crate, outlines_at, outlines_of, pixel_masks, rectangles, vessel, write_scene

SHIP, BOAT = 0, 1


def test_a_long_ship_hides_no_boat_before_its_stern_and_a_plane_close_to_the_camera_tells(renderer):
    # 210 m from (95, 31) to (301, −10): the ship's centre is 200 m ahead, that of the boat off its stern 220 m.
    ship, boat = vessel("ship", 210, 8, 15), vessel("boat", 2, 4, 4)
    outlines = outlines_of([(ship, (198.0, 10.4), float(np.arctan2(-41, 206))), (boat, (220.0, -2.0), 0.0)])
    assert outlines.depth_m[SHIP] < outlines.depth_m[BOAT]  # so ordering by depth would hide the boat
    order = order_of(outlines)
    assert (order.first_can_hide.tolist(), order.second_can_hide.tolist()) == ([False], [True])
    for seen in (analytic_occlusion(outlines, INTRINSICS), rendered_occlusion(outlines, INTRINSICS, renderer)):
        assert seen.visible_px[BOAT] == seen.silhouette_px[BOAT] > 100 and seen.occluders[BOAT] == ()
        ((hider, hidden_px),) = seen.occluders[SHIP]  # all of the boat but what lies below the ship's waterline
        assert hider == BOAT and 0.5 * seen.silhouette_px[BOAT] < hidden_px < seen.silhouette_px[BOAT]
        assert seen.visible_px[SHIP] + hidden_px == pytest.approx(seen.silhouette_px[SHIP])
    ruled = rectangle_occlusion(outlines)
    assert ruled.visible_px[BOAT] == 0 and ruled.visible_px[SHIP] == ruled.silhouette_px[SHIP]
    # The side of a long ship, 30 cm beside the camera; the nearest corner of a boat beyond is at 50 cm.
    ship, boat = vessel("ship", 250, 5.3, 8), vessel("boat", 100, 9.5, 8)
    for side in (1, -1):
        order = order_of(outlines_of([(ship, (175, -2.35 * side), 0), (boat, (150, 10.22 * side), 0.1 * side)]))
        assert (order.first_can_hide.tolist(), order.second_can_hide.tolist()) == ([True], [False])


def test_three_beams_each_hide_a_part_of_the_next(renderer):
    boxes, mount = scenes.cyclic_beams()
    outlines = outlines_at(boxes, INTRINSICS, mount)
    order = order_of(outlines)
    columns = zip(order.first, order.second, order.first_can_hide, order.second_can_hide, strict=True)
    hiders = {(a, b) if first else (b, a) for a, b, first, second in columns if first != second}
    assert hiders == {(1, 0), (2, 1), (0, 2)}
    exact = analytic_occlusion(outlines, INTRINSICS)
    assert [[vessel for vessel, _ in row] for row in exact.occluders] == [[1], [2], [0]]
    # A third of a turn about the line of sight puts each beam in the place of the next.
    np.testing.assert_allclose(exact.visible_px, exact.visible_px[0], rtol=1e-9)
    assert 0.7 < exact.visible_fraction()[0] < 0.9
    hidden = np.array([row[0][1] for row in exact.occluders])
    np.testing.assert_allclose(exact.visible_px + hidden, exact.silhouette_px, rtol=1e-9)
    for factor in (1, 4):
        seen = rendered_occlusion(outlines, INTRINSICS, renderer, factor)
        assert [[vessel for vessel, _ in row] for row in seen.occluders] == [[1], [2], [0]]
        np.testing.assert_allclose(seen.visible_px, exact.visible_px, atol=20 / factor)  # of some 6,500
        np.testing.assert_allclose(seen.visible_boxes_px, exact.visible_boxes_px, atol=1 / factor)
        masks = partial(pixel_masks, outlines, INTRINSICS, renderer, supersample=factor)
        assert not compare_with_analytic(outlines, INTRINSICS, seen, masks, factor).worst.any()


def corners_touching(rng):
    """Two boxes that share a part of a face, on any heading and anywhere; and the same pushed together by 1 mm."""
    heading = rng.uniform(-np.pi, np.pi)
    length, beam = rng.uniform(5, 300), rng.uniform(2, 40)
    other_length, other_beam = rng.uniform(5, 300), rng.uniform(2, 40)
    first = np.array([rng.uniform(400, 3000), rng.uniform(-300, 300)])
    reach = np.array([length + other_length, beam + other_beam]) / 2
    beside = rng.random() < 0.5  # or bow to stern
    offset = reach * np.where([beside, not beside], rng.uniform(-1, 1), 1.0)
    turn = world_R_vehicle(heading)[:2, :2]
    push = 1e-3 * np.sign(offset) * (np.abs(offset) == reach)

    def places(apart):
        one, two = vessel("one", length, beam, 20), vessel("two", other_length, other_beam, 20)
        return [(one, tuple(first), heading), (two, tuple(first + turn @ apart), heading)]

    return places(offset), places(offset - push)


@pytest.mark.parametrize("seed", range(20))
def test_touching_boxes_do_not_intersect_and_boxes_a_millimetre_into_each_other_do(seed):
    wide = replace(INTRINSICS, principal_point_px=(4000.0, 4000.0), image_size_px=(8000, 8000))
    touching, pushed = corners_touching(np.random.default_rng(seed))
    order = order_of(outlines_of(touching, wide))
    assert not order.intersecting.any() and not (order.first_can_hide & order.second_can_hide).any()
    assert order_of(outlines_of(pushed, wide)).intersecting.tolist() == [True]


def test_intersecting_boxes_are_named_and_what_both_hide_counts_for_the_nearer(renderer):
    """Two rafted boats that overlap by a metre, a boat behind both, one beside, one on a low pier, with a high one."""
    boat, places = vessel("boat", 10, 4, 10), ((200, 3), (100, 0), (101, 3), (100, -20), (99, 31))
    piers = [crate((8, 4, 4), (100, 34)), crate((4, 4, 12), (100, 35.5))]
    outlines = outlines_of([(boat, place, 0) for place in places], obstacles=piers)
    seen = analytic_occlusion(outlines, INTRINSICS)
    np.testing.assert_array_equal(seen.intersecting, [[1, 2], [4, 5]])
    unknown = [1, 2, 4, 5]
    assert np.isnan(seen.visible_px[unknown]).all() and np.isnan(seen.visible_boxes_px[unknown]).all()
    assert np.isnan(seen.visible_fraction()[unknown]).all() and np.isfinite(seen.full_boxes_px).all()
    assert seen.visible_px[3] == seen.silhouette_px[3]
    # What both hide of the one behind is counted once.
    drawn = rendered_occlusion(outlines, INTRINSICS, renderer)
    assert 0 < sum(px for _, px in seen.occluders[0]) == pytest.approx(seen.silhouette_px[0] - seen.visible_px[0])
    assert {vessel for vessel, _ in seen.occluders[0]} == {vessel for vessel, _ in drawn.occluders[0]} == {1, 2}
    np.testing.assert_array_equal(seen.truth(outlines, np.array([7]), 3).intersections, [[7, 3, 1, 2], [7, 3, 4, 5]])
    boat = vessel("boat", 10, 4, 10)
    rafts = [[(boat, (100, side), 0), (boat, (101, side + 3), 0), (boat, (200, 2 * side + 3), 0)] for side in (-20, 15)]
    outlines = outlines_of([place for raft in rafts for place in raft])
    seen, silhouettes = analytic_occlusion(outlines, INTRINSICS), image_silhouettes(outlines, INTRINSICS)
    np.testing.assert_array_equal(seen.intersecting, [[0, 1], [3, 4]])
    for nearer, farther, behind in ((0, 1, 2), (3, 4, 5)):
        by_nearer = silhouettes[behind].intersection(silhouettes[nearer])
        by_either = silhouettes[behind].intersection(silhouettes[farther])
        by_farther = by_either.difference(silhouettes[nearer])
        assert min(by_farther.area, by_either.intersection(by_nearer).area) > 20
        expected = {nearer: pytest.approx(by_nearer.area), farther: pytest.approx(by_farther.area)}
        assert dict(seen.occluders[behind]) == expected


def tumbled_pairs(rng, count):
    """Outlines of pairs of boxes turned any way, near enough to each other to touch about as often as not."""
    extents = np.exp(rng.uniform(np.log(1), np.log(30), (2 * count, 3)))
    outlines = outlines_of([(vessel("any"), (100.0 + 20 * i, 0.0), 0.0) for i in range(2 * count)])
    assert len(outlines) == 2 * count
    (part,) = outlines.parts
    turned = part.solid.vertices - [0, 0, 0.5]
    angles = rng.uniform(-np.pi, np.pi, (3, 2 * count))
    turns = rotation(0, angles[0]) @ rotation(1, angles[1]) @ rotation(2, angles[2])
    half = np.linalg.norm(extents, axis=1).reshape(count, 2) / 2
    centres, directions = rng.normal([0, 0, 100], 40, (count, 1, 3)), rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    apart = directions * (half.sum(axis=1) * rng.uniform(0.2, 1.0, count))[:, None]
    places = np.concatenate([centres, centres + apart[:, None]], axis=1).reshape(-1, 1, 3)
    vertices = (turned * extents[:, None]) @ np.swapaxes(turns, 1, 2) + places
    boxes = np.tile([0.0, 0.0, 10.0, 10.0], (2 * count, 1))
    parts, frame = (replace(part, vertices_camera=vertices),), np.repeat(np.arange(count), 2)
    return replace(outlines, frame=frame, boxes_px=boxes, parts=parts), (extents, turns, places[:, 0])


def margin_of_separation(a, b):
    """The widest gap along any direction with coordinates in [−1, 1], by linear programming; zero if there is none."""
    rows = np.pad(np.concatenate([a, -b]), ((0, 0), (0, 2)))  # n · a <= d and n · b >= d + gap
    rows[: len(a), 3], rows[len(a) :, 3:] = -1, 1
    limits = [(-1, 1)] * 3 + [(None, None), (0, None)]
    found = linprog([0, 0, 0, 0, -1], A_ub=rows, b_ub=np.zeros(len(rows)), bounds=limits)
    assert found.success
    return -found.fun


def test_order_does_not_depend_on_the_scale_of_the_scene_and_how_solids_are_grouped_and_looked_at(monkeypatch):
    outlines, _ = tumbled_pairs(np.random.default_rng(11), 100)
    (part,) = outlines.parts
    whole, group = order_of(outlines), np.random.default_rng(12).integers(0, 3, len(outlines))
    groups = [np.flatnonzero(group == number) for number in range(3)]
    grouped = tuple(replace(part.take(rows), solid=replace(part.solid)) for rows in groups)
    models = ((replace(part, vertices_camera=scale * part.vertices_camera),) for scale in (0.01, 100.0))
    monkeypatch.setattr(occlusion_order, "MAX_COORDINATES", 2_000)
    for parts in (grouped, *models):
        order = order_of(replace(outlines, parts=parts))
        for name in ("first", "second", "first_can_hide", "second_can_hide", "intersecting"):
            np.testing.assert_array_equal(getattr(order, name), getattr(whole, name))


def test_axis_across_the_widest_gap_of_two_hulls_is_a_unit_vector_that_no_other_direction_beats():
    rng = np.random.default_rng(11)

    def gaps(hulls, axes):
        """Of hulls along axes whose greatest component is 1."""
        along = axes / np.abs(axes).max(axis=1, keepdims=True)
        return (hulls[1] @ along.T).min(axis=0) - (hulls[0] @ along.T).max(axis=0)

    for _ in range(20):
        away = rng.normal(size=3)
        places = rng.uniform(-200, 200, 3) + np.outer([0, rng.uniform(5, 40)], away / np.linalg.norm(away))
        hulls = [rng.normal(size=(count, 3)) + place for count, place in zip((12, 9), places, strict=True)]
        axis = widest_gap_axis(*hulls)
        assert np.linalg.norm(axis) == pytest.approx(1)
        others = np.concatenate([rng.normal(size=(3000, 3)), axis + 0.02 * rng.normal(size=(300, 3))])
        assert gaps(hulls, axis[None])[0] >= gaps(hulls, others).max() - 1e-9 > 0
    cube = shoebox().vertices
    aslant = np.array([0.5, 0.5, 0.0]) ** 0.5
    np.testing.assert_allclose(widest_gap_axis(cube, cube + 9 * aslant), aslant, atol=1e-9)
    assert not widest_gap_axis(cube, cube + np.array([0.5, 0.0, 0.0])).any()


def test_two_shoeboxes_have_fifteen_axes_planes_where_one_exists_and_footprints_that_tell():
    rng = np.random.default_rng(6)
    wide, told = replace(INTRINSICS, focal_px=(10.0, 10.0)), []
    for _ in range(200):
        headings, places = rng.uniform(-np.pi, np.pi, 2), rng.uniform([80, -30], [140, 30], (2, 2))
        boats = [vessel(name, rng.uniform(5, 60), rng.uniform(2, 15), 12) for name in "ab"]
        order = order_of(outlines_of([*zip(boats, map(tuple, places), headings, strict=True)], wide))
        if len(order.first):
            one, two = rectangles(places, headings, [boat.extents_m[:2] for boat in boats])
            assert order.intersecting.tolist() == [shapely.area(shapely.intersection(one, two)) > 0]
            told.append(bool(order.intersecting[0]))
    assert 20 < sum(told) < len(told) - 20
    # Gottschalk, Lin & Manocha (1996): 3 + 3 face normals and 9 cross products of edges.
    outlines, (_, turns, _) = tumbled_pairs(np.random.default_rng(14), 40)
    vertices, box = outlines.parts[0].vertices_camera, shoebox()
    assert axis_count(box, box) == 15
    axes = candidate_axes(vertices[::2], box, vertices[1::2], box)
    assert axes.shape == (40, 15, 3)
    for found, a, b in zip(axes, turns[::2], turns[1::2], strict=True):  # the columns of a turn are the box's axes
        crosses = np.cross(a.T[:, None], b.T[None]).reshape(-1, 3)
        crosses /= np.linalg.norm(crosses, axis=1, keepdims=True)
        alike = np.abs(np.concatenate([a.T, b.T, crosses]) @ found.T)
        np.testing.assert_allclose(np.sort(alike, axis=1)[:, -1], 1, atol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1)
    alone = candidate_axes(vertices[:1], box, vertices[:1], box)[0]
    assert np.isclose(np.linalg.norm(alone, axis=1), 1).sum() == 12  # three pairs of edges are parallel
    assert (np.linalg.norm(alone, axis=1) == 0).sum() == 3
    outlines, _ = tumbled_pairs(np.random.default_rng(5), 300)
    order = order_of(outlines)
    np.testing.assert_array_equal(order.first, np.arange(0, 600, 2))
    gaps = np.array([margin_of_separation(*outlines.parts[0].vertices_camera[[i, i + 1]]) for i in range(0, 600, 2)])
    clear = (gaps == 0) | (gaps > 1e-6)
    assert clear.sum() > 290
    np.testing.assert_array_equal(order.intersecting[clear], (gaps == 0)[clear])
    assert 60 < order.intersecting.sum() < 240


def first_met(directions, extents, turn, place):
    """How far along each ray from the camera a box begins, by slabs; infinite where it is missed, shape (n,)."""
    origin, along = -place @ turn, directions @ turn
    with np.errstate(divide="ignore"):
        low, high = (-extents / 2 - origin) / along, (extents / 2 - origin) / along
    enter, leave = np.minimum(low, high).max(axis=1), np.maximum(low, high).min(axis=1)
    return np.where((enter < leave) & (leave > 0), enter, np.inf)


def test_order_is_that_in_which_rays_meet_the_boxes():
    outlines, (extents, turns, places) = tumbled_pairs(np.random.default_rng(7), 200)
    order = order_of(outlines)
    rng, vertices = np.random.default_rng(8), outlines.parts[0].vertices_camera
    both = 0
    for pair in np.flatnonzero(~order.intersecting):
        a, b = order.first[pair], order.second[pair]
        weights = rng.dirichlet(np.ones(8), 300)
        rays = np.concatenate([weights @ vertices[a], weights @ vertices[b]])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        met_a, met_b = (first_met(rays, extents[i], turns[i], places[i]) for i in (a, b))
        meet = np.isfinite(met_a) & np.isfinite(met_b)
        if (met_a < 0).any() or (met_b < 0).any():
            continue  # the camera is inside
        both += meet.any()
        assert not (met_a < met_b)[meet].any() or order.first_can_hide[pair]
        assert not (met_b < met_a)[meet].any() or order.second_can_hide[pair]
        assert not (order.first_can_hide[pair] and order.second_can_hide[pair])
    assert both > 30


BOATS = {
    "rafted1": ([12, 4, 3], [[0, 100, 0], [10, 100, 1]]),
    "rafted2": ([12, 4, 4], [[0, 103, 0], [10, 103, 1]]),
    "apart": ([12, 4, 3], [[0, 100, 40], [10, 100, 41]]),
}


@pytest.mark.parametrize(("source", "annotated"), [("analytic", 4), ("rendered", 12)])
def test_run_names_intersecting_vessels_of_unknown_visibility(call, tmp_path, source, annotated):
    scene = write_scene(tmp_path, BOATS, 4)
    status, said = call("run", scene, "--source", source, "--out", tmp_path / "run", "--no-sheet")
    assert status == 0 and ("rafted1 and rafted2 intersect" in said) == (source == "analytic")
    assert any(line.split()[:2] == ["annotated", str(annotated)] for line in said.splitlines())
