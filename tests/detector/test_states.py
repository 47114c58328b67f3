from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from modsim3d.core.errors import ModsimError
from modsim3d.core.random_streams import Purpose, Streams
from modsim3d.detector.classification import StateSequence
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.model import DetectorModel
from tests.detector.detector_builders import detector_data, make_frames


def sequence(model: DetectorModel, seed: int = 1) -> StateSequence:
    return StateSequence(model, Streams(seed))


def model(**changes: object) -> DetectorModel:
    return parse_detector(detector_data(**changes))


def test_the_first_step_is_in_the_initial_state() -> None:
    for seed in range(20):
        assert sequence(model(initial_state="fog"), seed).at(make_frames(1)).tolist() == [1]


def test_transitions_happen_as_often_as_the_columns_say() -> None:
    states = sequence(model()).at(make_frames(100_000))
    for now, column in enumerate([[0.9, 0.1], [0.2, 0.8]]):
        following = states[1:][states[:-1] == now]
        error = 4 * np.sqrt(0.9 * 0.1 / len(following)) if now == 0 else 4 * np.sqrt(0.16 / len(following))
        assert abs(np.mean(following == 0) - column[0]) < error


@given(starts=st.lists(st.integers(0, 9000), min_size=1, max_size=5))
def test_states_are_the_same_in_whatever_order_they_are_asked_for(starts: list[int]) -> None:
    whole, scattered = sequence(model()).at(make_frames(9010)), sequence(model())
    for start in starts:
        part = scattered.at(make_frames(10, camera="other", first_step=start))
        assert np.array_equal(part, whole[start : start + 10])


def test_states_hold_between_multiples_of_the_interval() -> None:
    each_step = sequence(model()).at(make_frames(200))
    slower = sequence(model(transition_interval_s=0.3)).at(make_frames(600, time_step_s=0.1))
    assert np.array_equal(slower, np.repeat(each_step, 3))


def test_a_transition_is_due_at_a_multiple_of_the_interval_in_spite_of_rounding() -> None:
    times_s = np.array([round(0.2 * k, 1) for k in range(2000)])
    assert np.any(np.floor(times_s / 0.2) < np.arange(2000))  # 0.6 / 0.2 is 2.9999999999999996
    frames = dataclasses.replace(make_frames(2000), times_s=times_s)
    each_step = sequence(model()).at(frames)
    assert np.array_equal(sequence(model(transition_interval_s=0.2)).at(frames), each_step)


def test_transition_k_uses_the_kth_number_of_the_stream() -> None:
    chain = model()
    uniforms = Streams(5).uniforms(Purpose.STATE, first=0, count=5000)[:, 0]
    state, slow = 0, [0]
    for u in uniforms[1:]:
        state = 0 if u < chain.transition_matrix[0, state] else 1
        slow.append(state)
    assert sequence(chain, seed=5).at(make_frames(5000)).tolist() == slow


def test_the_frame_rate_does_not_change_the_weather() -> None:
    fine = sequence(model(transition_interval_s=1.0)).at(make_frames(2000, time_step_s=0.05))
    coarse = sequence(model(transition_interval_s=1.0)).at(make_frames(200, time_step_s=0.5))
    assert np.array_equal(fine[::10], coarse)
    assert 0 < coarse.mean() < 1


def test_an_interval_far_too_short_is_refused() -> None:
    with pytest.raises(ModsimError, match="longer transition_interval_s than 1e-09"):
        sequence(model(transition_interval_s=1e-9)).at(make_frames(100))


def test_no_frames_have_no_states() -> None:
    assert sequence(model()).at(make_frames(0)).shape == (0,)
