"""Intervals, what cannot be told apart, and what is wrong with single vessels, on regressions with known answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from modsim3d.learn.voyage.registration.identifiability import Linear, undetermined
from modsim3d.learn.voyage.registration.parameters import known_of, plausible, vessel_effects

DRAWS, VESSELS, FRAMES = 400, 8, 60


def clustered(rng: np.random.Generator, together: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slopes by two values, errors of which a part is the same for all rows of a vessel, and the vessels."""
    vessel = np.repeat(np.arange(VESSELS), FRAMES)
    slopes = np.stack([np.ones(len(vessel)), rng.normal(size=VESSELS)[vessel] + 0.3 * rng.normal(size=len(vessel))], 1)
    return slopes, rng.normal(size=len(vessel)) + together * rng.normal(size=VESSELS)[vessel], vessel


@pytest.mark.parametrize("together", [0.0, 1.0])
def test_intervals_hold_95_percent_with_few_vessels_whose_errors_go_together(together: float) -> None:
    rng, held = np.random.default_rng(0), np.zeros(2)
    for _ in range(DRAWS):
        slopes, errors, vessel = clustered(rng, together)
        estimate, *_ = np.linalg.lstsq(slopes, errors, rcond=None)
        known = Linear(slopes, errors - slopes @ estimate).known_by(vessel)
        held += np.abs(estimate) <= known.half_widths
    low, high = binom.ppf([0.001, 0.999], DRAWS, 0.95)
    assert np.all(held >= low)
    assert np.all(held <= min(high + 0.03 * DRAWS, DRAWS))  # a wider interval is no error, a useless one is


def test_whitening_takes_off_what_rows_of_a_vessel_share() -> None:
    rng = np.random.default_rng(1)
    vessel = np.repeat(np.arange(2), 3)
    slopes, residuals, shared = rng.normal(size=(6, 2)), rng.normal(size=6), rng.normal(size=(6, 1))
    white = Linear(slopes, residuals).whitened(shared, vessel)
    covariance = np.eye(6) + np.where(vessel[:, None] == vessel, shared @ shared.T, 0.0)
    np.testing.assert_allclose(white.information, slopes.T @ np.linalg.inv(covariance) @ slopes)
    np.testing.assert_allclose(white.residuals @ white.residuals, residuals @ np.linalg.inv(covariance) @ residuals)


def test_of_two_values_that_look_the_same_one_is_held_and_the_exchange_is_said() -> None:
    rng = np.random.default_rng(2)
    base = 30 * rng.normal(size=(500, 2))
    names = ("pitch_deg", "focal_share", "height_m")
    slopes = np.stack([base[:, 0], base[:, 1], 2 * base[:, 0]], axis=1)  # in plausible distances
    (group,) = undetermined(Linear(slopes, rng.normal(size=500)), names, np.arange(500))
    assert group.held == "height_m"
    pitch, height = plausible(["pitch_deg", "height_m"])
    assert dict(group.exchange) == pytest.approx({"pitch_deg": -2 * pitch / height})
    assert group.words() == "height_m is held; 1 m of it looks like -2° of pitch_deg"


def offsets(spread: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Slopes by along, across and delay at 3 m/s, residuals with random offsets along, vessels, and the offsets."""
    rng = np.random.default_rng(3)
    vessel, along = np.repeat(np.arange(12), 50), rng.normal(0, spread, 12)
    slopes = rng.normal(0, 1, (600, 2))
    slopes = np.column_stack([slopes, -3 * slopes[:, 0]])
    return slopes, rng.normal(size=600) - slopes[:, 0] * along[vessel], vessel, along


def test_an_offset_along_and_a_delay_are_told_as_one_shift_of_a_vessel_at_constant_speed() -> None:
    slopes, residuals, vessel, along = offsets(4.0)
    effects = vessel_effects(slopes, residuals, np.zeros((600, 1)), vessel, 1.0)
    assert 2.5 < effects.spreads[0] < 6
    known = known_of(effects, np.zeros((1, 1)), np.full(12, 3.0), [f"v{i}" for i in range(12)])
    assert {name.split(".")[1] for name, *_ in known} == {"ahead_m"}
    for place, (_, _, _, value, error) in enumerate(known):
        assert abs(value + along[place]) < 4 * error < 1


def test_offsets_across_are_known_as_well_where_there_are_none_along() -> None:
    slopes, residuals, vessel, _ = offsets(4.0)
    effects = vessel_effects(slopes, residuals, np.zeros((600, 1)), vessel, 1.0)
    effects = replace(effects, spreads=np.array([0.0, 2.0, 0.0]))
    known = known_of(effects, np.zeros((1, 1)), np.full(12, 3.0), [f"v{i}" for i in range(12)])
    assert {name.split(".")[1] for name, *_ in known} == {"across_m"}
    assert all(0.1 < error < 0.2 for *_, error in known)


def test_exact_reports_are_found_exact() -> None:
    slopes, residuals, vessel, _ = offsets(0.0)
    effects = vessel_effects(slopes, residuals, np.zeros((600, 1)), vessel, 1.0)
    assert np.all(effects.spreads < 0.2)  # an offset is known to 0.14 m
