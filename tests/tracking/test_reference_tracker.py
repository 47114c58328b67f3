"""The reference tracker, and the Kalman filter of coordinates with rates."""

from dataclasses import replace

import numpy as np
import pytest

from modsim3d.core.boxes import centres, corner_form
from modsim3d.tracking.kalman import MotionEstimates
from modsim3d.tracking.trackers.interface import CameraFacts, SensedFrame
from modsim3d.tracking.trackers.reference import ReferenceTracker

CAMERA = CameraFacts("C0", (4000, 3000), 10.0, ("boat", "ship"))
TRACKER = ReferenceTracker(
    **{"noise_share": 0.0, "noise_x_px": 2.0, "noise_y_px": 2.0, "velocity_change_px_s": 1.0, "first_speed_px_s": 30.0},
    **{"gate_probability": 0.9999, "start_confidence": 0.4, "confirm_hits": 2, "lost_s": 1.0, "coast_s": 0.5},
)


def sensed(time_s, places, *, size=(40.0, 20.0), confidence=0.8, label=0):
    """A frame with boxes of one size around places."""
    count = len(places)
    boxes = np.column_stack([np.reshape(places, (count, 2)), np.tile(size, (count, 1))])
    return SensedFrame(time_s, corner_form(boxes), np.full(count, label), np.full(count, confidence))


def straight(times_s, starts, velocities):
    starts, velocities = np.array(starts, dtype=float), np.array(velocities, dtype=float)
    return [sensed(float(time_s), starts + velocities * time_s) for time_s in times_s]


def one_vessel(count):
    """Ten frames a second of a vessel that begins at 100, 200 and makes 30 px/s to the right."""
    return straight(np.arange(count) / 10, [[100, 200]], [[30, 0]])


def followed(frames, **settings):
    return list(TRACKER.model_copy(update=settings).follow(frames, CAMERA))


def numbers(answers):
    return [sorted(answer.track.tolist()) for answer in answers]


def without(frames, *missing):
    return [sensed(frame.time_s, []) if index in missing else frame for index, frame in enumerate(frames)]


def test_two_frames_are_those_of_the_hand():
    # A centre at 100, 104 one second later: predicted 100 with variance 4 + 30 ** 2 + 1 / 3, measured with variance 4.
    answer = followed(straight([0.0, 1.0], [[100, 200]], [[4, 0]]))[1]
    before = 4 + 900 + 1 / 3
    gain = before / (before + 4)
    np.testing.assert_allclose(centres(answer.boxes_px), [[100 + gain * 4, 200]])
    np.testing.assert_allclose(answer.covariance_px2, [np.eye(2) * before * 4 / (before + 4)])
    assert answer.track.tolist() == [0]


def test_a_track_is_reported_from_its_last_confirming_detection_on_and_a_new_one_may_miss_one_frame_and_not_two():
    frames = one_vessel(6)
    assert numbers(followed(frames, confirm_hits=3)) == [[], [], [0], [0], [0], [0]]
    assert numbers(followed(without(frames, 1), confirm_hits=3)) == [[], [], [], [0], [0], [0]]
    assert numbers(followed(without(frames, 1, 2), confirm_hits=3)) == [[], [], [], [], [], [1]]


def test_crossing_vessels_keep_their_tracks():
    answers = followed(straight(np.arange(40) / 10, [[100, 200], [500, 220]], [[100, 0], [-100, 0]]))[1:]
    for track in range(2):
        first, last = (answers[index].boxes_px[answers[index].track == track] for index in (0, -1))
        assert len(first) == len(last) == 1
        assert abs(abs(centres(last)[0, 0] - centres(first)[0, 0]) - 380) < 5
    assert numbers(answers) == [[0, 1]] * 39


