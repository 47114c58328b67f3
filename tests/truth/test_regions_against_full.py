"""Drawing where vessels overlap, or supersampled, or in tiles, or not at all, gives the truth of drawing everything."""

from dataclasses import fields, replace
from functools import partial
from itertools import compress
from unittest.mock import Mock

import numpy as np
import pytest
import shapely

from modsim3d.geometry.camera import Intrinsics
from modsim3d.geometry.camera_poses import Mount, poses_ashore, world_R_vehicle
from modsim3d.render.id_pass import Region
from modsim3d.runs.pipeline import truth_block
from modsim3d.scene.reading import load_scene
from modsim3d.truth import buffer_drawing, rendered
from modsim3d.truth import outlines as projection
from modsim3d.truth.analytic import analytic_occlusion
from modsim3d.truth.buffer_drawing import BufferDrawing, fits_a_buffer, tiles_of, triangles_of, within_guard
from modsim3d.truth.cluster_visibility import ClusteredPairs, OrderedClusters, visibility_in_order
from modsim3d.truth.full_frame import full_frame_occlusion, vessel_masks
from modsim3d.truth.occlusion_order import in_boxes
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.record import COLUMNS
from modsim3d.truth.rendered import _ranks, ranks_of, rendered_occlusion, rendered_spans
from modsim3d.truth.scan_conversion import scan_convert
from modsim3d.truth.silhouettes import Spans, counts_and_boxes, doubled_areas, spans_of_ids
from modsim3d.verify.sources.agreement import Agreement, compare_with_analytic
from modsim3d.world.bodies import vessel_bodies
from modsim3d.world.vessels import shoebox
from tests.scenes import INTRINSICS, crate, outlines_of, pixel_masks, random_places, random_rafts, random_scene, vessel


def assert_same(fast, slow):
    for name in ("full_boxes_px", "visible_boxes_px", "silhouette_px", "visible_px"):
        np.testing.assert_array_equal(getattr(fast, name), getattr(slow, name), err_msg=name)
    assert fast.occluders == slow.occluders


RANDOM = [(random_scene, 10_000 + seed, 1) for seed in range(60)]
RANDOM += [(random_scene, 20_000 + seed, 3) for seed in range(6)]
RANDOM += [(random_rafts, seed, 1) for seed in range(60)]


@pytest.mark.parametrize(("make", "seed", "supersample"), RANDOM)
def test_random_scenes_have_the_same_truth_either_way(renderer, make, seed, supersample):
    places, intrinsics, mount = make(np.random.default_rng(seed))
    scene = outlines_of(places, intrinsics, mount), intrinsics, renderer, supersample
    assert_same(rendered_occlusion(*scene), full_frame_occlusion(*scene))


@pytest.mark.parametrize(("name", "first", "stop"), [("simulation_1", 1210, 1250), ("harbour", 155, 180)])
def test_shipped_scenes_have_the_same_truth_either_way(renderer, name, first, stop):
    """Whole Simulation 1 and harbour were compared so; these are the steps with the most occlusion."""
    scenes = (load_scene(name, mode=2, render=render) for render in ("regions", "full"))
    fast, full = (truth_block(scene, first, stop, renderer) for scene in scenes)
    assert (full.visible_fraction < 1).sum() > 15
    for column in set(COLUMNS) - {"drawn"}:
        np.testing.assert_array_equal(getattr(fast, column), getattr(full, column), err_msg=column)


def painted(spans: Spans, row: int, shape: tuple[int, int]) -> np.ndarray:
    mask = np.zeros(shape, dtype=bool)
    own = spans.take(spans.row == row)
    for y, start, stop in zip(own.y, own.start, own.stop, strict=True):
        mask[y, start:stop] = True
    return mask


@pytest.mark.parametrize("seed", range(8))
def test_scan_conversion_fills_the_pixels_that_the_rasteriser_fills(renderer, seed):
    places, intrinsics, mount = random_scene(np.random.default_rng(30_000 + seed))
    outlines = outlines_of(places, intrinsics, mount)
    rows = np.flatnonzero(within_guard(outlines, intrinsics))
    width, height = intrinsics.image_size_px
    for part in outlines.parts:
        vertices = part.vertices_px[rows]
        spans, odd = scan_convert(vertices, part.solid, (width, height))
        for i in sorted(set(range(len(rows))) - set(odd.tolist()))[:12]:
            corners = vertices[i][part.solid.faces]
            drawn = renderer.draw(corners, np.full((12, 3), 0.5), np.ones(12, dtype=int), Region(0, 0, width, height))
            np.testing.assert_array_equal(painted(spans, i, (height, width)), drawn > 0)


