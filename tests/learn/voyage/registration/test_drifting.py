"""Errors of positions that last: the process, and a fit whose covariance is what repeated draws show."""

from __future__ import annotations

import numpy as np
import pytest

from modsim3d.learn.voyage.registration.boxes_at_times import Sightings
from modsim3d.learn.voyage.registration.estimating import KNOT_S, LASTS_S, drift_axes, fit_drift
from modsim3d.learn.voyage.registration.icp import SightingResiduals
from modsim3d.learn.voyage.registration.identifiability import Knowledge, Linear, covering

VESSELS, FRAMES, DRAWS = 8, 20, 40
NOISE_M, OFFSET_M, DELAY_S = 3.0, 2.0, 0.5
TRUE = np.array([2.0, -1.0])


def residuals_of(time_s: np.ndarray, vessel: np.ndarray) -> SightingResiduals:
    """A bearing of each of some sightings, of boxes of one size."""
    count = len(time_s)
    rows, four = np.arange(count), np.zeros((count, 4))
    sightings = Sightings(rows, rows, time_s, vessel, four, four > -1, four, np.zeros((count, 4, 3)))
    return SightingResiduals(sightings, rows, np.zeros(count, dtype=int), np.zeros(count), np.full(count, 50.0))


def test_the_drift_has_the_covariance_of_a_gauss_markov_process_and_each_vessel_its_own() -> None:
    one_s = np.arange(0, 61, KNOT_S)
    count = len(one_s)
    vessel = np.repeat([4, 7], count)
    axes = drift_axes(np.tile(one_s, 2), vessel, np.array([OFFSET_M, 0.0, DELAY_S]), NOISE_M)[:count]
    process = np.exp(-np.abs(one_s[:, None] - one_s) / LASTS_S)
    for axis, constant, noise in ((0, OFFSET_M, NOISE_M), (1, 0.0, NOISE_M), (2, DELAY_S, 0.0)):
        covariance = axes[:, axis] @ axes[:, axis].T
        # knots lie a little closer than `KNOT_S`, and between them the process is linear
        np.testing.assert_allclose(covariance, noise**2 * process + constant**2, rtol=0.005)
    np.testing.assert_allclose(axes[:, 0] @ axes[:, 1].T, 0, atol=1e-12)


def test_draws_spread_as_the_fit_says_and_less_than_without_drifts() -> None:
    rng = np.random.default_rng(1)
    time_s, vessel = np.tile(np.linspace(0, 60, FRAMES), VESSELS), np.repeat(np.arange(VESSELS), FRAMES)
    residuals, count = residuals_of(time_s, vessel), VESSELS * FRAMES
    slopes = np.stack([np.ones(count), rng.normal(size=VESSELS)[vessel] + 0.02 * time_s], axis=1)
    own = np.column_stack([np.ones(count), np.zeros((count, 2))])
    axes = drift_axes(time_s, vessel, np.array([OFFSET_M, 0, 0]), NOISE_M)
    found, plain = [], []
    for _ in range(DRAWS):
        normals = rng.normal(size=(VESSELS, axes.shape[2]))
        px = rng.normal(size=count) + (axes[:, 0] * normals[vessel]).sum(axis=1) - slopes @ TRUE
        drift = fit_drift(residuals, px, px, slopes, own, axes, 1.0)
        found.append(drift.change)
        plain.append(-np.linalg.lstsq(slopes, px, rcond=None)[0])
    white = Linear(slopes, np.zeros(count)).whitened(axes[:, 0], vessel)
    expected = np.sqrt(np.diagonal(white.known_by_model(1.0, 10.0).covariance))
    np.testing.assert_allclose(np.std(found, axis=0), expected, rtol=0.25)
    np.testing.assert_allclose(np.mean(found, axis=0), TRUE, atol=3.5 * expected.max() / np.sqrt(DRAWS))
    assert np.all(np.std(found, axis=0) < np.std(plain, axis=0))
    assert np.std(drift.errors_px) == pytest.approx(1, abs=0.15)


def test_intervals_cover_what_explains_the_data_nearly_as_well() -> None:
    known = Knowledge(np.eye(2), np.array([1.0, 2.0]), np.ones(2))
    np.testing.assert_array_equal(covering(known, []).half_widths, [1.0, 2.0])
    other = [np.array([0.5, -3.0]), np.array([-4.0, 0.0])]
    np.testing.assert_array_equal(covering(known, other).half_widths, [5.0, 5.0])
