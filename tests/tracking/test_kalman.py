"""The Kalman filter of coordinates with rates, and intervals of means."""

import numpy as np
import pytest

from modsim3d.core.text import number
from modsim3d.tracking.detector_seeds import Spread
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
    # A place that walks grows uncertain with time.
    assert values(motion(10, 0, 4, 0, 0).predicted(2.0, 0.0, 3.0)) == [10, 0, 4 + 9 * 2, 0, 0]


def test_two_short_predictions_are_one_long_one_and_what_the_future_did_not_measure_changes_nothing():
    start = motion(10, 2, 4, 1, 1)
    twice = start.predicted(0.3, 3.0, 0.5).predicted(1.1, 3.0, 0.5)
    np.testing.assert_allclose(values(twice), values(start.predicted(1.4, 3.0, 0.5)))
    later = start.predicted(2.0, 3.0)
    np.testing.assert_allclose(values(start.smoothed(later, later, 2.0)), values(start), rtol=1e-12)


def test_half_an_interval_is_the_quantile_of_students_t_times_the_standard_error() -> None:
    """Tables have 12.7062 for 1, 4.30265 for 2 and 2.77645 for 4 degrees of freedom at 97.5 %."""
    half = 2.77645 * (2.5 / 5) ** 0.5
    assert Spread((0.0, 2.0)).interval == pytest.approx((1 - 12.7062, 1 + 12.7062), rel=1e-5)
    assert Spread(tuple(range(5))).interval == pytest.approx((2 - half, 2 + half), abs=1e-5)
    spread = Spread((1.0, None, 2.0, 3.0))
    assert (spread.mean, spread.deviation) == (2.0, 1.0)
    assert spread.interval == pytest.approx((2 - 4.30265 / 3**0.5, 2 + 4.30265 / 3**0.5), abs=1e-5)
    assert Spread((1.0, 3.0)).deviation == pytest.approx(2**0.5)


def test_one_value_and_equal_and_infinite_values_have_no_interval() -> None:
    """A share of 1 in ten runs says nothing of how far the next one may be off."""
    for values in ((), (3.0,), (None,), (1.0,) * 19, (0.1 + 0.2, 0.3, 0.3), (0.5, 0.5), (1.0, np.inf)):
        assert Spread(values).interval is None, values
    assert (Spread((None,)).mean, Spread((1.0,)).deviation) == (None, None)
    spread = Spread((1.0, np.inf, None))
    assert (spread.mean, spread.deviation) == (np.inf, None) and number(spread.mean, 1) == "∞"
