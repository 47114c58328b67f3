"""Velocities and accelerations by differences, unions of polygons, and closest approaches of tracks and hulls."""

from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.hull_distances import TOLERANCE_M, Rectangles, least_hull_distance, rectangle_distances
from modsim3d.geometry import kinematics
from modsim3d.geometry.camera_poses import rotation
from modsim3d.geometry.kinematics import closest_approach, first_derivative, slopes, turning, union_of
from tests.scenes import rectangles

TIMES = st.lists(st.floats(0.05, 2.0), min_size=2, max_size=12).map(lambda gaps: np.cumsum([3.0, *gaps]))
NUMBERS = st.floats(-10, 10)


@settings(max_examples=50)
@given(TIMES, NUMBERS, NUMBERS, NUMBERS)
def test_parabola_has_its_own_derivatives_whatever_the_intervals(times, a, b, c):
    values = a + b * times + c * times**2
    between = slopes(times, values)
    np.testing.assert_allclose(first_derivative(times, between)[1:-1], (b + 2 * c * times)[1:-1], atol=1e-7)
    np.testing.assert_allclose(kinematics.second_derivative(times, between), 2 * c, atol=1e-6)


def test_ends_take_the_only_slope_they_have_and_distances_are_those_of_polygons():
    times = np.array([0.0, 1.0, 3.0])
    np.testing.assert_allclose(first_derivative(times, slopes(times, np.array([0.0, 2.0, 10.0])))[[0, 2]], [2, 4])
    for times in (np.array([1.0]), np.array([1.0, 2.0])):
        between = slopes(times, 5 * times)
        np.testing.assert_array_equal(kinematics.second_derivative(times, between), np.zeros(len(times)))
        np.testing.assert_array_equal(first_derivative(times, between), [0.0] if len(times) == 1 else [5.0, 5.0])
    times = np.arange(6.0)
    present = np.array([[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 1, 0], [1, 0, 0], [1, 0, 0]], dtype=bool)
    positions = np.where(present[..., None], (100 + 3 * times)[:, None, None], 0.0) * np.ones(3)
    found = kinematics.velocities(times, positions, present)
    np.testing.assert_allclose(found[:, 0], 3)
    np.testing.assert_allclose(found[1:4, 1], 3)
    np.testing.assert_array_equal(found[~present], 0)
    np.testing.assert_array_equal(found[:, 2], 0)  # there at one step only
    rng, n = np.random.default_rng(1), 2000
    drawn = ((rng.uniform(-30, 30, (n, 2)), rng.uniform(-9, 9, n), rng.uniform(0.5, 20, (n, 2))) for _ in range(2))
    ones, others = (Rectangles(*each) for each in drawn)
    hulls = [rectangles(each.centres_m, each.headings_rad, 2 * each.half_sizes_m) for each in (ones, others)]
    found = rectangle_distances(ones, others)
    np.testing.assert_allclose(found, shapely.distance(*hulls), atol=1e-9)
    assert 0.2 < np.mean(found == 0) < 0.9  # both cases are there
    # Two boats of 10 m that pass head-on 4 m apart with beams of 5 m, a step before and a step after.
    centres = np.array([[[-50.0, 0.0], [50.0, 4.0]], [[50.0, 0.0], [-50.0, 4.0]]])
    places = np.array([0.0, 10.0]), centres, np.array([[0.0, np.pi], [0.0, -np.pi]])
    wide, narrow = (kinematics.HullTracks(*places, np.full((2, 2), [5.0, half])) for half in (2.5, 1.5))
    distance, when = least_hull_distance(wide, 0, 1)
    assert distance == 0 and 4.0 < when < 6.0
    assert least_hull_distance(narrow, 0, 1)[0] == pytest.approx(1.0, abs=TOLERANCE_M)


@given(TIMES, st.integers(0, 2), st.floats(-1.0, 1.0))
def test_steady_turn_has_its_own_rate_in_body_axes_for_one_body_and_for_many(times, axis, rate):
    attitudes = rotation(1, 0.4) @ rotation(axis, rate * times)
    expected = rate * np.tile(np.eye(3)[axis], (len(times) - 1, 1))
    np.testing.assert_allclose(turning(times, attitudes), expected, atol=1e-9)
    both = np.stack([attitudes, np.swapaxes(rotation(axis, rate * times), -1, -2)], axis=1)
    np.testing.assert_allclose(turning(times, both), np.stack([expected, -expected], axis=1), atol=1e-9)


SLIVERS = Path(__file__).with_name("slivers.npy")
"""The faces of a boat close to a camera, turned to it, in pixels, shape (206, 3, 2). GEOS 3.14 cannot unite them."""
STEP_PX = 0.5


def test_slivers_have_a_union_and_vessels_are_nearest_where_their_relative_track_is():
    triangles = np.load(SLIVERS)
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    x, y = (np.stack(np.meshgrid(*map(np.arange, low, high, [STEP_PX] * 2)))).reshape(2, -1)
    faces = shapely.polygons(triangles)
    covered = np.any([shapely.contains_xy(face, x, y) for face in faces], axis=0)
    union = union_of(faces)
    assert union.area == pytest.approx(covered.sum() * STEP_PX**2, rel=0.01)
    assert (shapely.contains_xy(union, x, y) == covered).mean() > 0.999
    ordinary = shapely.polygons([[(0, 0), (1 / 3, 0), (0, 1 / 7)], [(0, 0), (1 / 3, 0), (1 / 3, 1 / 7)]])
    assert union_of(ordinary).wkb == shapely.union_all(ordinary).wkb
    # One goes east with 10 m/s from the origin, the other north with 10 m/s from (1000, −1100).
    times = np.array([0.0, 40.0, 200.0])
    one, other = np.outer(times, [10.0, 0.0]), np.array([1000.0, -1100.0]) + np.outer(times, [0.0, 10.0])
    distance, when = closest_approach(times, one, other)
    assert (distance, when) == pytest.approx((100 / np.sqrt(2), 105.0))
    times, still = np.arange(4.0), np.zeros((4, 2))
    for there, expected in (([1, 1, 0, 0], (30.0, 1.0)), ([0, 0, 0, 1], (50.0, 3.0)), ([1, 0, 1, 1], (2.0, 2.0))):
        other = np.where(np.array(there)[:, None], [[40.0, 0.0], [30.0, 0.0], [2.0, 0.0], [50.0, 0.0]], np.nan)
        assert closest_approach(times, still, other) == pytest.approx(expected)
    assert closest_approach(times, still, still + np.array([3.0, 4.0])) == (5.0, 0.0)  # in company
    slow = np.array([3.0, -0.75]) + np.outer(times, [0.0, 0.5])
    assert closest_approach(times, still, slow) == pytest.approx((3.0, 1.5))
    distance, when = closest_approach(times, still, np.full((4, 2), np.nan))
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


def test_least_hull_distance_is_that_of_dense_sampling() -> None:
    rng, times = np.random.default_rng(2), np.arange(0.0, 6.0)
    for _ in range(40):
        centres = np.cumsum(rng.normal(0, 12, (6, 2, 2)), axis=0) + np.array([[0, 0], [60, 0]])
        headings = rng.uniform(-4, 4, (1, 2)) + np.cumsum(rng.uniform(-1, 1, (6, 2)), axis=0)
        wrapped = (headings + np.pi) % (2 * np.pi) - np.pi
        halves = rng.uniform(1, 12, (2, 2))
        missing = rng.random((6, 2)) < 0.1
        wrapped[missing], centres[missing] = np.nan, np.nan
        found, when = least_hull_distance(kinematics.HullTracks(times, centres, wrapped, halves), 0, 1)
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
