"""Which vessels are annotated: modes and filters on rows whose values are given as numbers."""

from dataclasses import replace

import numpy as np
import pytest

from modsim3d.truth.record import Annotation, Truth, annotated_rows, annotation_boxes, no_truth

WHOLE, SEEN, HIDDEN, UNKNOWN = range(4)


def four_rows() -> Truth:
    """One vessel each that is seen as a whole, seen in part, hidden, and of which it is not known what is seen."""
    full = np.array([[0.0, 0.0, 40.0, 20.0]] * 4)
    visible = np.array([[0.0, 0, 40, 20], [10, 0, 15, 20], [np.nan] * 4, [np.nan] * 4])
    silhouette, seen = np.full(4, 800.0), np.array([800.0, 100.0, 0.0, np.nan])
    pixels = {"silhouette_px": silhouette, "visible_px": seen, "visible_fraction": seen / silhouette}
    step = np.zeros(4, dtype=np.int64)
    return replace(no_truth(), step=step, full_boxes_px=full, visible_boxes_px=visible, **pixels)


@pytest.mark.parametrize(
    ("mode", "filters", "kept"),
    [
        (0, {}, [WHOLE, SEEN, HIDDEN, UNKNOWN]),
        (1, {}, [WHOLE, SEEN]),
        (2, {}, [WHOLE, SEEN]),
        (0, {"min_visible_px": 1e-9}, [WHOLE, SEEN]),
        (0, {"min_visible_px": 100.0}, [WHOLE, SEEN]),
        (0, {"min_visible_px": 100.5}, [WHOLE]),
        (2, {"min_visible_px": 800.5}, []),
        (0, {"min_visible_fraction": 1e-9}, [WHOLE, SEEN]),
        (0, {"min_visible_fraction": 0.125}, [WHOLE, SEEN]),
        (1, {"min_visible_fraction": 0.126}, [WHOLE]),
        (0, {"min_visible_fraction": 1.0}, [WHOLE]),
        (0, {"min_box_px": 20.0}, [WHOLE, SEEN, HIDDEN, UNKNOWN]),
        (0, {"min_box_px": 20.5}, []),
        (1, {"min_box_px": 6.0}, [WHOLE, SEEN]),
        (2, {"min_box_px": 5.0}, [WHOLE, SEEN]),
        (2, {"min_box_px": 6.0}, [WHOLE]),
        (2, {"min_box_px": 6.0, "min_visible_px": 801.0}, []),
        (0, {"min_visible_px": 50.0, "min_visible_fraction": 0.5}, [WHOLE]),
    ],
)
def test_mode_and_filters_keep_these_rows(mode, filters, kept):
    assert np.flatnonzero(annotated_rows(four_rows(), Annotation(mode=mode, **filters))).tolist() == kept


@pytest.mark.parametrize("mode", [0, 1, 2])
def test_visible_boxes_are_annotated_in_mode_two_and_full_ones_otherwise(mode):
    truth = four_rows()
    expected = truth.visible_boxes_px if mode == 2 else truth.full_boxes_px
    np.testing.assert_array_equal(annotation_boxes(truth, mode), expected)


def test_nothing_is_filtered_unless_asked_for():
    assert Annotation() == Annotation(0, "rendered", 1, "regions", 0.0, 0.0, 0.0, False)
