"""Closest approach of tracks and least distance of hulls, against cases by hand, dense sampling and shapely."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
import shapely.affinity
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.hull_distances import TOLERANCE_M, Rectangles, least_hull_distance, rectangle_distances
from modsim3d.geometry.kinematics import HullTracks, closest_approach


def polygon(rectangles: Rectangles, index: int) -> shapely.Polygon:
    length, beam = rectangles.half_sizes_m[index]
    hull, heading = shapely.box(-length, -beam, length, beam), float(rectangles.headings_rad[index])
    turned = shapely.affinity.rotate(hull, heading, (0, 0), True)
    return shapely.affinity.translate(turned, *rectangles.centres_m[index])


def test_vessels_that_cross_at_right_angles_are_nearest_where_their_relative_track_is() -> None:
    """One goes east with 10 m/s from the origin, the other north with 10 m/s from (1000, −1100)."""
    times = np.array([0.0, 40.0, 200.0])
    one, other = np.outer(times, [10.0, 0.0]), np.array([1000.0, -1100.0]) + np.outer(times, [0.0, 10.0])
    distance, when = closest_approach(times, one, other)
    assert (distance, when) == pytest.approx((100 / np.sqrt(2), 105.0))


@pytest.mark.parametrize(("there", "expected"), [([1, 1, 0, 0], (30.0, 1.0)), ([0, 0, 0, 1], (50.0, 3.0))])
def test_only_times_count_at_which_both_are_there(there: list[int], expected: tuple[float, float]) -> None:
    times = np.arange(4.0)
    other = np.where(np.array(there)[:, None], [[40.0, 0.0], [30.0, 0.0], [2.0, 0.0], [50.0, 0.0]], np.nan)
    assert closest_approach(times, np.zeros((4, 2)), other) == pytest.approx(expected)
    distance, when = closest_approach(times, np.zeros((4, 2)), np.full((4, 2), np.nan))
    assert distance == np.inf and np.isnan(when)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.integers(0, 10**6))
def test_closest_approach_is_that_of_a_densely_sampled_track(seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.5, 3.0, 6))
    one, other = rng.uniform(-100, 100, (2, 6, 2))
    distance, when = closest_approach(times, one, other)
    dense = np.linspace(times[0], times[-1], 20_001)
    apart = [np.interp(dense, times, (other - one)[:, axis]) for axis in (0, 1)]
    sampled = np.hypot(*apart)
    assert sampled.min() - 0.2 <= distance <= sampled.min() + 1e-9
    assert abs(np.hypot(*(np.interp(when, times, (other - one)[:, axis]) for axis in (0, 1))) - distance) < 1e-9


def test_distances_of_rectangles_are_those_of_polygons() -> None:
    rng, n = np.random.default_rng(1), 2000
    ones, others = (
        Rectangles(rng.uniform(-30, 30, (n, 2)), rng.uniform(-9, 9, n), rng.uniform(0.5, 20, (n, 2))) for _ in range(2)
    )
    expected = [polygon(ones, i).distance(polygon(others, i)) for i in range(n)]
    found = rectangle_distances(ones, others)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert 0.2 < np.mean(found == 0) < 0.9  # both cases are there


def test_crossed_hulls_touch_though_no_corner_lies_in_the_other() -> None:
    halves, place = np.array([[20.0, 1.0]]), np.zeros((1, 2))
    crossed = (Rectangles(place, np.array([heading]), halves) for heading in (0.0, np.pi / 2))
    assert rectangle_distances(*crossed).tolist() == [0.0]


def test_hulls_that_meet_between_two_steps_touch() -> None:
    """Two boats of 10 m that pass head-on 4 m apart with beams of 5 m, a step before and a step after."""
    centres = np.array([[[-50.0, 0.0], [50.0, 4.0]], [[50.0, 0.0], [-50.0, 4.0]]])
    places = np.array([0.0, 10.0]), centres, np.array([[0.0, np.pi], [0.0, -np.pi]])
    wide, narrow = (HullTracks(*places, np.full((2, 2), [5.0, half])) for half in (2.5, 1.5))
    distance, when = least_hull_distance(wide, 0, 1)
    assert distance == 0 and 4.0 < when < 6.0
    assert least_hull_distance(narrow, 0, 1)[0] == pytest.approx(1.0, abs=TOLERANCE_M)


def test_least_hull_distance_is_that_of_dense_sampling() -> None:
    rng, times = np.random.default_rng(2), np.arange(0.0, 6.0)
    for _ in range(40):
        centres = np.cumsum(rng.normal(0, 12, (6, 2, 2)), axis=0) + np.array([[0, 0], [60, 0]])
        headings = rng.uniform(-4, 4, (1, 2)) + np.cumsum(rng.uniform(-1, 1, (6, 2)), axis=0)
        wrapped = (headings + np.pi) % (2 * np.pi) - np.pi
        halves = rng.uniform(1, 12, (2, 2))
        missing = rng.random((6, 2)) < 0.1
        wrapped[missing], centres[missing] = np.nan, np.nan
        found, when = least_hull_distance(HullTracks(times, centres, wrapped, halves), 0, 1)
        dense = np.linspace(0, 5, 1001)
        place = [[np.interp(dense, times, centres[:, i, axis]) for axis in (0, 1)] for i in (0, 1)]
        for i in (0, 1):  # no interpolation from or to a time at which one is absent
            gone = missing.any(axis=1)
            leg = np.minimum(np.searchsorted(times, dense, side="right") - 1, 4)
            known = np.where(dense == times[leg], ~gone[leg], ~gone[leg] & ~gone[leg + 1])
            known[-1] = not gone[5]
            place[i] = np.where(known, place[i], np.nan)
        turned = [np.interp(dense, times, headings[:, i]) for i in (0, 1)]
        ones, others = (Rectangles(np.array(place[i]).T, turned[i], np.tile(halves[i], (1001, 1))) for i in (0, 1))
        with np.errstate(invalid="ignore"):
            distances = rectangle_distances(ones, others)
        sampled = distances[np.isfinite(place[0][0])]
        if not len(sampled):
            assert found == np.inf
            continue
        assert sampled.min() - 0.5 <= found <= sampled.min() + TOLERANCE_M  # what may lie between two samples
        assert 0 <= when <= 5
