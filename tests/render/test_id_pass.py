import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LineString, distance, points

from modsim3d.geometry.camera import Intrinsics
from modsim3d.render.context import library_found
from modsim3d.render.id_pass import PlainIds, Region, Sheet
from modsim3d.truth.buffer_drawing import triangles_of
from modsim3d.truth.rendered import rendered_occlusion
from tests.scenes import INTRINSICS, outlines_of, random_places, vessel

WHOLE = Region(0, 0, 800, 600)


def draw(renderer, triangles, ids, region=WHOLE, depth=0.5):
    corners = np.array(triangles, dtype=float)
    return renderer.draw(corners, np.full(corners.shape[:2], depth), np.array(ids), region)


def test_a_pixel_is_hit_exactly_if_its_centre_is_and_ids_beyond_sixteen_bits_come_back(renderer):
    """A right triangle whose edges pass between pixel centres, against the half-planes themselves."""
    image = draw(renderer, [[[10.2, 10.3], [60.7, 10.3], [10.2, 45.9]]], [7], Region(0, 0, 80, 60))
    x, y = np.meshgrid(np.arange(80) + 0.5, np.arange(60) + 0.5)
    inside = (x > 10.2) & (y > 10.3) & ((x - 10.2) / 50.5 + (y - 10.3) / 35.6 < 1)
    np.testing.assert_array_equal(image == 7, inside)
    for drawer in (renderer, PlainIds()):
        drawn = drawer.draw(np.empty((0, 3, 2)), np.empty((0, 3)), np.empty(0, dtype=int), Region(0, 0, 5, 4))
        np.testing.assert_array_equal(drawn, np.zeros((4, 5)))
    assert draw(renderer, [[[0, 0], [8, 0], [0, 8]]], [4], Region(3, 3, 0, 7)).shape == (7, 0)
    for number in (1, 255, 256, 65_535, 65_536, 2**24 - 1):
        image = draw(renderer, [[[0, 0], [100, 0], [0, 100]]], [number], Region(0, 0, 8, 8))
        assert np.unique(image).tolist() == [number]
    draw(renderer, [[[0, 0], [800, 0], [0, 600]]], [3])
    assert np.unique(draw(renderer, [[[0, 0], [8, 0], [0, 8]]], [4])).tolist() == [0, 4]
    lens = Intrinsics((20000.0, 20000.0), (400.0, 300.0), (800, 600))
    front, back = vessel("front", 10, 30, 20), vessel("back", 10, 30, 20)
    boat = vessel("boat", 2, 0.1, 9.99)
    outlines = outlines_of([(back, (5011.0, 0.0), 0.0), (front, (5000.0, 0.0), 0.0), (boat, (5.0, 0.06), 0.0)], lens)
    occlusion = rendered_occlusion(outlines, lens, renderer)
    share = dict(zip(outlines.occluder.tolist(), occlusion.visible_px / occlusion.silhouette_px, strict=True))
    # The front one, 1 m nearer and of one size, leaves at most a rim of the back one.
    assert share[0] < 0.02 and share[1] > 0.5 and share[2] == 1


@pytest.mark.parametrize(("size", "reach"), [((800, 600), 300), ((3600, 64), 2048), ((12000, 64), 2048)])
def test_region_holds_the_pixels_of_the_whole_image_also_of_a_wide_one(renderer, size, reach):
    """Corners lie up to 2048 px outside the image, as they come from clipping."""
    rng = np.random.default_rng(1)
    corners = rng.uniform(-reach, np.add(size, reach), (60, 3, 2))
    depth, ids = rng.uniform(0.01, 1, (60, 3)), np.arange(1, 61)
    whole = renderer.draw(corners, depth, ids, Region(0, 0, *size))
    for _ in range(25):
        x, y = rng.integers(0, np.array(size) * 7 // 8).tolist()
        region = Region(x, y, *rng.integers(1, (size[0] - x, size[1] - y)).tolist())
        part = renderer.draw(corners, depth, ids, region)
        np.testing.assert_array_equal(part, whole[y : y + region.height, x : x + region.width])


def test_regions_drawn_side_by_side_hold_the_pixels_of_each_alone(renderer):
    rng, counts = np.random.default_rng(3), np.array([30, 25, 0, 40])
    regions = [Region(40, 10, 90, 50), Region(300, 200, 30, 80), Region(0, 0, 20, 20), Region(500, 90, 100, 33)]
    places = np.array([[0, 0], [95, 5], [130, 0], [90, 90]])
    corners = rng.uniform(-300, 1100, (95, 3, 2))  # most reach beyond their region, over the others' places
    depth, ids = rng.uniform(0.01, 1, (95, 3)), np.arange(1, 96)
    sheet = renderer.draw_sheet(corners, depth, ids, counts, Sheet(regions, places, (200, 130)))
    expected = np.zeros((130, 200), dtype=np.uint32)
    for region, (x, y), first, stop in zip(regions, places, np.cumsum(counts) - counts, np.cumsum(counts), strict=True):
        some = slice(first, stop)
        alone = renderer.draw(corners[some], depth[some], ids[some], region)
        expected[y : y + region.height, x : x + region.width] = alone
    assert len(np.unique(expected)) > 6
    np.testing.assert_array_equal(sheet, expected)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(-50, 900), min_size=4, max_size=4))
