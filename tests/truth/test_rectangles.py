"""The thesis's rule (Jessen & Mohr (2023), §7.5.1, Figures 7.14–7.16) on rectangles given as numbers. Mode 0 keeps the
full box of every vessel, mode 1 of every vessel that is not fully covered; in mode 2, "if two neighbouring corners of
the vessel are covered, only the visible part is annotated"."""

from dataclasses import fields, replace

import numpy as np
import pytest
import shapely

from modsim3d.render.id_pass import Region
from modsim3d.truth import analytic
from modsim3d.truth.analytic import counted_from, hidden_by, mask_box, mask_fits, rectangle_occlusion, visible_of
from modsim3d.truth.occlusion import HiddenPixels, Occlusion
from modsim3d.truth.record import Annotation, annotated_rows, annotation_boxes
from tests.scenes import INTRINSICS, outlines_of, vessel

B = (100.0, 100.0, 200.0, 200.0)  # the box that is looked at; everything else is before it unless its depth says not


def seen_of(boxes, depths=None):
    """What the rule says of boxes, the first 100 m away and the others 50 m unless told."""
    outlines = outlines_of([(vessel(f"v{i}"), (100.0, 0.0), 0.0) for i in range(len(boxes))])
    depth = np.array(depths if depths is not None else [100.0] + [50.0] * (len(boxes) - 1))
    return rectangle_occlusion(replace(outlines, boxes_px=np.array(boxes, dtype=float), depth_m=depth))


def annotated_box(seen, mode):
    """The box of the first vessel that a mode annotates, or None."""
    outlines = outlines_of([(vessel(f"v{i}"), (100.0, 0.0), 0.0) for i in range(len(seen.visible_px))])
    truth = seen.truth(outlines, np.zeros(1, dtype=int), 0)
    if not annotated_rows(truth, Annotation(mode=mode, source="rectangles"))[0]:
        return None
    return tuple(annotation_boxes(truth, mode)[0])


UPPER, LOWER = (50, 50, 140, 150), (50, 150, 130, 250)
COVERS = {
    "nothing": ([], B, 10_000),
    **{f"the corner at {x}, {y}": ([(x, y, x + 100, y + 100)], B, 7500) for x in (50, 150) for y in (50, 150)},
    "the left corners": ([(50, 50, 140, 250)], (140, 100, 200, 200), 6000),
    "the right corners": ([(160, 50, 250, 250)], (100, 100, 160, 200), 6000),
    "the upper corners": ([(50, 50, 250, 130)], (100, 130, 200, 200), 7000),
    "the lower corners": ([(50, 170, 250, 250)], (100, 100, 200, 170), 7000),
    "two opposite corners": ([(50, 50, 140, 140), (160, 160, 250, 250)], B, 6800),
    "the middle": ([(120, 50, 180, 250)], B, 4000),
    "a corner by one": ([UPPER], B, 8000),
    "a corner by another": ([LOWER], B, 8500),
    "a side by both of these": ([UPPER, LOWER], (130, 100, 200, 200), 6500),
    # What is left of the rectangle still reaches that side, so the visible part has the same box.
    "two corners of a side that is seen between them": ([(50, 50, 140, 140), (50, 160, 140, 250)], B, 6800),
    "everything": ([(100, 100, 200, 200)], None, 0),
    "everything, by two halves": ([(50, 50, 150, 250), (150, 50, 250, 250)], None, 0),
}
"""What is covered, the boxes that cover it, the box that is annotated in mode 2, and the area that is visible."""


@pytest.mark.parametrize("what", COVERS)
def test_only_two_neighbouring_corners_that_are_covered_cut_a_side_and_in_mode_two_only(what):
    covers, left, visible_px = COVERS[what]
    seen = seen_of([B, *covers])
    assert [annotated_box(seen, mode) for mode in (0, 1, 2)] == [B, B if left else None, left]
    assert seen.visible_px[0] == visible_px and np.isnan(seen.visible_boxes_px[0]).all() == (left is None)


def five_rows() -> Occlusion:
    """Rows 0 and 3 intersect, and 1 and 4; 2 is hidden by 0 and 1, and 4 by 2."""
    numbers = np.arange(5.0)
    return Occlusion(
        full_boxes_px=numbers[:, None] + np.arange(4.0),
        visible_boxes_px=numbers[:, None] + np.arange(4.0) / 2,
        silhouette_px=10 * numbers,
        visible_px=numbers,
        hidden=HiddenPixels(np.array([2, 2, 4]), np.array([0, 1, 2]), np.array([3.0, 5.0, 7.0])),
        intersecting=np.array([[0, 3], [1, 4]]),
    )