def test_of_the_pairs_in_the_gates_the_likeliest_are_taken_together():
    frames = straight(np.arange(10) / 10, [[100, 200], [112, 200]], [[30, 0], [30, 0]])
    last = followed(frames, noise_x_px=10.0, noise_y_px=10.0)[-1]
    for track, x_px in enumerate((127, 139)):
        np.testing.assert_allclose(centres(last.boxes_px[last.track == track]), [[x_px, 200]], atol=5)


def test_a_track_coasts_for_its_time_where_it_should_be_and_ends_after_its_own():
    frames = one_vessel(40)
    missed = followed(without(frames, 10))
    assert numbers(missed)[1:] == [[0]] * 39
    np.testing.assert_allclose(centres(missed[10].boxes_px), [[130, 200]], atol=1)
    short, long = followed(without(frames, *range(10, 19))), followed(without(frames, *range(10, 20)))
    assert numbers(short) == [[]] + [[0]] * 14 + [[]] * 4 + [[0]] * 21  # seen at 0.9 s, and at 1.9 s again
    assert numbers(long)[19:22] == [[], [], [1]]  # seen at 2.0 s again


def test_a_track_coasts_as_long_whatever_the_last_bits_of_times_since_1970_are():
    for begin in range(20):
        times_s = 1_700_000_000 + np.arange(begin, begin + 5) * 0.1 - 1_700_000_000
        frames = without(straight(times_s, [[100, 200]], [[0, 0]]), 2, 3, 4)
        assert numbers(followed(frames, coast_s=0.2)) == [[], [0], [0], [0], []]


def test_times_need_not_be_regular():
    times_s = np.cumsum(np.random.default_rng(1).uniform(0.02, 0.5, 60))
    answers = followed(straight(times_s, [[100, 200], [100, 300]], [[60, 5], [40, -5]]))
    assert numbers(answers)[1:] == [[0, 1]] * 59
    last_px = np.sort(centres(answers[-1].boxes_px)[:, 0])
    np.testing.assert_allclose(last_px, 100 + np.array([40, 60]) * times_s[-1], atol=1)


def test_frames_without_detections_have_no_tracks():
    assert numbers(followed([sensed(time_s, []) for time_s in (0.0, 0.1, 0.2)])) == [[], [], []]
    answers = followed(without(one_vessel(30), *range(5), *range(20, 30)))
    assert numbers(answers) == [[]] * 6 + [[0]] * 19 + [[]] * 5 and followed([]) == []


def test_unsure_detections_continue_a_track_and_start_none():
    frames = one_vessel(10)
    unsure = [replace(frame, confidence=np.full(1, 0.3)) for frame in frames]
    assert numbers(followed(unsure)) == [[]] * 10
    assert numbers(followed(frames[:3] + unsure[3:])) == [[]] + [[0]] * 9


def test_the_order_of_detections_changes_nothing():
    rng = np.random.default_rng(2)
    frames = []
    for step in range(40):
        places = np.array([[100, 200], [300, 220], [500, 240], [700, 800]]) + step * np.array([8, 1])
        frames.append(sensed(step / 10, places + rng.normal(0, 2, (4, 2))))
    shuffled = [replace(frame, boxes_px=frame.boxes_px[rng.permutation(4)]) for frame in frames]
    same = {}
    for one, other in zip(followed(frames), followed(shuffled), strict=True):
        a, b = (np.lexsort(answer.boxes_px.T) for answer in (one, other))
        np.testing.assert_allclose(one.boxes_px[a], other.boxes_px[b], rtol=0, atol=1e-9)
        pairs = zip(one.track[a].tolist(), other.track[b].tolist(), strict=True)
        assert all(same.setdefault(first, second) == second for first, second in pairs)
    assert len(same) == 4


def test_a_track_has_the_label_with_the_most_confidence():
    labelled = zip(one_vessel(5), [0, 1, 1, 1, 0], strict=True)
    mixed = [replace(frame, label=np.array([label])) for frame, label in labelled]
    assert [answer.label.tolist() for answer in followed(mixed)] == [[], [0], [1], [1], [1]]


