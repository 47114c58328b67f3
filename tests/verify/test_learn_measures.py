"""Tail probabilities, intervals and smallest noticeable changes of measured numbers."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from modsim3d.verify import measures
from modsim3d.verify.independence_checks import Strongest, SumDrift
from modsim3d.verify.measures import AMOUNT, CORRELATION, SHARE, DiscoveryRate, Estimate, Exact, ImageRate, Rate
from modsim3d.verify.parameters import DIFFERS, FALLS_SHORT, OBEYS, UNTESTED, Law, Occupancy, Parameter, judge
from modsim3d.verify.verify_run import conclusion


def test_intervals_are_clopper_and_pearsons_and_garwoods_and_wider_for_fewer_effective_trials():
    # 10 of 100 at 95 %: 0.0490, 0.1762, e.g. Newcombe (1998), Statistics in Medicine 17, 857-872.
    np.testing.assert_allclose(Rate(10, 100, 0.1).interval(0.05), (0.0490, 0.1762), atol=5e-5)
    # 10 events at 95 %: 4.795, 18.390, Garwood (1936), Biometrika 28, 437-442.
    np.testing.assert_allclose(measures.poisson_interval(10, 0.05), (4.795, 18.390), atol=5e-4)
    low, high = ImageRate(false=40, images=100, asked=0.4).interval(0.05)
    np.testing.assert_allclose((low * 100, high * 100), measures.poisson_interval(40, 0.05))
    assert ImageRate(40, 100, 0.4).p_value() == 1 and ImageRate(80, 100, 0.4).p_value() < 1e-6
    alone, together = Rate(100, 1000, 0.1).interval(0.01), Rate(100, 1000, 0.1, inflation=4).interval(0.01)
    assert together[1] - together[0] == pytest.approx(2 * (alone[1] - alone[0]), rel=0.05)


@given(st.integers(0, 200), st.integers(1, 200), st.floats(0.01, 0.99), st.floats(1e-4, 0.2))
def test_a_rate_fails_just_where_its_interval_leaves_the_asked_value_out(hits, more, asked, alpha):
    measure = Rate(hits, hits + more, asked)
    low, high = measure.interval(alpha)
    if min(abs(asked - low), abs(asked - high)) > 1e-9:
        assert (measure.p_value() < alpha) == (not low <= asked <= high)


@given(st.floats(-4, 4), st.floats(-0.5, 0.5) | st.floats(1.1, 9) | st.floats(-9, -1.1), st.floats(1e-4, 0.2))
def test_an_estimate_fails_just_where_its_interval_leaves_the_asked_value_out(z, skewness, alpha):
    measure = Estimate(measured=5 + z, asked=5.0, error=1.0, count=10, skewness=skewness)
    low, high = measure.interval(alpha)
    if min(abs(5 - low), abs(5 - high)) > 1e-6:
        assert (measure.p_value() < alpha) == (not low <= 5 <= high)


@pytest.mark.parametrize("trials, asked", [(400, 0.133), (2000, 0.0085), (50, 0.99), (3000, 0.381)])
def test_a_rate_notices_its_smallest_change_nine_times_in_ten(trials, asked):
    alpha = 1e-4
    below, above = Rate(0, trials, asked).noticed(alpha)
    rejected = np.array([Rate(k, trials, asked).p_value() < alpha for k in range(trials + 1)])
    for change, rate in ((above, asked + (above or 0)), (below, asked - (below or 0))):
        if change is not None:
            assert stats.binom.pmf(np.arange(trials + 1), trials, rate)[rejected].sum() == pytest.approx(0.9, abs=0.01)


def test_a_false_discovery_rate_notices_its_smallest_change_nine_times_in_ten():
    alpha, true, asked, counts = 1e-4, 1500, 0.089, np.arange(400)
    expected = true * asked / (1 - asked)
    below, above = DiscoveryRate(0, true, expected).noticed(alpha)
    rejected = np.array([DiscoveryRate(k, true, expected).p_value() < alpha for k in counts])
    for rate in (asked - below, asked + above):
        assert stats.poisson.pmf(counts, true * rate / (1 - rate))[rejected].sum() == pytest.approx(0.9, abs=0.01)


@given(st.integers(20, 2000), st.floats(-3.5, 4.5))
def test_skewed_tails_are_exact_for_a_sample_variance(n, z):
    # The sum of n squared normal numbers has mean n, variance 2n and skewness √(8/n).
    below, above = measures.skewed_tails(z, (8 / n) ** 0.5)
    expected = stats.chi2.sf(n + z * (2 * n) ** 0.5, n)
    assert above == pytest.approx(expected, rel=1e-6, abs=1e-12) and below + above == pytest.approx(1)


@given(st.tuples(st.floats(1e-6, 0.4), st.floats(-0.8, 0.8)) | st.tuples(st.floats(1e-6, 0.3), st.floats(1.01, 30)))
def test_quantile_undoes_the_tail_also_of_rare_events(case):
    tail, skewness = case
    assert measures.skewed_tails(measures.skewed_quantile(tail, skewness), skewness)[1] == pytest.approx(tail, rel=1e-6)
    if skewness > 1:  # that none happens is likelier than any such tail
        assert measures.skewed_quantile(tail, -skewness) == math.inf


@pytest.mark.parametrize("mean", [0.9, 0.05, 1e-6])
def test_tails_of_rare_events_are_those_of_a_poisson_number(mean):
    skewness = mean**-0.5
    for count in range(1, 5):
        below, above = measures.skewed_tails((count - mean) * skewness, skewness)
        assert above == pytest.approx(stats.poisson.sf(count - 1, mean), rel=1e-6)
        assert below == pytest.approx(stats.poisson.cdf(count, mean), rel=1e-6)
    for z in (-mean / mean**0.5, -mean / mean**0.5 - 1e-3):  # none, and as much as that by rounding
        assert measures.skewed_tails(z, skewness)[0] == pytest.approx(math.exp(-mean))
        assert measures.skewed_tails(-z, -skewness)[1] == pytest.approx(math.exp(-mean))


def test_a_law_is_held_against_its_quantiles():
    rng = np.random.default_rng(1)
    quantiles = np.array([0.2, 0.2, 0.5, 0.9, 1.0])
    values = np.interp(rng.random((200, 300)), np.linspace(0, 1, 5), quantiles)
    assert 0 <= np.mean([Law.of(each, quantiles).p_value() < 0.05 for each in values]) < 0.1
    assert Law.of(rng.random(300), quantiles).p_value() < 1e-4


def test_tests_share_the_overall_level():
    some = [Parameter(f"p{i}", "group", Rate(10, 100, 0.1)) for i in range(49)]
    off = Parameter("off", "group", Rate(35, 100, 0.1))
    verification = judge([*some, off, Parameter("unseen", "group", None, 0.3)])
    assert verification.alpha == pytest.approx(0.01 / 50)
    assert [v.verdict for v in verification.verdicts[-2:]] == [DIFFERS, UNTESTED] and not verification.obeys
    assert verification.cause.parameter is off


@pytest.mark.parametrize(
    ("measure", "interval"),
    [
        (Estimate(0.004, 0.006, 0.01, 300, possible=SHARE), "[0, 0.0"),
        (Estimate(0.944, 0.925, 0.04, 300, -0.3, possible=SHARE), "1]"),
        (Estimate(0.003, 0.006, 0.01, 300, 5.0, possible=SHARE), "1]"),  # ∞ without what is possible
        (Estimate(0.95, 0.8, 0.09, 90, possible=CORRELATION), "1]"),
        (Estimate(1.02, 1.0, 1.2, 40, possible=AMOUNT), "[0, "),
        (Estimate(1.3, 0.7, 0.2, 90, possible=CORRELATION), "1]"),
        (SumDrift(0.01, 100.0), "[0, "),
        (Rate(1, 40, 0.05), "[0"),
        (ImageRate(0, 30, 0.1), "[0, "),
    ],
)
def test_intervals_and_what_is_noticed_are_cut_to_what_is_possible(measure: measures.Measure, interval: str) -> None:
    (verdict,) = judge([Parameter("p", "group", measure)]).verdicts
    low, high = getattr(measure, "possible", AMOUNT)
    assert verdict.interval is not None and verdict.measured is not None
    assert low <= verdict.interval[0] <= verdict.measured <= verdict.interval[1] <= high
    assert interval in f"[{verdict.interval[0]:g}, {verdict.interval[1]:g}]"
    below, above = verdict.noticed
    assert below is None or measure.asked - below >= low - 1e-6
    assert above is None or measure.asked + above <= high + 1e-6


def test_what_no_violation_would_have_changed_is_too_little_seen_and_what_was_noticed_or_could_be_is_not():
    even = np.full(400, 1 / 400)
    for measure, verdict in (
        (Rate(1, 2, 0.92), UNTESTED),
        (Rate(1, 1, 0.7), UNTESTED),
        (Rate(45, 50, 0.92), OBEYS),
        (Rate(0, 2, 0.999), DIFFERS),  # two misses where one in a thousand was asked for
        (Estimate(0.9, 0.5, 0.4, 12, possible=SHARE), UNTESTED),
        (Estimate(0.9, 0.0, 0.2, 12, possible=CORRELATION), DIFFERS),
        (Strongest(0.3, 0.0, 0.5, 9, trials=20, possible=CORRELATION), UNTESTED),
        (Occupancy(1, np.array([0.3, 0.7])), UNTESTED),
        (Occupancy(0, even), DIFFERS),
        (Occupancy(200, even), OBEYS),
        (Exact(0, 0), UNTESTED),
        (Exact(0, 3), OBEYS),
        (Exact(1, 3), DIFFERS),
        (Law(0.4, 4), UNTESTED),
    ):
        found = judge([Parameter("p", "group", measure)])
        assert [each.verdict for each in found.verdicts] == [verdict], measure
        nothing = "The run obeys its detector file: nothing in 0 tests speaks against it."
        assert (conclusion(found) == nothing) == (verdict == UNTESTED)
        assert found.obeys == (verdict != DIFFERS)


def test_only_an_entry_of_the_file_is_a_cause_and_a_rule_that_is_obeyed_may_fall_short_of_what_is_asked():
    follows = Parameter("overall", "group", Rate(900, 1000, 0.1), in_file=False)
    entry = Parameter("entry", "group", Rate(35, 100, 0.1))
    assert judge([follows, entry]).cause.parameter is entry and judge([follows]).cause.parameter is follows
    rule = Parameter("fdr", "group", DiscoveryRate(0, 5000, 0.0), 0.089, promised=0.089)
    fine = Parameter("fdr", "group", DiscoveryRate(480, 5000, 490), 0.089, promised=0.089)
    assert [v.verdict for v in judge([rule, fine]).verdicts] == [FALLS_SHORT, OBEYS] and judge([rule]).obeys