def test_nearer_means_smaller_depth_and_entries_are_added_up_in_order():
    row, occluder = np.array([1, 1, 0, 1, 0, 1]), np.array([5, 2, 0, 5, 0, 2])
    found = HiddenPixels.of(row, occluder, np.array([1.0, 2, 4, 8, 16, 32]))
    assert (found.row.tolist(), found.occluder.tolist(), found.px.tolist()) == ([0, 1, 1], [0, 2, 5], [20.0, 34.0, 9.0])
    assert found.offsets(3).tolist() == [0, 1, 3, 3]
    assert HiddenPixels.of(row[:0], occluder[:0], np.empty(0)).offsets(2).tolist() == [0, 0, 0]
    found = five_rows().take(np.array([0, 2, 3]))
    assert found.occluders == ((), ((0, 3.0), (1, 5.0)), ()) and found.intersecting.tolist() == [[0, 2]]
    np.testing.assert_array_equal(found.silhouette_px, [0.0, 20.0, 30.0])
    assert five_rows().take(np.array([1, 2, 3, 4])).intersecting.tolist() == [[0, 3]]
    drawn = replace(five_rows(), drawn=np.array([True, False, True, True, False]))
    joined = Occlusion.joined([drawn, five_rows()])
    for part, rows in ((drawn, np.arange(5)), (five_rows(), np.arange(5, 10))):
        again = joined.take(rows)
        assert again.occluders == part.occluders and again.drawn.dtype == bool
        np.testing.assert_array_equal(again.intersecting, part.intersecting)
        np.testing.assert_array_equal(again.was_drawn(), part.was_drawn())
        for name in ("full_boxes_px", "visible_boxes_px", "silhouette_px", "visible_px"):
            np.testing.assert_array_equal(getattr(again, name), getattr(part, name))
    assert not five_rows().was_drawn().any()
    cover = (50, 50, 140, 250)
    assert annotated_box(seen_of([B, cover], [100.0, 99.9]), 2) == (140, 100, 200, 200)
    assert annotated_box(seen_of([B, cover], [99.9, 100.0]), 2) == B
    np.testing.assert_array_equal(seen_of([cover, B], [99.9, 100.0]).visible_boxes_px, [cover, (140, 100, 200, 200)])
    seen = seen_of([B, (50, 50, 250, 250)], [100.0, 100.0])
    np.testing.assert_array_equal(seen.visible_px, seen.silhouette_px)
    assert seen.occluders == ((), ())
    # Columns 100–150 under one at 50 m, 130–180 under one at 40 m: the latter takes 130–150 too.
    seen = seen_of([B, (100, 50, 150, 250), (130, 50, 180, 250)], [100.0, 50.0, 40.0])
    assert seen.occluders[0] == ((1, 3000.0), (2, 5000.0))
    tied = seen_of([B, (100, 50, 150, 250), (130, 50, 180, 250)], [100.0, 50.0, 50.0])
    assert sum(px for _, px in tied.occluders[0]) == 8000.0
    # A boat before the far end of a ship, in a part of the ship's box.
    boat, ship = vessel("boat", 2, 2, 2), vessel("ship", 60, 2, 12)
    outlines = outlines_of([(boat, (109.0, 9.5), 0.0), (ship, (100.0, 0.0), 0.6)])
    assert analytic.analytic_occlusion(outlines, INTRINSICS).visible_fraction()[0] == 1
    assert rectangle_occlusion(outlines).visible_fraction()[0] == 0


def test_record_has_the_steps_of_the_frames_nothing_annotated_and_no_share_that_is_visible_without_a_pixel():
    outlines = outlines_of([(vessel(f"v{i}"), (100.0 + 20 * i, 0.0), 0.0) for i in range(5)])
    truth = five_rows().truth(outlines, np.array([7]), 3)
    found = truth.step, truth.camera, truth.vessel, truth.annotated
    np.testing.assert_array_equal(found, [[7] * 5, [3] * 5, range(5), [False] * 5])
    assert truth.occluders_of(2) == [(0, 3.0), (1, 5.0)]
    np.testing.assert_array_equal(truth.intersections, [[7, 3, 0, 3], [7, 3, 1, 4]])
    np.testing.assert_array_equal(five_rows().visible_fraction(), [np.nan, 0.1, 0.1, 0.1, 0.1])
    columns = {field.name: getattr(five_rows(), field.name) for field in fields(Occlusion)[:5]}
    assert Occlusion(**columns).truth(outlines, np.array([7]), 3).intersections.shape == (0, 4)


