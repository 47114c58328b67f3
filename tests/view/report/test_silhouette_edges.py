"""The edges around what a mesh covers, against the union of its projected faces."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from modsim3d.geometry.camera import Distortion
from modsim3d.scene.reading import load_scene
from modsim3d.truth.silhouettes import in_image, silhouette_polygons
from modsim3d.view.report.overview import PartMotion
from modsim3d.view.report.silhouette_edges import silhouette_edges, tidy_at_border
from modsim3d.world.vessels import Solid

STEPS = np.array([0, 190])
POINTS, CLEAR_PX = 300, 0.3


@pytest.fixture(scope="module")
def strait():
    return load_scene("strait")


def windings(ends_px, points):
    """How often directed edges (e, 2, 2) wind around each point (n, 2), by crossings of a ray to the right."""
    (x0, y0), (x1, y1) = ends_px[:, 0].T, ends_px[:, 1].T
    x, y = points[:, None, 0], points[:, None, 1]
    upwards, downwards = (y0 <= y) & (y1 > y), (y1 <= y) & (y0 > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        right = x0 + (y - y0) / (y1 - y0) * (x1 - x0) > x
    return ((upwards & right).astype(int) - (downwards & right)).sum(axis=1)


def torn(part):
    solid = part.solid
    return replace(part, solid=Solid(solid.vertices, solid.faces[len(solid.faces) // 3 :], convex=False, closed=False))


LENS = Distortion(k1=-0.12, k2=0.03)
CUTTING = ((0, 160.0, None, False), (0, 160.0, None, True))  # vessels where they are seen


@pytest.mark.parametrize(
    "camera, near_clip_m, lens, is_torn", [(0, 0.1, None, False), *CUTTING, (1, 60.0, LENS, False)]
)
def test_edges_wind_around_what_the_faces_cover_and_around_nothing_else(strait, camera, near_clip_m, lens, is_torn):
    before = strait.cameras[camera]
    intrinsics = replace(before.intrinsics, near_clip_m=near_clip_m, distortion=lens)
    outlines = strait.sight(replace(before, intrinsics=intrinsics), STEPS).outlines(measured=False)
    if is_torn:
        outlines = replace(outlines, parts=tuple(torn(part) for part in outlines.parts))
    edges = silhouette_edges(outlines, intrinsics)
    boxes_px = edges.boxes_px(len(outlines))
    size, rng, compared, cut = np.array(intrinsics.image_size_px), np.random.default_rng(0), 0, 0
    assert edges.ends_px.min() >= 0 and np.all(edges.ends_px <= size)
    for part in outlines.parts:
        crosses = outlines.crosses_near[part.rows]
        whole = silhouette_polygons(intrinsics.pinhole, part.vertices_camera, part.vertices_px, crosses, part.solid)
        for row, covered in zip(part.rows, in_image(whole, intrinsics), strict=True):
            if covered.area < 20:
                continue
            low, high = np.array(covered.bounds).reshape(2, 2)
            assert np.all(boxes_px[row, :2] < low + CLEAR_PX) and np.all(boxes_px[row, 2:] > high - CLEAR_PX)
            if np.all(low > 0) and np.all(high < size):
                np.testing.assert_allclose(boxes_px[row], covered.bounds, atol=CLEAR_PX)
            points = rng.uniform(np.maximum(low - 5, 0), np.minimum(high + 5, size), (POINTS, 2))
            clear = shapely.distance(covered.boundary, shapely.points(points)) > CLEAR_PX
            found = windings(edges.ends_px[edges.row == row], points)
            assert len(set(np.sign(found)) - {0}) == 1
            np.testing.assert_array_equal((found != 0)[clear], shapely.contains_xy(covered, points)[clear])
            compared, cut = compared + 1, cut + bool(crosses[list(part.rows).index(row)])
    assert compared > 10 and cut > 0


def test_ways_to_and_fro_along_the_border_are_left_out():
    there = [[(0, 0), (4, 3)], [(4, 3), (0, 9)], [(0, 9), (0, 2)], [(0, 2), (0, 7)], [(0, 7), (0, 0)]]
    shape, ends = tidy_at_border(np.array([3] * 5), np.array(there), (20, 20))
    assert shape.tolist() == [3, 3, 3]
    edges = {tuple(map(tuple, edge)) for edge in ends.tolist()}
    assert edges == {((0, 0), (4, 3)), ((4, 3), (0, 9)), ((0, 9), (0, 0))}
    _, ends = tidy_at_border(np.array([0, 0]), np.array([[(5, 20), (9, 20)], [(9, 20), (5, 20)]]), (20, 20))
    assert len(ends) == 0


def test_poses_of_a_part_are_those_of_each_camera_on_its_own(strait):
    some, others = np.array([3, 5, 8]), np.array([4, 5])
    motion = PartMotion(strait, [some, others])
    for steps in (some, others):
        alone = strait.motion.at(steps)
        np.testing.assert_array_equal(motion.at(steps).world_R_vessel, alone.world_R_vessel)
        np.testing.assert_array_equal(motion.at(steps).poses.positions_m, alone.poses.positions_m)
