"""Pixels of closed solids from their outlines' edges, against drawn buffers and convex scan conversion."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from modsim3d.render.id_pass import Region
from modsim3d.truth.buffer_drawing import triangles_of, within_guard
from modsim3d.truth.scan_conversion import scan_convert
from modsim3d.truth.silhouettes import _Edges, edges_of, spans_of_ids, winding_spans
from modsim3d.world.mesh_reading import load_mesh
from modsim3d.world.vessels import Solid, shoebox
from tests.scenes import INTRINSICS, outlines_of, random_places

SIZE = INTRINSICS.image_size_px
MESHES = ("ferry", "sailboat", "container_ship")


def tube() -> Solid:
    """Walls around a hole along v2, through which one sees what is behind."""
    outer, inner = (shoebox().vertices * (side, side, 1.0) for side in (1.0, 0.6))
    vertices = np.concatenate([outer, inner])
    side = [0, 2, 6, 4]  # around the bottom; the top has the next numbers
    walls = []
    for a, b in zip(side, side[1:] + side[:1], strict=True):
        upright = (b, a, a + 1, b + 1), (a + 8, b + 8, b + 9, a + 9)  # outside, and in the hole
        level = (a, b, b + 8, a + 8), (b + 1, a + 1, a + 9, b + 9)  # below and above
        for c, d, e, f in upright + level:
            walls += [(c, d, e), (c, e, f)]
    return Solid(vertices[:, [1, 2, 0]] + [0, -0.5, 0.5], np.array(walls), convex=False)


def seen(solid, seed, count=40):
    """The vertices of vessels with a solid that lie wholly near the image, in pixels, and their outlines."""
    places = random_places(np.random.default_rng(seed), count, near_m=8.0, far_m=150.0)
    outlines = outlines_of([(replace(ship, solid=solid), *rest) for ship, *rest in places])
    outlines = outlines.take(np.flatnonzero(within_guard(outlines, INTRINSICS)))
    (part,) = outlines.parts
    return part.vertices_px, outlines


@pytest.mark.parametrize("most", [300, 200_000])
def test_convex_solids_have_the_spans_of_convex_scan_conversion(monkeypatch, most):
    monkeypatch.setattr("modsim3d.truth.silhouettes.MAX_CROSSINGS", most)
    pixels, _ = seen(shoebox(), 1)
    assert (len(_Edges.of(pixels, shoebox(), SIZE[1]).portions()) > 1) == (most == 300)
    expected, odd = scan_convert(pixels, shoebox(), SIZE)
    assert len(odd) == 0 and len(np.unique(expected.row)) > 15
    for name, column in vars(winding_spans(pixels, shoebox(), SIZE)).items():
        np.testing.assert_array_equal(column, getattr(expected, name), err_msg=name)


@pytest.mark.parametrize("name", [*MESHES, "tube"])
def test_meshes_have_the_pixels_that_are_drawn(renderer, name):
    solid = tube() if name == "tube" else load_mesh(name, Path())
    pixels, outlines = seen(solid, 2)
    triangles, found = triangles_of(outlines, INTRINSICS), winding_spans(pixels, solid, SIZE)
    several = 0
    for row in range(len(outlines)):
        own = triangles.take(triangles.row == row)
        ids = np.ones(len(own.row), dtype=np.int64)
        drawn = spans_of_ids(renderer.draw(own.corners_px, own.inverse_depth, ids, Region(0, 0, *SIZE)))
        spans = found.take(found.row == row)
        for column in ("y", "start", "stop"):
            np.testing.assert_array_equal(getattr(spans, column), getattr(drawn, column), err_msg=column)
        several += len(spans.y) > len(np.unique(spans.y))
    assert several  # scan lines with a gap


def test_every_edge_has_a_face_on_each_side():
    for solid in (shoebox(), tube(), *(load_mesh(name, Path()) for name in MESHES)):
        start, end, left, right = edges_of(solid)
        assert len(start) == 3 * len(solid.faces) / 2
        for face in (left, right):
            assert (solid.faces[face] == start[:, None]).any(axis=1).all()
            assert (solid.faces[face] == end[:, None]).any(axis=1).all()
