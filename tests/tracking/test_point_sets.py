"""GOSPA and OSPA of matrices of distances: laws, all assignments tried out, and Stone Soup's values."""

import datetime as dt
from itertools import permutations

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stonesoup.metricgenerator.ospametric import GOSPAMetric, OSPAMetric
from stonesoup.types.state import State

from modsim3d.tracking.scores.errors import distances, gospa_frame, mean_gospa, mean_ospa, ospa_frame

CUTOFF = 10.0
POWERS = (1.0, 2.0, 3.5)
_NOW = dt.datetime(2024, 1, 1)


@st.composite
def points(draw: st.DrawFn) -> np.ndarray:
    """0 to 4 points in a square of four cutoffs."""
    return draw(hnp.arrays(float, (draw(st.integers(0, 4)), 2), elements=st.floats(-20, 20, width=32)))


def _random_frames(count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Sets of 0 to 7 vessels and 0 to 7 tracks, never both empty."""
    rng = np.random.default_rng(7)
    sizes = rng.integers(0, 8, (count, 2))
    return [(rng.uniform(0, 30, (n, 2)), rng.uniform(0, 30, (m, 2))) for n, m in sizes if n + m]


def _states(values: np.ndarray) -> list[State]:
    return [State(value, timestamp=_NOW) for value in values]


@pytest.mark.parametrize("power", POWERS)
def test_gospa_and_its_parts_and_ospa_are_those_of_stone_soup(power: float) -> None:
    gospa, ospa = GOSPAMetric(p=power, c=CUTOFF), OSPAMetric(p=1, c=CUTOFF)
    for vessels, tracks in _random_frames(60):
        theirs = gospa.compute_gospa_metric(_states(tracks), _states(vessels))[0].value
        ours = gospa_frame(distances(vessels, tracks), CUTOFF, power)
        wanted = [theirs[name] for name in ("distance", "localisation", "missed", "false")]
        np.testing.assert_allclose(ours, wanted, rtol=1e-9, atol=1e-9)
        if power == 1:
            distance = ospa.compute_OSPA_distance(_states(tracks), _states(vessels)).value
            assert ospa_frame(distances(vessels, tracks), CUTOFF) == pytest.approx(distance, abs=1e-9)


@pytest.mark.parametrize("power", POWERS)
def test_no_assignment_is_cheaper(power: float) -> None:
    """Stone Soup's OSPA assigns by d instead of d^p, so for p > 1 all assignments are tried out instead."""
    for vessels, tracks in _random_frames(60):
        few, many = sorted((vessels[:5], tracks[:5]), key=len)
        costs = np.minimum(distances(few, many), CUTOFF) ** power
        orders = permutations(range(len(many)), len(few))
        paired = min(sum(costs[i, j] for i, j in enumerate(order)) for order in orders)
        left, distance = CUTOFF**power * (len(many) - len(few)), distances(few, many)
        ospa = ((paired + left) / len(many)) ** (1 / power) if len(many) else 0
        assert ospa_frame(distance, CUTOFF, power) == pytest.approx(ospa)
        assert gospa_frame(distance, CUTOFF, power).gospa == pytest.approx((paired + left / 2) ** (1 / power))


@given(points(), points(), st.sampled_from(POWERS))
def test_the_other_way_round_misses_and_false_tracks_change_places(a: np.ndarray, b: np.ndarray, power: float) -> None:
    there, back = (gospa_frame(distance, CUTOFF, power) for distance in (distances(a, b), distances(b, a)))
    np.testing.assert_allclose(there, (back.gospa, back.localisation, back.false, back.missed), atol=1e-9)
    assert ospa_frame(distances(a, b), CUTOFF, power) == pytest.approx(ospa_frame(distances(b, a), CUTOFF, power))


@settings(max_examples=150)
@given(points(), points(), points(), st.sampled_from(POWERS))
def test_no_way_round_is_shorter(a: np.ndarray, b: np.ndarray, c: np.ndarray, power: float) -> None:
    for frame in (lambda *of: gospa_frame(*of).gospa, ospa_frame):
        direct, there, on = (frame(distances(x, y), CUTOFF, power) for x, y in ((a, c), (a, b), (b, c)))
        assert direct <= there + on + 1e-9


@given(points(), points(), st.sampled_from(POWERS))
def test_the_distance_is_0_of_equal_sets_only_and_its_parts_add_up_to_its_power(a, b, power: float) -> None:
    assert gospa_frame(distances(a, a[::-1]), CUTOFF, power).gospa == 0
    assert ospa_frame(distances(a, a[::-1]), CUTOFF, power) == 0
    whole, *parts = gospa_frame(distances(a, b), CUTOFF, power)
    assert sum(parts) == pytest.approx(whole**power, rel=1e-9)
    if len(a) != len(b):
        assert whole >= CUTOFF / 2 ** (1 / power) - 1e-9
        assert ospa_frame(distances(a, b), CUTOFF, power) > 0


def test_one_pair_a_miss_and_a_false_track_worked_by_hand() -> None:
    """Vessels at 0 and 100, tracks at 3 and 50: with c = 10 the pair costs 3, and 100 and 50 cost 5 each."""
    distance = np.array([[3.0, 50.0], [97.0, 50.0]])
    assert gospa_frame(distance, 10) == (13, 3, 5, 5)
    assert ospa_frame(distance, 10) == 6.5  # (3 + 10) / 2
    assert gospa_frame(distance, 10, 2) == pytest.approx((109**0.5, 9, 50, 50))
    assert ospa_frame(distance, 10, 2) == pytest.approx((109 / 2) ** 0.5)


def test_a_pair_at_the_cutoff_is_a_miss_and_a_false_track_and_of_empty_sets_the_other_is_charged() -> None:
    assert gospa_frame(np.array([[10.0]]), 10) == (10, 0, 5, 5)
    for vessels, tracks, gospa, ospa in ((0, 0, 0, 0), (2, 0, 10, 10), (0, 3, 15, 10)):
        distance = np.zeros((vessels, tracks))
        assert gospa_frame(distance, 10) == (gospa, 0, 5 * vessels, 5 * tracks)
        assert ospa_frame(distance, 10) == ospa, (vessels, tracks)


def test_the_mean_is_over_all_frames_and_none_without_frames() -> None:
    frames = [np.zeros((0, 0)), np.array([[4.0]]), np.zeros((1, 0))]  # GOSPA 0, 4, 5; OSPA 0, 4, 10
    assert mean_gospa(frames, 10) == (3, 4 / 3, 5 / 3, 0) and mean_ospa(frames, 10) == pytest.approx(14 / 3)
    assert mean_gospa([], 10) is None and mean_ospa([], 10) is None
