"""Buffers: which regions fit into one, and how larger ones are cut into tiles."""

import numpy as np
import pytest

from modsim3d.render.id_pass import Region
from modsim3d.truth.buffer_drawing import BufferDrawing, fits_a_buffer, tiles_of
from tests.scenes import INTRINSICS, outlines_of, random_places


@pytest.mark.parametrize(
    ("size", "fits"),
    [((8192, 4096), True), ((8193, 1), False), ((1, 4097), False), ((4096, 8192), False), ((1, 1), True)],
)
def test_buffer_is_8192_wide_and_4096_high(size, fits):
    assert fits_a_buffer(size) == fits


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
