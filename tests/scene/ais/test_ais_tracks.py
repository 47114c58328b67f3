"""Laws of projection, antenna offset, headings, jumps and resampling."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modsim3d.geometry.camera_poses import world_R_vehicle
from modsim3d.scene.ais import vessel_track
from modsim3d.scene.ais.hulls import antenna_offset
from modsim3d.scene.ais.messages import SeaRegion, local_metres, median_place, reachable
from modsim3d.scene.ais.vessel_track import HeadingSource, ReportedTrack, heading_rad, resample

NAN = math.nan
metres = st.floats(-5000, 5000)
angles = st.floats(-10, 10)


@given(st.floats(-80, 80), st.floats(-180, 180), st.floats(-300, 300), st.floats(-300, 300))
def test_local_metres_are_the_radii_of_curvature_times_angles_nearby(latitude, longitude, north_m, east_m):
    # WGS84: a = 6378137 m, 1/f = 298.257223563; meridian and transverse radii of curvature, e.g. Torge & Müller,
    # Geodesy (2012), eq. 4.13 to 4.15. What is left out grows with the square of the distance over the Earth's radius.
    a, f = 6378137.0, 1 / 298.257223563
    e2 = f * (2 - f)
    w = 1 - e2 * math.sin(math.radians(latitude)) ** 2
    meridian, transverse = a * (1 - e2) / w**1.5, a / w**0.5
    there = np.array([latitude + math.degrees(north_m / meridian)])
    across = transverse * math.cos(math.radians(latitude))
    eastward = np.array([longitude + math.degrees(east_m / across)])
    (east, north), *_ = local_metres(there, eastward, (latitude, longitude))
    tilted = 0.02 * (1 + math.tan(math.radians(abs(latitude))))  # metres; 300² / 6.4e6 = 0.014, times the tangent
    assert abs(east - east_m) < tilted and abs(north - north_m) < tilted


def test_origin_antenna_and_headings_have_the_signs_of_the_standard():
    latitude, longitude = median_place(np.array([52.0, 53.0, 54.0]), np.array([179.9, -179.9, 179.8]))
    assert latitude == 53.0 and abs(longitude) == pytest.approx(179.9)
    # A = 30 before the antenna, B = 10 behind: the middle is ahead. C = 6 to port, D = 2: the middle is to port.
    assert antenna_offset(30, 10, 6, 2) == (10, 2)
    assert antenna_offset(0, 40, 0, 8) is None  # only the size is known
    assert antenna_offset(0, 40, 4, 4) == (-20, 0)  # an antenna on the bow
    same_direction(heading_rad(np.array([0, 90, 180, 270])), np.pi * np.array([0.5, 0, -0.5, 1]))
    for reports, headings_deg, sources in (
        (([10, 10], [45, 50], [NAN, 47]), [45, 47], [COURSE, REPORT]),  # the course of a vessel that moves
        (([10] * 3, [NAN] * 3, [NAN] * 3, WAY), [90, 45, 0], [BEARING] * 3),  # between positions, without a course
        (([0.1, 10, 0.1, 0, 0.2], [10, 200, 77, 300, 5], [NAN] * 5), [200] * 5, [HELD, COURSE] + [HELD] * 3),
        (([10] * 4, [NAN] * 4, [NAN] * 4, *ACROSS_A_GAP), [90, 90, 0, 0], [BEARING] * 4),
        (([0, 0], [NAN, NAN], [NAN, NAN]), [0, 0], [NOTHING] * 2),  # north, with nothing to go by
    ):
        filled, source = headings_of(*reports)
        assert filled.tolist() == pytest.approx(headings_deg, abs=1e-9), reports
        assert source.tolist() == sources, reports


@pytest.mark.parametrize(("corners", "inside"), [((55, 12, 57, 13), 12.5), ((50, 179, 56, -179), 180.0)])
def test_region_holds_what_is_between_its_corners_in_any_order(corners, inside):
    for region in (SeaRegion.between(*corners), SeaRegion.between(*corners[2:], *corners[:2])):
        longitudes = np.array([inside, inside - 10, inside + 10])
        assert region.holds(np.full(3, 55.5), longitudes).tolist() == [True, False, False]
        assert not region.holds(np.array([60.0]), np.array([inside])).any()


@given(angles, metres, metres)
def test_hull_centre_turns_with_the_vehicle_frame(heading, ahead, to_port):
    found = vessel_track.to_hull_centre(np.zeros((1, 2)), np.array([heading]), ahead, to_port)
    np.testing.assert_allclose(found[0], (world_R_vehicle(heading) @ [ahead, to_port, 0])[:2], atol=1e-8)


@st.composite
def tracks(draw):
    speed = st.floats(-20, 20)
    reports = st.tuples(st.integers(1, 100), st.tuples(metres, metres), st.tuples(speed, speed), angles)
    steps, *columns = map(np.array, zip(*draw(st.lists(reports, min_size=1, max_size=12)), strict=True))
    return ReportedTrack(np.cumsum(steps).astype(np.float64), *columns)


def same_direction(a, b):
    np.testing.assert_allclose(np.cos(a - b), 1, atol=1e-9)


@given(tracks())
def test_resampling_at_the_reports_gives_the_reports(track):
    there, places, headings = resample(track, track.times_s, 50)
    assert there.all()
    np.testing.assert_allclose(places, track.places_m, atol=1e-8)
    same_direction(headings, track.headings_rad)


@given(st.tuples(metres, metres), st.floats(-15, 15), st.floats(-15, 15), st.booleans())
def test_a_straight_track_at_constant_speed_stays_straight(start, east, north, known):
    times = np.array([0.0, 7.0, 19.0, 60.0, 61.0, 300.0])
    velocity = np.array([east, north])
    places = np.array(start) + times[:, None] * velocity
    velocities = np.tile(velocity if known else [NAN, NAN], (6, 1))
    grid = np.arange(0, 300.5, 0.5)
    there, found, headings = resample(ReportedTrack(times, places, velocities, np.full(6, 0.3)), grid, 300)
    assert there.all()
    np.testing.assert_allclose(found, np.array(start) + grid[:, None] * velocity, atol=1e-7)
    np.testing.assert_allclose(headings, 0.3)


def test_a_turn_is_followed_where_speed_and_course_fit_the_way_and_a_long_gap_is_absence():
    # A circle of 500 m at 5 m/s, reported every 30 s (17°): the cubic errs by R θ⁴ / 384, the chord by R θ² / 8.
    radius, speed, every = 500.0, 5.0, 30.0
    theta, times, grid = speed * every / radius, np.arange(0, 301, every), np.arange(0, 300.25, 0.25)

    def around(t):
        """Unit vectors from the centre."""
        return np.stack([np.cos(speed * t / radius), np.sin(speed * t / radius)], axis=-1)

    headings = speed * times / radius + math.pi / 2
    turning = speed * np.stack([np.cos(headings), np.sin(headings)], axis=-1)
    curved, straight = (
        np.linalg.norm(resample(track, grid, 400)[1] - radius * around(grid), axis=1).max()
        for track in (ReportedTrack(times, radius * around(times), way, headings) for way in (turning, turning * NAN))
    )
    assert curved < 2 * radius * theta**4 / 384 and straight == pytest.approx(radius * theta**2 / 8, rel=0.02)
    times, places = np.array([0.0, 60.0]), np.array([[0.0, 0.0], [300.0, 0.0]])
    wrong = np.array([[0.0, 50.0], [0.0, 50.0]])
    _, found, _ = resample(ReportedTrack(times, places, wrong, np.zeros(2)), np.array([15.0, 30.0, 50.0]), 400)
    np.testing.assert_allclose(found, [[75, 0], [150, 0], [250, 0]])
    times = np.array([10.0, 20.0, 120.0, 130.0])
    track = ReportedTrack(times, np.zeros((4, 2)), np.full((4, 2), NAN), np.zeros(4))
    grid = np.arange(0, 141, 5.0)
    for max_gap_s, expected in ((99.9, [10, 15, 20, 120, 125, 130]), (100, [*range(10, 131, 5)])):
        there, *_ = resample(track, grid, max_gap_s)
        assert grid[there].tolist() == expected


@given(st.floats(0, 360), st.floats(-179, 179), st.floats(0, 1))
def test_heading_turns_along_the_shorter_arc(start, turn, share):
    headings = heading_rad(np.array([start, (start + turn) % 360]))
    track = ReportedTrack(np.array([0.0, 1.0]), np.zeros((2, 2)), np.full((2, 2), NAN), headings)
    *_, found = resample(track, np.array([share]), 10)
    same_direction(found, heading_rad(np.array([start + share * turn])))


def headings_of(speed, course, heading, places=None, times=None):
    number = len(speed)
    times = np.arange(number) * 10.0 if times is None else np.array(times)
    places = np.zeros((number, 2)) if places is None else np.array(places, dtype=float)
    arrays = (np.array(values, dtype=float) for values in (speed, course, heading))
    return vessel_track.fill_headings(times, places, *arrays, 100)


REPORT, COURSE, BEARING, HELD, NOTHING = HeadingSource
WAY, ACROSS_A_GAP = [[0, 0], [50, 0], [50, 50]], ([[0, 0], [50, 0], [0, 5000], [0, 5050]], [0, 10, 1000, 1010])


@given(st.integers(0, 19), st.floats(500, 1e5), st.floats(0, 2 * math.pi))
def test_one_wrong_position_is_dropped_wherever_it_stands(wrong, far, bearing):
    times = np.arange(20) * 10.0
    places = np.stack([times * 5, np.zeros(20)], axis=1)
    # Further than anything reached in half the track at 10 m/s.
    places[wrong] += (far + 1500) * np.array([math.cos(bearing), math.sin(bearing)])
    assert np.flatnonzero(~reachable(times, places, 10.0)).tolist() == [wrong]


def brute_force(times, places, fastest, slack):
    """The longest chain of pieces, by trying every choice of them."""
    number = len(times)

    def possible(i, j):
        return np.linalg.norm(places[j] - places[i]) <= fastest * (times[j] - times[i] + slack)

    cuts = [i for i in range(1, number) if not possible(i - 1, i)]
    pieces = list(zip([0, *cuts], [*cuts, number], strict=True))
    best = 0
    for choice in range(1, 2 ** len(pieces)):
        chosen = [piece for k, piece in enumerate(pieces) if choice >> k & 1]
        if all(possible(a[1] - 1, b[0]) for a, b in pairwise(chosen)):
            best = max(best, sum(stop - first for first, stop in chosen))
    return best


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(1, 20), st.integers(-200, 200)), min_size=1, max_size=9))
def test_reachable_keeps_as_many_as_any_choice_of_pieces(steps):
    times = np.cumsum([float(step) for step, _ in steps])
    places = np.array([[float(place), 0.0] for _, place in steps])
    kept = reachable(times, places, 5.0)
    assert kept.sum() == brute_force(times, places, 5.0, 1.0)
    assert (np.abs(np.diff(places[kept, 0])) <= 5.0 * (np.diff(times[kept]) + 1.0)).all()
