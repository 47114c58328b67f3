"""Intervals, what cannot be told apart, what is wrong with single vessels, and errors of positions that last.
On regressions with known answers, and by what repeated draws show."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from modsim3d.learn.voyage.registration import parameters
from modsim3d.learn.voyage.registration.estimating import KNOT_S, LASTS_S, drift_axes, fit_drift
from modsim3d.learn.voyage.registration.icp import SightingResiduals, Sightings

DRAWS, VESSELS, FRAMES = 400, 8, 60
SEEN, NOISE_M, OFFSET_M, DELAY_S = 20, 3.0, 2.0, 0.5
TRUE = np.array([2.0, -1.0])


@pytest.mark.parametrize("together", [0.0, 1.0])
def test_intervals_hold_95_percent_with_few_vessels_whose_errors_go_together(together: float) -> None:
    rng, held, vessel = np.random.default_rng(0), np.zeros(2), np.repeat(np.arange(VESSELS), FRAMES)
    for _ in range(DRAWS):
        slope = rng.normal(size=VESSELS)[vessel] + 0.3 * rng.normal(size=len(vessel))
        slopes = np.column_stack([np.ones(len(vessel)), slope])
        errors = rng.normal(size=len(vessel)) + together * rng.normal(size=VESSELS)[vessel]  # a part is the vessel's
        estimate, *_ = np.linalg.lstsq(slopes, errors, rcond=None)
        held += np.abs(estimate) <= parameters.Linear(slopes, errors - slopes @ estimate).known_by(vessel).half_widths
    low, high = binom.ppf([0.001, 0.999], DRAWS, 0.95)
    assert np.all(held >= low)
    assert np.all(held <= min(high + 0.03 * DRAWS, DRAWS))  # a wider interval is no error, a useless one is


def test_whitening_takes_off_what_rows_of_a_vessel_share() -> None:
    rng = np.random.default_rng(1)
    vessel = np.repeat(np.arange(2), 3)
    slopes, residuals, shared = rng.normal(size=(6, 2)), rng.normal(size=6), rng.normal(size=(6, 1))
    white = parameters.Linear(slopes, residuals).whitened(shared, vessel)
    covariance = np.eye(6) + np.where(vessel[:, None] == vessel, shared @ shared.T, 0.0)
    np.testing.assert_allclose(white.information, slopes.T @ np.linalg.inv(covariance) @ slopes)
    np.testing.assert_allclose(white.residuals @ white.residuals, residuals @ np.linalg.inv(covariance) @ residuals)


def test_of_two_values_that_look_the_same_one_is_held_and_the_exchange_is_said() -> None:
    rng = np.random.default_rng(2)
    base = 30 * rng.normal(size=(500, 2))
    names = ("pitch_deg", "focal_share", "height_m")
    slopes = np.stack([base[:, 0], base[:, 1], 2 * base[:, 0]], axis=1)  # in plausible distances
    (group,) = parameters.undetermined(parameters.Linear(slopes, rng.normal(size=500)), names, np.arange(500))
    assert group.held == "height_m"
    pitch, height = parameters.plausible(["pitch_deg", "height_m"])
    assert dict(group.exchange) == pytest.approx({"pitch_deg": -2 * pitch / height})
    assert group.words() == "height_m is held; 1 m of it looks like -2° of pitch_deg"


def offsets(spread: float) -> tuple[parameters.VesselEffects, np.ndarray]:
    """Effects of slopes by along, across and delay at 3 m/s with random offsets along, and the offsets."""
    rng = np.random.default_rng(3)
    vessel, along = np.repeat(np.arange(12), 50), rng.normal(0, spread, 12)
    slopes = rng.normal(0, 1, (600, 2))
    slopes = np.column_stack([slopes, -3 * slopes[:, 0]])
    residuals = rng.normal(size=600) - slopes[:, 0] * along[vessel]
    return parameters.vessel_effects(slopes, residuals, np.zeros((600, 1)), vessel, 1.0), along


def test_offsets_of_vessels_at_constant_speed_are_known_as_one_shift_along_or_across() -> None:
    def known_at_3_m_s(effects: parameters.VesselEffects) -> list[tuple[str, str, str, float, float]]:
        return parameters.known_of(effects, np.zeros((1, 1)), np.full(12, 3.0), [f"v{i}" for i in range(12)])

    effects, along = offsets(4.0)
    assert 2.5 < effects.spreads[0] < 6
    known = known_at_3_m_s(effects)
    assert {name.split(".")[1] for name, *_ in known} == {"ahead_m"}  # an offset and a delay look alike
    for place, (_, _, _, value, error) in enumerate(known):
        assert abs(value + along[place]) < 4 * error < 1
    known = known_at_3_m_s(replace(effects, spreads=np.array([0.0, 2.0, 0.0])))
    assert {name.split(".")[1] for name, *_ in known} == {"across_m"} and all(0.1 < error < 0.2 for *_, error in known)
    assert np.all(offsets(0.0)[0].spreads < 0.2)  # of exact reports; an offset is known to 0.14 m


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
        # knots lie a little closer than `KNOT_S`, and between them the process is linear
        np.testing.assert_allclose(axes[:, axis] @ axes[:, axis].T, noise**2 * process + constant**2, rtol=0.005)
    np.testing.assert_allclose(axes[:, 0] @ axes[:, 1].T, 0, atol=1e-12)


def test_draws_spread_as_the_fit_says_and_less_than_without_drifts() -> None:
    rng = np.random.default_rng(1)
    time_s, vessel = np.tile(np.linspace(0, 60, SEEN), VESSELS), np.repeat(np.arange(VESSELS), SEEN)
    residuals, count = residuals_of(time_s, vessel), VESSELS * SEEN
    slopes = np.stack([np.ones(count), rng.normal(size=VESSELS)[vessel] + 0.02 * time_s], axis=1)
    own = np.column_stack([np.ones(count), np.zeros((count, 2))])
    axes = drift_axes(time_s, vessel, np.array([OFFSET_M, 0, 0]), NOISE_M)
    found, plain = [], []
    for _ in range(40):
        normals = rng.normal(size=(VESSELS, axes.shape[2]))
        px = rng.normal(size=count) + (axes[:, 0] * normals[vessel]).sum(axis=1) - slopes @ TRUE
        drift = fit_drift(residuals, px, px, slopes, own, axes, 1.0)
        found.append(drift.change)
        plain.append(-np.linalg.lstsq(slopes, px, rcond=None)[0])
    white = parameters.Linear(slopes, np.zeros(count)).whitened(axes[:, 0], vessel)
    expected = np.sqrt(np.diagonal(white.known_by_model(1.0, 10.0).covariance))
    np.testing.assert_allclose(np.std(found, axis=0), expected, rtol=0.25)
    np.testing.assert_allclose(np.mean(found, axis=0), TRUE, atol=3.5 * expected.max() / np.sqrt(40))
    assert np.all(np.std(found, axis=0) < np.std(plain, axis=0))
    assert np.std(drift.errors_px) == pytest.approx(1, abs=0.15)


def test_intervals_cover_what_explains_the_data_nearly_as_well() -> None:
    known = parameters.Knowledge(np.eye(2), np.array([1.0, 2.0]), np.ones(2))
    np.testing.assert_array_equal(parameters.covering(known, []).half_widths, [1.0, 2.0])
    other = [np.array([0.5, -3.0]), np.array([-4.0, 0.0])]
    np.testing.assert_array_equal(parameters.covering(known, other).half_widths, [5.0, 5.0])
