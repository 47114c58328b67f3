"""Groups of overlapping boxes against a search of every pair; the cross-check's drawing against the plain one."""

from dataclasses import replace

import numpy as np
import pytest

from modsim3d.geometry.camera import Distortion
from modsim3d.render.id_pass import Region
from modsim3d.truth.cluster_visibility import SHEET_PX, Cluster, ClusteredPairs, batches_of, clusters_of
from modsim3d.truth.crosscheck.comparison import possible_ids, undecided
from modsim3d.truth.crosscheck.drawing import cut, tiles_of
from modsim3d.truth.full_frame import vessel_masks
from modsim3d.truth.occlusion_order import overlapping_pairs
from modsim3d.truth.outlines import Outlines
from tests.scenes import drawing_of, outlines_of, random_scene, vessel


def random_outlines(rng: np.random.Generator, count: int) -> Outlines:
    """Whole pixel boxes in three frames; a fifth are obstacles."""
    corner, size = rng.integers(0, 400, (count, 2)), rng.integers(1, 60, (count, 2))
    frame, boxed, nothing = np.sort(rng.integers(0, 3, count)), rng.random(count) < 0.8, np.empty(count)
    boxes_px = np.concatenate([corner, corner + size], axis=1).astype(np.float64)
    return Outlines(frame, np.arange(count), boxed, boxes_px, *[nothing] * 3, np.zeros(count, dtype=bool), parts=())


def overlap(outlines: Outlines, a: int, b: int) -> bool:
    one, other = outlines.boxes_px[a], outlines.boxes_px[b]
    apart = (one[:2] >= other[2:]).any() or (other[:2] >= one[2:]).any()
    return bool(outlines.frame[a] == outlines.frame[b] and not apart)


def expected_clusters(outlines: Outlines) -> set[tuple]:
    """Rows and shared region of each cluster, grown from one vessel at a time."""
    every, found, seen = range(len(outlines)), set(), set()
    for first in np.flatnonzero(outlines.boxed).tolist():
        if first in seen:
            continue
        vessels = {first}
        while more := {b for a in vessels for b in every if outlines.boxed[b] and overlap(outlines, a, b)} - vessels:
            vessels |= more
        seen |= vessels
        pairs = [(a, b) for a in vessels for b in every if a != b and overlap(outlines, a, b)]
        if pairs:
            rows = sorted(vessels | {b for _, b in pairs})
            one, other = outlines.boxes_px[np.array(pairs).T]
            low = np.maximum(one[:, :2], other[:, :2]).min(axis=0).astype(int)
            high = np.minimum(one[:, 2:], other[:, 2:]).max(axis=0).astype(int)
            found.add((tuple(rows), Region(*low.tolist(), *(high - low).tolist())))
    return found


@pytest.mark.parametrize("seed", range(12))
def test_clusters_are_those_that_a_search_of_all_pairs_finds(seed):
    outlines = random_outlines(np.random.default_rng(seed), (0, 1, 5, 40, 90, 120)[seed % 6])
    clusters = clusters_of(outlines, outlines.boxes_px, ClusteredPairs.of(outlines, outlines.boxes_px))
    told = [(tuple(each.rows.tolist()), each.shared) for each in clusters]
    assert len(told) == len(set(told)) and set(told) == expected_clusters(outlines)


def test_overlapping_pairs_are_those_of_all_pairs_and_none_of_boxes_without_a_pixel():
    for seed in range(6):
        outlines = random_outlines(np.random.default_rng(50 + seed), 60)
        every = [(a, b) for a in range(60) for b in range(a + 1, 60) if overlap(outlines, a, b)]
        with_vessel = [(a, b) for a, b in every if outlines.boxed[[a, b]].any()]
        for asked, expected in ((None, every), (outlines.boxed, with_vessel)):
            pairs = overlapping_pairs(outlines.frame, outlines.boxes_px, asked)
            assert list(zip(*(rows.tolist() for rows in pairs), strict=True)) == expected
    nothing, touching = (np.inf, np.inf, -np.inf, -np.inf), ((9, 0, 12, 9), (0, 9, 9, 12))
    boxes = np.array([(0, 0, 9, 9), (4, 2, 4, 6), nothing, *touching], dtype=np.float64)
    for order in (1, -1):  # a box without a width overlaps those around it
        pairs = overlapping_pairs(np.zeros(5, dtype=np.int64), boxes[::order])
        assert [rows.tolist() for rows in pairs] == ([[0], [1]] if order == 1 else [[3], [4]])


def random_clusters(rng: np.random.Generator, count: int, most: int) -> list[Cluster]:
    sizes = rng.integers(1, most, (count, 2)).tolist()
    return [Cluster(np.array([row]), Region(7 * row, 3, w, h)) for row, (w, h) in enumerate(sizes)]


@pytest.mark.parametrize(("count", "most"), [(1, 200), (40, 80), (150, 256), (30, 600), (20, 4000), (0, 9)])
def test_every_cluster_has_a_place_of_its_own_in_one_buffer(count, most):
    batches = batches_of(random_clusters(np.random.default_rng(count), count, most))
    assert sorted(each.rows[0] for batch in batches for each in batch.clusters) == list(range(count))
    for batch in batches:
        sheet = batch.sheet
        assert sheet.regions == [each.shared for each in batch.clusters]
        taken = np.zeros(sheet.size[::-1], dtype=int)
        for region, (x, y) in zip(sheet.regions, sheet.places.tolist(), strict=True):
            assert x + region.width <= sheet.size[0] and y + region.height <= sheet.size[1]
            taken[y : y + region.height, x : x + region.width] += 1
        assert taken.max() == 1
        assert taken.any(axis=1).all()  # no shelf is higher than what stands on it


