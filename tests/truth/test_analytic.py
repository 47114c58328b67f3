"""Occlusion by geometry and by pixels where every number can be said beforehand. The camera looks along w1 from 10 m
above the sea with a focal length of 1000 px, the principal point at (400, 300). A box of 10 m height has its top on the
horizon, so that of a box straight ahead nothing but the front face is seen: a rectangle from row 300 to row 300 +
10000 / distance."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from modsim3d.geometry.camera_poses import Mount
from modsim3d.runs.pipeline import truth_block
from modsim3d.scene.reading import load_scene
from modsim3d.truth.analytic import analytic_occlusion
from modsim3d.truth.rendered import rendered_occlusion
from tests.scenes import INTRINSICS, crossing, outlines_of, vessel


def seen_of(places, **options):
    return analytic_occlusion(outlines_of(places, **options), options.get("intrinsics", INTRINSICS))


def seen_by_both(renderer, places, lens=INTRINSICS, mount=None):
    """What geometry and pixels say of a scene."""
    outlines = outlines_of(places, lens, mount)
    return outlines, (analytic_occlusion(outlines, lens), rendered_occlusion(outlines, lens, renderer))


def test_lone_box_has_the_area_and_box_of_its_front_face():
    """20 m wide at 200 m: columns 350–450, rows 300–350."""
    seen = seen_of([(vessel("lone", 2, 20, 10), (201, 0), 0)])
    np.testing.assert_allclose(seen.full_boxes_px, [[350, 300, 450, 350]], atol=1e-9)
    np.testing.assert_array_equal(seen.visible_boxes_px, seen.full_boxes_px)
    np.testing.assert_allclose(seen.silhouette_px, [5000])
    assert seen.visible_fraction().tolist() == [1.0] and seen.occluders == ((),)


def test_side_that_is_covered_is_cut_to_the_exact_column():
    """Front: at 100 m from w2 = −3 to 5.013: columns 349.87–430, over all rows of the one behind."""
    back, front = vessel("back", 2, 20, 10), vessel("front", 2, 8.013, 30)
    seen = seen_of([(back, (201, 0), 0), (front, (101, 1.0065), 0)])
    np.testing.assert_allclose(seen.visible_boxes_px[0], [430, 300, 450, 350], atol=1e-9)
    np.testing.assert_allclose(seen.visible_px[0], 20 * 50)
    np.testing.assert_allclose(seen.visible_fraction(), [0.2, 1.0])
    assert seen.occluders == (((1, pytest.approx(4000)),), ())


def test_edges_between_pixel_centres_are_told_to_a_thousandth_of_a_pixel():
    """At 100 m a millimetre is a hundredth of a pixel."""
    back = vessel("back", 2, 20, 10)
    for width_m in (8.0, 8.001, 8.05):
        seen = seen_of([(back, (201, 0), 0), (vessel("front", 2, width_m, 30), (101, 5 - width_m / 2), 0)])
        np.testing.assert_allclose(seen.visible_boxes_px[0, 0], 350 + 10 * width_m, atol=1e-9)


def test_corner_that_is_covered_cuts_no_side_but_its_area_is_missing():
    """A 2.5 m high box at 100 m, columns 350–400: it hides rows 375–400 there, which begins below the one behind."""
    back, low = vessel("back", 2, 20, 10), vessel("low", 2, 5, 6)
    seen = seen_of([(back, (201, 0), 0), (low, (101, 2.5), 0)])
    # Its top edge: front face from row 340; the top beyond recedes to 102 m, row 300 + 4000 / 102.
    top = 300 + 4000 / 102
    np.testing.assert_allclose(seen.visible_boxes_px[0], [350, 300, 450, 350], atol=1e-9)
    ((hider, hidden),) = seen.occluders[0]
    # Front face: columns 350–400. Back edge of its top at 102 m: columns 400 − 5000 / 102 to 400; a trapezium.
    face, roof = 50 * 10, (50 + 5000 / 102) / 2 * (340 - top)
    assert (hider, hidden) == (1, pytest.approx(face + roof))
    np.testing.assert_allclose(seen.visible_px[0], 5000 - face - roof)


def test_vessel_cut_in_two_by_one_before_it_keeps_the_box_around_both_parts():
    back, mast = vessel("back", 2, 20, 10), vessel("mast", 1, 2, 30)
    seen = seen_of([(back, (201, 0), 0), (mast, (100.5, 0), 0)])
    np.testing.assert_allclose(seen.visible_boxes_px[0], [350, 300, 450, 350], atol=1e-9)
    np.testing.assert_allclose(seen.visible_px[0], 80 * 50)


def test_vessel_behind_a_larger_one_has_no_visible_box_and_keeps_its_full_one(renderer):
    small, large = vessel("small", 2, 4, 3), vessel("large", 2, 40, 30)
    for seen in seen_by_both(renderer, [(small, (301, 0), 0), (large, (101, 0), 0)])[1]:
        assert seen.visible_px[0] == 0 < seen.silhouette_px[0] and np.isnan(seen.visible_boxes_px[0]).all()
        assert seen.full_boxes_px[0, 2] - seen.full_boxes_px[0, 0] == pytest.approx(4000 / 300, abs=1)
        assert seen.occluders[0] == ((1, pytest.approx(seen.silhouette_px[0])),)


def test_two_that_each_hide_a_half_hide_all():
    """Columns 350–400 and 400–450, meeting at column 400 but at different distances."""
    back = vessel("back", 2, 20, 10)
    left, right = vessel("left", 1, 5, 30), vessel("right", 1, 7.5, 30)
    seen = seen_of([(back, (201, 0), 0), (left, (100.5, 2.5), 0), (right, (150.5, -3.75), 0)])
    assert seen.visible_px[0] == 0
    assert dict(seen.occluders[0]) == {1: pytest.approx(2500), 2: pytest.approx(2500)}


def test_each_hidden_point_belongs_to_the_front_most(renderer):
    """At 300, 200 and 100 m: columns 350–450, 375–425 and 390–410, each over all rows of those behind it."""
    far, middle, near = vessel("far", 1, 30, 10), vessel("middle", 1, 10, 30), vessel("near", 1, 2, 30)
    _, both = seen_by_both(renderer, [(far, (300.5, 0), 0), (middle, (200.5, 0), 0), (near, (100.5, 0), 0)])
    for seen, height in zip(both, (10_000 / 300, 33), strict=True):
        assert dict(seen.occluders[0]) == {1: pytest.approx(30 * height), 2: pytest.approx(20 * height)}
        np.testing.assert_allclose(seen.visible_px[0], 50 * height)
        assert [hider for hider, _ in seen.occluders[1]] == [2]


def test_vessel_wholly_behind_the_middle_of_three_is_not_given_to_the_nearest():
    """The nearest hides none of the farthest: it covers columns 430–450 of the middle one only."""
    far, middle, near = vessel("far", 1, 3, 10), vessel("middle", 1, 20, 30), vessel("near", 1, 2, 30)
    seen = seen_of([(far, (300.5, 0), 0), (middle, (200.5, 0), 0), (near, (100.5, -4), 0)])
    assert dict(seen.occluders[0]) == {1: pytest.approx(10 * 10_000 / 300)}


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


def test_vessel_cut_at_the_image_edge_is_hidden_in_the_part_that_is_in_the_image():
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


def test_box_in_front_hides_exactly_the_columns_it_should(renderer):
    """Back: front face at 200 m, 20 m wide: columns 350–450. Front: at 100 m, from w2 = −3 to 5: columns 350–430."""
    back, front = vessel("back", 2, 20, 10), vessel("front", 2, 8, 30)
    outlines, both = seen_by_both(renderer, [(back, (201, 0), 0), (front, (101, 1), 0)])
    assert outlines.occluder.tolist() == [0, 1]
    for seen in both:
        np.testing.assert_allclose(seen.full_boxes_px[:, [0, 2]], [[350, 450], [350, 430]], atol=1e-9)
        np.testing.assert_allclose(seen.visible_boxes_px[0, [0, 2]], [430, 450], atol=1e-9)
        assert seen.visible_px[0] == pytest.approx(seen.silhouette_px[0] * 20 / 100)
        assert seen.occluders == (((1, pytest.approx(seen.silhouette_px[0] * 80 / 100)),), ())
        assert seen.visible_px[1] == seen.silhouette_px[1]


@pytest.mark.parametrize("place", [(-100, 0), (100, 60)], ids=["behind the camera", "outside the image"])
def test_vessel_behind_the_camera_or_outside_the_image_is_not_in_it(renderer, place):
    outlines, (exact, drawn) = seen_by_both(renderer, [(vessel("away"), place, 0)])
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


def test_vessel_larger_than_the_image_fills_it_and_one_without_a_pixel_centre_keeps_its_projected_box(renderer):
    outlines, both = seen_by_both(renderer, [(vessel("wall", 2, 500, 200), (20, 0), 0)])
    assert 0 < outlines.in_frame_fraction[0] < 0.1
    for seen in both:
        np.testing.assert_allclose(seen.full_boxes_px[0], [0, 0, 800, 600], atol=1e-9)
        assert seen.silhouette_px[0] == pytest.approx(800 * 600)
    outlines, (_, drawn) = seen_by_both(renderer, [(vessel("speck", 0.01, 0.01, 0.01), (3000.0, 1.0), 0)])
    np.testing.assert_array_equal(drawn.full_boxes_px, outlines.boxes_px)
    assert drawn.silhouette_px[0] == 0 and np.isnan(drawn.visible_fraction()[0])


def test_boxes_that_only_touch_hide_nothing_of_each_other_and_three_hundred_have_an_id_each(renderer):
    """Side by side at 100 m, meeting at column 400; and a grid on a hillside seen from high above."""
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


RUN_WITHOUT_OPENGL = """
import sys
sys.modules["OpenGL"] = None
from modsim3d.cli.main import main
for mode in ("1", "2"):
    sys.argv = ["modsim3d", "run", SCENE, "--source", "analytic", "--mode", mode]
    sys.argv += ["--out", FOLDER + "/" + mode]
    try:
        main()
    except SystemExit as stopped:
        assert not stopped.code, stopped.code
"""


def test_modes_one_and_two_run_from_end_to_end_where_there_is_no_opengl(tmp_path):
    scene = crossing(tmp_path)
    script = f"SCENE, FOLDER = {str(scene)!r}, {str(tmp_path)!r}\n{RUN_WITHOUT_OPENGL}"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    exact = truth_block(load_scene(scene, source="analytic"), 0, 12, None)
    assert (exact.visible_px == 0).any()
    assert ((exact.visible_fraction > 0) & (exact.visible_fraction < 1)).any()
    for mode in "12":
        rows = pq.read_table(tmp_path / mode / "truth.parquet").to_pylist()
        assert [row["annotated"] for row in rows] == (exact.visible_px > 0).tolist()
        np.testing.assert_array_equal([row["visible_px"] for row in rows], exact.visible_px)
        boxes = json.loads((tmp_path / mode / "annotations_C0.json").read_text())
        widths = [boat["bbox"]["width"] for step in boxes.values() for boat in step.values()]
        expected = exact.full_boxes_px if mode == "1" else exact.visible_boxes_px
        np.testing.assert_allclose(widths, (expected[:, 2] - expected[:, 0])[exact.visible_px > 0])
