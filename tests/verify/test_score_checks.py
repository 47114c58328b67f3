"""Checks of the score behind misses and confidence: covariances, sums, and whether a wrong memory is noticed."""

import numpy as np
import pytest
from scipy import special, stats

from modsim3d.detector.persistence import LatentScore, Persistence
from modsim3d.verify.box_error_checks import latent_paths
from modsim3d.verify.class_checks import at_each, memory_checks, miss_covariance, off_diagonal, variance_of_sum

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
    np.testing.assert_allclose(miss_covariance(first, second, np.full(4, correlation)), asked, atol=2e-5)


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
        assert min(each.measure.p_value() for each in memory_checks(TRACKS, TIMES_S, SCORE, chance, missed)) < 1e-3


def test_vessels_that_are_seen_once_have_no_memory() -> None:
    tracks, times_s, chance = np.arange(5)[:, None], np.zeros(5), np.full(5, 0.3)
    assert off_diagonal(tracks, times_s, SCORE, chance, np.ones(5)) == 0
    assert all(each.measure is None for each in memory_checks(tracks, times_s, SCORE, chance, np.zeros(5)))
    assert memory_checks(tracks[:0], times_s[:0], SCORE, chance[:0], chance[:0]) == []


# ---- Sums of misses of vessels that keep a share of their noise ----

FEW, SHARE = (3, 8), 0.4  # vessels, turns


def uniforms(rng: np.random.Generator, count: int, kept: float) -> np.ndarray:
    """Uniform numbers of vessels that keep a share, shape (count, vessels, turns), as the detector draws them."""
    own = rng.random((count, *FEW))
    for turn in range(1, FEW[1]):
        keeps = rng.random((count, FEW[0])) < kept
        own[..., turn] = np.where(keeps, own[..., turn - 1], own[..., turn])
    constant = rng.standard_normal((count, FEW[0], 1))
    return special.ndtr(np.sqrt(SHARE) * constant + np.sqrt(1 - SHARE) * special.ndtri(own))


@pytest.mark.parametrize("class_s", [0.0, 0.9])
def test_the_variance_of_a_sum_of_vessels_that_keep_a_share_is_that_of_many_draws(class_s: float) -> None:
    rng = np.random.default_rng(5)
    low, high = np.sort(rng.random((2, 24)), axis=0)
    amount = rng.normal(1, 0.5, 24)
    drawn = uniforms(rng, 40_000, np.exp(-STEP_S / class_s) if class_s else 0.0).reshape(-1, 24)
    sums = ((drawn >= low) & (drawn < high)) @ amount
    tracks = np.repeat(np.arange(3), 8)[:, None]
    times_s = np.tile(np.arange(8) * STEP_S, 3)
    persistence = Persistence(class_s=class_s, class_vessel_share=SHARE)
    assert variance_of_sum(tracks, times_s, persistence, (low, high), amount) == pytest.approx(sums.var(), rel=0.03)


def test_bounds_at_what_a_vessel_keeps_have_the_bounds_as_their_mean() -> None:
    bounds = np.array([0.0, 0.01, 0.5, 0.9, 1.0])
    np.testing.assert_allclose(sum(weight * found for weight, (found,) in at_each(SHARE, bounds)), bounds, atol=1e-9)


def test_replayed_errors_keep_their_share_along_a_track() -> None:
    tracks, times_s = np.repeat(np.arange(4), 2)[:, None], np.tile([0.0, 100.0], 4)
    rng = np.random.default_rng(6)
    for box_s in (0.0, 50.0):
        paths = latent_paths(tracks, times_s, Persistence(box_s=box_s, box_vessel_share=SHARE), rng, 20_000, 5)
        kept = np.exp(-100 / box_s) if box_s else 0.0
        asked = np.array([SHARE + (1 - SHARE) * kept] * 4 + [kept])
        np.testing.assert_allclose((paths[:, ::2] * paths[:, 1::2]).mean(axis=(0, 1)), asked, atol=0.02)