def test_what_pieces_of_one_obstacle_hide_together_counts_once():
    """Columns 0–5 and 4–8 under two pieces of occluder 7, 9–10 under occluder 3, of which 9–12 is before a piece."""
    silhouettes = np.array([shapely.box(0, 0, 10, 10), shapely.box(0, 0, 5, 10), shapely.box(4, 0, 8, 10)])
    silhouettes = np.append(silhouettes, shapely.box(7, 0, 12, 10))
    occluder = np.array([0, 7, 7, 3])
    hiding = analytic.Hiders.of(np.array([0, 0, 0, 2]), np.array([3, 1, 2, 3]))
    areas = analytic.hidden_areas(silhouettes, hiding, occluder)
    np.testing.assert_allclose(areas, [70, 0, 30, 10])
    hidden = hidden_by(hiding, areas, occluder)
    assert (hidden.row.tolist(), hidden.occluder.tolist(), hidden.px.tolist()) == ([0, 0, 2], [3, 7, 3], [30, 70, 10])
    boxes = np.array([shape.bounds for shape in silhouettes])
    seen_boxes, seen_px = analytic.boxes_and_areas(visible_of(silhouettes, hiding), boxes, shapely.area(silhouettes))
    np.testing.assert_allclose(seen_px, [0, 50, 30, 50])
    np.testing.assert_array_equal(seen_boxes, [[np.nan] * 4, boxes[1], [4, 0, 7, 10], boxes[3]])


REGION = Region(30, 60, 60, 45)
SHAPE = shapely.Polygon([(12.3, 21.2), (27.9, 22.1), (25.2, 33.8), (14.1, 31.7)])
COVER_SHAPES = np.array([shapely.box(11, 20, 16.2, 34.9), shapely.box(20.3, 28.1, 40, 40)])


def pixels_of(shape: shapely.Geometry, factor: int, shrink_px: float = 0.0) -> tuple[np.ndarray, Region]:
    """Which pixels of a region of the buffer have their centre in a shape given in image pixels."""
    region = Region(*(value * factor // 3 for value in (REGION.x, REGION.y, REGION.width, REGION.height)))
    x, y = np.meshgrid(region.x + np.arange(region.width) + 0.5, region.y + np.arange(region.height) + 0.5)
    return shapely.contains_xy(shape.buffer(-shrink_px), x / factor, y / factor), region


@pytest.mark.parametrize("factor", [1, 3, 4])
@pytest.mark.parametrize("covers", [COVER_SHAPES[:0], COVER_SHAPES[:1], COVER_SHAPES], ids=len)
def test_centres_inside_fit_and_one_wrong_pixel_does_not(factor, covers):
    seen = SHAPE.difference(shapely.union_all(covers)) if len(covers) else SHAPE
    mask, region = pixels_of(seen, factor)
    assert mask_fits(mask, region, SHAPE, covers, factor)
    surely, surely_not = pixels_of(seen, factor, 0.1)[0], ~pixels_of(seen, factor, -0.1)[0]
    rng = np.random.default_rng(factor)
    for wrong in (surely, surely_not):
        for place in rng.permutation(np.argwhere(wrong))[:20]:
            other = mask.copy()
            other[tuple(place)] ^= True
            assert not mask_fits(other, region, SHAPE, covers, factor)


@pytest.mark.parametrize("factor", [1, 3, 4])
def test_centre_closer_to_the_edge_than_the_rounding_of_corners_may_be_either(factor):
    # The band is 1/128 of a buffer pixel to either side.
    for off, free in ((0.9 / 128, True), (1.1 / 128, False)):
        for side in (-1, 1):
            edge = (10.5 + side * off) / factor
            square = shapely.box(edge, 0, 20 / factor, 20 / factor)
            mask = np.zeros((20, 20), dtype=bool)
            mask[:, 10:] = True
            assert mask_fits(mask, Region(0, 0, 20, 20), square, COVER_SHAPES[:0], factor) == (free or side < 0)
            mask[:, 10] = False
            assert mask_fits(mask, Region(0, 0, 20, 20), square, COVER_SHAPES[:0], factor) == (free or side > 0)


@pytest.mark.parametrize("factor", [1, 3])
def test_box_and_count_are_those_of_the_mask_they_were_counted_from(factor):
    mask, region = pixels_of(SHAPE, factor)
    (y, x), box = np.nonzero(mask), mask_box(mask, region)
    expected = [x.min() + region.x, y.min() + region.y, x.max() + 1 + region.x, y.max() + 1 + region.y]
    np.testing.assert_array_equal(box, expected)
    count = mask.sum() / factor**2
    assert counted_from(mask, region, box / factor, count, factor)
    assert counted_from(mask, region, box / factor, count + 1 / factor**2, factor) is False
    assert not counted_from(mask, region, box / factor + [0, 0, 1 / factor, 0], count, factor)
    assert counted_from(np.zeros_like(mask), region, np.full(4, np.nan), 0.0, factor)
    assert not counted_from(np.zeros_like(mask), region, np.full(4, np.nan), 1 / factor**2, factor)
