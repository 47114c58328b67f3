"""The cross-check's own drawing against the plain one, and what it says about ties."""

from dataclasses import replace

import numpy as np
import pytest

from modsim3d.geometry.camera import Distortion
from modsim3d.render.id_pass import IdRenderer, Region
from modsim3d.truth.crosscheck.comparison import possible_ids, undecided
from modsim3d.truth.crosscheck.drawing import cut, tiles_of
from modsim3d.truth.full_frame import vessel_masks
from tests.scenes import drawing_of, outlines_of, random_scene, vessel


@pytest.mark.parametrize(("seed", "lens"), [*((seed, False) for seed in range(12)), (1, True), (2, True), (5, True)])
def test_pixels_are_those_of_the_plain_drawing_and_differ_behind_a_lens_at_ties_only(
    seed: int, lens: bool, renderer: IdRenderer
) -> None:
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
        for plain, own, of in (
            (masks.silhouette, alone.ids(renderer, region) > 0, alone),
            (masks.visible, seen[here] == occluder + 1, drawing),
        ):
            y, x = np.nonzero(plain ^ own)
            assert lens or len(x) < 2  # where two vessels touch, one pixel may be either's
            assert (possible_ids(of, x + region.x, y + region.y)[1].sum(axis=1) > 1).all()


def test_a_buffer_of_a_vessel_alone_has_the_pixels_of_the_whole_image(renderer: IdRenderer) -> None:
    drawing = drawing_of([(vessel("a"), (60.0, 3.0), 0.4), (vessel("b"), (120.0, -29.0), 1.0)])
    whole, region = drawing.ids(renderer, drawing.image), drawing.region(1)
    here = whole[region.y : region.y + region.height, region.x : region.x + region.width]
    np.testing.assert_array_equal(here, drawing.only(1).ids(renderer, region))
    assert 0 < (here == 2).sum() == (whole == 2).sum()


def test_corner_boxes_are_those_of_the_silhouettes_in_the_image() -> None:
    for seed in range(20):
        places, intrinsics, mount = random_scene(np.random.default_rng(seed))
        outlines, drawing = outlines_of(places, intrinsics, mount), drawing_of(places, intrinsics, mount)
        boxes = np.array([drawing.boxes_px[occluder] for occluder in outlines.occluder.tolist()]).reshape(-1, 4)
        np.testing.assert_allclose(boxes, outlines.boxes_px, atol=1e-6)


def test_pieces_of_a_cut_triangle_have_its_area_on_the_inner_side() -> None:
    triangle = np.array([[[0.0, 0.0], [4.0, 0.0], [0.0, 4.0]]])
    for offset, area in ((1.0, 4.5), (-1.0, 8.0), (5.0, 0.0)):
        parts, source = cut(triangle, [(np.array([1.0, 0.0]), offset)])
        (a, b, c) = np.moveaxis(parts, 1, 0)
        doubled = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
        assert doubled.sum() / 2 == pytest.approx(area) and (source == 0).all()


def test_equal_boats_side_by_side_tie_where_their_faces_are_one() -> None:
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


def test_a_boat_clearly_in_front_never_ties() -> None:
    drawing = drawing_of([(vessel("a"), (60.0, 0.0), 0.0), (vessel("b"), (61.0 + 10.0, 1.0), 0.0)])
    x, y = np.meshgrid(np.arange(320, 380), np.arange(300, 320))
    ids, possible = possible_ids(drawing, x.ravel(), y.ravel())
    assert ids.tolist() == [0, 1, 2]
    np.testing.assert_array_equal(possible, np.tile([False, True, False], (x.size, 1)))


def test_tiles_cover_a_region_once() -> None:
    assert sum(tile.width * tile.height for tile in tiles_of(Region(3, 5, 9000, 4500))) == 9000 * 4500
