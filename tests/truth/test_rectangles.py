"""The thesis's rule (Jessen & Mohr (2023), §7.5.1, Figures 7.14–7.16) on rectangles given as numbers. Mode 0 keeps the
full box of every vessel, mode 1 of every vessel that is not fully covered; in mode 2, "if two neighbouring corners of
the vessel are covered, only the visible part is annotated"."""

from dataclasses import replace

import numpy as np
import pytest

from modsim3d.truth.analytic import analytic_occlusion, rectangle_occlusion
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


def test_nearer_means_smaller_depth_whatever_the_order_of_vessels():
    cover = (50, 50, 140, 250)
    assert annotated_box(seen_of([B, cover], [100.0, 99.9]), 2) == (140, 100, 200, 200)
    assert annotated_box(seen_of([B, cover], [99.9, 100.0]), 2) == B
    np.testing.assert_array_equal(seen_of([cover, B], [99.9, 100.0]).visible_boxes_px, [cover, (140, 100, 200, 200)])


def test_boxes_of_equal_depth_hide_nothing_of_each_other():
    seen = seen_of([B, (50, 50, 250, 250)], [100.0, 100.0])
    np.testing.assert_array_equal(seen.visible_px, seen.silhouette_px)
    assert seen.occluders == ((), ())


def test_hidden_part_belongs_to_the_nearest_and_is_counted_once():
    """Columns 100–150 under one at 50 m, 130–180 under one at 40 m: the latter takes 130–150 too."""
    seen = seen_of([B, (100, 50, 150, 250), (130, 50, 180, 250)], [100.0, 50.0, 40.0])
    assert seen.occluders[0] == ((1, 3000.0), (2, 5000.0))
    tied = seen_of([B, (100, 50, 150, 250), (130, 50, 180, 250)], [100.0, 50.0, 50.0])
    assert sum(px for _, px in tied.occluders[0]) == 8000.0


def test_rule_looks_at_rectangles_and_not_at_what_is_drawn_in_them():
    """A boat before the far end of a ship, in a part of the ship's box."""
    boat, ship = vessel("boat", 2, 2, 2), vessel("ship", 60, 2, 12)
    outlines = outlines_of([(boat, (109.0, 9.5), 0.0), (ship, (100.0, 0.0), 0.6)])
    assert analytic_occlusion(outlines, INTRINSICS).visible_fraction()[0] == 1
    assert rectangle_occlusion(outlines).visible_fraction()[0] == 0
