"""Hand-made scenes whose pixels can be said beforehand: focal length 1000 px, so a metre at 100 m is 10 px."""

import numpy as np
import pytest

from modsim3d.geometry.camera_poses import Mount
from modsim3d.truth.rendered import rendered_occlusion
from tests.scenes import INTRINSICS, outlines_of, vessel


def truth_of(renderer, places, **options):
    outlines = outlines_of(places, **options)
    return outlines, rendered_occlusion(outlines, options.get("intrinsics", INTRINSICS), renderer)


def test_box_in_front_hides_exactly_the_columns_it_should(renderer):
    """Back: front face at 200 m, 20 m wide: columns 350–450. Front: at 100 m, from w2 = −3 to 5: columns 350–430."""
    back, front = vessel("back", 2, 20, 10), vessel("front", 2, 8, 30)
    outlines, seen = truth_of(renderer, [(back, (201, 0), 0), (front, (101, 1), 0)])
    assert outlines.occluder.tolist() == [0, 1]
    np.testing.assert_array_equal(seen.full_boxes_px[0][[0, 2]], [350, 450])
    np.testing.assert_array_equal(seen.full_boxes_px[1][[0, 2]], [350, 430])
    np.testing.assert_array_equal(seen.visible_boxes_px[0][[0, 2]], [430, 450])
    assert seen.visible_px[0] == seen.silhouette_px[0] * 20 / 100
    assert seen.occluders[0] == ((1, seen.silhouette_px[0] * 80 / 100),)
    assert seen.visible_px[1] == seen.silhouette_px[1] and seen.occluders[1] == ()


@pytest.mark.parametrize("place", [(-100, 0), (100, 60)], ids=["behind the camera", "outside the image"])
def test_vessel_behind_the_camera_or_outside_the_image_is_not_in_it(renderer, place):
    outlines, seen = truth_of(renderer, [(vessel("away"), place, 0)])
    assert len(outlines) == len(seen.visible_px) == 0


@pytest.mark.parametrize("factor", [1, 3])
def test_vessel_of_one_pixel_has_the_box_of_that_pixel(renderer, factor):
    """10 cm wide and high at 100 m, around the centre of the pixel in column 399 and row 399; a third of that at 3."""
    size = 0.1 / factor
    outlines = outlines_of([(vessel("dot", 1e-3, size, size), (100, size / 2), 0)])
    seen = rendered_occlusion(outlines, INTRINSICS, renderer, factor)
    assert seen.silhouette_px[0] == seen.visible_px[0] == pytest.approx(1 / factor**2)
    for boxes_px in (seen.full_boxes_px, seen.visible_boxes_px):
        np.testing.assert_allclose(boxes_px, [[400 - 1 / factor, 400 - 1 / factor, 400, 400]])


def test_vessel_larger_than_the_image_fills_it(renderer):
    outlines, seen = truth_of(renderer, [(vessel("wall", 2, 500, 200), (20, 0), 0)])
    np.testing.assert_array_equal(seen.full_boxes_px[0], [0, 0, 800, 600])
    assert seen.silhouette_px[0] == 800 * 600 and 0 < outlines.in_frame_fraction[0] < 0.1


def test_boxes_that_only_touch_hide_nothing_of_each_other(renderer):
    """Side by side at 100 m, edges on whole pixels: 10 m each, meeting at column 400."""
    left, right = vessel("left", 1, 10, 5), vessel("right", 1, 10, 5)
    _, seen = truth_of(renderer, [(left, (100.5, 5), 0), (right, (100.5, -5), 0)])
    np.testing.assert_array_equal(seen.visible_px, seen.silhouette_px)
    assert seen.full_boxes_px[0][2] == seen.full_boxes_px[1][0] == 400


def test_three_hundred_vessels_in_one_image_have_an_id_each(renderer):
    """A grid of boxes on a hillside seen from high above: nobody hides anybody."""
    corners = [(60.0 * i - 360, 60.0 * j - 720) for i in range(12) for j in range(25)]
    places = [(vessel(f"v{k}", 4, 4, 1), corner, 0.0) for k, corner in enumerate(corners)]
    outlines, seen = truth_of(renderer, places, mount=Mount((0.0, 0.0, 2000.0), pitch_rad=np.pi / 2))
    assert len(outlines) == 300 and (seen.visible_px > 0).all()
    np.testing.assert_array_equal(seen.visible_px, seen.silhouette_px)


def test_silhouette_without_a_pixel_centre_has_no_pixels_and_keeps_its_projected_box(renderer):
    outlines, seen = truth_of(renderer, [(vessel("speck", 0.01, 0.01, 0.01), (3000.0, 1.0), 0)])
    assert seen.silhouette_px[0] == 0
    np.testing.assert_array_equal(seen.full_boxes_px, outlines.boxes_px)
    assert np.isnan(seen.visible_fraction()[0])
