"""Exact truth of meshes: boxes of projected and clipped corners, unions of triangles, planes between hulls."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
import shapely

from modsim3d import load_scene, simulate_frames
from modsim3d.truth import analytic, occlusion_order
from modsim3d.truth.analytic import analytic_occlusion, boundary_pixels, image_silhouettes
from modsim3d.truth.full_frame import full_frame_occlusion
from modsim3d.truth.occlusion_order import hull_vertices, order_of
from modsim3d.verify.sources.agreement import Agreement, compare_with_analytic
from modsim3d.world.bodies import Obstacle, placed
from modsim3d.world.mesh_reading import shipped_meshes
from modsim3d.world.vessels import Solid, shoebox
from tests.scenes import INTRINSICS, outlines_of, pixel_masks, random_scene, vessel
from tests.truth.test_mesh_truth import WRECK, mesh, own_ship_scene

IMAGE = shapely.box(0, 0, *INTRINSICS.image_size_px)


@cache
def catamaran():
    """Two hulls side by side, each a fifth of the beam: its convex hull holds what lies between them."""
    hulls = [shoebox().vertices * (1, 0.2, 1) + (0, side * 0.4, 0) for side in (-1, 1)]
    return Solid(np.concatenate(hulls), np.concatenate([shoebox().faces, shoebox().faces + 8]), convex=False)


def ship(name, length, beam, height, solid=None):
    return replace(vessel(name, length, beam, height), solid=solid or shoebox())


def compared(renderer, outlines, intrinsics=INTRINSICS):
    """Comparison with everything drawn in one buffer with a depth test."""
    drawn = full_frame_occlusion(outlines, intrinsics, renderer)
    return compare_with_analytic(outlines, intrinsics, drawn, partial(pixel_masks, outlines, intrinsics, renderer))


def beyond_near(triangle):
    """The corners of a triangle, cut at the near plane, edge by edge."""
    near, corners = INTRINSICS.near_clip_m, []
    for one, other in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
        if one[2] >= near:
            corners.append(one)
        if (one[2] >= near) != (other[2] >= near):
            corners.append(one + (near - one[2]) / (other[2] - one[2]) * (other - one))
            corners[-1][2] = near
    return np.array(corners)


@pytest.mark.parametrize("name", shipped_meshes())
@pytest.mark.parametrize(
    ("place", "cut"),
    [((150.0, 4.0), "nowhere"), ((60.0, 25.0), "at the image edge"), ((6.0, 3.0), "at the near plane")],
)
def test_full_box_is_that_of_corners_clipped_one_by_one_and_area_that_of_pixels_an_eighth_wide(
    renderer, name, place, cut
):
    outlines = outlines_of([(ship("ship", 40, 9, 9.9, mesh(name)), place, 0.3)])
    assert bool(outlines.crosses_near[0]) == (cut == "at the near plane")
    assert (outlines.in_frame_fraction[0] == 1) == (cut == "nowhere")
    (part,) = outlines.parts
    corners = [beyond_near(face) for face in part.vertices_camera[0][part.solid.faces]]
    faces = [shapely.convex_hull(shapely.multipoints(INTRINSICS.project(each))) for each in corners if len(each)]
    seen = [shapely.intersection(face, IMAGE) for face in faces]
    low, high = np.array([each.bounds for each in seen if not each.is_empty]).T.reshape(2, 2, -1)
    exact = analytic_occlusion(outlines, INTRINSICS)
    np.testing.assert_allclose(exact.full_boxes_px[0], [*low.min(axis=1), *high.max(axis=1)], atol=1e-6)
    if cut != "at the near plane":
        whole = shapely.union_all([shapely.Polygon(each) for each in part.vertices_px[0][part.solid.faces]])
        assert outlines.in_frame_fraction[0] == pytest.approx(exact.silhouette_px[0] / whole.area)
    drawn = full_frame_occlusion(outlines, INTRINSICS, renderer, 8)
    bound = boundary_pixels(image_silhouettes(outlines, INTRINSICS), 8)[0] / 64
    assert abs(drawn.silhouette_px[0] - exact.silhouette_px[0]) < min(bound, 0.02 * exact.silhouette_px[0])
    assert exact.visible_px.tolist() == exact.silhouette_px.tolist()


def front_and_back(front, back):
    before, behind = ship("front", 30, 7, 11, front), ship("back", 60, 12, 16, back)
    return outlines_of([(before, (100.0, 2.0), 1.2), (behind, (190.0, -6.0), 1.9)])


SHAPES = {"shoebox": shoebox, "ferry": lambda: mesh("ferry"), "sailboat": lambda: mesh("sailboat")}


@pytest.mark.parametrize(
    ("front", "back"), [("shoebox", "ferry"), ("sailboat", "shoebox"), ("sailboat", "ferry"), ("ferry", "sailboat")]
)
def test_visible_part_behind_or_of_a_mesh_is_that_of_the_pixels(renderer, front, back):
    outlines = front_and_back(SHAPES[front](), SHAPES[back]())
    exact = analytic_occlusion(outlines, INTRINSICS)
    fine = full_frame_occlusion(outlines, INTRINSICS, renderer, 8)
    assert 0.05 < exact.visible_fraction()[1] < 0.95
    np.testing.assert_allclose(exact.visible_fraction(), fine.visible_fraction(), atol=2e-3)
    np.testing.assert_allclose(exact.visible_boxes_px, fine.visible_boxes_px, atol=0.3)
    ((hider, px),) = exact.occluders[1]
    assert hider == 0 and px == pytest.approx(exact.silhouette_px[1] - exact.visible_px[1])
    assert (compared(renderer, outlines).worst < Agreement.BOUNDARY_ROUNDING).all()  # tips of the sails


@pytest.mark.parametrize("seed", range(16))
def test_no_difference_between_pixels_and_geometry_of_meshes_is_unexplained(renderer, seed):
    places, intrinsics, mount = random_scene(np.random.default_rng(90_000 + seed))
    solids = [*map(mesh, shipped_meshes()), shoebox(), catamaran()]
    places = [(replace(each, solid=solids[i % len(solids)]), *rest) for i, (each, *rest) in enumerate(places)]
    found = compared(renderer, outlines_of(places, intrinsics, mount), intrinsics)
    assert (found.worst < Agreement.INTERSECTING).all()


def test_hulls_that_intersect_while_the_meshes_do_not_are_left_to_pixels_and_counted(renderer):
    ships = ship("cat", 30, 15, 6, catamaran()), ship("between", 4, 2, 2), ship("behind", 30, 20, 9)
    places = ((100.0, 0.0), (110.0, 0.0), (200.0, 0.0))
    outlines = outlines_of([(each, place, 0.0) for each, place in zip(ships, places, strict=True)])
    exact = analytic_occlusion(outlines, INTRINSICS)
    assert exact.intersecting.tolist() == [[0, 1]] and np.isnan(exact.visible_px[:2]).all()
    assert np.isnan(exact.visible_boxes_px[:2]).all()
    found = compared(renderer, outlines)
    assert found.visible.tolist() == [Agreement.INTERSECTING, Agreement.INTERSECTING, Agreement.AGREE]
    assert found.full.tolist() == [Agreement.AGREE] * 3


def test_hulls_whose_boxes_intersect_have_a_plane_between_them(renderer):
    """A kayak's pointed bow reaches past the corner of the box around the other's bow, and of a pontoon."""
    for place, other in (((127.0, 5.0), mesh("kayak")), ((128.0, 7.0), shoebox())):
        outlines, in_boxes = (
            outlines_of([(ship("a", 30, 10, 6, first), (100.0, 0.0), 0.0), (ship("b", 30, 10, 6, second), place, 0.0)])
            for first, second in ((mesh("kayak"), other), (shoebox(), shoebox()))
        )
        assert order_of(in_boxes).intersecting.tolist() == [True]
        order = order_of(outlines)
        assert (order.first_can_hide.tolist(), order.second_can_hide.tolist()) == ([True], [False])
        assert (compared(renderer, outlines).worst == Agreement.AGREE).all()


def test_wrong_order_of_two_meshes_is_found(renderer, monkeypatch):
    outlines = front_and_back(mesh("sailboat"), mesh("ferry"))
    monkeypatch.setattr(occlusion_order, "widest_gap_axis", None)  # boxes around them are apart

    def swapped(outlines):
        order = order_of(outlines)
        return replace(order, first_can_hide=order.second_can_hide, second_can_hide=order.first_can_hide)

    monkeypatch.setattr(analytic, "order_of", swapped)
    assert compared(renderer, outlines).visible.tolist() == [Agreement.UNEXPLAINED] * 2


def test_mesh_of_an_obstacle_hides_by_its_own_silhouette(renderer):
    wreck = Obstacle("wreck", (placed(mesh("sailboat"), np.array([20, 6, 16]), np.array([100.0, 0, 0]), 1.3),))
    outlines = outlines_of([(vessel("ship", 60, 14, 12), (200.0, 5.0), 0.4)], obstacles=[wreck])
    exact = analytic_occlusion(outlines, INTRINSICS)
    ((hider, px),) = exact.occluders[0]
    assert hider == 1 and 0 < px < 0.6 * exact.silhouette_px[0]
    assert (compared(renderer, outlines).worst == Agreement.AGREE).all()


def test_hull_of_a_flat_mesh_is_all_its_vertices():
    flat = Solid(np.array([[0, 0, 0], [1, 0, 1], [0, 1, 0], [1, 1, 1], [0.5, 0.5, 0.5]]), np.array([[0, 1, 2]]))
    assert hull_vertices(flat).tolist() == [0, 1, 2, 3, 4]
    assert hull_vertices(catamaran()).tolist() == sorted({*range(16)} & {*hull_vertices(catamaran()).tolist()})
    assert len(hull_vertices(catamaran())) == 8


def test_open_surface_has_the_same_silhouette_from_both_sides():
    sail = Solid(shoebox().vertices, shoebox().faces[4:8], convex=False, closed=False)
    turned = replace(sail, faces=sail.faces[:, ::-1])
    for size, place in (((20, 6, 8), (100.0, 4.0)), ((40, 4, 20), (0.0, 3.0))):  # the near plane cuts the second
        both = (outlines_of([(ship("sail", *size, solid), place, 0.1)]) for solid in (sail, turned))
        (one,), (other,) = (analytic_occlusion(outlines, INTRINSICS).silhouette_px for outlines in both)
        assert one == pytest.approx(other) and one > 1000


def test_sources_take_vessels_own_ship_and_obstacles_by_their_meshes(tmp_path):
    path = own_ship_scene(tmp_path, obstacles={"wreck": WRECK})
    drawn, exact = (list(simulate_frames(load_scene(path, source=source))) for source in ("rendered", "analytic"))
    for one, other in zip(drawn, exact, strict=True):
        assert one.truth.vessels == other.truth.vessels == ("near", "far")
        np.testing.assert_allclose(other.truth.full_boxes_px, one.truth.full_boxes_px, atol=1)
        np.testing.assert_allclose(other.truth.visible_fraction, one.truth.visible_fraction, atol=0.05)
        for near, far in (one.truth.occluded_by, other.truth.occluded_by):
            assert set(near) == {"own"} and near["own"] > 20 and far["obstacle:wreck"] > 100
        assert one.truth.occluded_by[1].keys() == other.truth.occluded_by[1].keys()


def test_way_from_a_region_to_its_hole_is_no_boundary_that_pixels_may_cross():
    square = shapely.box(0, 0, 30, 20)
    holed = square.difference(shapely.box(10, 5, 20, 15))
    regions = np.array([square, holed, shapely.MultiPolygon([square, shapely.box(100, 0, 101, 1)])])
    np.testing.assert_array_equal(boundary_pixels(regions, 1), [108, 156, 120])
