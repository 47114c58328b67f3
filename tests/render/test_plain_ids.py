"""ID buffers without OpenGL against those of the renderer."""

import numpy as np
import pytest
from shapely import LineString, distance, points

from modsim3d.render.id_pass import PlainIds, Region
from modsim3d.truth.buffer_drawing import triangles_of
from tests.scenes import INTRINSICS, outlines_of, random_places


@pytest.mark.parametrize("seed", range(4))
def test_ids_differ_from_the_renderers_only_on_edges(renderer, seed):
    outlines = outlines_of(random_places(np.random.default_rng(seed), 12, far_m=400.0))
    triangles = triangles_of(outlines, INTRINSICS)
    arguments = (triangles.corners_px, triangles.inverse_depth, outlines.occluder[triangles.row] + 1)
    region = Region(100, 50, 600, 500)
    drawn, plain = (drawer.draw(*arguments, region) for drawer in (renderer, PlainIds()))
    assert (drawn > 0).any()
    rows, columns = np.nonzero(drawn != plain)
    assert len(rows) < 1e-3 * drawn.size
    edges = [LineString(c[[i, i - 1]]) for c in triangles.corners_px for i in range(3)]
    for x, y in zip(columns + region.x + 0.5, rows + region.y + 0.5, strict=True):
        assert distance(edges, points(x, y)).min() < 1 / 64


def test_nothing_gives_zeros():
    drawn = PlainIds().draw(np.empty((0, 3, 2)), np.empty((0, 3)), np.empty(0, dtype=int), Region(0, 0, 4, 3))
    np.testing.assert_array_equal(drawn, np.zeros((3, 4)))


def test_the_nearer_of_two_triangles_is_seen_in_any_order():
    corners = np.tile(np.array([[0.0, 0.0], [20.0, 0.0], [0.0, 20.0]]), (2, 1, 1))
    depths = np.array([[0.5] * 3, [0.25] * 3])
    for order in ([0, 1], [1, 0]):
        ids = PlainIds().draw(corners[order], depths[order], np.array([1, 2])[order], Region(0, 0, 10, 10))
        assert set(np.unique(ids[:5, :5])) == {1}