def test_boxes_end_at_the_edge_of_the_image():
    seen = straight(np.arange(4) / 10, [[3960, 200]], [[100, 0]])
    answers = followed([*seen, sensed(0.5, []), sensed(0.8, [])])
    assert max(answer.boxes_px[:, 2].max(initial=0) for answer in answers) == 4000
    assert numbers(answers)[-1] == []


def test_the_filter_is_as_uncertain_as_it_is_wrong():
    rng, vessels, steps = np.random.default_rng(3), 400, 15
    tracker = TRACKER.model_copy(update={"lost_s": 9.0, "gate_probability": 1 - 1e-12})
    place = np.stack(np.meshgrid(np.arange(20), np.arange(20)), -1).reshape(-1, 2) * 2000.0 + 1000
    camera = replace(CAMERA, image_size_px=(40000, 40000))
    velocity = rng.normal(0, 30, (vessels, 2))
    frames, places, time_s = [], [], 0.0
    for _ in range(steps):
        frames.append(sensed(time_s, place + rng.normal(0, 2, (vessels, 2))))
        places.append(place)
        step_s = float(rng.uniform(0.2, 1.5))
        # Exact samples of white-noise acceleration over the step.
        first, second = rng.normal(0, 1, (2, vessels, 2))
        place = place + velocity * step_s + step_s**1.5 * (first / 2 + second / np.sqrt(12))
        velocity, time_s = velocity + first * np.sqrt(step_s), time_s + step_s
    answers = list(tracker.follow(frames, camera))
    for answer, true in zip(answers[1:], places[1:], strict=True):
        assert answer.track.tolist() == list(range(vessels))
        error = centres(answer.boxes_px) - true
        nees = np.einsum("ki,kij,kj->k", error, np.linalg.inv(answer.covariance_px2), error)
        assert abs(nees.mean() - 2) < 4 * 2 / np.sqrt(vessels)  # chi-square of 2 has a standard deviation of 2
    last_px2 = answers[-1].covariance_px2
    assert last_px2[0, 0, 0] == pytest.approx(last_px2[-1, 1, 1])


def motion(*values):
    return MotionEstimates(*(np.array([value], dtype=float) for value in values))


def values(found):
    return [float(each[0]) for each in vars(found).values()]


def test_a_step_is_that_of_the_hand():
    # place 10, rate 2, variances 4, 1, 1. After 2 s with a change of the rate of 3 a second (variance 9):
    # place 10 + 2 * 2; variance 4 + 2 * 2 * 1 + 4 * 1 + 9 * 8 / 3; mixed 1 + 2 * 1 + 9 * 4 / 2; rate 1 + 9 * 2.
    predicted = motion(10, 2, 4, 1, 1).predicted(2.0, 3.0)
    assert values(predicted) == [14, 2, 36, 21, 19]
    # Measured at 19 with variance 9: total 45, gains 36 / 45 and 21 / 45, surprise 5.
    corrected = predicted.corrected(np.array([19.0]), np.array([9.0]))
    expected = [14 + 0.8 * 5, 2 + 21 / 45 * 5, 36 * 9 / 45, 21 * 9 / 45, 19 - 21 * 21 / 45]
    np.testing.assert_allclose(values(corrected), expected)
    # A place that walks grows uncertain with time.
    assert values(motion(10, 0, 4, 0, 0).predicted(2.0, 0.0, 3.0)) == [10, 0, 4 + 9 * 2, 0, 0]


def test_two_short_predictions_are_one_long_one_and_what_the_future_did_not_measure_changes_nothing():
    start = motion(10, 2, 4, 1, 1)
    twice = start.predicted(0.3, 3.0, 0.5).predicted(1.1, 3.0, 0.5)
    np.testing.assert_allclose(values(twice), values(start.predicted(1.4, 3.0, 0.5)))
    later = start.predicted(2.0, 3.0)
    np.testing.assert_allclose(values(start.smoothed(later, later, 2.0)), values(start), rtol=1e-12)
