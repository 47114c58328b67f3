"""Bounds of proportions and means: their definitions, their limits, and how often they err at the threshold."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, stats

from modsim3d.campaign.verdicts import bounds
from modsim3d.core.statistics import exact_bounds, t_bounds

ALPHA = 0.05


@given(st.integers(1, 400), st.data(), st.floats(0.005, 0.5))
def test_exact_bounds_are_where_the_binomial_tails_have_the_level(seeds, data, alpha):
    right = data.draw(st.integers(0, seeds))
    low, high = exact_bounds(right, seeds, alpha)
    assert low == 0 if right == 0 else math.isclose(stats.binom.sf(right - 1, seeds, low), alpha, rel_tol=1e-7)
    assert high == 1 if right == seeds else math.isclose(stats.binom.cdf(right, seeds, high), alpha, rel_tol=1e-7)


@given(st.floats(0.5, 0.999), st.floats(0.5, 0.99), st.integers(0, 3))
def test_the_needed_seeds_are_the_fewest_whose_exact_bound_reaches_the_share(share, confidence, failures):
    needed = bounds.clean_seeds(share, confidence, failures)
    assert exact_bounds(needed - failures, needed, 1 - confidence)[0] >= share - 1e-12
    if needed - 1 > failures:
        assert exact_bounds(needed - 1 - failures, needed - 1, 1 - confidence)[0] < share + 1e-12


def test_capitals_are_the_integral_of_the_likelihood_over_jeffreys_prior_and_the_sum_of_what_stakes_came_to():
    right = np.array([True, True, False, True])
    shares = np.sin(np.linspace(0, np.pi / 2, 200_001)) ** 2  # equally likely by beta(1/2, 1/2)
    expected = np.log(np.mean(shares**3 * (1 - shares))) - np.log(0.7**3 * 0.3)
    assert bounds.mixture_log_capital(right, 0.7)[-1] == pytest.approx(expected, abs=1e-5)
    values, mean = np.array([0.9, 0.2, 0.7]), 0.6
    weights = 1 / np.arange(1, len(bounds.STAKES) + 1)
    came_to = [np.prod([1 + stake * (value - mean) / mean for value in values]) for stake in bounds.STAKES]
    assert bounds.log_capital(values, mean)[-1] == pytest.approx(math.log(np.average(came_to, weights=weights)))


@settings(max_examples=50)
@given(st.lists(st.floats(0, 1), max_size=60))
def test_bounds_of_a_mean_lie_below_the_greatest_mean_so_far_mirror_each_other_and_only_close_in(values):
    values = np.array(values)
    low, high = bounds.betting_bounds(values, ALPHA)
    assert (low, high) == (0, 1) or len(values)
    assert 0 <= low <= np.max(np.cumsum(values) / np.arange(1, len(values) + 1), initial=0) + 1e-9
    mirrored = bounds.betting_bounds(1 - values, ALPHA)
    assert (1 - mirrored[1], 1 - mirrored[0]) == pytest.approx((low, high), abs=1e-8)
    earlier = bounds.betting_bounds(values[: len(values) // 2 + 1], ALPHA)
    assert low >= earlier[0] - 1e-9 and high <= earlier[1] + 1e-9


@settings(max_examples=50)
@given(st.lists(st.booleans(), max_size=60), st.floats(0.01, 0.3))
def test_bounds_of_a_share_exclude_what_the_capital_excludes(right, alpha):
    right = np.array(right, dtype=bool)
    low, high = bounds.mixture_bounds(right, alpha)
    shares = np.linspace(0.001, 0.999, 199)
    found = np.cumsum(right) / np.arange(1, len(right) + 1)
    for share in shares:
        excluded = bounds.mixture_log_capital(right, share) >= -math.log(alpha)
        assert (share < low - 1e-9) <= bool(np.any(excluded & (found > share)))
        assert (share > high + 1e-9) <= bool(np.any(excluded & (found < share)))
        assert not np.any(excluded) or share <= low + 1e-9 or share >= high - 1e-9


@pytest.mark.parametrize("stop", ["once", "sequential"])
@pytest.mark.parametrize("clean", [True, False])
def test_a_hundred_thousand_seeds_all_alike_give_finite_bounds(stop, clean):
    found = bounds.share_bounds(np.full(100_000, clean), 0.95, stop)
    low, high = (found.low, found.high) if clean else (1 - found.high, 1 - found.low)
    assert 1 - 2e-4 < low < 1 and high == 1


def test_a_mean_close_to_its_greatest_value_needs_as_many_seeds_as_it_says_and_ten_thousand_alike_have_finite_bounds():
    needed = bounds.perfect_seeds(0.99, 0.95)
    enough, fewer = (bounds.betting_bounds(np.ones(count), ALPHA)[0] for count in (needed, needed - 1))
    assert enough >= 0.99 > fewer and math.isinf(bounds.perfect_seeds(1.0, 0.95))
    for value in (0.0, 0.5, 1.0):
        low, high = bounds.betting_bounds(np.full(10_000, value), ALPHA)
        assert low <= value <= high and high - low < 0.05


def test_t_bounds_are_those_of_a_textbook_and_no_bound_says_anything_of_equal_values_or_one():
    # Student (1908): the additional hours of sleep by ten patients; two-sided 90 % as two one-sided 95 %
    hours = np.array([1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4])
    assert t_bounds(hours, 0.05) == pytest.approx((1.169, 3.491), abs=0.001)
    assert t_bounds(np.full(10, 0.1), 0.05) is None and t_bounds(np.array([1.0]), 0.05) is None
    assert bounds.skewed_bounds(np.full(10, 0.1), ALPHA) == bounds.skewed_bounds(np.array([1.0]), ALPHA) == -math.inf


def test_a_bound_gains_by_what_the_mean_lacks_to_the_best_value_twice_the_half_width_at_most():
    half = stats.t.ppf(1 - ALPHA, 399) * 0.2 / 20
    for lacks, widths in ((0.2, 1 + 1.5 * half / 0.2), (0.001, 2)):
        low = bounds.corrected_bounds(0.5, 0.2, 0.0, 400, ALPHA, 0.5 + lacks)
        assert low == pytest.approx(0.5 - widths * half)


LIMITS = (1.0, 1.5), (math.inf, 1.5), (0.0, 1.1)


@given(st.lists(st.floats(0, 0.9), min_size=3, max_size=40), st.floats(0.01, 0.3), st.sampled_from(LIMITS))
def test_a_bound_of_skewed_values_is_the_lesser_of_halls_cubic_and_of_a_skewness_by_the_spread(values, alpha, limit):
    greatest, variation = limit
    values = np.array(values) - (0 if greatest else 1)
    mean, deviation, count = values.mean(), values.std(ddof=1), len(values)
    if deviation < 1e-6:
        return
    wanted = stats.t.ppf(1 - alpha, count - 1) / math.sqrt(count)
    skewness = min(stats.skew(values), -bounds.SKEWNESS)

    def of_cubic(low):  # Hall (1992), equation for T = (mean − low)/deviation
        error = (mean - low) / deviation
        return error + skewness * error**2 / 3 + skewness**2 * error**3 / 27 + skewness / (6 * count) - wanted

    gain = variation * wanted * deviation / (greatest - mean)  # of values as skewed as the inverse Gaussian law
    error = wanted * (1 + min(gain, 1))
    expected = [mean - error * deviation, optimize.brentq(of_cubic, -1e4, 1e4)]
    assert float(bounds.skewed_bounds(values, alpha, greatest)) == pytest.approx(min(expected), rel=1e-5, abs=1e-5)


def test_a_bound_of_skewed_values_errs_as_often_as_it_may_where_t_errs_twice_as_often_and_has_no_unit():
    values = np.random.default_rng(5).gamma(2.0, 0.5, (20_000, 20))
    high = -bounds.skewed_bounds(-values, ALPHA, 0.0)
    half = stats.t.ppf(1 - ALPHA, 19) * values.std(axis=1, ddof=1) / math.sqrt(20)
    assert np.mean(values.mean(axis=1) + half <= 1) > 0.08
    assert np.mean(high <= 1) <= ALPHA + 3 * math.sqrt(ALPHA * (1 - ALPHA) / len(values))
    few = np.array([[0.2, 0.3, 0.9], [0.5, 0.4, 0.1]])
    assert bounds.skewed_bounds(1e6 * few, ALPHA, 1e6) == pytest.approx(1e6 * bounds.skewed_bounds(few, ALPHA, 1.0))


def test_bounds_that_contradict_each_other_stay_where_they_were_before():
    values = np.concatenate([np.ones(60), np.zeros(200)])
    found = bounds.mean_bounds(values, values, 0.95, "sequential", (0.0, 1.0))
    assert found.low <= found.high
    low, high = bounds.betting_bounds(values, ALPHA)
    assert low > high and found.low == low


@pytest.mark.parametrize("share", [0.99, 0.9, 0.5])
def test_a_sequence_of_a_share_errs_at_most_five_percent_however_often_it_is_looked_at(share):
    right = np.random.default_rng(1).random((400, 2_000)) < share
    ever = np.any(bounds.mixture_log_capital(right, share) >= -math.log(ALPHA), axis=1)
    assert ever.mean() <= ALPHA + 3 * math.sqrt(ALPHA * (1 - ALPHA) / len(ever))


def test_99_percent_need_299_clean_seeds_or_473_with_one_failure_and_looking_at_both_errs_more_than_five_percent():
    assert [bounds.clean_seeds(0.99, 0.95, failures) for failures in (0, 1)] == [299, 473]
    assert bounds.clean_seeds_sequential(0.99, 0.95) == 680
    assert (bounds.clean_seeds(0.01, 0.5), bounds.clean_seeds(0.01, 0.5, 1)) == (1, 2)
    right = np.random.default_rng(2).random((20_000, 473)) < 0.99
    met = [(~right[:, :size]).sum(axis=1) <= failures for size, failures in ((299, 0), (473, 1))]
    once, twice = met[0].mean(), (met[0] | met[1]).mean()
    assert once == pytest.approx(0.05, abs=0.005) and twice == pytest.approx(0.076, abs=0.006)


@pytest.mark.parametrize("draw", ["two-point", "beta"])
def test_a_sequence_of_a_mean_errs_at_most_five_percent_each_way(draw):
    rng, shape = np.random.default_rng(3), (300, 500)
    values = rng.beta(2.0, 0.5, shape) if draw == "beta" else np.where(rng.random(shape) < 0.9, 0.98, 0.0)
    mean = 0.8 if draw == "beta" else 0.9 * 0.98
    for above, threshold in ((values, mean), (1 - values, 1 - mean)):
        ever = np.any(bounds.log_capital(above, threshold) >= -math.log(ALPHA), axis=1)
        assert ever.mean() <= ALPHA + 3 * math.sqrt(ALPHA * (1 - ALPHA) / len(ever))
