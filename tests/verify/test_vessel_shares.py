"""Sums of misses of vessels that keep a share of their noise stray as far as simulated ones do."""

import numpy as np
import pytest
from scipy import special

from modsim3d.detector.persistence import Persistence
from modsim3d.verify.box_error_checks import latent_paths
from modsim3d.verify.class_checks import at_each, variance_of_sum

VESSELS, TURNS, STEP_S, SHARE = 3, 8, 0.5, 0.4


def uniforms(rng: np.random.Generator, count: int, kept: float) -> np.ndarray:
    """Uniform numbers of vessels that keep a share, shape (count, vessels, turns), as the detector draws them."""
    own = rng.random((count, VESSELS, TURNS))
    for turn in range(1, TURNS):
        keeps = rng.random((count, VESSELS)) < kept
        own[..., turn] = np.where(keeps, own[..., turn - 1], own[..., turn])
    constant = rng.standard_normal((count, VESSELS, 1))
    return special.ndtr(np.sqrt(SHARE) * constant + np.sqrt(1 - SHARE) * special.ndtri(own))


@pytest.mark.parametrize("class_s", [0.0, 0.9])
def test_the_variance_of_a_sum_is_that_of_many_draws(class_s: float) -> None:
    rng = np.random.default_rng(5)
    low, high = np.sort(rng.random((2, VESSELS * TURNS)), axis=0)
    amount = rng.normal(1, 0.5, VESSELS * TURNS)
    drawn = uniforms(rng, 40_000, np.exp(-STEP_S / class_s) if class_s else 0.0).reshape(-1, VESSELS * TURNS)
    sums = ((drawn >= low) & (drawn < high)) @ amount
    tracks = np.repeat(np.arange(VESSELS), TURNS)[:, None]
    times_s = np.tile(np.arange(TURNS) * STEP_S, VESSELS)
    persistence = Persistence(class_s=class_s, class_vessel_share=SHARE)
    asked = variance_of_sum(tracks, times_s, persistence, (low, high), amount)
    assert asked == pytest.approx(sums.var(), rel=0.03)


def test_bounds_at_what_a_vessel_keeps_have_the_bounds_as_their_mean() -> None:
    bounds = np.array([0.0, 0.01, 0.5, 0.9, 1.0])
    mean = sum(weight * found for weight, (found,) in at_each(SHARE, bounds))
    np.testing.assert_allclose(mean, bounds, atol=1e-9)


def test_replayed_errors_keep_their_share_along_a_track() -> None:
    tracks, times_s = np.repeat(np.arange(4), 2)[:, None], np.tile([0.0, 100.0], 4)
    rng = np.random.default_rng(6)
    for box_s in (0.0, 50.0):
        paths = latent_paths(tracks, times_s, Persistence(box_s=box_s, box_vessel_share=SHARE), rng, 20_000, 5)
        kept = np.exp(-100 / box_s) if box_s else 0.0
        products = (paths[:, ::2] * paths[:, 1::2]).mean(axis=(0, 1))
        asked = np.array([SHARE + (1 - SHARE) * kept] * 4 + [kept])
        np.testing.assert_allclose(products, asked, atol=0.02)
