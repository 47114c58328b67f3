"""Checks of the score behind misses and confidence: covariances, sums, and whether a wrong memory is noticed."""

import numpy as np
import pytest
from scipy import special, stats

from modsim3d.detector.persistence import LatentScore
from modsim3d.verify.score_checks import memory_checks, miss_covariance, off_diagonal

SCORE = LatentScore(0.3, (0.2, 0.4), (1.0, 6.0))
VESSELS, TURNS, STEP_S = 60, 80, 0.5
TRACKS = np.repeat(np.arange(VESSELS), TURNS)[:, None]
TIMES_S = np.tile(np.arange(TURNS) * STEP_S, VESSELS)


def drawn(score: LatentScore, count: int, seed: int, vessels: int = VESSELS) -> np.ndarray:
    """Scores of vessels, from the Cholesky root of their covariance, shape (count, vessels · turns)."""
    times_s = np.arange(TURNS) * STEP_S
    covariance = score.correlation(np.abs(times_s[:, None] - times_s))
    np.fill_diagonal(covariance, 1.0)
    normal = np.random.default_rng(seed).standard_normal((count, vessels, TURNS))
    return special.ndtr(normal @ np.linalg.cholesky(covariance).T).reshape(count, -1)


@pytest.mark.parametrize("correlation", [0.0, 0.3, 0.95])
def test_the_covariance_of_misses_is_that_of_the_bivariate_normal_distribution(correlation: float) -> None:
    first, second = np.array([0.05, 0.3, 0.5, 0.9]), np.array([0.1, 0.3, 0.8, 0.95])
    pair = stats.multivariate_normal([0, 0], [[1, correlation], [correlation, 1]])
    asked = [pair.cdf(special.ndtri([a, b])) - a * b for a, b in zip(first, second, strict=True)]
    found = miss_covariance(first, second, np.full(4, correlation))
    np.testing.assert_allclose(found, asked, atol=2e-5)


def test_the_variance_of_a_sum_of_misses_is_that_of_many_draws() -> None:
    rng = np.random.default_rng(3)
    chance = np.repeat(rng.uniform(0.1, 0.8, 5), TURNS) + 0.1 * np.sin(np.tile(np.arange(TURNS) / 9, 5))
    amount = rng.normal(1, 0.1, 5 * TURNS)
    sums = (drawn(SCORE, 8000, 4, vessels=5) < chance) @ amount
    alone = float((amount**2 * chance * (1 - chance)).sum())
    tracks, times_s = TRACKS[: 5 * TURNS], TIMES_S[: 5 * TURNS]
    assert alone + off_diagonal(tracks, times_s, SCORE, chance, amount) == pytest.approx(sums.var(), rel=0.05)


def test_a_memory_as_asked_passes_and_another_one_does_not() -> None:
    chance = np.full(VESSELS * TURNS, 0.25)
    sure = []
    for seed in range(8):
        missed = (drawn(SCORE, 1, seed)[0] < chance).astype(float)
        sure += [each.measure.p_value() for each in memory_checks(TRACKS, TIMES_S, SCORE, chance, missed)]
    assert np.mean(np.array(sure) < 0.05) < 0.2
    for wrong in (LatentScore(0.0, (0.9,), (0.5,)), LatentScore(0.7, (0.25,), (6.0,))):
        missed = (drawn(wrong, 1, 9)[0] < chance).astype(float)
        found = memory_checks(TRACKS, TIMES_S, SCORE, chance, missed)
        assert min(each.measure.p_value() for each in found) < 1e-3


def test_vessels_that_are_seen_once_have_no_memory() -> None:
    tracks, times_s, chance = np.arange(5)[:, None], np.zeros(5), np.full(5, 0.3)
    assert off_diagonal(tracks, times_s, SCORE, chance, np.ones(5)) == 0
    assert all(each.measure is None for each in memory_checks(tracks, times_s, SCORE, chance, np.zeros(5)))
    assert memory_checks(tracks[:0], times_s[:0], SCORE, chance[:0], chance[:0]) == []
