"""Traffic that the seed draws: no hulls touch, encounters as asked and as measured, and wrong keys are named."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from scipy import stats

from modsim3d.core.errors import InputError
from modsim3d.geometry.kinematics import HullTracks
from modsim3d.world import encounters
from modsim3d.world.bodies import Obstacle, extruded
from modsim3d.world.encounters import Encounter, encounter
from modsim3d.world.poses.base import PoseRequest, waypoint_tracks
from modsim3d.world.poses.registry import read_source
from modsim3d.world.traffic.clearance import Land, Waters
from modsim3d.world.traffic.generate import plan
from modsim3d.world.traffic.paths import VesselPath
from modsim3d.world.traffic.tracks import DrawnHull, Track, shipped_kinds
from modsim3d.world.vessels import Vessel
from tests.scenes import rectangles
from tests.world.drawn_traffic import LAND, OWN, TRAFFIC, Drive, draw, traffic_keys

SEEDS = range(6)
STEP_S = 0.5
ABAFT_RAD = math.radians(112.5)
LAND_M = shapely.union_all([shapely.Polygon(corners) for corners, _, _ in LAND.values()])
NEARER_M = float(np.nextafter(10.0, 0.0))  # nearer than the clearance, which is the least distance that is kept


@pytest.fixture(scope="module")
def drives() -> list[Drive]:
    return [draw(TRAFFIC, seed) for seed in SEEDS]


def wrapped(angle_rad):
    return (angle_rad + np.pi) % (2 * np.pi) - np.pi


def ways(drives: list[Drive], section: str = ""):
    """All drawn vessels, or those of a section, each with its drive, its places and its headings."""
    for drive in drives:
        for craft in drive.of(section) if section else drive.traffic.craft:
            yield drive, craft, *drive.way(craft.name)


def hulls_between(drive: Drive, step: int, share: float) -> np.ndarray:
    """Polygons of the vessels that are there at a step and the next one, a share of a step later."""
    poses = drive.poses
    columns = np.flatnonzero(poses.present[step] & poses.present[step + 1])
    before, after = poses.positions_m[step : step + 2, columns, :2]
    heading, later = poses.headings_rad[step : step + 2, columns]
    sizes = np.array([drive.vessels[column].extents_m[:2] for column in columns]).reshape(-1, 2)
    return rectangles(before + share * (after - before), heading + share * wrapped(later - heading), sizes)


def test_no_hull_comes_closer_than_the_clearance_and_vessels_pass_below_bridges_above_their_masts(drives):
    shapely.prepare(LAND_M)
    for drive in drives:
        for step in range(0, len(drive.poses.present) - 1, 2):
            for share in (0.0, 0.6):
                hulls = hulls_between(drive, step, share)
                first, second = np.triu_indices(len(hulls), 1)
                assert not shapely.dwithin(hulls[first], hulls[second], NEARER_M).any()
                assert not shapely.dwithin(hulls, LAND_M, NEARER_M).any()
    deck = [(-1000, -1200), (-980, -1200), (-980, 1200), (-1000, 1200)]
    lane = {"waypoints_m": [[-2000, 0], [0, 0]], "width_m": 200, "per_hour": 60, "kinds": ["tug", "coaster"]}
    drive = draw({"lanes": {"low": lane}}, land={"deck": (deck, 18.5, 3)})
    crossed = 0
    for _, craft, places, _ in ways([drive], "lanes.low"):
        crosses = len(places) and places[:, 0].min() < -1000 < places[:, 0].max()
        crossed += crosses
        assert not crosses or craft.track.hull.air_draft_m <= 18.5
    assert crossed


def bearing(places, headings, others):
    offset = others - places
    return wrapped(np.arctan2(offset[1], offset[0]) - headings)


def test_encounters_have_the_kind_closest_approach_and_time_that_were_asked_for(drives):
    kinds = set()
    for drive in drives:
        asking, own = [craft for craft in drive.traffic.craft if craft.asked], drive.column("own")
        assert len(asking) == 4
        (ours, *_), (heading, *_) = drive.way("own")
        for craft in asking:
            column, asked = drive.column(craft.name), craft.asked
            both = np.flatnonzero(drive.poses.present[:, column] & drive.poses.present[:, own])
            offset = drive.poses.positions_m[both, column] - drive.poses.positions_m[both, own]
            apart = np.hypot(offset[:, 0], offset[:, 1])
            for name, drawn in (("closest_m", asked.closest_m), ("time_s", asked.time_s)):
                low, high = np.broadcast_to(TRAFFIC["encounters"][craft.name][name], 2)
                assert low <= drawn <= high
            assert abs(both[np.argmin(apart)] * STEP_S - asked.time_s) <= STEP_S / 2 + 1e-6
            drift = (craft.track.speed_m_s + 6.0) * STEP_S / 2
            assert asked.closest_m - 1e-3 <= apart.min() <= math.hypot(asked.closest_m, drift)
            (place, *_), (course, *_) = drive.way(craft.name)
            seen, shown = bearing(ours, heading, place), bearing(place, course, ours)
            kinds.add(asked.kind)
            match asked.kind:
                case "head_on":
                    assert max(abs(seen), abs(shown)) < math.radians(45)
                case "overtaking":
                    assert abs(seen) > ABAFT_RAD - 0.2
                case "overtaken":
                    assert abs(shown) > ABAFT_RAD - 0.2
                case side:
                    assert side == ("crossing_from_starboard" if seen < 0 else "crossing_from_port")
                    assert abs(seen) < ABAFT_RAD
    assert {"crossing_from_starboard", "crossing_from_port"} <= kinds


def test_vessels_of_a_lane_keep_to_its_starboard_half_from_its_one_end_to_the_other(drives):
    for _, craft, places, headings in ways(drives, "lanes.fairway"):
        straight = places[:, 0] < 600  # the first leg lies on w2 = 0
        side = places[straight, 1] * (-1 if craft.outbound else 1)
        assert (side >= craft.track.hull.beam_m / 2).all()
        assert (np.cos(headings[straight]) > 0).all() == craft.outbound or not straight.any()
    for _, craft, places, headings in ways(drives):
        low, high = shipped_kinds()[craft.track.hull.kind]["speed_m_s"]
        assert low <= craft.track.speed_m_s <= high
        moved, turned = np.diff(places, axis=0), np.diff(np.unwrap(headings))
        np.testing.assert_allclose(np.linalg.norm(moved, axis=1) / STEP_S, craft.track.speed_m_s, rtol=0.02)
        off = np.arctan2(moved[:, 1], moved[:, 0]) - (headings[:-1] + turned / 2)
        assert np.abs(wrapped(off)).max(initial=0) < 0.02
        least = craft.track.hull.turning_radius_m * 0.97
        assert np.abs(turned).max(initial=0) <= craft.track.speed_m_s * STEP_S / least
    drive = draw({"lanes": {"ferry": TRAFFIC["lanes"]["ferry"] | {"per_hour": 40}}}, steps=1400)
    whole = [craft for craft in drive.of("lanes.ferry") if craft.track.start_s > 0 and craft.track.end_s < 690]
    assert whole
    for craft in whole:
        places, _ = drive.way(craft.name)
        ends, half = sorted((places[0, 1], places[-1, 1])), craft.track.hull.length_m / 2
        np.testing.assert_allclose(ends, [-1350 + half, 1050 - half], atol=6)


def assert_poisson(count, mean):
    low, high = stats.poisson.interval(0.999, mean)
    assert low <= count <= high


def test_arrivals_and_density_come_out_as_asked_and_sailing_craft_keep_away_from_the_wind():
    lane = {"waypoints_m": [[0, 0], [3000, 0]], "width_m": 400, "per_hour": 40, "kinds": "coaster"}
    lanes = {"lane": lane | {"speed_m_s": {"coaster": 6.0}}}
    drives = [draw({"lanes": lanes}, seed, steps=41, time_step_s=5.0, land={}) for seed in range(40)]
    seen = sum(len(drive.of("lanes.lane")) for drive in drives)
    left_out = sum(sum(drive.traffic.left_out.values()) for drive in drives)
    assert left_out <= 0.02 * seen
    assert_poisson(seen + left_out, 40 * 40 / 3600 * (200 + (3000 - 80) / 6))
    for step in (0, -1):
        assert_poisson(sum(drive.poses.present[step].sum() for drive in drives), 40 * 40 / 3600 * (3000 - 80) / 6)
    area = TRAFFIC["leisure"]["bay"] | {"per_km2": 1.0, "kinds": "kayak"}
    water = shapely.Polygon(area["polygon_m"]) - LAND_M
    seen = sum(len(draw({"leisure": {"bay": area}}, seed, steps=2).of("leisure.bay")) for seed in range(8))
    assert_poisson(seen, 8 * water.area / 1e6)
    area = TRAFFIC["leisure"]["bay"] | {"kinds": "sailing_yacht"}
    drive, off = draw({"leisure": {"bay": area}, "wind_from_rad": 0.5}, steps=600), []
    for *_, headings in ways([drive], "leisure.bay"):
        straight = np.abs(np.diff(np.unwrap(headings))) <= 1e-4
        off += np.abs(wrapped(headings[1:] - 0.5))[straight].tolist()
    assert len(off) > 1000 and min(off) >= math.radians(42)


def test_vessels_make_way_own_ship_on_her_route_and_leisure_craft_in_their_area(drives):
    for drive in [*drives, *(draw(traffic_keys(lanes__ferry__per_hour=60), seed) for seed in range(3))]:
        crossings = [*drive.of("lanes.fairway"), *drive.of("lanes.ferry")]
        assert all(drive.poses.present[:, drive.column(craft.name)].any() for craft in crossings)
    area = shapely.Polygon(TRAFFIC["leisure"]["bay"]["polygon_m"])
    for drive, craft, places, _ in ways(drives, "leisure.bay"):
        assert len(places) == len(drive.poses.present)  # they are there for the whole drive
        points = shapely.points(places)
        assert shapely.contains(area, points).all()
        assert craft.track.hull.kind != "kayak" or shapely.distance(points, LAND_M).max() < 100
    starts, others = np.array([drive.way("own")[0][:2] for drive in drives]).swapaxes(0, 1)
    np.testing.assert_allclose(starts, np.tile(TRAFFIC["own"]["own"]["waypoints_m"][0], (len(SEEDS), 1)))
    speeds = np.linalg.norm(others - starts, axis=1) / STEP_S
    assert 4.5 <= speeds.min() < speeds.max() - 0.1 and speeds.max() <= 6.0


def same(first: Drive, second: Drive) -> bool:
    ours, theirs = ([column.tobytes() for column in vars(drive.poses).values()] for drive in (first, second))
    return first.entries == second.entries and ours == theirs


def test_the_same_seed_gives_the_same_bytes_and_a_changed_lane_leaves_other_draws_unchanged(drives):
    plan.cache_clear()
    assert same(draw(TRAFFIC, 0), drives[0])
    assert not same(draw(TRAFFIC, 1), drives[0])
    lane = {"width_m": 200, "per_hour": 30, "kinds": ["coaster", "tug"]}
    ways = {"a": [[0, 0], [3000, 0]], "b": [[0, 5000], [3000, 5000]]}
    lanes = {name: lane | {"waypoints_m": way} for name, way in ways.items()}
    before = draw({"lanes": lanes}, steps=60, land={})
    lanes["a"] = lanes["a"] | {"per_hour": 60, "kinds": "tug"}
    after = draw({"lanes": lanes}, steps=60, land={})
    assert len(before.of("lanes.b")) >= 2
    for ours, theirs in zip(before.of("lanes.b"), after.of("lanes.b"), strict=True):
        assert ours.track.hull == theirs.track.hull
        np.testing.assert_array_equal(before.way(ours.name)[0], after.way(theirs.name)[0])
    assert len(before.of("lanes.a")) != len(after.of("lanes.a"))


def test_a_short_drive_is_the_beginning_of_the_same_traffic_and_an_own_kind_within_its_numbers():
    keys = traffic_keys(duration_s=200.0)
    long, short = draw(keys, 3, steps=401), draw(keys, 3, steps=20)
    assert long.vessels == short.vessels
    np.testing.assert_array_equal(long.poses.positions_m[:20], short.poses.positions_m)
    entries, keys = draw(TRAFFIC, 0).entries.values(), {"length_m", "beam_m", "air_draft_m", "label", "mesh"}
    assert {entry["label"] for entry in entries} == {"boat", "sailboat", "ship"}
    assert all(entry.keys() <= keys for entry in entries)
    for labels, left in (({"sailboat": "boat"}, {"boat", "ship"}), ("Vessel", {"Vessel"})):
        renamed = draw(traffic_keys(labels=labels), 0)
        assert {vessel.label for vessel in renamed.vessels if vessel is not OWN} == left
    barge = {"length_m": [40, 50, 60], "beam_m": [9, 11], "air_draft_m": [4, 5], "speed_m_s": 3.0, "label": "ship"}
    lane = {"waypoints_m": [[0, 0], [4000, 0]], "width_m": 300, "per_hour": 60, "kinds": "barge"}
    drive = draw({"kinds": {"barge": barge}, "lanes": {"lane": lane}}, land={}, steps=10)
    lengths, beams = np.array([(vessel.length_m, vessel.beam_m) for vessel in drive.vessels[1:]]).T
    assert len(lengths) > 10 and np.std(lengths) > 1
    assert (lengths >= 40).all() and (lengths <= 60).all()
    assert (beams >= 9 * 0.92).all() and (beams <= 11 * 1.08).all()


@pytest.mark.parametrize(("steps", "time_step_s"), [(1, 0.5), (3, 1e-6), (40, 7.0), (30, 0.3)])
def test_any_steps_will_do(steps, time_step_s):
    drive = draw(TRAFFIC, 0, steps, time_step_s)
    assert drive.poses.present.shape == (steps, len(drive.vessels))
    assert drive.poses.present[:, 0].all() or time_step_s == 7.0


WRONG = [
    ({"lanes__fairway__perhour": 3}, "lanes.fairway.perhour: unknown key (did you mean 'per_hour'?)"),
    ({"lanes__fairway__per_hour": -1}, "lanes.fairway.per_hour: must be at least 0"),
    ({"lanes__fairway__per_hour": float("nan")}, "lanes.fairway.per_hour: a finite number"),
    ({"lanes__fairway__kinds": ["tanke"]}, "lanes.fairway.kinds.tanke: no such kind (did you mean 'tanker'?)"),
    ({"lanes__fairway__speed_m_s": {"tugg": 3}}, "lanes.fairway.speed_m_s.tugg: no such kind (did you mean 'tug'?)"),
    ({"lanes__fairway__kinds": {"tug": 0}}, "lanes.fairway.kinds: at least one kind with a weight above 0"),
    ({"lanes__fairway__waypoints_m": [[0, 0], [0, 0]]}, "lanes.fairway.waypoints_m: waypoint 1 is less"),
    ({"lanes__fairway__waypoints_m": [[0, 0], [900, 0], [0, 9]]}, "lanes.fairway.waypoints_m: turns by more than 149°"),
    ({"lanes__fairway__waypoints_m": [[-2000, 0], [0, 0], [0, 700]]}, "lanes.fairway.waypoints_m[1]: container_ship "
     "turns on a radius of 540 m, and the legs leave room for 450"),
    ({"lanes__ferry__waypoints_m": [[-300, 0], [-300, 200]]}, "lanes.ferry.waypoints_m: the lane is 200 m long: at "
     "least 3 lengths of a ferry, 390 m"),
    ({"lanes__fairway__waypoints_m": [[-300, 0], [-300, 3000]]}, "lanes.fairway.waypoints_m: leads over an obstacle at "
     "[-300, 1124]"),
    ({"lanes__fairway__width_m": 60}, "lanes.fairway.width_m: container_ship with a beam of 49 m needs 107 m"),
    ({"leisure__bay__polygon_m": [[0, 0], [9, 9], [0, 9], [9, 0]]}, "leisure.bay.polygon_m: must be a polygon with an "
     "area, whose sides do not cross"),
    ({"leisure__bay__per_km2": 9000}, "leisure.bay.per_km2: means 152,7"),
    ({"duration_s": 1e6}, "lanes.fairway.per_hour: means 8,353 vessels, of 11,706 in all; at most 2 can be planned for "
     "1,000,001 s"),
    ({"duration_s": 1e7}, "duration_s: must be at most 1000000"),
    ({"leisure__fairway": TRAFFIC["leisure"]["bay"]}, "leisure.fairway: lanes.fairway has this name too"),
    ({"own__owm": TRAFFIC["own"]["own"]}, "own.owm: no vessel 'owm' in the scene (did you mean 'own'?)"),
    ({"own__own__waypoints_m": [[0, -1000], [0, -4000]]}, "own.own.waypoints_m: leads closer to an obstacle than "
     "clearance_m (10 m)"),
    ({"own__own__waypoints_m": [[0, 0], [2000, 0], [2000, 20]]}, "own.own.waypoints_m[1]: she turns on a radius of 36 "
     "m, and the legs leave room for 20 m"),
    ({"own": {}}, "encounters.meets: with whom? `own` has no vessel"),
    ({"encounters__meets__own": "onw"}, "encounters.meets.own: no vessel 'onw' in `own` (did you mean 'own'?)"),
    ({"encounters__meets__kind": "headon"}, "encounters.meets.kind: must be"),
    ({"encounters__meets__closest_m": [90, 50]}, "encounters.meets.closest_m: must not fall: least first"),
    ({"encounters__meets__closest_m": 5}, "encounters.meets.closest_m: the centres of hulls with clearance_m between "
     "them are 14 m apart"),
    ({"encounters__passes__kinds": "kayak"}, "encounters.passes.kinds: the fastest makes 1.6 m/s, and 'own' up to 6 "
     "m/s: one must be 1.15"),
    ({"encounters__passed__kinds": "pilot_boat"}, "encounters.passed.kinds: the slowest makes 7 m/s, and 'own' as "
     "little as 4.5 m/s: one must"),
    ({"encounters__meets__time_s": [100, 900]}, "encounters.meets.time_s: 'own' is at the end of her route after 672"),
    ({"labels": {"shp": "x"}}, "labels.shp: no kind has this label (did you mean 'ship'?)"),
    ({"labels": 3}, "labels: one label for all vessels, or a mapping"),
    ({"kinds": {"raft": {"label": "boat"}}}, "kinds.raft.length_m: missing"),
    ({"kinds": {"ferry": {"speed_m_s": 0}}}, "kinds.ferry.speed_m_s[0]: must be"),
    ({"clearance_m": 0}, "clearance_m: must be at least 0.1"),
    ({"wind_from_rad": 90}, "wind_from_rad: must be at most 6.3"),
]  # fmt: skip
"""Keys and what is said of them below `poses.traffic`."""


@pytest.mark.parametrize(("changes", "message"), WRONG)
def test_wrong_key_is_named(changes, message):
    with pytest.raises(InputError) as caught:
        draw(traffic_keys(**changes), steps=20)
    assert any(f"poses.traffic.{message}" in problem for problem in caught.value.problems), caught.value


def test_a_track_keeps_the_clearance_and_a_crowd_without_room_is_an_error(monkeypatch):
    monkeypatch.setattr("modsim3d.world.traffic.clearance.MAX_WORK", 3_000_000)
    with pytest.raises(InputError, match=r"too many vessels for the water or the time: [0-9]+ found room so far"):
        draw(traffic_keys(leisure__bay__per_km2=5), seed=77, steps=200)
    monkeypatch.setattr("modsim3d.world.traffic.clearance.MAX_WORK", 1_000_000)
    pond = {"polygon_m": [[0, 0], [300, 0], [300, 300], [0, 300]], "per_km2": 500, "kinds": "kayak"}
    with pytest.raises(InputError, match=r"too many vessels for the water or the time: [0-9]+ found room so far"):
        draw({"leisure": {"pond": pond}}, steps=2, land={})
    monkeypatch.undo()
    there, back = [[0, 0], [900, 0]], [[900, 0], [0, 0]]
    own = {name: {"waypoints_m": way, "speed_m_s": 3} for name, way in (("own", there), ("other", back))}
    source = read_source({"traffic": {"own": own}}, "scene").keys
    request = PoseRequest(Path(), ("own", "other"), (OWN, replace(OWN, name="other")), 400, 0.5, 0)
    with pytest.raises(InputError, match=r"own\.other: comes closer to 'own' than clearance_m .* at 150 s"):
        source.vessels(request)

    def abeam(north_m: float) -> Track:
        path = VesselPath.through(np.array([[0, north_m], [600, north_m]]))
        return Track(DrawnHull("boat", 20, 6, 4, 30), path, 5, 0)

    quay = extruded(np.array([[0.0, -100.0], [600.0, -100.0], [600.0, -61.0], [0.0, -61.0]]), 0, 3)
    waters = Waters.during(Land.of([Obstacle("quay", quay)]), 100, 1.0, clearance_m=10)
    waters.add(abeam(0))
    # Sides are 6 m nearer than centres; what hulls may move between two steps takes 1.75 m more, and 3.5 m to land.
    for north_m, clear, roomy in ((14, False, False), (17.7, False, False), (17.8, True, False), (34, True, True)):
        verdict = waters.judge([abeam(north_m)])
        assert waters.is_clear(abeam(north_m), 10, 60) == clear == (verdict.track is not None), north_m
        assert (verdict.crowding == 0) == roomy, north_m
    for north_m, clear, roomy in ((-44.6, False, False), (-44.4, True, False), (-34.4, True, True)):
        verdict = waters.judge([abeam(north_m)])
        assert waters.is_clear(abeam(north_m), 10, 60) and (verdict.track is not None) == clear, north_m
        assert (verdict.crowding == 0) == roomy, north_m
    ways = [abeam(north_m) for north_m in (-44.6, -44.4, -39)]
    assert waters.judge(ways).track is ways[2]


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


def test_speeds_density_places_inside_polygons_and_offsets_from_lanes_are_measured_as_defined():
    vessels = [Vessel(name, "boat", 10, 4, 3) for name in ("a", "b")]
    tracks = {"a": [(0.0, 0.0, 0.0), (4.0, 40.0, 0.0)], "b": [(1.0, 500.0, 500.0), (2.0, 500.0, 505.0)]}
    found = encounters.hull_tracks(vessels, waypoint_tracks(tracks, ["a", "b"], 5, 1.0), 5)
    assert isinstance(found, HullTracks)
    speeds = encounters.speeds_m_s(found)
    np.testing.assert_allclose(speeds[:, 0], 10.0)
    np.testing.assert_allclose(speeds[:, 1], [np.nan, 5.0, np.nan, np.nan])
    square = np.array([[-50.0, -50.0], [-50.0, 950.0], [950.0, 950.0], [950.0, -50.0]])
    assert encounters.density_per_km2(found, square) == pytest.approx((1 + 2 + 2 + 1 + 1) / 5)
    corners = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [5.0, 2.0], [0.0, 8.0]])
    places = np.random.default_rng(3).uniform(-2, 12, (500, 2))
    expected = shapely.contains_xy(shapely.Polygon(corners), places)
    np.testing.assert_array_equal(encounters.inside(corners, places), expected)
    assert 50 < expected.sum() < 400
    # A lane that goes 100 m east, then 100 m south.
    waypoints = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, -100.0]])
    places = np.array([[30.0, -4.0], [60.0, 7.0], [96.0, -40.0], [100.0, -90.0]])
    along, offset = encounters.lane_offsets(waypoints, places)
    np.testing.assert_allclose(along, [30, 60, 140, 190])
    np.testing.assert_allclose(offset, [4, -7, 4, 0])
