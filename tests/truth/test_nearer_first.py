"""Clusters cut without drawing: against drawn ones, against painting pixel by pixel, and where nobody can tell."""

from dataclasses import fields, replace
from itertools import compress
from unittest.mock import Mock

import numpy as np
import pytest

from modsim3d.geometry.camera_poses import Mount, poses_ashore, world_R_vehicle
from modsim3d.scene.reading import load_scene
from modsim3d.truth import buffer_drawing, rendered
from modsim3d.truth import outlines as projection
from modsim3d.truth.cluster_visibility import ClusteredPairs, OrderedClusters, visibility_in_order
from modsim3d.truth.full_frame import full_frame_occlusion, vessel_masks
from modsim3d.truth.occlusion_order import in_boxes
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.rendered import _ranks, ranks_of, rendered_occlusion, rendered_spans
from modsim3d.truth.silhouettes import Spans, counts_and_boxes
from modsim3d.world.bodies import vessel_bodies
from modsim3d.world.vessels import shoebox
from tests.scenes import INTRINSICS, crate, outlines_of, random_places, vessel
from tests.truth.test_regions_against_full import assert_same

WIDTH, HEIGHT = 60, 40


class NoRenderer:
    """In place of a renderer, where nothing should be drawn."""

    def draw_sheet(self, *_):
        raise AssertionError("something is drawn")


@pytest.mark.parametrize("seed", range(8))
def test_ships_that_are_clear_of_each_other_are_cut_without_a_renderer_as_if_they_were_drawn(renderer, seed):
    outlines = outlines_of(random_places(np.random.default_rng(700 + seed), 25, near_m=150.0))
    cut = rendered_occlusion(outlines, INTRINSICS, NoRenderer())
    assert (cut.visible_px < cut.silhouette_px).sum() > 3 and not cut.drawn.any()
    full = full_frame_occlusion(outlines, INTRINSICS, renderer)
    assert_same(cut, full)
    assert full.drawn.dtype == bool and full.drawn.all()
    (whole, _), (visible, _) = counted(outlines, NoRenderer())
    np.testing.assert_array_equal([whole, visible], [full.silhouette_px, full.visible_px])
    masks = dict(vessel_masks(outlines, INTRINSICS, renderer))
    assert [np.count_nonzero(masks[row].visible) for row in range(len(outlines))] == full.visible_px.tolist()


BOAT = vessel("boat", 5, 2, 20)
IN_DOUBT = [(BOAT, (500.0, 0.0), 0.0), (BOAT, (505.0, 0.0), 0.0)]
"""From 30 m above one sees the faces at which they touch."""


def counted(outlines, *asked):
    """Pixels and boxes of whole and of visible silhouettes, from their spans."""
    return [counts_and_boxes(spans, len(outlines)) for spans in rendered_spans(outlines, INTRINSICS, *asked)]


def test_only_clusters_in_doubt_are_drawn_and_everything_if_one_of_them_fits_no_buffer(renderer, monkeypatch):
    raft = [(vessel("raft", 20, 20, 20), (150.0 + 20 * i, 40.0), 0.0) for i in (0, 1)]
    behind = [(BOAT, (300.0, -40.0), 0.0), (BOAT, (330.0, -44.0), 0.0)]
    outlines = outlines_of([*IN_DOUBT, *raft, *behind], mount=Mount((0.0, 0.0, 30.0)))
    full = full_frame_occlusion(outlines, INTRINSICS, renderer)
    seen = rendered_occlusion(outlines, INTRINSICS, renderer)
    assert_same(seen, full)
    assert seen.drawn.tolist() == [True] * 4 + [False] * 2 and 0 < seen.visible_fraction()[5] < 1
    spans = counted(outlines, renderer)
    np.testing.assert_array_equal([px for px, _ in spans], [full.silhouette_px, full.visible_px])
    monkeypatch.setattr(buffer_drawing, "TILE_PX", (60, 600))
    tiled = rendered_occlusion(outlines, INTRINSICS, renderer)
    assert_same(tiled, full)
    assert tiled.drawn.all()
    np.testing.assert_equal(counted(outlines, renderer), spans)


@pytest.mark.parametrize("order", [1, -1])
def test_of_obstacles_the_one_in_front_is_named_and_what_is_in_doubt_or_refused_is_drawn(renderer, order, monkeypatch):
    walls = [crate((1, 20, 6), (120, -2)), crate((1, 20, 6), (150, 2)), crate((1, 20, 6), (150, 2), 0.6)]
    for obstacles, drawer in ((walls[:2][::order], NoRenderer()), (walls[::order], renderer), ([], NoRenderer())):
        outlines = outlines_of([(vessel("ship", 8, 40, 15), (200, 0), 0)], obstacles=obstacles)
        cut = rendered_occlusion(outlines, INTRINSICS, drawer)
        assert_same(cut, full_frame_occlusion(outlines, INTRINSICS, renderer))
        assert len(cut.occluders[0]) == len(obstacles)
        monkeypatch.setattr(rendered, "scan_convert", lambda vertices, *_: (Spans.none(), np.arange(len(vertices))))
        assert_same(rendered_occlusion(outlines, INTRINSICS, renderer), cut)
        monkeypatch.setattr(buffer_drawing, "TILE_PX", (800, 40))  # the vessel is in two of them
        assert_same(rendered_occlusion(outlines, INTRINSICS, renderer), cut)
        monkeypatch.undo()


