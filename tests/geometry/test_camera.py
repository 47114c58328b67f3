"""Cameras: what is projected where, and lens distortion: the published model, its inverse, and truth through a lens."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import assume, example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from modsim3d.core.errors import InputError
from modsim3d.geometry import camera_poses
from modsim3d.geometry.camera import Camera, Distortion, Intrinsics, clip_triangles, guard_planes, near_plane
from modsim3d.geometry.camera_poses import Mount, camera_R_parent, heading_of, poses_on_board, rotation, rotation_vector
from modsim3d.geometry.kinematics import KNOT_M_S, NAUTICAL_MILE_M
from modsim3d.render.id_pass import SUBPIXELS
from modsim3d.runs.pipeline import simulate_frames
from modsim3d.scene.reading import load_scene
from modsim3d.truth.analytic import analytic_occlusion
from modsim3d.truth.buffer_drawing import subdivided
from modsim3d.truth.rendered import rendered_occlusion
from modsim3d.truth.silhouettes import silhouette_polygons
from modsim3d.verify.sources.agreement import Agreement, compare_with_analytic
from tests import scenes
from tests.scenes import INTRINSICS, camera_keys, crate, outlines_of, pixel_masks, random_scene, vessel, write_scene

LEGACY = Intrinsics.from_lens(0.05, (1e-5, 1e-5), (1800, 1200), (3600, 2400))
SKEWED = Intrinsics((900.0, 1300.0), (410.0, 290.0), (800, 600), skew=25.0)


def image_of(point, mount, intrinsics=LEGACY):
    return intrinsics.project(camera_poses.poses_ashore(mount, 1).to_camera(np.array([point], dtype=float)))[0]


def test_worked_examples_of_the_source_hold_and_what_is_not_said_of_a_camera_is_nothing():
    plain = Intrinsics((900.0, 900.0), (400.0, 300.0), (800, 600))
    assert (plain.skew, plain.near_clip_m, plain.distortion) == (0.0, 0.1, None)
    assert Camera("C0", plain, Mount((0, 0, 0))).start_offset_s == 0
    assert not camera_poses.BASE_R_WORLD.flags.writeable
    board = Mount((5, 0, 2), pitch_rad=0.1), np.zeros((1, 3)), np.zeros(1), np.array([[0.1, 0.2, 0.0]])
    rigid = poses_on_board(*board, "rigid").camera_R_world
    np.testing.assert_array_equal(poses_on_board(*board).camera_R_world, rigid)
    assert NAUTICAL_MILE_M == 1852
    assert pytest.approx(0.5144444) == KNOT_M_S
    for mount, expected in (
        # Jessen & Mohr (2023), §7.4.2; a 20 cm shift moves the point 0.2 / 20 · 5000 = 50 px, not 5.
        (Mount((0, 0, 0)), (1800, 1200)),
        (Mount((0.2, 0, 0)), (1800, 1200)),
        (Mount((0, 0.2, 0)), (1850, 1200)),
        (Mount((0, 0, 0.2)), (1800, 1250)),
        (Mount((0, 0, 0), pitch_rad=np.pi / 40), (1800, 806.49)),
        (Mount((0, 0, 0), yaw_rad=np.pi / 40), (2193.51, 1200)),
        (Mount((0, 0, 0), roll_rad=np.pi / 40), (1800, 1200)),
    ):
        np.testing.assert_allclose(image_of((20, 0, 0), mount), expected, atol=0.005, err_msg=str(mount))
    # The world rises on the side that sinks.
    assert image_of((100, 10, 0), Mount((0, 0, 0), roll_rad=0.1))[1] < 1200


@given(st.floats(-2000, 3000), st.floats(-2000, 3000), st.floats(0.2, 1e5))
def test_unproject_then_project_is_the_identity(x, y, depth):
    np.testing.assert_allclose(SKEWED.project(SKEWED.unproject([x, y], depth)), [x, y], rtol=1e-9, atol=1e-6)


def test_project_is_the_matrix_k_whose_focal_lengths_are_in_the_sides_of_a_pixel():
    point = np.array([1.5, -0.7, 9.0])
    homogeneous = SKEWED.matrix @ point
    np.testing.assert_allclose(SKEWED.project(point), homogeneous[:2] / homogeneous[2])
    # By hand: 0.05 m / 10 µm = 5000 and 0.05 m / 20 µm = 2500.
    assert Intrinsics.from_lens(0.05, (1e-5, 2e-5), (0, 0), (8, 6)).focal_px == pytest.approx((5000, 2500))


@pytest.mark.parametrize("kind", [np.float32, np.int64])
def test_numbers_of_any_kind_are_computed_with_in_double_precision(kind):
    pixels, depth, points = [[412, 305], [3, 7]], [3, 7], [[1, 2, 3], [4, 5, 7]]
    for camera in (SKEWED, replace(SKEWED, distortion=Distortion(k1=-0.1))):
        inputs = {camera.project: (points,), camera.unproject: (pixels, depth), camera.through_lens: (pixels,)}
        for compute, arrays in inputs.items():
            found = compute(*(np.array(each).astype(kind) for each in arrays))
            assert found.dtype == np.float64
            np.testing.assert_array_equal(found, compute(*(np.array(each, dtype=np.float64) for each in arrays)))


def test_points_behind_the_camera_have_no_image_and_the_horizon_is_the_principal_row():
    points = [[0.1, 0.1, -5.0], [0.1, 0.1, 0.0], [0.1, 0.1, 0.0999], [0.1, 0.1, 0.1]]
    assert np.isnan(LEGACY.project(points)).all(axis=1).tolist() == [True, True, True, False]
    level, down, up = (camera_R_parent(0, pitch_rad, 1.0) for pitch_rad in (0, np.pi / 2, -np.pi / 2))
    np.testing.assert_allclose(SKEWED.sea_half_plane(level), [0, 1, -290], atol=1e-12)
    np.testing.assert_allclose(LEGACY.sea_half_plane(down), [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(LEGACY.sea_half_plane(up), [0, 0, -1], atol=1e-9)
    exactly = np.array([[0, -1, 0], [-1, 0, 0], [0, 0, -1]])
    np.testing.assert_array_equal(LEGACY.sea_half_plane(exactly), [0, 0, 1])


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1), st.floats(-3, 3), st.floats(0.01, 1.5))
def test_points_far_away_on_the_sea_are_below_the_horizon_and_in_the_sky_above_it(roll, pitch, yaw, bearing, dip):
    rotation = camera_R_parent(roll, pitch, yaw)
    a, b, c = SKEWED.sea_half_plane(rotation)
    for sign in (-1, 1):
        ray = rotation @ [np.cos(bearing) * np.cos(dip), np.sin(bearing) * np.cos(dip), sign * np.sin(dip)]
        if ray[2] > 0.01:
            x, y = SKEWED.project(1e3 * ray)
            assert (a * x + b * y + c > 0) == (sign < 0)


def area_vectors(triangles):
    return np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) / 2


def test_the_near_plane_cuts_what_crosses_it_and_parts_of_triangles_make_up_the_whole_in_order():
    for depths in ((2.0, 2.5, 3.0), (0.1, 0.2, 0.3), (0.1, 0.1, 0.2), (0.1, 0.1, 0.1)):
        triangle = np.column_stack([[0.0, 0.1, 0.0], [0.0, 0.1, 0.1], depths])[None]
        np.testing.assert_array_equal(clip_triangles(triangle, near_plane(LEGACY))[0], triangle)
        assert clip_triangles(-triangle, near_plane(LEGACY))[0].shape == (0, 3, 3)
    clipped = clip_triangles(np.array([[[0.0, 0.0, 2.0], [0.0, 1.0, 2.0], [0.0, 0.0, -2.0]]]), near_plane(LEGACY))[0]
    assert clipped[..., 2].min() == pytest.approx(0.1)
    assert np.linalg.norm(area_vectors(clipped), axis=1).sum() == pytest.approx(2.0 - 0.5 * 2.1 * 2.1 / 4)
    rng = np.random.default_rng(4)
    for triangle in rng.normal(size=(200, 1, 3, 3)):
        normal, whole = rng.normal(size=3), area_vectors(triangle)[0]
        plane = np.array([[*normal, normal @ triangle[0].mean(axis=0) + rng.normal(scale=0.3)]])
        parts = [clip_triangles(triangle, side)[0] for side in (plane, -plane)]
        for side, part in zip((plane[0], -plane[0]), parts, strict=True):
            assert (part @ side[:3] - side[3] > -1e-12).all() and (area_vectors(part) @ whole > -1e-12).all()
        np.testing.assert_allclose(sum(area_vectors(part).sum(axis=0) for part in parts), whole, atol=1e-12)
    rng = np.random.default_rng(5)
    triangles = rng.normal(size=(30, 3, 3)) + 100 * np.arange(30)[:, None, None] * [1.0, 0.0, 0.0]
    parts = clip_triangles(triangles, np.array([[0.0, 0.3, 1.0, 0.1]]))[0]
    assert (np.diff(np.rint(parts[..., 0].mean(axis=1) / 100)) >= 0).all()
    everything = np.array([[[-500.0, -300.0, 5.0], [600.0, -300.0, 5.0], [0.0, 700.0, 5.0]]])
    planes = np.concatenate([near_plane(SKEWED), guard_planes(SKEWED, 100.0)])
    shown = SKEWED.project(clip_triangles(everything, planes)[0])
    np.testing.assert_allclose([shown.min(axis=(0, 1)), shown.max(axis=(0, 1))], [[-100, -100], [900, 700]], atol=1e-6)


angles = st.floats(-10, 10)


@given(angles, angles, angles)
def test_camera_rotation_is_orthonormal_and_right_handed(roll, pitch, yaw):
    matrix = camera_R_parent(roll, pitch, yaw)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert abs(np.linalg.det(matrix) - 1) < 1e-12


def test_base_pose_is_two_quarter_turns_that_look_along_w1_and_headings_are_counter_clockwise_from_w1():
    # Jessen & Mohr (2023), eq. 7.14: Ry(3π/2) · Rx(π/2). Right is along −w2 and down along −w3.
    base = camera_poses.BASE_R_WORLD
    np.testing.assert_allclose(rotation(1, 3 * np.pi / 2) @ rotation(0, np.pi / 2), base, atol=1e-15)
    np.testing.assert_array_equal(base @ [[1, 0, 0], [0, -1, 0], [0, 0, -1]], [[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    turned = camera_poses.world_R_vehicle(np.pi / 2)  # port is v2
    np.testing.assert_allclose(turned @ np.eye(3)[:2].T, [[0, -1], [1, 0], [0, 0]], atol=1e-15)


@given(angles)
def test_heading_of_recovers_the_sign_that_arccos_loses(heading):
    direction = np.array([np.cos(heading), np.sin(heading)])
    assert np.isclose(np.angle(np.exp(1j * (heading_of(direction) - heading))), 0, atol=1e-9)


def test_attitude_broadcasts_in_double_precision_and_rotation_vectors_are_those_of_each():
    angle = np.linspace(-1, 1, 7)
    stacked = camera_poses.attitude(angle, 2 * angle, 3 * angle)
    each = [rotation(2, a) @ rotation(0, 2 * a) @ rotation(1, 3 * a) for a in angle]
    np.testing.assert_allclose(stacked, each, atol=1e-15)
    angle = np.array([0.1, 0.7, -0.3], dtype=np.float32)
    for turn in (lambda a: rotation(2, a), camera_poses.vehicle_R_nominal, lambda a: rotation_vector(rotation(1, a))):
        assert turn(angle).dtype == np.float64
        np.testing.assert_array_equal(turn(angle), turn(angle.astype(np.float64)))
    east = np.array([0.3, 0.1], dtype=np.float32)
    assert heading_of(east) == heading_of(east.astype(np.float64))
    single = rotation(0, 0.4).astype(np.float32)
    np.testing.assert_array_equal(rotation_vector(single), rotation_vector(single.astype(np.float64)))
    rng = np.random.default_rng(6)
    axes = np.concatenate([rng.normal(size=(60, 3)), [[0.3, -0.5, 0.8], [0.0, 0.0, -1.0]]])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    angles = [0, *rng.uniform(0, 3.14, 29), *(np.pi - np.geomspace(1e-12, 0.5, 30)), np.pi, np.pi]
    vectors = axes * np.array(angles)[:, None]
    turns = Rotation.from_rotvec(vectors).as_matrix()
    found = rotation_vector(turns)
    np.testing.assert_allclose(found[:-2], vectors[:-2], atol=1e-9)
    # Half a turn is the same both ways.
    signs = np.sign((found * vectors)[-2:].sum(axis=1))[:, None]
    np.testing.assert_allclose(found[-2:] * signs, vectors[-2:], atol=3e-7)
    np.testing.assert_array_equal(found, [rotation_vector(turn) for turn in turns])


BARREL = Distortion(k1=-0.21, k2=0.07, p1=0.0013, p2=-0.0021, k3=-0.011)
PINCUSHION = Distortion(k1=0.15, k2=0.03, p1=-0.001, p2=0.002)
coefficient = st.floats(-0.05, 0.05)
BOTH = pytest.mark.parametrize("lens", [BARREL, PINCUSHION], ids=["barrel", "pincushion"])


@given(st.tuples(*[coefficient] * 5), st.tuples(*[st.floats(-0.8, 0.8)] * 2))
@example((0.0, -0.046875, 0.0, -0.03125, -0.046875), (0.78125, 0.796875))  # just beyond a fold
def test_undistort_undoes_distort_where_the_lens_is_one_to_one(coefficients, point):
    k1, k2, p1, p2, k3 = coefficients
    lens = Distortion(k1, k2, p1 / 10, p2 / 10, k3)
    ideal = np.array(point)
    assume(lens.one_to_one(1.1 * ideal[None]))
    np.testing.assert_allclose(lens.undistort(lens.distort(ideal)), ideal, atol=1e-9)


GRID = np.stack(np.meshgrid(*[np.linspace(-0.6, 0.6, 7)] * 2), axis=-1)
"""Points of the ideal plane in all four quadrants and on the axes, shape (7, 7, 2)."""


@BOTH
def test_each_point_is_undistorted_in_few_steps_and_has_its_derivatives_as_if_it_were_alone(lens, monkeypatch):
    distorted = lens.distort(GRID)
    for place in np.ndindex(7, 7):
        np.testing.assert_allclose(lens.undistort(distorted[place]), GRID[place], rtol=0, atol=1e-13)
        np.testing.assert_array_equal(lens.jacobian(GRID)[place], lens.jacobian(GRID[place]))
    assert lens.undistort(np.empty((0, 2))).shape == (0, 2)
    monkeypatch.setattr("modsim3d.geometry.camera.MAX_ITERATIONS", 6)
    np.testing.assert_allclose(lens.undistort(distorted), GRID, rtol=0, atol=1e-13)


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("axis", [0, 1])
def test_only_points_that_no_direction_is_seen_at_have_none(axis, sign):
    # On the axis, x + 1.5 x² is at least −1/6.
    lens = Distortion(**{("p2", "p1")[axis]: 0.5 * sign})
    along = np.roll(np.eye(2), axis, axis=0)
    places = sign * np.array([[0.2, 0.1], [-0.3, 0.0], [-0.1, 0.05], [-0.2, 0.0], [0.0, 0.0]]) @ along
    missing = np.isnan(lens.undistort(places))
    assert missing.all(axis=1).tolist() == missing.any(axis=1).tolist() == [False, True, False, True, False]


def test_projection_is_that_of_opencv_one_to_one_up_to_its_fold():
    lens = Distortion(k1=-1.0)  # r − r³ rises up to r = 1 / √3 = 0.5774
    for direction in ((1.0, 0.0), (0.0, -1.0), (0.6, 0.8), (-0.8, 0.6), (np.sqrt(0.5), np.sqrt(0.5))):
        inside, outside = np.outer([0.3, 0.577], direction), np.outer([0.3, 0.580], direction)
        assert lens.one_to_one(inside) and not lens.one_to_one(outside) and not lens.one_to_one(outside[::-1])
        # Beyond r = 1 it mirrors both axes, and the one place of 257 before that is the axis itself.
        assert not lens.one_to_one(np.outer([300.0], direction))
        assert not lens.one_to_one(np.concatenate([inside, [[np.nan, 0.1]]]))
    lens = Distortion(k1=-0.9, k2=0.35)  # its radius falls from r = 0.79 to 0.96, and rises again
    assert lens.one_to_one(np.array([[0.78, 0.0]])) and not lens.one_to_one(np.array([[1.1, 0.0]]))
    assert (np.linalg.det(lens.jacobian(np.array([[1.1, 0.0]]))) > 0).all()
    points, step = np.random.default_rng(0).uniform(-0.7, 0.7, (50, 2)), 1e-6
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        slope = (BARREL.distort(points + shift) - BARREL.distort(points - shift)) / (2 * step)
        np.testing.assert_allclose(BARREL.jacobian(points)[..., axis], slope, atol=1e-8)
    lens = Intrinsics((1000.0, 1100.0), (640.0, 360.0), (1280, 720), distortion=BARREL)
    points = [[0.5, -0.3, 1.0], [-1.2, 0.7, 2.5], [3.0, 2.0, 9.0], [0.0, 0.0, 4.0]]
    # cv2.projectPoints of OpenCV 5.0.0 with these coefficients in its order k1, k2, p1, p2, k3.
    expected = [
        *([1105.975828, 52.47091352], [186.1129068891, 651.2696940795]),
        *([962.0735224293, 596.6639164481], [640, 360]),
    ]
    np.testing.assert_allclose(lens.project(points), expected, rtol=0, atol=1e-6)
    assert Distortion() == Distortion(0.0, 0.0, 0.0, 0.0, 0.0)  # what is not given distorts nothing


@BOTH
def test_pinhole_window_holds_all_that_the_lens_shows_which_maps_an_array_as_it_maps_each_pixel(lens):
    camera = replace(INTRINSICS, distortion=lens, skew=12.0)
    pixels = np.random.default_rng(1).uniform(0, camera.image_size_px, (25, 20, 2))
    straight = camera.pinhole.project(camera.unproject(pixels, np.full((25, 20), 10.0)))
    assert (straight >= 0).all() and (straight <= camera.pinhole.image_size_px).all()
    np.testing.assert_allclose(camera.through_lens(straight), pixels, atol=1e-6)
    each = [[camera.through_lens(pixel) for pixel in row] for row in straight[:3]]
    np.testing.assert_array_equal(camera.through_lens(straight)[:3], each)
    np.testing.assert_array_equal(INTRINSICS.through_lens(pixels), pixels)  # without a lens they stay
    assert camera.lens_problem() is None


@BOTH
@pytest.mark.parametrize("principal_point", [(300.0, 200.0), (500.0, 400.0)])
def test_pinhole_window_leaves_one_to_two_pixels_around_what_the_lens_shows(lens, principal_point):
    camera = Intrinsics((1000.0, 1300.0), principal_point, (800, 600), skew=12.0, distortion=lens)
    along = np.linspace(0, 1, 4001)[:, None]
    corners = np.array([[0, 0], [800, 0], [800, 600], [0, 600]])
    border = np.concatenate([a + along * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    straight = camera.pinhole.project(camera.unproject(border, np.ones(len(border))))
    spare = [straight.min(axis=0), camera.pinhole.image_size_px - straight.max(axis=0)]
    assert 0.99 < np.min(spare) <= np.max(spare) < 2.01  # the window is measured at 256 points of the border


def worst_bend(camera, chord):
    """Greatest distance in pixels between a chord at the border of the pinhole image and what the lens makes of it."""
    border, angle = camera.pinhole.image_border()[:, None], np.linspace(0, np.pi, 36, endpoint=False)
    half = chord / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    middle = (camera.through_lens(border + half) + camera.through_lens(border - half)) / 2
    return np.linalg.norm(middle - camera.through_lens(border), axis=-1).max()


@BOTH
@pytest.mark.parametrize("principal_point", [(300.0, 200.0), (500.0, 200.0), (300.0, 400.0), (500.0, 400.0)])
@pytest.mark.parametrize("focal", [(1000.0, 1000.0), (900.0, 1300.0), (1300.0, 900.0)])
def test_longest_chord_is_bent_by_a_step_of_the_pixel_grid(lens, principal_point, focal):
    camera = Intrinsics(focal, principal_point, (800, 600), distortion=lens)
    # Four directions are measured; between two of them the bend may be a tenth larger.
    assert 0.98 < worst_bend(camera, camera.chord_px) * SUBPIXELS < 1.1


def test_longest_chord_is_between_one_pixel_and_256_and_has_no_bound_without_a_lens():
    assert INTRINSICS.chord_px == np.inf and replace(INTRINSICS, distortion=Distortion()).chord_px == 256
    strong = Intrinsics((10.0, 10.0), (16.0, 12.0), (32, 24), distortion=Distortion(k1=0.3))
    assert strong.lens_problem() is None and strong.chord_px == 1 and worst_bend(strong, 1.0) > 1 / SUBPIXELS


def through(seed, lens):
    """A random scene before a camera with a lens that bends edges by many pixels, but is none too wide for that."""
    places, intrinsics, mount = random_scene(np.random.default_rng(50_000 + seed))
    width, height = intrinsics.image_size_px
    focal_px = tuple(max(focal, 1.2 * max(width, height)) for focal in intrinsics.focal_px)
    middle = (width / 2, height / 2)
    camera = replace(intrinsics, focal_px=focal_px, principal_point_px=middle, skew=0.0, distortion=lens)
    assert camera.lens_problem() is None
    return outlines_of(places, camera, mount), camera


@pytest.mark.parametrize("seed", range(12))
def test_pixels_and_geometry_agree_through_a_lens(renderer, seed):
    outlines, camera = through(seed, (BARREL, PINCUSHION)[seed % 2])
    rendered = rendered_occlusion(outlines, camera, renderer)
    found = compare_with_analytic(outlines, camera, rendered, lambda row: pixel_masks(outlines, camera, renderer, row))
    assert (found.worst < Agreement.INTERSECTING).all()


def test_each_pixel_shows_what_lies_in_its_direction(renderer):
    seen = 0
    for seed in range(4):
        outlines, camera = through(100 + seed, BARREL)
        outlines = outlines.take(np.flatnonzero(outlines.areas_px < 60_000))  # enough, and soon looked at
        for part in outlines.parts:
            crosses = outlines.crosses_near[part.rows]
            straight = silhouette_polygons(camera.pinhole, part.vertices_camera, part.vertices_px, crosses, part.solid)
            for row, silhouette in zip(part.rows.tolist(), straight, strict=True):
                mask = pixel_masks(outlines, camera, renderer, row)
                height, width = mask.silhouette.shape
                x, y = np.meshgrid(mask.region.x + np.arange(width) + 0.5, mask.region.y + np.arange(height) + 0.5)
                centres = np.stack([x, y], axis=-1)
                directions = camera.pinhole.project(camera.unproject(centres, np.full(centres.shape[:-1], 10.0)))
                x, y = directions[..., 0], directions[..., 1]
                sure, perhaps = (shapely.contains_xy(silhouette.buffer(band), x, y) for band in (-0.05, 0.05))
                assert not (sure & ~mask.silhouette).any() and not (mask.silhouette & ~perhaps).any()
                seen += int(sure.sum())
    assert seen > 10_000


def test_an_edge_that_the_lens_bends_reaches_beyond_its_corners_and_subdivision_keeps_the_area(renderer):
    """Of the last nothing is in the image, though it is not as a whole beyond any of its sides."""
    camera, wall, half = replace(INTRINSICS, distortion=BARREL), ((2, 140, 60), (200, 0)), ((1, 40, 10), (50, 20))
    boxes = (*wall, 0), ((20, 8, 6), (90, 30), 0.5), (*half, 0), ((266, 2, 6), (-90, -15), 0.598)
    outlines = outlines_of([(vessel("any", *size), *rest) for size, *rest in boxes], camera)
    exact = analytic_occlusion(outlines, camera).full_boxes_px
    assert np.abs(exact - rendered_occlusion(outlines, camera, renderer).full_boxes_px).max() <= 1
    assert exact[0, 1] < camera.project(outlines.parts[0].vertices_camera[0])[:, 1].min() - 3
    around = outlines_of([], camera, obstacles=[crate(*each) for each in boxes]).boxes_px
    assert (outlines.in_frame_fraction[:2] == 1).all() and 0.3 < outlines.in_frame_fraction[2] < 0.9
    assert len(around) == len(exact) == 3 and (np.abs(around - exact - (-5, -5, 5, 5)) < 5 + 1e-6).all()
    triangles = np.random.default_rng(3).uniform([-3, -3, 5], [3, 3, 9], (20, 3, 3))
    small, _ = subdivided(triangles, INTRINSICS, 20.0)
    pixels = INTRINSICS.project(small)
    assert np.linalg.norm(np.roll(pixels, -1, axis=1) - pixels, axis=-1).max() <= 20.0
    normals, parts = (np.cross(some[:, 1] - some[:, 0], some[:, 2] - some[:, 0]) for some in (triangles, small))
    assert np.linalg.norm(parts, axis=1).sum() == pytest.approx(np.linalg.norm(normals, axis=1).sum())
    np.testing.assert_allclose(parts.sum(axis=0), normals.sum(axis=0))  # none was turned over


def lens_scene(folder, **distortion):
    boats = {"a": ([10, 4, 3], [[0, 100, -20], [10, 100, 20]]), "b": ([10, 4, 6], [[0, 150, 30], [10, 150, -20]])}
    camera = camera_keys(pose={"position_m": [0, 0, scenes.CAMERA_HEIGHT_M]}, distortion=distortion)
    return write_scene(folder, boats, 5, cameras={"C0": camera})


def test_scene_runs_through_a_lens_from_every_source_and_coefficients_of_zero_are_a_pinhole(tmp_path):
    (camera,) = load_scene(lens_scene(tmp_path, k1=0.0)).cameras
    assert camera.intrinsics.distortion is None and camera.intrinsics.pinhole is camera.intrinsics
    scene = load_scene(lens_scene(tmp_path, k1=-0.2, k2=0.05))
    drawn, exact, _ = (
        list(simulate_frames(replace(scene, annotation=replace(scene.annotation, source=source))))
        for source in ("rendered", "analytic", "rectangles")
    )
    for rendered, analytic in zip(drawn, exact, strict=True):
        assert rendered.truth.vessels == analytic.truth.vessels
        assert np.abs(rendered.truth.full_boxes_px - analytic.truth.full_boxes_px).max() <= 1


PART = "the lens reaches only a part of the image: reduce the coefficients or the image size"
FOLDS = [
    ({"k1": -3.0}, PART),
    ({"k1": -1.0, "k2": -2.0}, PART),
    ({"k1": -0.9, "k2": 0.27}, PART),
    ({"p1": 5.0}, PART),
    # One to one in the image, but a fold lies between: r (1 − 0.9 r² + 0.35 r⁴) falls from r = 0.79 to 0.96.
    ({"k1": -0.9, "k2": 0.35}, "folds the image over itself: some pixels show two directions"),
]


def test_lens_that_folds_the_image_is_refused_and_that_of_a_long_narrow_image_is_not(tmp_path):
    for coefficients, problem in FOLDS:
        with pytest.raises(InputError, match=rf"cameras\.C0\.distortion: {problem}"):
            load_scene(lens_scene(tmp_path, **coefficients))
    for width, height in ((2400, 200), (200, 2400)):
        middle, lens = (width / 2, height / 2), Distortion(k1=-0.1)
        assert Intrinsics((3000.0, 3000.0), middle, (width, height), distortion=lens).lens_problem() is None