def flat_box(left: float, top: float, right: float, bottom: float) -> np.ndarray:
    """A shoebox that projects to a rectangle: every vertex at the corner of its own side, seen along its length."""
    unit = shoebox().vertices
    x, y = np.where(unit[:, 1] > 0, left, right), np.where(unit[:, 2] > 0, top, bottom)
    shrink = np.where(unit[:, 0] > 0, 1.0, 0.5)  # the far side within the near one
    centre = np.array([(left + right) / 2, (top + bottom) / 2])
    return (centre + (np.stack([x, y], axis=-1) - centre) * shrink[:, None])[None]


OUTSIDE = [(5.0, -9.0, 20.0, -3.0), (5.0, 43.0, 20.0, 49.0), (-9.0, 5.0, -3.0, 20.0), (43.0, 5.0, 49.0, 20.0)]


def test_centre_on_an_edge_belongs_to_the_left_and_upper_side_and_without_a_centre_there_is_no_span(renderer):
    for box, expected in (
        ((10.5, 10.5, 20.5, 20.5), (10, 10, 20, 20)),  # edges through pixel centres: left and top are in
        ((10.51, 10.51, 20.51, 20.51), (11, 11, 21, 21)),
        ((10.49, 10.49, 20.49, 20.49), (10, 10, 20, 20)),
        ((-5.0, -5.0, 3.5, 2.5), (0, 0, 3, 2)),
        ((30.0, 30.0, 60.0, 60.0), (30, 30, 40, 40)),
        ((10.45, 10.45, 10.55, 10.55), (10, 10, 11, 11)),
        *((box, (np.inf, np.inf, -np.inf, -np.inf)) for box in (*OUTSIDE, (10.6, 10.45, 10.7, 10.55))),
    ):
        vertices = flat_box(*box)
        spans, odd = scan_convert(vertices, shoebox(), (40, 40))
        assert not len(odd)
        pixels, boxes = counts_and_boxes(spans, 1)
        np.testing.assert_array_equal(boxes[0], expected)
        assert pixels[0] == max(0, expected[2] - expected[0]) * max(0, expected[3] - expected[1])
        assert (len(spans.row) > 0) == (pixels[0] > 0)
        corners = vertices[0][shoebox().faces]
        drawn = renderer.draw(corners, np.full((12, 3), 0.5), np.ones(12, dtype=int), Region(0, 0, 40, 40))
        np.testing.assert_array_equal(painted(spans, 0, (40, 40)), drawn > 0)


def test_outlines_that_cross_themselves_are_drawn_and_faces_and_spans_are_those_of_the_image():
    boxes = [flat_box(3.2, 4.1, 20.7, 30.2), flat_box(8.0, 2.0, 33.0, 21.0), flat_box(1.0, 1.0, 9.5, 38.0)]
    alone = [painted(scan_convert(box, shoebox(), (40, 40))[0], 0, (40, 40)) for box in boxes]
    spans, odd = scan_convert(np.concatenate(boxes), shoebox(), (40, 40))
    assert len(odd) == 0
    twisted = boxes[1].copy()
    twisted[:, :4] = twisted[:, 3::-1]
    spans, odd = scan_convert(np.concatenate([boxes[0], twisted, boxes[2]]), shoebox(), (40, 40))
    assert odd.tolist() == [1]
    for row in (0, 2):
        np.testing.assert_array_equal(painted(spans, row, (40, 40)), alone[row])
    assert not (spans.row == 1).any()
    assert doubled_areas(np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 1.0]])) > 0  # rows run downwards
    assert doubled_areas(np.array([[0.0, 0.0], [1.0, 1.0], [0.0, 1.0]])) < 0
    assert doubled_areas(np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]])) == 0
    ids = np.random.default_rng(3).integers(0, 4, (30, 41)).astype(np.uint32)
    spans = spans_of_ids(ids)
    for row in range(3):
        np.testing.assert_array_equal(painted(spans, row, ids.shape), ids == row + 1)


ABOVE = Mount((0.0, 0.0, 40.0), pitch_rad=0.55, yaw_rad=0.1, roll_rad=0.05)


