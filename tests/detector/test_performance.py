"""Forced states and chains of their own."""

from __future__ import annotations

import numpy as np

from modsim3d.core.random_streams import Streams
from modsim3d.detector.classification import PerformanceStates
from modsim3d.detector.file.reading import parse_detector
from tests.detector.detector_builders import detector_data, make_frames


def states(camera: str = "C0", frames: int = 3000, **changes: object) -> np.ndarray:
    return PerformanceStates(parse_detector(detector_data(**changes)), Streams(1)).at(make_frames(frames, camera))


def test_a_schedule_forces_states_from_its_times_on() -> None:
    found = states(performance={"schedule": [[0, "clear"], [60, "fog"], [70, "clear"]]})
    times_s = make_frames(3000).times_s
    assert np.array_equal(found == 1, (times_s > 60 - 1e-6) & (times_s < 70 - 1e-6))


def test_the_chain_goes_on_unseen_where_a_state_is_forced() -> None:
    plain, forced = states(), states(performance={"schedule": [[60, "fog"], [70, None]]})
    assert np.all(forced[600:700] == 1)
    assert np.array_equal(np.delete(forced, slice(600, 700)), np.delete(plain, slice(600, 700)))
    assert 0 < plain[600:700].mean() < 1


def test_cameras_share_one_chain_unless_each_is_to_have_its_own() -> None:
    assert np.array_equal(states("C0"), states("C1"))
    one, two = (states(camera, 60_000, performance={"scope": "per_camera"}) for camera in ("C0", "C1"))
    assert abs(np.corrcoef(one, two)[0, 1]) < 0.05
    for found in (one, two):
        assert abs(found.mean() - 1 / 3) < 0.02  # what the chain's columns make in the long run


def test_a_camera_with_its_own_chain_is_the_same_whatever_the_others_do() -> None:
    model = parse_detector(detector_data(performance={"scope": "per_camera"}))
    both = PerformanceStates(model, Streams(1))
    both.at(make_frames(500, "C0"))
    alone = PerformanceStates(model, Streams(1)).at(make_frames(500, "C1"))
    assert np.array_equal(both.at(make_frames(500, "C1")), alone)


def test_a_forced_state_is_due_in_spite_of_rounding() -> None:
    frames = make_frames(5, time_step_s=0.7)
    assert frames.times_s[3] < 2.1
    model = parse_detector(detector_data(performance={"schedule": [[0, "clear"], [2.1, "fog"]]}))
    assert PerformanceStates(model, Streams(1)).at(frames).tolist() == [0, 0, 0, 1, 1]
