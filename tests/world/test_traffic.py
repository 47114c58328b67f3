"""Traffic that the seed draws: no hulls touch, encounters come out as asked, and ships are steered as ships are."""

import math

import numpy as np
import pytest
import shapely
from scipy import stats

from modsim3d.world.bodies import Obstacle, extruded
from modsim3d.world.traffic.clearance import Land, Waters
from modsim3d.world.traffic.generate import plan
from modsim3d.world.traffic.paths import VesselPath
from modsim3d.world.traffic.tracks import DrawnHull, Track, shipped_kinds
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


def test_no_hull_comes_closer_to_another_or_to_land_than_the_clearance_between_steps_too(drives):
    shapely.prepare(LAND_M)
    for drive in drives:
        for step in range(0, len(drive.poses.present) - 1, 2):
            for share in (0.0, 0.6):
                hulls = hulls_between(drive, step, share)
                first, second = np.triu_indices(len(hulls), 1)
                assert not shapely.dwithin(hulls[first], hulls[second], NEARER_M).any()
                assert not shapely.dwithin(hulls, LAND_M, NEARER_M).any()


def test_vessels_pass_below_a_bridge_that_is_above_their_masts_and_no_other():
    deck = [(-1000, -1200), (-980, -1200), (-980, 1200), (-1000, 1200)]
    lane = {"waypoints_m": [[-2000, 0], [0, 0]], "width_m": 200, "per_hour": 60, "kinds": ["tug", "coaster"]}
    drive = draw({"lanes": {"low": lane}}, land={"deck": (deck, 18.5, 3)})
    crossed = 0
    for _, craft, places, _ in ways([drive], "lanes.low"):
        crosses = len(places) and places[:, 0].min() < -1000 < places[:, 0].max()
        crossed += crosses
        assert not crosses or craft.track.hull.air_draft_m <= 18.5
    assert crossed


def test_a_track_keeps_the_clearance_from_vessels_and_from_land_and_room_beyond_it_is_preferred():
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


def test_vessels_of_a_lane_both_ways_keep_to_its_starboard_half(drives):
    for _, craft, places, headings in ways(drives, "lanes.fairway"):
        straight = places[:, 0] < 600  # the first leg lies on w2 = 0
        side = places[straight, 1] * (-1 if craft.outbound else 1)
        assert (side >= craft.track.hull.beam_m / 2).all()
        assert (np.cos(headings[straight]) > 0).all() == craft.outbound or not straight.any()


def test_vessels_keep_a_speed_of_their_kind_head_along_their_way_and_turn_no_tighter_than_their_circle(drives):
    for _, craft, places, headings in ways(drives):
        low, high = shipped_kinds()[craft.track.hull.kind]["speed_m_s"]
        assert low <= craft.track.speed_m_s <= high
        moved, turned = np.diff(places, axis=0), np.diff(np.unwrap(headings))
        np.testing.assert_allclose(np.linalg.norm(moved, axis=1) / STEP_S, craft.track.speed_m_s, rtol=0.02)
        off = np.arctan2(moved[:, 1], moved[:, 0]) - (headings[:-1] + turned / 2)
        assert np.abs(wrapped(off)).max(initial=0) < 0.02
        least = craft.track.hull.turning_radius_m * 0.97
        assert np.abs(turned).max(initial=0) <= craft.track.speed_m_s * STEP_S / least


def test_vessels_of_a_lane_are_there_from_its_one_end_to_the_other():
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


def test_arrivals_come_out_as_asked_and_traffic_is_stationary():
    lane = {"waypoints_m": [[0, 0], [3000, 0]], "width_m": 400, "per_hour": 40, "kinds": "coaster"}
    lanes = {"lane": lane | {"speed_m_s": {"coaster": 6.0}}}
    drives = [draw({"lanes": lanes}, seed, steps=41, time_step_s=5.0, land={}) for seed in range(40)]
    seen = sum(len(drive.of("lanes.lane")) for drive in drives)
    left_out = sum(sum(drive.traffic.left_out.values()) for drive in drives)
    assert left_out <= 0.02 * seen
    assert_poisson(seen + left_out, 40 * 40 / 3600 * (200 + (3000 - 80) / 6))
    for step in (0, -1):
        assert_poisson(sum(drive.poses.present[step].sum() for drive in drives), 40 * 40 / 3600 * (3000 - 80) / 6)


