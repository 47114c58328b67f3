"""Supersampled ID buffers: boxes of sub-pixel exactness that close in on the exact ones, and buffers cut into tiles."""

from functools import partial

import numpy as np
import pytest

from modsim3d.geometry.camera import Intrinsics
from modsim3d.render.id_pass import Region
from modsim3d.truth import buffer_drawing
from modsim3d.truth.analytic import analytic_occlusion
from modsim3d.truth.buffer_drawing import BufferDrawing, fits_a_buffer, tiles_of
from modsim3d.truth.rendered import rendered_occlusion
from modsim3d.verify.sources.agreement import Agreement, compare_with_analytic
from tests.scenes import INTRINSICS, outlines_of, pixel_masks, random_places, random_scene, vessel
from tests.truth.test_regions_against_full import assert_same

SMALL = Intrinsics((500.0, 500.0), (200.0, 150.0), (400, 300))
FACTORS = (1, 2, 4, 8)


def smaller(lens: Intrinsics, divisor: int) -> Intrinsics:
    """A lens of the same view with fewer pixels."""
    width, height = lens.image_size_px
    focal_px, middle_px = (tuple(np.divide(each, divisor)) for each in (lens.focal_px, lens.principal_point_px))
    size_px = width // divisor, height // divisor
    return Intrinsics(focal_px, middle_px, size_px, lens.skew / divisor, near_clip_m=lens.near_clip_m)


@pytest.fixture(scope="module")
def side_differences(renderer):
    """Factor → sides of full and of visible boxes less the exact ones, of vessels that hold pixels at every factor."""
    full, visible = ({factor: [] for factor in FACTORS} for _ in range(2))
    for seed in range(25):
        outlines = outlines_of(random_places(np.random.default_rng(seed), 25, far_m=700.0), SMALL)
        exact = analytic_occlusion(outlines, SMALL)
        drawn = {factor: rendered_occlusion(outlines, SMALL, renderer, factor) for factor in FACTORS}
        clear = (exact.visible_px > 30) & (drawn[1].visible_px > 10)
        inside = exact.full_boxes_px % 1 != 0  # a side on the image edge is exact at any factor
        for factor, seen in drawn.items():
            full[factor].append((seen.full_boxes_px - exact.full_boxes_px)[clear][inside[clear]])
            visible[factor].append((seen.visible_boxes_px - exact.visible_boxes_px)[clear][inside[clear]])
    return [{factor: np.concatenate(parts) for factor, parts in kind.items()} for kind in (full, visible)]


@pytest.mark.parametrize("kind", [0, 1], ids=["full", "visible"])
@pytest.mark.parametrize("factor", FACTORS[1:])
def test_side_differences_shrink_in_proportion_to_the_factor(side_differences, factor, kind):
    sides = side_differences[kind]
    assert len(sides[1]) > 300
    at_one, here = np.abs(sides[1]).mean(), np.abs(sides[factor]).mean()
    # Pixel centres miss a third of a pixel of a slanting side and a quarter of an upright one.
    assert 0.2 < at_one < 0.5
    assert here == pytest.approx(at_one / factor, rel=0.25)


@pytest.mark.parametrize("factor", FACTORS[1:])
def test_full_boxes_are_within_1_2_buffer_pixels_but_for_tips_without_a_pixel_centre(renderer, factor):
    rows = tips = 0
    for seed in range(9):
        places, lens, mount = random_scene(np.random.default_rng(seed))
        lens = smaller(lens, factor // 2)  # so that each factor draws as many pixels, few of which are a second's work
        outlines = outlines_of(places, lens, mount)
        drawn = rendered_occlusion(outlines, lens, renderer, factor)
        masks = partial(pixel_masks, outlines, lens, renderer, supersample=factor)
        found = compare_with_analytic(outlines, lens, drawn, masks, factor)
        off = np.abs(found.full_side_px).max(axis=1) > 1.2 / factor
        assert (found.full[off] == Agreement.SHARP_TIP).all()
        assert not (found.worst == Agreement.UNEXPLAINED).any()
        rows, tips = rows + len(outlines), tips + int(off.sum())
    assert rows > 150 and tips < 0.03 * rows


@pytest.mark.parametrize("factor", [2, 3, 4, 8])
def test_counts_are_in_image_pixels_and_come_nearer_to_the_areas(renderer, factor):
    outlines = outlines_of(random_places(np.random.default_rng(3), 25, far_m=400.0), SMALL)
    exact = analytic_occlusion(outlines, SMALL)
    coarse, fine = (rendered_occlusion(outlines, SMALL, renderer, scale) for scale in (1, factor))
    for pixels in (fine.silhouette_px, fine.visible_px):
        buffer_pixels = pixels * factor**2
        np.testing.assert_allclose(buffer_pixels, np.rint(buffer_pixels), atol=1e-6)
        assert (np.rint(pixels) != pixels).any()
    for name in ("silhouette_px", "visible_px"):
        off = [np.abs(getattr(seen, name) - getattr(exact, name)).mean() for seen in (coarse, fine)]
        assert off[1] < 1.5 * off[0] / factor
    hidden = np.array([sum(px for _, px in row) for row in fine.occluders])
    np.testing.assert_allclose(fine.visible_px + hidden, fine.silhouette_px)
    assert (hidden > 0).any()


def test_box_between_pixels_is_told_to_an_eighth_of_a_pixel(renderer):
    """Front face at 100 m from w2 = −3.03 to 2.04 m: columns 379.6–430.3."""
    outlines = outlines_of([(vessel("box", 0.01, 5.07, 10), (100.005, -0.495), 0.0)])
    sides = outlines.boxes_px[0, [0, 2]]
    for factor in FACTORS:
        drawn = rendered_occlusion(outlines, INTRINSICS, renderer, factor).full_boxes_px[0, [0, 2]]
        # The first buffer column whose centre is inside, and the one after the last.
        assert drawn.tolist() == (np.ceil(sides * factor - 0.5) / factor).tolist()
        assert abs(drawn - sides)[0] <= 0.5 / factor


@pytest.mark.parametrize(("factor", "tile"), [(1, (100, 64)), (3, (257, 100)), (4, (64, 1000))])
def test_buffer_drawn_in_tiles_gives_the_same_as_in_one(renderer, monkeypatch, factor, tile):
    outlines = outlines_of(random_places(np.random.default_rng(4), 25, far_m=400.0), SMALL)
    whole = rendered_occlusion(outlines, SMALL, renderer, factor)
    monkeypatch.setattr(buffer_drawing, "TILE_PX", tile)
    assert_same(rendered_occlusion(outlines, SMALL, renderer, factor), whole)
    assert any(whole.occluders)


def test_buffer_is_8192_wide_and_4096_high():
    sizes = (8192, 4096), (1, 1), (8193, 1), (1, 4097), (4096, 8192)
    assert [fits_a_buffer(size) for size in sizes] == [True, True, False, False, False]


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
