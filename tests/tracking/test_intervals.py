"""Intervals of means."""

import numpy as np
import pytest

from modsim3d.core.text import number
from modsim3d.tracking.detector_seeds import Spread


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


def test_a_spread_with_an_infinite_value_is_infinite() -> None:
    spread = Spread((1.0, np.inf, None))
    assert (spread.mean, spread.deviation) == (np.inf, None) and number(spread.mean, 1) == "∞"
