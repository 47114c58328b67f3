"""Occlusion by geometry and by pixels where every number can be said beforehand. The camera looks along w1 from 10 m
above the sea with a focal length of 1000 px, the principal point at (400, 300). A box of 10 m height has its top on the
horizon, so that of a box straight ahead nothing but the front face is seen: a rectangle from row 300 to row 300 +
10000 / distance."""

import json
import subprocess
import sys
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pyarrow.parquet as pq
import pytest
import shapely

from modsim3d import simulate_frames
from modsim3d.geometry.camera import Distortion
from modsim3d.geometry.camera_poses import Mount
from modsim3d.runs.pipeline import truth_block
from modsim3d.scene.reading import load_scene
from modsim3d.truth import analytic, occlusion_order
from modsim3d.truth.analytic import analytic_occlusion, boundary_pixels, visible_areas, visible_regions
from modsim3d.truth.full_frame import full_frame_occlusion
from modsim3d.truth.occlusion_order import hull_vertices, order_of
from modsim3d.truth.rendered import rendered_occlusion
from modsim3d.verify.sources.agreement import Agreement, compare_with_analytic
from modsim3d.world.bodies import Obstacle, placed
from modsim3d.world.mesh_reading import shipped_meshes
from modsim3d.world.vessels import Solid, shoebox
from tests.scenes import INTRINSICS, crate, crossing, outlines_of, pixel_masks, random_scene, vessel
from tests.truth.test_mesh_truth import WRECK, mesh, own_ship_scene


def seen_by_both(renderer, places, lens=INTRINSICS, mount=None):
    """What geometry and pixels say of a scene."""
    outlines = outlines_of(places, lens, mount)
    return outlines, (analytic_occlusion(outlines, lens), rendered_occlusion(outlines, lens, renderer))


BACK, FAR_PX = ((2, 20, 10), (201, 0)), 10_000 / 300  # columns 350–450, rows 300–350; rows that show 10 m at 300 m
# At 300, 200 and 100 m: columns 350–450, 375–425 and 390–410; columns 395–405, 350–450 and 430–450.
SMALLER = [((1, 30, 10), (300.5, 0)), ((1, 10, 30), (200.5, 0)), ((1, 2, 30), (100.5, 0))]
LARGER = [((1, 3, 10), (300.5, 0)), ((1, 20, 30), (200.5, 0)), ((1, 2, 30), (100.5, -4))]
CASES = {
    "nothing": ([BACK], (350, 300, 450, 350), 5000, {}),
    "a side": ([BACK, ((2, 8, 30), (101, 1))], (430, 300, 450, 350), 1000, {1: 4000}),
    "a side and the pixel beside it": ([BACK, ((2, 8.013, 30), (101, 1.0065))], (430, 300, 450, 350), 1000, {1: 4000}),
    "a millimetre more": ([BACK, ((2, 8.001, 30), (101, 0.9995))], (430.01, 300, 450, 350), 999.5, {1: 4000.5}),
    "the middle": ([BACK, ((1, 2, 30), (100.5, 0))], (350, 300, 450, 350), 4000, {1: 1000}),
    "all, by halves": ([BACK, ((1, 5, 30), (100.5, 2.5)), ((1, 7.5, 30), (150.5, -3.75))], None, 0, {1: 2500, 2: 2500}),
    "the middle, by two": (SMALLER, (350, 300, 450, 300 + FAR_PX), 50 * FAR_PX, {1: 30 * FAR_PX, 2: 20 * FAR_PX}),
    "all, by the middle of three": (LARGER, None, 0, {1: 10 * FAR_PX}),
}
"""What is hidden of the first: all vessels, what box and area are left, and how much each hides."""