@pytest.mark.parametrize("seed", range(10))
def test_cut_spans_are_those_of_painting_pixel_by_pixel_from_far_to_near(seed):
    rng = np.random.default_rng(seed)
    count = 12
    ranks, boxed = rng.permutation(count), rng.random(count) < 0.8
    masks = np.zeros((count, HEIGHT, WIDTH), dtype=bool)
    spans = []
    for row in range(count):
        for y in range(*np.sort(rng.integers(0, HEIGHT, 2)).tolist()):
            start, stop = np.sort(rng.integers(0, WIDTH + 1, 2)).tolist()
            if start < stop:
                masks[row, y, start:stop] = True
                spans.append((row, y, start, stop))
    front = np.full((HEIGHT, WIDTH), -1)
    for row in np.argsort(-ranks).tolist():
        front[masks[row]] = row
    first, second = np.triu_indices(count, 1)
    pairs = ClusteredPairs(first, second, np.zeros(len(first), dtype=np.int64))
    ordered = OrderedClusters(pairs, ranks, Spans(*np.array(spans, dtype=np.int64).reshape(-1, 4).T))
    seen = visibility_in_order(ordered, boxed, (WIDTH, HEIGHT))
    covered = (masks & (front != np.arange(count)[:, None, None])).any(axis=(1, 2)) & boxed
    assert 0 < covered.sum() < boxed.sum() and seen.rows.tolist() == np.flatnonzero(covered).tolist()
    painted = np.full((HEIGHT, WIDTH), -1)
    for row, y, start, stop in zip(*(getattr(seen.visible, n) for n in ("row", "y", "start", "stop")), strict=True):
        assert (painted[y, start:stop] == -1).all()
        painted[y, start:stop] = row
    np.testing.assert_array_equal(painted, np.where(covered[front] & (front >= 0), front, -1))
    hidden = {
        (row, hider): int((masks[row] & (front == hider)).sum())
        for row in np.flatnonzero(boxed).tolist()
        for hider in range(count)
        if hider != row
    }
    told = dict(zip(zip(seen.hidden_row.tolist(), seen.hider.tolist(), strict=True), seen.px.tolist(), strict=True))
    assert told == {pair: px for pair, px in hidden.items() if px}


def ranks(outlines: Outlines) -> tuple[list[int], list[bool]]:
    found, known = ranks_of(outlines, *np.triu_indices(len(outlines), 1), INTRINSICS, 1)
    return found.tolist(), known.tolist()


def test_ranks_rise_from_near_to_far_and_unknown_orders_leave_it_open_who_hides(monkeypatch):
    boat, ship = vessel("boat", 5, 2, 2), vessel("ship", 200, 30, 30)
    # The centre of the ship is nearer than the boat, which lies in front of its stern.
    assert ranks(outlines_of([(ship, (250.0, 90.0), 0.6), (boat, (300.0, 30.0), 0.0)])) == ([0, 1], [True])
    assert ranks(outlines_of([(ship, (350.0, 90.0), 0.6), (boat, (250.0, -20.0), 0.0)])) == ([1, 0], [True])
    queue = [(boat, (distance, 0.0), 0.0) for distance in (300.0, 100.0, 200.0)]
    assert ranks(outlines_of(queue)) == ([2, 0, 1], [True, True, True])
    for gap_m, known in ((0.0, False), (0.01, False), (1.0, True)):
        assert ranks(outlines_of([(boat, (500.0, 0.0), 0.0), (boat, (505.0 + gap_m, 0.0), 0.0)]))[1] == [known]
    for height_m, known in ((10.0, True), (30.0, False)):
        outlines = outlines_of(IN_DOUBT, mount=Mount((0.0, 0.0, height_m)))
        assert ranks(outlines) == ([0, 1 if known else 0], [known])
        assert ranks(outlines_of(IN_DOUBT[::-1], mount=Mount((0.0, 0.0, height_m)))) == ([int(known), 0], [known])
    outlines = outlines_of(IN_DOUBT, mount=Mount((0.0, 0.0, 10.0)))
    (part,) = outlines.parts
    assert ranks(replace(outlines, parts=(replace(part, solid=replace(part.solid, convex=False)),)))[1] == [False]
    fronts = outlines_of([(vessel("box", 5, 20, 20), (100 + far_m, 0), 0) for far_m in (0, 0.01)])  # all that is seen
    for gap_m in (0.009, 0.011):
        assert rendered._in_front(fronts, np.array([0]), np.array([1]), np.array([gap_m])) == (gap_m < 0.01)
    first, second = np.array([0, 0, 1, 2, 2]), np.array([2, 3, 2, 4, 5])  # rows 0 and 1 are obstacles
    inner = (6, 6, 7, 7)
    boxes = np.array([(0, 0, 9, 9), (5, 5, 20, 9), inner, (0, 0, 5, 9), inner, inner, (9, 0, 20, 9)], dtype=float)
    pairs, one = ClusteredPairs(first, second, np.full(5, 2)), np.array([0])
    for nearer, other, doubtful in (
        ([0, 0, 1, 1, 2, 2, 0], 1, [0]),  # the vessel of row 3 is beside the second obstacle
        ([2, 2, 1, 1, 0, 0, 2], 1, []),  # the vessels are in front
        ([0, 0, 1, 1, 2, 2, 0], 6, []),  # an obstacle beside all vessels
    ):
        found = rendered._behind_both(pairs, np.array(nearer), boxes, one, np.array([other]))
        assert np.flatnonzero(found).tolist() == doubtful
    near, far = np.array([0, 1, 2, 0, 4]), np.array([1, 2, 0, 3, 5])
    found = _ranks(near, far, 6)
    rises = found[near] < found[far]
    assert not rises[:3].all() and rises[4]
    boat = vessel("boat", 5, 2, 2)
    outlines = outlines_of([(boat, (distance, 0.0), 0.0) for distance in (100.0, 200.0, 300.0)])
    monkeypatch.setattr(rendered, "_ranks", lambda near, far, count: np.array([0, 1, 1]))
    assert ranks(outlines)[1] == [True, True, False]


