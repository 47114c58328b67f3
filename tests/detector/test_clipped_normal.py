"""Clipped normal numbers against integrals, differences and a general optimiser."""

import numpy as np
import pytest
from scipy import integrate, optimize, stats

from modsim3d.detector.confidence import clipped_laws, clipped_score, clipped_sums, fit_clipped

LAWS = [(0.6, 0.2, 0.2), (0.9, 0.3, 0.1), (0.1, 0.15, 0.3), (1.4, 0.5, 0.05), (-0.5, 0.4, 0.2), (0.5, 0.01, 0.2)]


@pytest.mark.parametrize(("mean", "std", "threshold"), LAWS)
def test_law_has_the_ends_and_the_moments_of_the_clipped_normal(mean, std, threshold):
    (nodes,), (probabilities,) = clipped_laws(np.array([mean]), std, threshold)
    normal = stats.norm(mean, std)
    assert (nodes[0], nodes[-1]) == (threshold, 1.0)
    assert probabilities[[0, -1]] == pytest.approx([normal.cdf(threshold), normal.sf(1)], rel=1e-12, abs=1e-300)
    assert probabilities.sum() == pytest.approx(1, abs=1e-12)
    for power in (1, 2, 3):
        inside = integrate.quad(lambda x: x**power * normal.pdf(x), threshold, 1, points=[np.clip(mean, threshold, 1)])  # noqa: B023
        exact = inside[0] + threshold**power * normal.cdf(threshold) + normal.sf(1)
        assert probabilities @ nodes**power == pytest.approx(exact, rel=1e-9)


def test_law_whose_numbers_all_lie_beyond_an_end_is_that_end():
    for mean, end in ((-5.0, 0), (7.0, -1)):  # fifty standard deviations away
        (nodes,), (probabilities,) = clipped_laws(np.array([mean]), 0.1, 0.2)
        assert len(nodes) == len(probabilities) and probabilities[end] == pytest.approx(1)
        assert probabilities.sum() == pytest.approx(1)
        assert ((nodes >= 0.2) & (nodes <= 1)).all()


def log_likelihood(values, mean, std, low, high):
    normal = stats.norm(mean, std)
    inside = np.where(values >= high, normal.logsf(high), normal.logpdf(values))
    return np.where(values <= low, normal.logcdf(low), inside).sum()


@pytest.mark.parametrize("high", [1.0, 0.9, 3.0])
@pytest.mark.parametrize(("mean", "std"), [(0.6, 0.2), (0.8, 0.4), (0.35, 0.3)])
def test_fit_is_the_greatest_likelihood_that_a_general_optimiser_finds(mean, std, high):
    values = np.clip(np.random.default_rng(3).normal(mean, std, 4000), 0.2, high)
    found = fit_clipped(clipped_sums(values, 0.2, high).sum(axis=0)[None], 0.2, high)
    best = optimize.minimize(
        lambda law: -log_likelihood(values, law[0], np.exp(law[1]), 0.2, high),
        [0.5, -1.0],
        method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-9},
    )
    np.testing.assert_allclose(np.ravel(found), [best.x[0], np.exp(best.x[1])], atol=1e-6)
    if high == 1:
        score = clipped_score(values, found[0], float(found[1][0]), 0.2).mean(axis=0)
        np.testing.assert_allclose(score, 0, atol=1e-6)


def test_sums_tell_ends_from_what_is_between_and_rows_are_fitted_one_by_one():
    values = np.array([0.1, 0.2, 0.5, 0.9, 1.0])
    expected = [[1, 0, 0, 0, 0], [1, 0, 0, 0, 0], [0, 0, 1, 0.5, 0.25], [0, 1, 0, 0, 0], [0, 1, 0, 0, 0]]
    sums = clipped_sums(values, 0.2, 0.9)
    np.testing.assert_allclose(sums, expected)
    assert sums.dtype == np.float64
    rng = np.random.default_rng(4)
    rows = np.array(
        [clipped_sums(np.clip(rng.normal(m, 0.2, 500), 0.2, 1), 0.2, 1).sum(axis=0) for m in (0.5, 0.8, 1.0)]
    )
    together = fit_clipped(np.vstack([rows, np.zeros(5)]), 0.2, 1.0)
    for row in range(3):
        np.testing.assert_allclose(
            [column[row] for column in together], np.ravel(fit_clipped(rows[[row]], 0.2, 1.0)), atol=1e-8
        )
    assert np.isnan([column[3] for column in together]).all()