def test_small_clusters_share_buffers_and_large_ones_have_their_own():
    many = batches_of(random_clusters(np.random.default_rng(40), 40, 80))
    assert len(many) == 1
    assert all(side <= most for side, most in zip(many[0].sheet.size, SHEET_PX, strict=True))
    tall, wide = (50, 1100), (3600, 700)
    halves, levels = ([(512, 9)] * 2, [(1024, 9)]), ([(1024, 512)] * 2, [(1024, 1024)])
    pairs = halves, levels, ([(600, 9), (425, 9)], [(600, 18)])  # and two that are too wide together by a pixel
    for sizes, buffers in (((tall, wide, tall, wide), [tall, tall, wide, wide]), *pairs):
        batches = batches_of([Cluster(np.array([row]), Region(0, 0, *size)) for row, size in enumerate(sizes)])
        assert sorted(batch.sheet.size for batch in batches) == buffers


@pytest.mark.parametrize(("seed", "lens"), [*((seed, False) for seed in range(12)), (1, True), (2, True), (5, True)])
def test_pixels_are_those_of_the_plain_drawing_and_differ_behind_a_lens_at_ties_only(seed, lens, renderer) -> None:
    places, intrinsics, mount = random_scene(np.random.default_rng(seed))
    if lens:
        zoom = intrinsics.focal_px[0] / intrinsics.image_size_px[0]
        intrinsics = replace(intrinsics, distortion=Distortion(k1=-0.05 * min(1.0, zoom**2), p1=0.002))
    supersample = 1 + seed % 2
    drawing = drawing_of(places, intrinsics, mount, supersample)
    seen, outlines = drawing.ids(renderer, drawing.image), outlines_of(places, intrinsics, mount)
    for row, masks in vessel_masks(outlines, intrinsics, renderer, supersample):
        occluder, region = int(outlines.occluder[row]), masks.region
        alone = drawing.only(occluder)
        here = np.s_[region.y : region.y + region.height, region.x : region.x + region.width]
        whole = (masks.silhouette, alone.ids(renderer, region) > 0, alone)
        for plain, own, of in (whole, (masks.visible, seen[here] == occluder + 1, drawing)):
            y, x = np.nonzero(plain ^ own)
            assert lens or len(x) < 2  # where two vessels touch, one pixel may be either's
            assert (possible_ids(of, x + region.x, y + region.y)[1].sum(axis=1) > 1).all()


def test_a_vessel_alone_has_the_pixels_of_the_image_and_equal_boats_tie_where_faces_are_one(renderer):
    drawing = drawing_of([(vessel("a"), (60.0, 3.0), 0.4), (vessel("b"), (120.0, -29.0), 1.0)])
    whole, region = drawing.ids(renderer, drawing.image), drawing.region(1)
    here = whole[region.y : region.y + region.height, region.x : region.x + region.width]
    np.testing.assert_array_equal(here, drawing.only(1).ids(renderer, region))
    assert 0 < (here == 2).sum() == (whole == 2).sum()
    for seed in range(20):
        places, intrinsics, mount = random_scene(np.random.default_rng(seed))
        outlines, drawing = outlines_of(places, intrinsics, mount), drawing_of(places, intrinsics, mount)
        boxes = np.array([drawing.boxes_px[occluder] for occluder in outlines.occluder.tolist()]).reshape(-1, 4)
        np.testing.assert_allclose(boxes, outlines.boxes_px, atol=1e-6)
    triangle = np.array([[[0.0, 0.0], [4.0, 0.0], [0.0, 4.0]]])
    for offset, area in ((1.0, 4.5), (-1.0, 8.0), (5.0, 0.0)):
        parts, source = cut(triangle, [(np.array([1.0, 0.0]), offset)])
        (a, b, c) = np.moveaxis(parts, 1, 0)
        doubled = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
        assert doubled.sum() / 2 == pytest.approx(area) and (source == 0).all()
    # Both bows lie in one plane across the view; they overlap by a tenth of the beam.
    places = [(vessel("a"), (60.0, 0.0), 0.0), (vessel("b"), (60.0, 9.0), 0.0)]
    drawing, column = drawing_of(places), np.arange(300, 420)
    row = np.full(len(column), 305)
    ties = possible_ids(drawing, column, row)[1].sum(axis=1) > 1
    centre = column + 0.5
    common = (centre > 400 - 1000 * 5 / 55) & (centre < 400 - 1000 * 4 / 55)
    np.testing.assert_array_equal(ties[2:-2], common[2:-2])
    for each in (1, 2):
        np.testing.assert_array_equal(undecided(drawing, column, row, each), ties)
    assert not possible_ids(drawing, column[ties], row[ties])[1][:, 0].any()
    drawing = drawing_of([(vessel("a"), (60.0, 0.0), 0.0), (vessel("b"), (61.0 + 10.0, 1.0), 0.0)])
    x, y = np.meshgrid(np.arange(320, 380), np.arange(300, 320))
    ids, possible = possible_ids(drawing, x.ravel(), y.ravel())
    assert ids.tolist() == [0, 1, 2]
    np.testing.assert_array_equal(possible, np.tile([False, True, False], (x.size, 1)))
    assert sum(tile.width * tile.height for tile in tiles_of(Region(3, 5, 9000, 4500))) == 9000 * 4500
