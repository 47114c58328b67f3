"""Masks against geometry: the pixels of a polygon fit it, and one wrong pixel does not."""

import numpy as np
import pytest
import shapely

from modsim3d.render.id_pass import Region
from modsim3d.truth.analytic import counted_from, mask_box, mask_fits

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
    assert not counted_from(mask, region, box / factor, count + 1 / factor**2, factor)
    assert not counted_from(mask, region, box / factor + [0, 0, 1 / factor, 0], count, factor)
    assert counted_from(np.zeros_like(mask), region, np.full(4, np.nan), 0.0, factor)
    assert not counted_from(np.zeros_like(mask), region, np.full(4, np.nan), 1 / factor**2, factor)