@pytest.mark.parametrize("what", CASES)
def test_what_is_hidden_is_cut_at_the_exact_column_and_counted_for_the_front_most(renderer, what):
    vessels, left, visible_px, hidden_px = CASES[what]
    outlines, both = seen_by_both(renderer, [(vessel("any", *size), place, 0) for size, place in vessels])
    rows_px = outlines.boxes_px[0, 3] - 300
    for seen, on_grid, off_px in zip(both, (np.array, np.rint), (1e-9, 0.5), strict=True):
        share = on_grid(rows_px) / rows_px
        np.testing.assert_allclose(seen.full_boxes_px[0], on_grid(outlines.boxes_px[0]), atol=1e-9)
        np.testing.assert_allclose(seen.visible_boxes_px[0], on_grid(left or [np.nan] * 4), atol=1e-9)
        assert seen.visible_px[0] == pytest.approx(share * visible_px, abs=off_px)
        assert dict(seen.occluders[0]) == pytest.approx({row: share * px for row, px in hidden_px.items()}, abs=off_px)
        hidden = [sum(px for _, px in row) for row in seen.occluders]
        np.testing.assert_allclose(seen.visible_px + hidden, seen.silhouette_px)
    np.testing.assert_allclose(outlines.areas_px, both[0].silhouette_px)
    areas, bounds = visible_areas(outlines, INTRINSICS, 2)
    regions = visible_regions(outlines, INTRINSICS)
    around = boundary_pixels(regions.silhouettes, 2) + boundary_pixels(regions.visible, 2)
    np.testing.assert_allclose([areas, bounds], [both[0].visible_px, around / 4])


def test_a_covered_corner_cuts_no_side_and_what_edges_cut_has_the_box_of_what_is_seen():
    """A 2.5 m high box at 100 m, columns 350–400: it hides rows 375–400 there, which begins below the one behind."""
    back, low = vessel("back", 2, 20, 10), vessel("low", 2, 5, 6)
    seen = analytic_occlusion(outlines_of([(back, (201, 0), 0), (low, (101, 2.5), 0)]), INTRINSICS)
    # Its top edge: front face from row 340; the top beyond recedes to 102 m, row 300 + 4000 / 102.
    top = 300 + 4000 / 102
    np.testing.assert_allclose(seen.visible_boxes_px[0], [350, 300, 450, 350], atol=1e-9)
    ((hider, hidden),) = seen.occluders[0]
    # Front face: columns 350–400. Back edge of its top at 102 m: columns 400 − 5000 / 102 to 400; a trapezium.
    face, roof = 50 * 10, (50 + 5000 / 102) / 2 * (340 - top)
    assert (hider, hidden) == (1, pytest.approx(face + roof))
    np.testing.assert_allclose(seen.visible_px[0], 5000 - face - roof)
    # The near plane at 10 m. A low quay, 2 to 3 m to port, reaches from behind the camera to 200 m, where it is in
    # columns 385 to 390. Its far top edge is 5 m below the camera, and the lower image edge cuts its far side at 5000 /
    # 300 m, in column 400 − 180. A pier is in columns 750 and more.
    lens = replace(INTRINSICS, near_clip_m=10.0)
    quay, pier, buoy = (((220, 1, 5), (90, 2.5)), ((1, 10, 10), (100.5, -40)), ((1, 1, 1), (50.5, 0)))
    vessels = outlines_of([(vessel("any", *size), place, 0) for size, place in (quay, pier, buoy)], lens)
    assert np.isnan(vessels.in_frame_fraction[0]) and vessels.in_frame_fraction[2] == 1
    obstacles = outlines_of([], lens, obstacles=[crate(*each) for each in (quay, pier, buoy)])
    for outlines in (vessels, obstacles):
        np.testing.assert_allclose(outlines.boxes_px[0], [220, 325, 390, 600])
        np.testing.assert_allclose(outlines.boxes_px[1], [400 + 35_000 / 101, 300, 800, 400], atol=1e-9)
        np.testing.assert_allclose(outlines.boxes_px, vessels.boxes_px, atol=1e-9)
    beside = [(vessel("beside", 40), place, 0) for place in ((100, 60), (100, -60), (0, 60))]
    guess = outlines_of([*beside, (vessel("any", *quay[0]), quay[1], 0)], lens, measured=False)
    assert guess.boxes_px.tolist() == [[0, 0, 800, 600]]
    lens = replace(INTRINSICS, distortion=Distortion(k1=-0.2))  # bends the box of what is whole too
    bent = outlines_of([(vessel("any"), (60, 15), 0)], lens)
    pixels = lens.project(bent.parts[0].vertices_camera[0])
    np.testing.assert_allclose(bent.boxes_px[0], [*pixels.min(axis=0), *pixels.max(axis=0)], atol=0.3)