@pytest.fixture(scope="module")
def strait():
    scene = load_scene("strait", mode=2)
    return scene, scene.sight(scene.cameras[0], np.arange(100, 102))


def test_islands_with_hills_hide_ships_as_drawn_and_boxes_around_meshes_are_shoeboxes(renderer, strait):
    scene, sight = strait
    outlines, intrinsics = sight.outlines(), scene.cameras[0].intrinsics
    cut = rendered_occlusion(outlines, intrinsics, NoRenderer())
    assert max({occluder for entries in cut.occluders for occluder, _ in entries}) >= len(scene.vessels)
    assert_same(cut, full_frame_occlusion(outlines, intrinsics, renderer))
    _, sight = strait
    (boxes,) = (part for part in sight.outlines(as_shoeboxes=True).parts if part.solid is shoebox())
    outlines = sight.outlines()
    meshes = [not part.solid.convex and outlines.boxed[part.rows].all() for part in outlines.parts]
    assert any(meshes)
    for part in compress(in_boxes(outlines).parts, meshes):
        for corners in part.vertices_camera:
            assert np.abs(boxes.vertices_camera - corners).max(axis=(1, 2)).min() < 1e-6


def test_frames_steps_and_rows_in_portions_have_the_truth_of_all_at_once(monkeypatch):
    outlines = outlines_of(random_places(np.random.default_rng(710), 60, near_m=150.0))
    outlines = replace(outlines, frame=np.arange(len(outlines)) // 4)
    whole, heights = rendered_occlusion(outlines, INTRINSICS, NoRenderer()), np.diff(outlines.boxes_px[:, 1::2])[:, 0]
    monkeypatch.setattr(rendered, "MAX_LINES", 300)
    lines = np.array([heights[first:stop].sum() for first, stop in rendered._portions(outlines, 1)])
    assert len(lines) > 3 and np.abs(lines[:-1] - 300).max() < np.bincount(outlines.frame, heights).max()
    portion = Mock(wraps=rendered._occlusion)
    monkeypatch.setattr(rendered, "_occlusion", portion)
    assert_same(rendered_occlusion(outlines, INTRINSICS, NoRenderer()), whole)
    assert portion.call_count == len(lines) and any(whole.occluders)
    positions = np.random.default_rng(720).uniform([60, -20, 0], [200, 20, 0], (12, 3, 3))
    turned, camera = world_R_vehicle(np.zeros((12, 3))), poses_ashore(Mount((0.0, 0.0, 10.0)), 12)
    bodies = vessel_bodies([BOAT] * 3, np.ones((12, 3), dtype=bool), positions, turned)
    whole = projection.outline(INTRINSICS, camera, bodies)
    for most in (24, 7 * 24):  # corners of three boats
        monkeypatch.setattr(projection, "MAX_VERTICES", most)
        assert_same_outlines(projection.outline(INTRINSICS, camera, bodies), whole)
    scene = load_scene("strait", mode=2)
    sight = scene.sight(scene.cameras[0], np.arange(100, 112))
    whole = sight.outlines()
    assert len(whole) > 40 and len(whole.parts) > 3
    for first, stop in ((0, 40), (7, 31), (7, 7)):
        assert_same_outlines(whole.between(first, stop), whole.take(np.arange(first, stop)))
    monkeypatch.setattr(projection, "MAX_VERTICES", 400)
    assert_same_outlines(sight.outlines(), whole)


def assert_same_outlines(one: Outlines, other: Outlines) -> None:
    for column in fields(Outlines):
        if column.name != "parts":
            np.testing.assert_array_equal(getattr(one, column.name), getattr(other, column.name))
    assert len(one.parts) == len(other.parts)
    for part, same in zip(one.parts, other.parts, strict=True):
        assert part.solid is same.solid
        for name in ("rows", "vertices_camera", "vertices_px"):
            np.testing.assert_array_equal(getattr(part, name), getattr(same, name))
