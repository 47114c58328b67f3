"""Velocities and accelerations by differences."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from modsim3d.geometry.camera_poses import rotation
from modsim3d.geometry.kinematics import first_derivative, second_derivative, slopes, turning, velocities

TIMES = st.lists(st.floats(0.05, 2.0), min_size=2, max_size=12).map(lambda gaps: np.cumsum([3.0, *gaps]))
NUMBERS = st.floats(-10, 10)


@settings(max_examples=50)
@given(TIMES, NUMBERS, NUMBERS, NUMBERS)
def test_parabola_has_its_own_derivatives_whatever_the_intervals(times, a, b, c):
    values = a + b * times + c * times**2
    between = slopes(times, values)
    np.testing.assert_allclose(first_derivative(times, between)[1:-1], (b + 2 * c * times)[1:-1], atol=1e-7)
    np.testing.assert_allclose(second_derivative(times, between), 2 * c, atol=1e-6)


def test_ends_take_the_only_slope_they_have():
    times = np.array([0.0, 1.0, 3.0])
    between = slopes(times, np.array([0.0, 2.0, 10.0]))
    np.testing.assert_allclose(first_derivative(times, between)[[0, 2]], [2, 4])


def test_one_or_two_times_have_no_acceleration():
    for times in (np.array([1.0]), np.array([1.0, 2.0])):
        between = slopes(times, 5 * times)
        np.testing.assert_array_equal(second_derivative(times, between), np.zeros(len(times)))
        np.testing.assert_array_equal(first_derivative(times, between), [0.0] if len(times) == 1 else [5.0, 5.0])


def test_velocities_of_vessels_that_come_and_go_ignore_where_they_are_not():
    times = np.arange(6.0)
    present = np.array([[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 1, 0], [1, 0, 0], [1, 0, 0]], dtype=bool)
    positions = np.where(present[..., None], (100 + 3 * times)[:, None, None], 0.0) * np.ones(3)
    found = velocities(times, positions, present)
    np.testing.assert_allclose(found[:, 0], 3)
    np.testing.assert_allclose(found[1:4, 1], 3)
    np.testing.assert_array_equal(found[~present], 0)
    np.testing.assert_array_equal(found[:, 2], 0)  # there at one step only


@given(TIMES, st.integers(0, 2), st.floats(-1.0, 1.0))
def test_steady_turn_has_its_own_rate_in_body_axes_for_one_body_and_for_many(times, axis, rate):
    attitudes = rotation(1, 0.4) @ rotation(axis, rate * times)
    expected = rate * np.tile(np.eye(3)[axis], (len(times) - 1, 1))
    np.testing.assert_allclose(turning(times, attitudes), expected, atol=1e-9)
    both = np.stack([attitudes, np.swapaxes(rotation(axis, rate * times), -1, -2)], axis=1)
    np.testing.assert_allclose(turning(times, both), np.stack([expected, -expected], axis=1), atol=1e-9)