def pixels_inside(corners_m: np.ndarray) -> np.ndarray:
    """Whether each pixel is inside a face with these corners (4, 3) in the world, half a pixel from its edges."""
    outline_px = INTRINSICS.project((corners_m - ABOVE.position_m) @ ABOVE.camera_R_parent.T)
    x, y = np.meshgrid(np.arange(800) + 0.5, np.arange(600) + 0.5)
    return shapely.contains_xy(shapely.Polygon(outline_px).buffer(-0.5), x, y)


@pytest.mark.parametrize("heading", [0.0, 0.3, 1.2, -2.0, np.pi / 2])
def test_deck_that_two_vessels_share_is_that_of_the_first_in_the_scene(renderer, heading):
    """Two boats of one size side by side; the tenth of a beam that they share is a part of both decks."""
    boat, place, turn = vessel("boat", 20, 6, 5), np.array([60.0, 5.0, 0.0]), world_R_vehicle(heading)
    places = [(boat, tuple((place + turn @ [0, side, 0])[:2]), heading) for side in (0.0, 6 - 0.6)]
    corners = np.array([(-10, 3, 5), (10, 3, 5), (10, 2.4, 5), (-10, 2.4, 5)]) @ turn.T
    shared = pixels_inside(corners + place)
    assert shared.sum() > 300
    for order in (places, places[::-1]):
        triangles = triangles_of(outlines_of(order, mount=ABOVE), INTRINSICS)
        ids = renderer.draw(triangles.corners_px, triangles.inverse_depth, triangles.row + 1, Region(0, 0, 800, 600))
        assert (ids[shared] == 1).all()


SMALL = Intrinsics((500.0, 500.0), (200.0, 150.0), (400, 300))
FACTORS = (1, 2, 4, 8)


def smaller(lens: Intrinsics, divisor: int) -> Intrinsics:
    """A lens of the same view with fewer pixels."""
    width, height = lens.image_size_px
    focal_px, middle_px = (tuple(np.divide(each, divisor)) for each in (lens.focal_px, lens.principal_point_px))
    size_px = width // divisor, height // divisor
    return Intrinsics(focal_px, middle_px, size_px, lens.skew / divisor, near_clip_m=lens.near_clip_m)


@pytest.fixture(scope="module")
def side_differences(renderer):
    """Factor → sides of full and of visible boxes less the exact ones, of vessels that hold pixels at every factor."""
    full, visible = ({factor: [] for factor in FACTORS} for _ in range(2))
    for seed in range(25):
        outlines = outlines_of(random_places(np.random.default_rng(seed), 25, far_m=700.0), SMALL)
        exact = analytic_occlusion(outlines, SMALL)
        drawn = {factor: rendered_occlusion(outlines, SMALL, renderer, factor) for factor in FACTORS}
        clear = (exact.visible_px > 30) & (drawn[1].visible_px > 10)
        inside = exact.full_boxes_px % 1 != 0  # a side on the image edge is exact at any factor
        for factor, seen in drawn.items():
            full[factor].append((seen.full_boxes_px - exact.full_boxes_px)[clear][inside[clear]])
            visible[factor].append((seen.visible_boxes_px - exact.visible_boxes_px)[clear][inside[clear]])
    return [{factor: np.concatenate(parts) for factor, parts in kind.items()} for kind in (full, visible)]


@pytest.mark.parametrize("kind", [0, 1], ids=["full", "visible"])
@pytest.mark.parametrize("factor", FACTORS[1:])
def test_side_differences_shrink_in_proportion_to_the_factor(side_differences, factor, kind):
    sides = side_differences[kind]
    assert len(sides[1]) > 300
    at_one, here = np.abs(sides[1]).mean(), np.abs(sides[factor]).mean()
    # Pixel centres miss a third of a pixel of a slanting side and a quarter of an upright one.
    assert 0.2 < at_one < 0.5
    assert here == pytest.approx(at_one / factor, rel=0.25)