def test_box_across_the_near_plane_is_cut_there_and_hides_what_is_behind_its_visible_part(renderer):
    """2 to 3 m to port, from 20 m behind the camera to 20 m ahead, and the near plane at 10 m. The near side at the far
    end is at column 400 − 2000 / 20 = 300, the far side at the cut at 400 − 3000 / 10 = 100."""
    quay, boat = vessel("quay", 40, 1, 20), vessel("boat", 1, 60, 10)
    lens = replace(INTRINSICS, near_clip_m=10.0)
    outlines, both = seen_by_both(renderer, [(quay, (0, 2.5), 0), (boat, (200.5, 0), 0)], lens)
    assert outlines.crosses_near.tolist() == [True, False] and np.isnan(outlines.in_frame_fraction[0])
    for seen in both:
        np.testing.assert_allclose(seen.full_boxes_px[0], [100, 0, 300, 600], atol=1e-9)
        np.testing.assert_allclose(seen.visible_px[0], 200 * 600)
        # The boat: columns 250–550, of which 250–300 are hidden.
        np.testing.assert_allclose(seen.visible_boxes_px[1], [300, 300, 550, 350], atol=1e-9)
        assert seen.occluders[1] == ((0, pytest.approx(50 * 50)),)


def test_a_vessel_cut_at_the_edge_is_hidden_in_the_part_in_the_image_and_one_outside_is_not_in_it(renderer):
    """Front face at 100 m, w2 from 30 to 50: columns −100 to 100; a post at 50 m hides columns −20 to 20."""
    wide, post = vessel("wide", 1, 20, 10), vessel("post", 1, 2, 30)
    outlines = outlines_of([(wide, (100.5, 40), 0), (post, (50.5, 20), 0)])
    seen = analytic_occlusion(outlines, INTRINSICS)
    # The inner side of each is seen too, up to the back edge: 400 − 30000 / 101 and 400 − 19000 / 51.
    inner, post_inner = 400 - 30_000 / 101, 400 - 19_000 / 51
    np.testing.assert_allclose(seen.full_boxes_px[0], [0, 300, inner, 400], atol=1e-9)
    np.testing.assert_allclose(seen.visible_boxes_px[0], [post_inner, 300, inner, 400], atol=1e-9)
    np.testing.assert_allclose(seen.occluders[0], [(1, post_inner * 100)])
    side = (inner - 100) * (100 + 10_000 / 101) / 2
    np.testing.assert_allclose(seen.visible_px[0], (100 - post_inner) * 100 + side)
    np.testing.assert_allclose(outlines.in_frame_fraction[0], (100 * 100 + side) / (200 * 100 + side))
    outlines, (exact, drawn) = seen_by_both(renderer, [(vessel("away"), place, 0) for place in ((-100, 0), (100, 60))])
    assert len(outlines) == len(exact.visible_px) == len(drawn.visible_px) == 0


@pytest.mark.parametrize("factor", [1, 3])
def test_vessel_of_one_pixel_has_the_box_of_that_pixel(renderer, factor):
    """10 cm wide and high at 100 m, around the centre of the pixel in column 399 and row 399; a third of that at 3."""
    size = 0.1 / factor
    outlines = outlines_of([(vessel("dot", 1e-3, size, size), (100, size / 2), 0)])
    seen = rendered_occlusion(outlines, INTRINSICS, renderer, factor)
    assert seen.silhouette_px[0] == seen.visible_px[0] == pytest.approx(1 / factor**2)
    for boxes_px in (seen.full_boxes_px, seen.visible_boxes_px):
        np.testing.assert_allclose(boxes_px, [[400 - 1 / factor, 400 - 1 / factor, 400, 400]])


