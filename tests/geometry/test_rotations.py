import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from modsim3d.geometry import camera_poses
from modsim3d.geometry.camera_poses import BASE_R_WORLD, camera_R_parent, heading_of, rotation, rotation_vector

angles = st.floats(-10, 10)


@given(angles, angles, angles)
def test_camera_rotation_is_orthonormal_and_right_handed(roll, pitch, yaw):
    matrix = camera_R_parent(roll, pitch, yaw)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert abs(np.linalg.det(matrix) - 1) < 1e-12


def test_base_pose_is_two_quarter_turns():
    """Jessen & Mohr (2023), eq. 7.14: Ry(3π/2) · Rx(π/2)."""
    np.testing.assert_allclose(rotation(1, 3 * np.pi / 2) @ rotation(0, np.pi / 2), BASE_R_WORLD, atol=1e-15)


def test_base_pose_looks_along_w1_with_right_along_minus_w2_and_down_along_minus_w3():
    np.testing.assert_array_equal(BASE_R_WORLD @ [[1, 0, 0], [0, -1, 0], [0, 0, -1]], [[0, 1, 0], [0, 0, 1], [1, 0, 0]])


def test_heading_is_counter_clockwise_from_w1_and_port_is_v2():
    turned = camera_poses.world_R_vehicle(np.pi / 2)
    np.testing.assert_allclose(turned @ np.eye(3)[:2].T, [[0, -1], [1, 0], [0, 0]], atol=1e-15)


@given(angles)
def test_heading_of_recovers_the_sign_that_arccos_loses(heading):
    direction = np.array([np.cos(heading), np.sin(heading)])
    assert np.isclose(np.angle(np.exp(1j * (heading_of(direction) - heading))), 0, atol=1e-9)


def test_attitude_broadcasts_over_steps():
    angle = np.linspace(-1, 1, 7)
    stacked = camera_poses.attitude(angle, 2 * angle, 3 * angle)
    each = [rotation(2, a) @ rotation(0, 2 * a) @ rotation(1, 3 * a) for a in angle]
    np.testing.assert_allclose(stacked, each, atol=1e-15)


def test_angles_of_single_precision_are_turned_by_in_double_precision():
    angle = np.array([0.1, 0.7, -0.3], dtype=np.float32)
    for turn in (lambda a: rotation(2, a), camera_poses.vehicle_R_nominal, lambda a: rotation_vector(rotation(1, a))):
        assert turn(angle).dtype == np.float64
        np.testing.assert_array_equal(turn(angle), turn(angle.astype(np.float64)))
    east = np.array([0.3, 0.1], dtype=np.float32)
    assert heading_of(east) == heading_of(east.astype(np.float64))
    single = rotation(0, 0.4).astype(np.float32)
    np.testing.assert_array_equal(rotation_vector(single), rotation_vector(single.astype(np.float64)))


def test_rotation_vectors_of_many_turns_up_to_half_a_turn_are_those_of_each():
    rng = np.random.default_rng(6)
    axes = rng.normal(size=(60, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    vectors = axes * np.concatenate([rng.uniform(0, 3.14, 30), np.pi - np.geomspace(1e-12, 0.5, 30)])[:, None]
    turns = Rotation.from_rotvec(vectors).as_matrix()
    np.testing.assert_allclose(rotation_vector(turns), vectors, atol=1e-9)
    np.testing.assert_array_equal(rotation_vector(turns), [rotation_vector(turn) for turn in turns])
