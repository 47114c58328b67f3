"""How much of the time a chain of performance states spends in each state in the long run."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from modsim3d.detector.file.reading import load_detector
from modsim3d.detector.model import stationary_shares


def test_two_states_are_shared_as_their_rates_of_leaving():
    """Left with 0.01 and with 0.05 a step: 5 to 1."""
    np.testing.assert_allclose(stationary_shares(np.array([[0.99, 0.05], [0.01, 0.95]])), [5 / 6, 1 / 6])


@given(weights=st.integers(1, 6).flatmap(lambda n: arrays(float, (n, n), elements=st.floats(1e-3, 1))))
def test_a_transition_leaves_the_shares_as_they_are(weights):
    matrix = weights / weights.sum(axis=0)
    shares = stationary_shares(matrix)
    np.testing.assert_allclose(matrix @ shares, shares, atol=1e-9)
    assert shares.sum() == pytest.approx(1)
    np.testing.assert_allclose(np.linalg.matrix_power(matrix, 10_000) @ np.eye(len(shares))[0], shares, atol=1e-6)


def test_shares_of_the_source_s_detector():
    """Jessen & Mohr (2023), eq. 9.1: 10.5/59, 19/59, 19/59, 10.5/59, by hand from its four columns."""
    model = load_detector("thesis")
    assert list(model.stationary_shares) == ["excellent", "good", "bad", "terrible"]
    shares = list(model.stationary_shares.values())
    np.testing.assert_allclose(shares, np.array([21, 38, 38, 21]) / 118, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.matrix_power(model.transition_matrix, 100_000)[:, 0], shares)


def test_state_that_is_left_for_ever_has_none_of_the_time():
    np.testing.assert_allclose(stationary_shares(np.array([[0.5, 0.0], [0.5, 1.0]])), [0, 1], atol=1e-12)


def test_states_that_take_turns_have_half_of_the_time_each():
    np.testing.assert_allclose(stationary_shares(np.array([[0.0, 1.0], [1.0, 0.0]])), [0.5, 0.5])


def test_there_are_no_shares_where_the_first_state_decides():
    assert not len(stationary_shares(np.eye(2)))
