"""Performance states: their chain, the share of time in each, forced states and chains of cameras of their own."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from modsim3d.core.errors import ModsimError
from modsim3d.core.random_streams import Purpose, Streams
from modsim3d.detector.classification import PerformanceStates, StateSequence
from modsim3d.detector.file.reading import load_detector, parse_detector
from modsim3d.detector.model import DetectorModel, stationary_shares
from tests.detector.detector_builders import detector_data, make_frames


def sequence(model: DetectorModel, seed: int = 1) -> StateSequence:
    return StateSequence(model, Streams(seed))


def model(**changes: object) -> DetectorModel:
    return parse_detector(detector_data(**changes))


def test_the_first_step_is_in_the_initial_state_and_transition_k_uses_the_kth_number_of_the_stream() -> None:
    for seed in range(20):
        assert sequence(model(initial_state="fog"), seed).at(make_frames(1)).tolist() == [1]
    chain = model()
    uniforms = Streams(5).uniforms(Purpose.STATE, first=0, count=5000)[:, 0]
    state, slow = 0, [0]
    for u in uniforms[1:]:
        state = 0 if u < chain.transition_matrix[0, state] else 1
        slow.append(state)
    assert sequence(chain, seed=5).at(make_frames(5000)).tolist() == slow


@pytest.fixture(scope="module")
def whole() -> np.ndarray:
    return sequence(model()).at(make_frames(9010))


@given(starts=st.lists(st.integers(0, 9000), min_size=1, max_size=5))
def test_states_are_the_same_in_whatever_order_they_are_asked_for(whole: np.ndarray, starts: list[int]) -> None:
    scattered = sequence(model())
    for start in starts:
        part = scattered.at(make_frames(10, camera="other", first_step=start))
        assert np.array_equal(part, whole[start : start + 10])


def test_states_hold_between_multiples_of_the_interval_whatever_the_frame_rate() -> None:
    each_step = sequence(model()).at(make_frames(200))
    slower = sequence(model(transition_interval_s=0.3)).at(make_frames(600, time_step_s=0.1))
    assert np.array_equal(slower, np.repeat(each_step, 3))
    fine = sequence(model(transition_interval_s=1.0)).at(make_frames(2000, time_step_s=0.05))
    coarse = sequence(model(transition_interval_s=1.0)).at(make_frames(200, time_step_s=0.5))
    assert np.array_equal(fine[::10], coarse) and 0 < coarse.mean() < 1


def test_transitions_and_forced_states_are_due_in_spite_of_rounding() -> None:
    times_s = np.array([round(0.2 * k, 1) for k in range(2000)])
    assert np.any(np.floor(times_s / 0.2) < np.arange(2000))  # 0.6 / 0.2 is 2.9999999999999996
    frames = dataclasses.replace(make_frames(2000), times_s=times_s)
    each_step = sequence(model()).at(frames)
    assert np.array_equal(sequence(model(transition_interval_s=0.2)).at(frames), each_step)
    frames = make_frames(5, time_step_s=0.7)
    assert frames.times_s[3] < 2.1
    forced = model(performance={"schedule": [[0, "clear"], [2.1, "fog"]]})
    assert PerformanceStates(forced, Streams(1)).at(frames).tolist() == [0, 0, 0, 1, 1]


def test_an_interval_far_too_short_is_refused_and_no_frames_have_no_states() -> None:
    with pytest.raises(ModsimError, match="longer transition_interval_s than 1e-09"):
        sequence(model(transition_interval_s=1e-9)).at(make_frames(100))
    assert sequence(model()).at(make_frames(0)).shape == (0,)


def states_of(camera: str = "C0", frames: int = 3000, **changes: object) -> np.ndarray:
    return PerformanceStates(model(**changes), Streams(1)).at(make_frames(frames, camera))


def test_a_schedule_forces_states_from_its_times_on_and_the_chain_goes_on_unseen() -> None:
    found = states_of(performance={"schedule": [[0, "clear"], [60, "fog"], [70, "clear"]]})
    times_s = make_frames(3000).times_s
    assert np.array_equal(found == 1, (times_s > 60 - 1e-6) & (times_s < 70 - 1e-6))
    plain, forced = states_of(), states_of(performance={"schedule": [[60, "fog"], [70, None]]})
    assert np.all(forced[600:700] == 1) and 0 < plain[600:700].mean() < 1
    assert np.array_equal(np.delete(forced, slice(600, 700)), np.delete(plain, slice(600, 700)))


def test_cameras_share_one_chain_unless_each_has_its_own_whatever_the_others_do() -> None:
    assert np.array_equal(states_of("C0"), states_of("C1"))
    one, two = (states_of(camera, 60_000, performance={"scope": "per_camera"}) for camera in ("C0", "C1"))
    assert abs(np.corrcoef(one, two)[0, 1]) < 0.05
    for found in (one, two):
        assert abs(found.mean() - 1 / 3) < 0.02  # what the chain's columns make in the long run
    both = PerformanceStates(model(performance={"scope": "per_camera"}), Streams(1))
    both.at(make_frames(500, "C0"))
    assert np.array_equal(both.at(make_frames(500, "C1")), two[:500])


def test_states_are_shared_as_their_rates_of_leaving_or_if_left_for_ever_or_never_as_they_must_be():
    for matrix, shares in (
        ([[0.99, 0.05], [0.01, 0.95]], [5 / 6, 1 / 6]),  # left with 0.01 and with 0.05 a step: 5 to 1
        ([[0.5, 0.0], [0.5, 1.0]], [0, 1]),  # the second is never left
        ([[0.0, 1.0], [1.0, 0.0]], [0.5, 0.5]),
        (np.eye(2), []),  # the first state decides
    ):
        np.testing.assert_allclose(stationary_shares(np.array(matrix)), shares, atol=1e-12)
    # Jessen & Mohr (2023), eq. 9.1: 10.5/59, 19/59, 19/59, 10.5/59, by hand from its four columns.
    chain = load_detector("thesis")
    assert list(chain.stationary_shares) == ["excellent", "good", "bad", "terrible"]
    shares = list(chain.stationary_shares.values())
    np.testing.assert_allclose(shares, np.array([21, 38, 38, 21]) / 118, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.matrix_power(chain.transition_matrix, 100_000)[:, 0], shares)


@given(weights=st.integers(1, 6).flatmap(lambda n: arrays(float, (n, n), elements=st.floats(1e-3, 1))))
def test_a_transition_leaves_the_shares_as_they_are(weights):
    matrix = weights / weights.sum(axis=0)
    shares = stationary_shares(matrix)
    np.testing.assert_allclose(matrix @ shares, shares, atol=1e-9)
    assert shares.sum() == pytest.approx(1)
    np.testing.assert_allclose(np.linalg.matrix_power(matrix, 10_000) @ np.eye(len(shares))[0], shares, atol=1e-6)
