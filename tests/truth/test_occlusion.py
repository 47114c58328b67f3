"""What a source says about occlusion, as rows are chosen, spread and turned into the truth record."""

import numpy as np
import shapely

from modsim3d.truth.analytic import Hiding, boxes_and_areas, hidden_areas, hidden_by, visible_of
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


def test_record_has_the_steps_of_the_frames_nothing_annotated_and_no_share_that_is_visible_without_a_pixel():
    outlines = outlines_of([(vessel(f"v{i}"), (100.0 + 20 * i, 0.0), 0.0) for i in range(5)])
    truth = five_rows().truth(outlines, np.array([7]), 3)
    found = truth.step, truth.camera, truth.vessel, truth.annotated
    np.testing.assert_array_equal(found, [[7] * 5, [3] * 5, range(5), [False] * 5])
    assert truth.occluders_of(2) == [(0, 3.0), (1, 5.0)]
    np.testing.assert_array_equal(truth.intersections, [[7, 3, 0, 3], [7, 3, 1, 4]])
    np.testing.assert_array_equal(five_rows().visible_fraction(), [np.nan, 0.1, 0.1, 0.1, 0.1])


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
