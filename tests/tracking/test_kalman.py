"""The Kalman filter of coordinates with rates."""

import numpy as np

from modsim3d.tracking.kalman import MotionEstimates


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


def test_a_place_that_walks_grows_uncertain_with_time():
    assert values(motion(10, 0, 4, 0, 0).predicted(2.0, 0.0, 3.0)) == [10, 0, 4 + 9 * 2, 0, 0]


def test_two_short_predictions_are_one_long_one():
    start = motion(10, 2, 4, 1, 1)
    twice = start.predicted(0.3, 3.0, 0.5).predicted(1.1, 3.0, 0.5)
    np.testing.assert_allclose(values(twice), values(start.predicted(1.4, 3.0, 0.5)))


def test_what_the_future_did_not_measure_changes_nothing():
    start = motion(10, 2, 4, 1, 1)
    later = start.predicted(2.0, 3.0)
    np.testing.assert_allclose(values(start.smoothed(later, later, 2.0)), values(start), rtol=1e-12)
