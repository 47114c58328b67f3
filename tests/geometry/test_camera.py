from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from modsim3d.geometry import camera_poses
from modsim3d.geometry.camera import Camera, Distortion, Intrinsics, clip_triangles, guard_planes, near_plane
from modsim3d.geometry.camera_poses import Mount, camera_R_parent, heading_of, poses_on_board, rotation, rotation_vector
from modsim3d.geometry.kinematics import KNOT_M_S, NAUTICAL_MILE_M

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