def test_a_vessel_larger_than_the_image_fills_it_and_three_hundred_that_touch_hide_nothing(renderer):
    outlines, both = seen_by_both(renderer, [(vessel("wall", 2, 500, 200), (20, 0), 0)])
    assert 0 < outlines.in_frame_fraction[0] < 0.1
    for seen in both:
        np.testing.assert_allclose(seen.full_boxes_px[0], [0, 0, 800, 600], atol=1e-9)
        assert seen.silhouette_px[0] == pytest.approx(800 * 600)
    outlines, (_, drawn) = seen_by_both(renderer, [(vessel("speck", 0.01, 0.01, 0.01), (3000.0, 1.0), 0)])
    np.testing.assert_array_equal(drawn.full_boxes_px, outlines.boxes_px)
    assert drawn.silhouette_px[0] == 0 and np.isnan(drawn.visible_fraction()[0])
    # Side by side at 100 m, meeting at column 400; and a grid on a hillside seen from high above.
    left, right = vessel("left", 1, 10, 5), vessel("right", 1, 10, 5)
    corners = [(60.0 * i - 360, 60.0 * j - 720) for i in range(12) for j in range(25)]
    grid = [(vessel(f"v{k}", 4, 4, 1), corner, 0.0) for k, corner in enumerate(corners)]
    above = Mount((0.0, 0.0, 2000.0), pitch_rad=np.pi / 2)
    for places, mount in (([(left, (100.5, 5), 0), (right, (100.5, -5), 0)], None), (grid, above)):
        outlines, both = seen_by_both(renderer, places, mount=mount)
        for seen in both:
            assert len(outlines) == len(places) and (seen.visible_px > 0).all()
            np.testing.assert_allclose(seen.visible_px, seen.silhouette_px, rtol=1e-9)
            assert mount or seen.full_boxes_px[0, 2] == pytest.approx(400) == seen.full_boxes_px[1, 0]


def test_all_modes_run_from_end_to_end_where_there_is_no_opengl(tmp_path):
    scene = crossing(tmp_path)
    exact = truth_block(load_scene(scene, source="analytic"), 0, 12, None)
    assert (exact.visible_px == 0).any()
    assert ((exact.visible_fraction > 0) & (exact.visible_fraction < 1)).any()
    line = ["modsim3d", "run", str(scene), "--source", "analytic", "--mode"]
    lines = [[*line, mode, "--out", str(tmp_path / mode)] for mode in "012"]
    code = "import sys; sys.modules['OpenGL'] = None\nfrom modsim3d.cli.main import main\n"
    code += f"for sys.argv in {lines!r}:\n try: main()\n except SystemExit as end: assert not end.code"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for mode in "012":
        rows = pq.read_table(tmp_path / mode / "truth.parquet").to_pylist()
        kept = (exact.visible_px > 0) | (mode == "0")
        assert [row["annotated"] for row in rows] == kept.tolist()
        np.testing.assert_array_equal([row["visible_px"] for row in rows], exact.visible_px)
        boxes = json.loads((tmp_path / mode / "annotations_C0.json").read_text())
        widths = [boat["bbox"]["width"] for step in boxes.values() for boat in step.values()]
        expected = exact.visible_boxes_px if mode == "2" else exact.full_boxes_px
        np.testing.assert_allclose(widths, (expected[:, 2] - expected[:, 0])[kept])


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
def test_full_box_is_that_of_corners_clipped_one_by_one_and_its_area_that_of_small_pixels(renderer, name, place, cut):
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
    bound = boundary_pixels(analytic.image_silhouettes(outlines, INTRINSICS), 8)[0] / 64
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


def test_hulls_that_intersect_are_left_to_pixels_and_those_whose_boxes_do_have_a_plane_between(renderer):
    ships = ship("cat", 30, 15, 6, catamaran()), ship("between", 4, 2, 2), ship("behind", 30, 20, 9)
    places = ((100.0, 0.0), (110.0, 0.0), (200.0, 0.0))
    outlines = outlines_of([(each, place, 0.0) for each, place in zip(ships, places, strict=True)])
    exact = analytic_occlusion(outlines, INTRINSICS)
    assert exact.intersecting.tolist() == [[0, 1]] and np.isnan(exact.visible_px[:2]).all()
    assert np.isnan(exact.visible_boxes_px[:2]).all()
    found = compared(renderer, outlines)
    assert found.visible.tolist() == [Agreement.INTERSECTING, Agreement.INTERSECTING, Agreement.AGREE]
    assert found.full.tolist() == [Agreement.AGREE] * 3
    # A kayak's pointed bow reaches past the corner of the box around the other's bow, and of a pontoon.
    for place, other in (((127.0, 5.0), mesh("kayak")), ((128.0, 7.0), shoebox())):
        outlines, in_boxes = (
            outlines_of([(ship("a", 30, 10, 6, first), (100.0, 0.0), 0.0), (ship("b", 30, 10, 6, second), place, 0.0)])
            for first, second in ((mesh("kayak"), other), (shoebox(), shoebox()))
        )
        assert order_of(in_boxes).intersecting.tolist() == [True]
        order = order_of(outlines)
        assert (order.first_can_hide.tolist(), order.second_can_hide.tolist()) == ([True], [False])
        assert (compared(renderer, outlines).worst == Agreement.AGREE).all()