@pytest.mark.parametrize("factor", FACTORS[1:])
def test_full_boxes_are_within_1_2_buffer_pixels_but_for_tips_without_a_pixel_centre(renderer, factor):
    rows = tips = 0
    for seed in range(9):
        places, lens, mount = random_scene(np.random.default_rng(seed))
        lens = smaller(lens, factor // 2)  # so that each factor draws as many pixels, few of which are a second's work
        outlines = outlines_of(places, lens, mount)
        drawn = rendered_occlusion(outlines, lens, renderer, factor)
        masks = partial(pixel_masks, outlines, lens, renderer, supersample=factor)
        found = compare_with_analytic(outlines, lens, drawn, masks, factor)
        off = np.abs(found.full_side_px).max(axis=1) > 1.2 / factor
        assert (found.full[off] == Agreement.SHARP_TIP).all()
        assert not (found.worst == Agreement.UNEXPLAINED).any()
        rows, tips = rows + len(outlines), tips + int(off.sum())
    assert rows > 150 and tips < 0.03 * rows


@pytest.mark.parametrize("factor", [2, 3, 4, 8])
def test_counts_are_in_image_pixels_and_come_nearer_to_the_areas(renderer, factor):
    outlines = outlines_of(random_places(np.random.default_rng(3), 25, far_m=400.0), SMALL)
    exact = analytic_occlusion(outlines, SMALL)
    coarse, fine = (rendered_occlusion(outlines, SMALL, renderer, scale) for scale in (1, factor))
    for pixels in (fine.silhouette_px, fine.visible_px):
        buffer_pixels = pixels * factor**2
        np.testing.assert_allclose(buffer_pixels, np.rint(buffer_pixels), atol=1e-6)
        assert (np.rint(pixels) != pixels).any()
    for name in ("silhouette_px", "visible_px"):
        off = [np.abs(getattr(seen, name) - getattr(exact, name)).mean() for seen in (coarse, fine)]
        assert off[1] < 1.5 * off[0] / factor
    hidden = np.array([sum(px for _, px in row) for row in fine.occluders])
    np.testing.assert_allclose(fine.visible_px + hidden, fine.silhouette_px)
    assert (hidden > 0).any()


def test_box_between_pixels_is_told_to_an_eighth_of_a_pixel(renderer):
    """Front face at 100 m from w2 = −3.03 to 2.04 m: columns 379.6–430.3."""
    outlines = outlines_of([(vessel("box", 0.01, 5.07, 10), (100.005, -0.495), 0.0)])
    sides = outlines.boxes_px[0, [0, 2]]
    for factor in FACTORS:
        drawn = rendered_occlusion(outlines, INTRINSICS, renderer, factor).full_boxes_px[0, [0, 2]]
        # The first buffer column whose centre is inside, and the one after the last.
        assert drawn.tolist() == (np.ceil(sides * factor - 0.5) / factor).tolist()
        assert abs(drawn - sides)[0] <= 0.5 / factor


@pytest.mark.parametrize(("factor", "tile"), [(1, (100, 64)), (3, (257, 100)), (4, (64, 1000))])
def test_buffer_drawn_in_tiles_gives_the_same_as_in_one(renderer, monkeypatch, factor, tile):
    outlines = outlines_of(random_places(np.random.default_rng(4), 25, far_m=400.0), SMALL)
    whole = rendered_occlusion(outlines, SMALL, renderer, factor)
    monkeypatch.setattr(buffer_drawing, "TILE_PX", tile)
    assert_same(rendered_occlusion(outlines, SMALL, renderer, factor), whole)
    assert any(whole.occluders)


def test_buffer_is_8192_wide_and_4096_high():
    sizes = (8192, 4096), (1, 1), (8193, 1), (1, 4097), (4096, 8192)
    assert [fits_a_buffer(size) for size in sizes] == [True, True, False, False, False]


@pytest.mark.parametrize("region", [Region(5, 7, 20_000, 9_000), Region(0, 0, 8192, 4096), Region(-3, 9000, 8193, 10)])
def test_tiles_are_the_region_cut_into_as_few_parts_as_fit(region):
    tiles = tiles_of(region)
    assert all(fits_a_buffer((tile.width, tile.height)) for tile in tiles)
    assert sum(tile.width * tile.height for tile in tiles) == region.width * region.height
    assert all(tile == tile.common(region) for tile in tiles)
    corners = {(tile.x, tile.y) for tile in tiles}
    assert len(corners) == len(tiles) == -(-region.width // 8192) * -(-region.height // 4096)


@pytest.mark.parametrize("factor", [1, 3])
def test_pixel_boxes_are_the_smallest_of_whole_buffer_pixels_around_the_silhouettes(renderer, factor):
    outlines = outlines_of(random_places(np.random.default_rng(9), 30, far_m=400.0))
    drawing = BufferDrawing(outlines, INTRINSICS, renderer, factor)
    low, high = np.split(drawing.pixel_boxes - outlines.boxes_px * factor, 2, axis=1)
    assert ((low <= 0) & (low > -1) & (high >= 0) & (high < 1)).all()
    np.testing.assert_array_equal(drawing.pixel_boxes, np.rint(drawing.pixel_boxes))
    assert drawing.image == Region(0, 0, 800 * factor, 600 * factor)


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
