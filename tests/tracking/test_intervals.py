"""Intervals of means."""

from __future__ import annotations

import numpy as np
import pytest

from modsim3d.core.text import number
from modsim3d.tracking.detector_seeds import Spread


def test_half_an_interval_is_the_quantile_of_students_t_times_the_standard_error() -> None:
    """Tables have 12.7062 for 1 and 2.77645 for 4 degrees of freedom at 97.5 %."""
    half = 2.77645 * (2.5 / 5) ** 0.5
    assert Spread((0.0, 2.0)).interval == pytest.approx((1 - 12.7062, 1 + 12.7062), rel=1e-5)
    assert Spread(tuple(range(5))).interval == pytest.approx((2 - half, 2 + half), abs=1e-5)


def test_one_value_has_no_interval() -> None:
    assert Spread((3.0,)).interval is None
    assert Spread(()).interval is None


def test_equal_and_infinite_values_have_no_interval() -> None:
    """A share of 1 in ten runs says nothing of how far the next one may be off."""
    assert Spread((1.0,) * 19).interval is None
    assert Spread((0.1 + 0.2, 0.3, 0.3)).interval is None
    assert Spread((1.0, np.inf)).interval is None


def test_a_spread_with_an_infinite_value_is_infinite_and_has_no_interval() -> None:
    spread = Spread((1.0, np.inf, None))
    assert (spread.mean, spread.deviation, spread.interval) == (np.inf, None, None)
    assert number(spread.mean, 1) == "∞"
    assert Spread((0.5, 0.5)).interval is None