def test_region_around_a_box_holds_every_pixel_it_touches_inside_the_image(sides):
    box = np.array([min(sides[:2]), min(sides[2:]), max(sides[:2]), max(sides[2:])])
    region = Region.around(box, (800, 600), margin_px=0)
    for least, most, first, side in ((0, 2, region.x, region.width), (1, 3, region.y, region.height)):
        pixels = np.arange((800, 600)[least])
        assert set(pixels[(pixels + 1 > box[least]) & (pixels < box[most])]) <= set(range(first, first + side))


DRAWS = """
import sys, numpy as np
from tests.scenes import *
from modsim3d.truth.buffer_drawing import triangles_of
from modsim3d.render.context import open_context
from modsim3d.render.id_pass import IdRenderer, Region
with open_context() as context:
    renderer = IdRenderer(context)
    print(context.description, file=sys.stderr)
    for seed in range(12):
        outlines = outlines_of(random_places(np.random.default_rng(seed), 25))
        t = triangles_of(outlines, INTRINSICS)
        image = renderer.draw(t.corners_px, t.inverse_depth, outlines.occluder[t.row] + 1, Region(0, 0, 800, 600))
        sys.stdout.buffer.write(image.tobytes())
"""


def id_images(backend: str) -> bytes:
    environment = {**os.environ, "MODSIM3D_GL": backend}
    environment.pop("PYOPENGL_PLATFORM", None)
    done = subprocess.run([sys.executable, "-c", DRAWS], capture_output=True, env=environment, check=False)
    assert done.returncode == 0 and backend in done.stderr.decode(), done.stderr.decode()
    return done.stdout


def test_osmesa_and_egl_give_the_same_id_images():
    """With EGL alone where there is no OSMesa: Mesa 25.1 and later have none."""
    egl, *osmesa = (id_images(backend) for backend in ("egl", *(["osmesa"] if library_found("osmesa") else [])))
    assert len(egl) == 12 * 800 * 600 * 4 and len(np.unique(np.frombuffer(egl, dtype=np.uint32))) > 15
    assert all(image == egl for image in osmesa)


OPENS_AGAIN = """
import numpy as np
from modsim3d.render.context import open_context
from modsim3d.render.id_pass import IdRenderer, Region
corners = np.array([[[0.0, 0], [9, 0], [0, 9]]])
for _ in range(3):
    with open_context() as context:
        assert IdRenderer(context).draw(corners, np.ones((1, 3)), np.array([5]), Region(0, 0, 4, 4)).max() == 5
"""


def test_context_can_be_opened_again_after_it_was_closed():
    assert subprocess.run([sys.executable, "-c", OPENS_AGAIN], check=False).returncode == 0


def test_depth_beyond_the_edge_of_a_triangle_is_that_of_its_nearest_corner(renderer):
    """Rounded corners reach a pixel centre 1/2000 px beside a triangle that is seen almost edge-on."""
    thin = [[10.5005, 5.0], [10.5030, 5.0], [10.5005, 25.0]]
    corners = np.array([thin, [[0.0, 0.0], [80.0, 0.0], [0.0, 80.0]]])
    depths = np.array([[0.2, 0.3, 0.2], [0.19, 0.19, 0.19]])  # at the centre, the plane of the first is at 0.18
    image = renderer.draw(corners, depths, np.array([1, 2]), Region(0, 0, 40, 40))
    assert (image == 1).sum() > 5


@pytest.mark.parametrize("region", [WHOLE, Region(37, 11, 50, 40)])
def test_of_triangles_in_one_plane_the_first_is_in_front(renderer, region):
    rng = np.random.default_rng(4)
    corners = rng.uniform(-100, 700, (12, 3, 2))
    depths = 0.1 + corners @ [2e-4, 3e-4] + 1e-12 * rng.uniform(-1, 1, (12, 3))
    shown = renderer.draw(corners, depths, np.arange(1, 13), region)
    first = np.zeros_like(shown)
    for i in reversed(range(12)):
        first[renderer.draw(corners[i : i + 1], depths[i : i + 1], np.ones(1, dtype=int), region) > 0] = i + 1
    np.testing.assert_array_equal(shown, first)


@pytest.mark.parametrize("seed", range(4))
def test_ids_differ_from_the_renderers_only_on_edges(renderer, seed):
    outlines = outlines_of(random_places(np.random.default_rng(seed), 12, far_m=400.0))
    triangles = triangles_of(outlines, INTRINSICS)
    arguments = (triangles.corners_px, triangles.inverse_depth, outlines.occluder[triangles.row] + 1)
    region = Region(100, 50, 600, 500)
    drawn, plain = (drawer.draw(*arguments, region) for drawer in (renderer, PlainIds()))
    rows, columns = np.nonzero(drawn != plain)
    assert (drawn > 0).any() and len(rows) < 1e-3 * drawn.size
    edges = [LineString(c[[i, i - 1]]) for c in triangles.corners_px for i in range(3)]
    for x, y in zip(columns + region.x + 0.5, rows + region.y + 0.5, strict=True):
        assert distance(edges, points(x, y)).min() < 1 / 64