def test_a_wrong_order_of_two_meshes_is_found_and_an_obstacles_mesh_hides_by_its_own_silhouette(renderer, monkeypatch):
    outlines = front_and_back(mesh("sailboat"), mesh("ferry"))
    monkeypatch.setattr(occlusion_order, "widest_gap_axis", None)  # boxes around them are apart

    def swapped(outlines):
        order = order_of(outlines)
        return replace(order, first_can_hide=order.second_can_hide, second_can_hide=order.first_can_hide)

    monkeypatch.setattr(analytic, "order_of", swapped)
    assert compared(renderer, outlines).visible.tolist() == [Agreement.UNEXPLAINED] * 2
    monkeypatch.undo()
    wreck = Obstacle("wreck", (placed(mesh("sailboat"), np.array([20, 6, 16]), np.array([100.0, 0, 0]), 1.3),))
    outlines = outlines_of([(vessel("ship", 60, 14, 12), (200.0, 5.0), 0.4)], obstacles=[wreck])
    exact = analytic_occlusion(outlines, INTRINSICS)
    ((hider, px),) = exact.occluders[0]
    assert hider == 1 and 0 < px < 0.6 * exact.silhouette_px[0]
    assert (compared(renderer, outlines).worst == Agreement.AGREE).all()


def test_the_hull_of_a_flat_mesh_is_all_its_vertices_and_an_open_surface_the_same_from_both_sides():
    flat = Solid(np.array([[0, 0, 0], [1, 0, 1], [0, 1, 0], [1, 1, 1], [0.5, 0.5, 0.5]]), np.array([[0, 1, 2]]))
    assert hull_vertices(flat).tolist() == [0, 1, 2, 3, 4]
    assert hull_vertices(catamaran()).tolist() == sorted({*range(16)} & {*hull_vertices(catamaran()).tolist()})
    assert len(hull_vertices(catamaran())) == 8
    sail = Solid(shoebox().vertices, shoebox().faces[4:8], convex=False, closed=False)
    turned = replace(sail, faces=sail.faces[:, ::-1])
    for size, place in (((20, 6, 8), (100.0, 4.0)), ((40, 4, 20), (0.0, 3.0))):  # the near plane cuts the second
        both = (outlines_of([(ship("sail", *size, solid), place, 0.1)]) for solid in (sail, turned))
        (one,), (other,) = (analytic_occlusion(outlines, INTRINSICS).silhouette_px for outlines in both)
        assert one == pytest.approx(other) and one > 1000


def test_sources_take_meshes_and_the_way_from_a_region_to_its_hole_is_no_boundary(tmp_path):
    path = own_ship_scene(tmp_path, obstacles={"wreck": WRECK})
    drawn, exact = (list(simulate_frames(load_scene(path, source=source))) for source in ("rendered", "analytic"))
    for one, other in zip(drawn, exact, strict=True):
        assert one.truth.vessels == other.truth.vessels == ("near", "far")
        np.testing.assert_allclose(other.truth.full_boxes_px, one.truth.full_boxes_px, atol=1)
        np.testing.assert_allclose(other.truth.visible_fraction, one.truth.visible_fraction, atol=0.05)
        for near, far in (one.truth.occluded_by, other.truth.occluded_by):
            assert set(near) == {"own"} and near["own"] > 20 and far["obstacle:wreck"] > 100
        assert one.truth.occluded_by[1].keys() == other.truth.occluded_by[1].keys()
    square = shapely.box(0, 0, 30, 20)
    holed = square.difference(shapely.box(10, 5, 20, 15))
    regions = np.array([square, holed, shapely.MultiPolygon([square, shapely.box(100, 0, 101, 1)])])
    np.testing.assert_array_equal(boundary_pixels(regions, 1), [108, 156, 120])
