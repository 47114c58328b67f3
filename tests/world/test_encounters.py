"""Measures of traffic against cases by hand and shapely."""

import numpy as np
import pytest
import shapely

from modsim3d.geometry.kinematics import HullTracks
from modsim3d.world import encounters
from modsim3d.world.encounters import Encounter, encounter
from modsim3d.world.poses.base import waypoint_tracks
from modsim3d.world.vessels import Vessel

# Own ship heads north (w2) from the origin; the other's bearing and course as on a compass, in degrees.
AHEAD, GIVES, STANDS = Encounter.HEAD_ON, Encounter.GIVES_WAY, Encounter.STANDS_ON
CASES = [(0, 180, AHEAD), (5, 186, AHEAD), (-5, 174, AHEAD)]
CASES += [(20, 180, AHEAD)]  # passes clear to starboard, where no rule bids either to give way
CASES += [(45, 270, GIVES), (110, 315, GIVES), (-45, 90, STANDS), (-110, 45, STANDS)]
CASES += [(bearing, course, Encounter.OVERTAKEN) for bearing, course in ((115, 350), (180, 0), (-150, 10))]
CASES += [(bearing, course, Encounter.OVERTAKING) for bearing, course in ((0, 0), (10, 20))]


def compass(degrees: float) -> float:
    """A course or bearing, clockwise from north, as a heading counter-clockwise from w1, which is east."""
    return float(np.radians(90 - degrees))


@pytest.mark.parametrize(("bearing", "course", "kind"), CASES)
def test_encounters_are_those_of_rules_13_to_15(bearing: float, course: float, kind: Encounter) -> None:
    towards = compass(bearing)
    other = 900 * np.array([np.cos(towards), np.sin(towards)])
    assert encounter(np.zeros(2), compass(0), other, compass(course)) is kind
    seen = encounters.relative_bearing(np.zeros(2), compass(0), other)
    assert np.degrees(seen) == pytest.approx(bearing) or abs(bearing) == 180
    # The other sees the counterpart; turning the world changes nothing.
    counterpart = {AHEAD: AHEAD, GIVES: STANDS, STANDS: GIVES}
    counterpart |= {Encounter.OVERTAKEN: Encounter.OVERTAKING, Encounter.OVERTAKING: Encounter.OVERTAKEN}
    assert encounter(other, compass(course), np.zeros(2), compass(0)) is counterpart[kind]
    for turn in (0.7, 3.0, -2.0):
        matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        assert encounter(np.zeros(2), compass(0) + turn, matrix @ other, compass(course) + turn) is kind


def test_speeds_and_density_leave_out_absent_vessels() -> None:
    vessels = [Vessel(name, "boat", 10, 4, 3) for name in ("a", "b")]
    tracks = {"a": [(0.0, 0.0, 0.0), (4.0, 40.0, 0.0)], "b": [(1.0, 500.0, 500.0), (2.0, 500.0, 505.0)]}
    found = encounters.hull_tracks(vessels, waypoint_tracks(tracks, ["a", "b"], 5, 1.0), 5)
    assert isinstance(found, HullTracks)
    speeds = encounters.speeds_m_s(found)
    np.testing.assert_allclose(speeds[:, 0], 10.0)
    np.testing.assert_allclose(speeds[:, 1], [np.nan, 5.0, np.nan, np.nan])
    square = np.array([[-50.0, -50.0], [-50.0, 950.0], [950.0, 950.0], [950.0, -50.0]])
    assert encounters.density_per_km2(found, square) == pytest.approx((1 + 2 + 2 + 1 + 1) / 5)


def test_places_inside_a_polygon_are_those_that_shapely_finds() -> None:
    corners = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [5.0, 2.0], [0.0, 8.0]])
    places = np.random.default_rng(3).uniform(-2, 12, (500, 2))
    expected = shapely.contains_xy(shapely.Polygon(corners), places)
    np.testing.assert_array_equal(encounters.inside(corners, places), expected)
    assert 50 < expected.sum() < 400


def test_offsets_from_a_lane_are_positive_to_starboard() -> None:
    """A lane that goes 100 m east, then 100 m south."""
    waypoints = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, -100.0]])
    places = np.array([[30.0, -4.0], [60.0, 7.0], [96.0, -40.0], [100.0, -90.0]])
    along, offset = encounters.lane_offsets(waypoints, places)
    np.testing.assert_allclose(along, [30, 60, 140, 190])
    np.testing.assert_allclose(offset, [4, -7, 4, 0])