def test_density_of_leisure_craft_comes_out_as_asked():
    area = TRAFFIC["leisure"]["bay"] | {"per_km2": 1.0, "kinds": "kayak"}
    water = shapely.Polygon(area["polygon_m"]) - LAND_M
    seen = sum(len(draw({"leisure": {"bay": area}}, seed, steps=2).of("leisure.bay")) for seed in range(8))
    assert_poisson(seen, 8 * water.area / 1e6)


def test_no_vessel_makes_way_by_staying_away(drives):
    for drive in [*drives, *(draw(traffic_keys(lanes__ferry__per_hour=60), seed) for seed in range(3))]:
        crossings = [*drive.of("lanes.fairway"), *drive.of("lanes.ferry")]
        assert all(drive.poses.present[:, drive.column(craft.name)].any() for craft in crossings)


def test_leisure_craft_stay_in_their_area_and_kayaks_near_the_shore(drives):
    area = shapely.Polygon(TRAFFIC["leisure"]["bay"]["polygon_m"])
    for drive, craft, places, _ in ways(drives, "leisure.bay"):
        assert len(places) == len(drive.poses.present)  # they are there for the whole drive
        points = shapely.points(places)
        assert shapely.contains(area, points).all()
        assert craft.track.hull.kind != "kayak" or shapely.distance(points, LAND_M).max() < 100


def test_sailing_craft_keep_away_from_the_wind():
    area = TRAFFIC["leisure"]["bay"] | {"kinds": "sailing_yacht"}
    drive, off = draw({"leisure": {"bay": area}, "wind_from_rad": 0.5}, steps=600), []
    for *_, headings in ways([drive], "leisure.bay"):
        straight = np.abs(np.diff(np.unwrap(headings))) <= 1e-4
        off += np.abs(wrapped(headings[1:] - 0.5))[straight].tolist()
    assert len(off) > 1000 and min(off) >= math.radians(42)


def same(first: Drive, second: Drive) -> bool:
    ours, theirs = ([column.tobytes() for column in vars(drive.poses).values()] for drive in (first, second))
    return first.entries == second.entries and ours == theirs


def test_same_seed_gives_the_same_bytes_and_another_other_traffic(drives):
    plan.cache_clear()
    assert same(draw(TRAFFIC, 0), drives[0])
    assert not same(draw(TRAFFIC, 1), drives[0])


def test_a_changed_lane_leaves_the_draws_of_another_unchanged():
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


def test_a_short_drive_shows_the_beginning_of_the_same_traffic():
    keys = traffic_keys(duration_s=200.0)
    long, short = draw(keys, 3, steps=401), draw(keys, 3, steps=20)
    assert long.vessels == short.vessels
    np.testing.assert_array_equal(long.poses.positions_m[:20], short.poses.positions_m)


def test_own_ship_follows_her_route_at_a_speed_of_the_range(drives):
    starts, others = np.array([drive.way("own")[0][:2] for drive in drives]).swapaxes(0, 1)
    np.testing.assert_allclose(starts, np.tile(TRAFFIC["own"]["own"]["waypoints_m"][0], (len(SEEDS), 1)))
    speeds = np.linalg.norm(others - starts, axis=1) / STEP_S
    assert 4.5 <= speeds.min() < speeds.max() - 0.1 and speeds.max() <= 6.0


def test_entries_have_the_form_of_a_vessels_file_and_labels_may_be_renamed():
    entries, keys = draw(TRAFFIC, 0).entries.values(), {"length_m", "beam_m", "air_draft_m", "label", "mesh"}
    assert {entry["label"] for entry in entries} == {"boat", "sailboat", "ship"}
    assert all(entry.keys() <= keys for entry in entries)
    for labels, left in (({"sailboat": "boat"}, {"boat", "ship"}), ("Vessel", {"Vessel"})):
        renamed = draw(traffic_keys(labels=labels), 0)
        assert {vessel.label for vessel in renamed.vessels if vessel is not OWN} == left


def test_a_kind_of_ones_own_is_drawn_within_its_numbers():
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
