"""What a source says about occlusion as rows are chosen and turned into the truth record, and whether masks fit it."""

from dataclasses import fields, replace

import numpy as np
import pytest
import shapely

from modsim3d.render.id_pass import Region
from modsim3d.truth.analytic import (
    Hiding,
    boxes_and_areas,
    counted_from,
    hidden_areas,
    hidden_by,
    mask_box,
    mask_fits,
    visible_of,
)
from modsim3d.truth.occlusion import HiddenPixels, Occlusion
from tests.scenes import outlines_of, vessel


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


def test_entries_of_one_row_and_occluder_are_added_up_in_order():
    row, occluder = np.array([1, 1, 0, 1, 0, 1]), np.array([5, 2, 0, 5, 0, 2])
    found = HiddenPixels.of(row, occluder, np.array([1.0, 2, 4, 8, 16, 32]))
    assert (found.row.tolist(), found.occluder.tolist(), found.px.tolist()) == ([0, 1, 1], [0, 2, 5], [20.0, 34.0, 9.0])
    assert found.offsets(3).tolist() == [0, 1, 3, 3]
    assert HiddenPixels.of(row[:0], occluder[:0], np.empty(0)).offsets(2).tolist() == [0, 0, 0]


def test_chosen_rows_keep_their_hiders_and_the_pairs_of_which_both_are_chosen():
    found = five_rows().take(np.array([0, 2, 3]))
    assert found.occluders == ((), ((0, 3.0), (1, 5.0)), ()) and found.intersecting.tolist() == [[0, 2]]
    np.testing.assert_array_equal(found.silhouette_px, [0.0, 20.0, 30.0])
    assert five_rows().take(np.array([1, 2, 3, 4])).intersecting.tolist() == [[0, 3]]


def test_parts_that_are_joined_are_the_rows_that_are_chosen_again():
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
    hiding = Hiding.of(np.array([0, 0, 0, 2]), np.array([3, 1, 2, 3]))
    areas = hidden_areas(silhouettes, hiding, occluder)
    np.testing.assert_allclose(areas, [70, 0, 30, 10])
    hidden = hidden_by(hiding, areas, occluder)
    assert (hidden.row.tolist(), hidden.occluder.tolist(), hidden.px.tolist()) == ([0, 0, 2], [3, 7, 3], [30, 70, 10])
    boxes = np.array([shape.bounds for shape in silhouettes])
    seen_boxes, seen_px = boxes_and_areas(visible_of(silhouettes, hiding), boxes, shapely.area(silhouettes))
    np.testing.assert_allclose(seen_px, [0, 50, 30, 50])
    np.testing.assert_array_equal(seen_boxes, [[np.nan] * 4, boxes[1], [4, 0, 7, 10], boxes[3]])


REGION = Region(30, 60, 60, 45)
SHAPE = shapely.Polygon([(12.3, 21.2), (27.9, 22.1), (25.2, 33.8), (14.1, 31.7)])
COVERS = np.array([shapely.box(11, 20, 16.2, 34.9), shapely.box(20.3, 28.1, 40, 40)])


def pixels_of(shape: shapely.Geometry, factor: int, shrink_px: float = 0.0) -> tuple[np.ndarray, Region]:
    """Which pixels of a region of the buffer have their centre in a shape given in image pixels."""
    region = Region(*(value * factor // 3 for value in (REGION.x, REGION.y, REGION.width, REGION.height)))
    x, y = np.meshgrid(region.x + np.arange(region.width) + 0.5, region.y + np.arange(region.height) + 0.5)
    return shapely.contains_xy(shape.buffer(-shrink_px), x / factor, y / factor), region


@pytest.mark.parametrize("factor", [1, 3, 4])
@pytest.mark.parametrize("covers", [COVERS[:0], COVERS[:1], COVERS], ids=len)
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
            assert mask_fits(mask, Region(0, 0, 20, 20), square, COVERS[:0], factor) == (free or side < 0)
            mask[:, 10] = False
            assert mask_fits(mask, Region(0, 0, 20, 20), square, COVERS[:0], factor) == (free or side > 0)


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
