"""Sums over pairs of residuals equal those of plain loops, and have the moments that they say."""

import itertools

import numpy as np
import pytest

from modsim3d.verify.independence_checks import group_sums, lag_sums

RNG = np.random.default_rng(1)


def columns(rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return RNG.normal(size=(rows, 2)), RNG.uniform(0.1, 2, rows), RNG.normal(size=(rows, 2))


def test_sums_over_groups_are_those_of_a_loop() -> None:
    values, variance, third = columns(30)
    group = RNG.integers(0, 5, 30) * 7
    pairs = [(i, j) for i, j in itertools.combinations(range(30), 2) if group[i] == group[j]]
    triples = [c for c in itertools.combinations(range(30), 3) if len({int(group[i]) for i in c}) == 1]
    sums = group_sums(values, variance, third, group)
    assert sums.product[0] == pytest.approx(sum(values[i] @ values[j] for i, j in pairs))
    assert sums.spread[0] == pytest.approx(2 * sum((variance[i] * variance[j]) ** 0.5 for i, j in pairs))
    assert sums.variance[0] == pytest.approx(2 * sum(variance[i] * variance[j] for i, j in pairs))
    of_triples = 6 * 2 * sum(variance[i] * variance[j] * variance[k] for i, j, k in triples)
    assert sums.third[0] == pytest.approx(sum(third[i] @ third[j] for i, j in pairs) + of_triples)


def test_sums_over_lags_are_those_of_a_loop() -> None:
    values, variance, third = columns(40)
    place = RNG.permutation(60)[:40]  # three series with gaps, their rows in any order
    series, step = place // 20, 3 + 2 * (place % 20)
    sums = lag_sums(values, variance, third, series, step)
    for lag in range(len(sums.product)):
        pairs = [(i, j) for i in range(40) for j in range(40) if series[i] == series[j] and step[i] - step[j] == lag]
        assert sums.product[lag] == pytest.approx(sum(values[i] @ values[j] for i, j in pairs), abs=1e-10)
        expected = 2 * sum((variance[i] * variance[j]) ** 0.5 for i, j in pairs)
        assert sums.spread[lag] == pytest.approx(expected, abs=1e-10)
        assert sums.variance[lag] == pytest.approx(2 * sum(variance[i] * variance[j] for i, j in pairs), abs=1e-10)
        assert sums.third[lag] == pytest.approx(sum(third[i] @ third[j] for i, j in pairs), abs=1e-10)
    assert len(sums.product) > 30


def test_cumulants_of_a_sum_over_a_group_are_those_of_all_outcomes() -> None:
    # Four rare events: every one of the sixteen outcomes with its probability.
    p = np.array([0.1, 0.3, 0.5, 0.05])
    variance = p * (1 - p)
    third, moments = (variance * (1 - 2 * p))[:, None], np.zeros(4)
    for outcome in itertools.product((0, 1), repeat=4):
        happened = np.array(outcome)
        chance = np.where(happened == 1, p, 1 - p).prod()
        sums = group_sums((happened - p)[:, None], variance, third, np.zeros(4, dtype=np.int64))
        moments += chance * sums.product[0] ** np.arange(4)
    assert moments == pytest.approx([1, 0, sums.variance[0], sums.third[0]], abs=1e-12)
