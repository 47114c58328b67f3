"""Traffic that the seed draws: no hulls touch, encounters come out as asked, and ships are steered as ships are."""

import math

import numpy as np
import pytest
import shapely
from scipy import stats

from modsim3d.world.traffic.generate import plan
from modsim3d.world.traffic.tracks import shipped_kinds
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


def hulls_between(drive: Drive, step: int, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Polygons and columns of the vessels that are there at a step and the next one, a share of a step later."""
    poses = drive.poses
    columns = np.flatnonzero(poses.present[step] & poses.present[step + 1])
    before, after = poses.positions_m[step, columns, :2], poses.positions_m[step + 1, columns, :2]
    turn = wrapped(poses.headings_rad[step + 1, columns] - poses.headings_rad[step, columns])
    heading = poses.headings_rad[step, columns] + share * turn
    along = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    along *= np.array([[drive.vessels[column].length_m / 2] for column in columns])
    across *= np.array([[drive.vessels[column].beam_m / 2] for column in columns])
    corners = np.stack([along + across, along - across, -along - across, across - along], axis=1)
    return shapely.polygons((before + share * (after - before))[:, None] + corners), columns


def test_no_two_hulls_come_closer_than_the_clearance_between_steps_too(drives):
    for drive in drives:
        for step in range(0, len(drive.poses.present) - 1, 2):
            for share in (0.0, 0.6):
                hulls, _ = hulls_between(drive, step, share)
                first, second = np.triu_indices(len(hulls), 1)
                assert not shapely.dwithin(hulls[first], hulls[second], NEARER_M).any()


def test_no_hull_comes_closer_to_land_than_the_clearance(drives):
    shapely.prepare(LAND_M)
    for drive in drives:
        for step in range(0, len(drive.poses.present) - 1, 4):
            assert not shapely.dwithin(hulls_between(drive, step, 0.5)[0], LAND_M, NEARER_M).any()


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


def test_encounters_have_the_closest_approach_and_time_that_were_drawn(drives):
    for drive in drives:
        asking, own = [craft for craft in drive.traffic.craft if craft.asked], drive.column("own")
        assert len(asking) == 4
        for craft in asking:
            column = drive.column(craft.name)
            both = np.flatnonzero(drive.poses.present[:, column] & drive.poses.present[:, own])
            offset = drive.poses.positions_m[both, column] - drive.poses.positions_m[both, own]
            apart = np.hypot(offset[:, 0], offset[:, 1])
            asked, nearest = craft.asked, both[np.argmin(apart)] * STEP_S
            low, high = np.broadcast_to(TRAFFIC["encounters"][craft.name]["closest_m"], 2)
            assert low <= asked.closest_m <= high
            early, late = np.broadcast_to(TRAFFIC["encounters"][craft.name]["time_s"], 2)
            assert early <= asked.time_s <= late
            assert abs(nearest - asked.time_s) <= STEP_S / 2 + 1e-6
            drift = (craft.track.speed_m_s + 6.0) * STEP_S / 2
            assert asked.closest_m - 1e-3 <= apart.min() <= math.hypot(asked.closest_m, drift)


def bearing(places, headings, others):
    offset = others - places
    return wrapped(np.arctan2(offset[1], offset[0]) - headings)


def test_encounters_are_of_the_kind_that_was_asked_for(drives):
    for drive in drives:
        (own, *_), (heading, *_) = drive.way("own")
        for craft in (craft for craft in drive.traffic.craft if craft.asked):
            (place, *_), (course, *_) = drive.way(craft.name)
            seen, shown = bearing(own, heading, place), bearing(place, course, own)
            match craft.asked.kind:
                case "head_on":
                    assert abs(seen) < math.radians(45)
                    assert abs(shown) < math.radians(45)
                case "overtaking":
                    assert abs(seen) > ABAFT_RAD - 0.2
                case "overtaken":
                    assert abs(shown) > ABAFT_RAD - 0.2
                case side:
                    assert side == ("crossing_from_starboard" if seen < 0 else "crossing_from_port")
                    assert abs(seen) < ABAFT_RAD
    kinds = {craft.asked.kind for drive in drives for craft in drive.traffic.craft if craft.asked}
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


def test_arrivals_come_out_as_asked_and_traffic_is_stationary():
    lane = {"waypoints_m": [[0, 0], [3000, 0]], "width_m": 400, "per_hour": 40, "kinds": "coaster"}
    lanes = {"lane": lane | {"speed_m_s": {"coaster": 6.0}}}
    seen, early, late, expected, left_out = 0, 0, 0, 0.0, 0
    for seed in range(40):
        drive = draw({"lanes": lanes}, seed, steps=41, time_step_s=5.0, land={})
        seen += len(drive.of("lanes.lane"))
        left_out += sum(drive.traffic.left_out.values())
        early, late = early + drive.poses.present[0].sum(), late + drive.poses.present[-1].sum()
        expected += 40 / 3600 * (200 + (3000 - 80) / 6)
    assert left_out <= 0.02 * seen
    low, high = stats.poisson.interval(0.999, expected)
    assert low <= seen + left_out <= high
    there = 40 * 40 / 3600 * (3000 - 80) / 6
    for count in (early, late):
        low, high = stats.poisson.interval(0.999, there)
        assert low <= count <= high


def test_no_vessel_makes_way_by_staying_away(drives):
    for drive in [*drives, *(draw(traffic_keys(lanes__ferry__per_hour=60), seed) for seed in range(3))]:
        crossings = [*drive.of("lanes.fairway"), *drive.of("lanes.ferry")]
        assert all(drive.poses.present[:, drive.column(craft.name)].any() for craft in crossings)


def test_density_of_leisure_craft_comes_out_as_asked():
    area = TRAFFIC["leisure"]["bay"] | {"per_km2": 1.0, "kinds": "kayak"}
    water = shapely.Polygon(area["polygon_m"]) - LAND_M
    seen = sum(len(draw({"leisure": {"bay": area}}, seed, steps=2).of("leisure.bay")) for seed in range(8))
    low, high = stats.poisson.interval(0.999, 8 * water.area / 1e6)
    assert low <= seen <= high


def test_leisure_craft_stay_in_their_area_and_kayaks_near_the_shore(drives):
    area = shapely.Polygon(TRAFFIC["leisure"]["bay"]["polygon_m"])
    for drive, craft, places, _ in ways(drives, "leisure.bay"):
        assert len(places) == len(drive.poses.present)  # they are there for the whole drive
        points = shapely.points(places)
        assert shapely.contains(area, points).all()
        assert craft.track.hull.kind != "kayak" or shapely.distance(points, LAND_M).max() < 100


def test_sailing_craft_keep_away_from_the_wind():
    area = TRAFFIC["leisure"]["bay"] | {"kinds": "sailing_yacht"}
    drive = draw({"leisure": {"bay": area}, "wind_from_rad": 0.5}, steps=600)
    straight, upwind = 0, 0
    for *_, headings in ways([drive], "leisure.bay"):
        turning = np.abs(np.diff(np.unwrap(headings))) > 1e-4
        off = np.abs(wrapped(headings[1:] - 0.5))[~turning]
        straight, upwind = straight + len(off), upwind + (off < math.radians(42)).sum()
    assert straight > 1000
    assert upwind == 0


def same(first: Drive, second: Drive) -> bool:
    ours, theirs = ([column.tobytes() for column in vars(drive.poses).values()] for drive in (first, second))
    return first.vessels == second.vessels and ours == theirs


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
    speeds = []
    for drive in drives:
        places, _ = drive.way("own")
        np.testing.assert_allclose(places[0], TRAFFIC["own"]["own"]["waypoints_m"][0])
        speeds.append(np.linalg.norm(places[1] - places[0]) / STEP_S)
    assert min(speeds) >= 4.5
    assert max(speeds) <= 6.0
    assert np.ptp(speeds) > 0.1


def test_entries_have_the_form_of_a_vessels_file_and_labels_may_be_renamed():
    drive = draw(TRAFFIC, 0)
    assert {entry["label"] for entry in drive.entries.values()} == {"boat", "sailboat", "ship"}
    keys = {"length_m", "beam_m", "air_draft_m", "label", "mesh"}
    assert all(entry.keys() <= keys for entry in drive.entries.values())
    renamed = draw(traffic_keys(labels={"sailboat": "boat"}), 0)
    assert {vessel.label for vessel in renamed.vessels} == {"boat", "ship"}
    one = draw(traffic_keys(labels="Vessel"), 0)
    assert {vessel.label for vessel in one.vessels if vessel is not OWN} == {"Vessel"}


def test_a_kind_of_ones_own_is_drawn_within_its_numbers():
    barge = {"length_m": [40, 50, 60], "beam_m": [9, 11], "air_draft_m": [4, 5], "speed_m_s": 3.0, "label": "ship"}
    lane = {"waypoints_m": [[0, 0], [4000, 0]], "width_m": 300, "per_hour": 60, "kinds": "barge"}
    drive = draw({"kinds": {"barge": barge}, "lanes": {"lane": lane}}, land={}, steps=10)
    drawn = drive.vessels[1:]
    assert len(drawn) > 10
    for vessel in drawn:
        assert 40 <= vessel.length_m <= 60
        assert 9 * 0.92 <= vessel.beam_m <= 11 * 1.08
    assert np.std([vessel.length_m for vessel in drawn]) > 1


@pytest.mark.parametrize(("steps", "time_step_s"), [(1, 0.5), (3, 1e-6), (40, 7.0), (30, 0.3)])
def test_any_steps_will_do(steps, time_step_s):
    drive = draw(TRAFFIC, 0, steps, time_step_s)
    assert drive.poses.present.shape == (steps, len(drive.vessels))
    assert drive.poses.present[:, 0].all() or time_step_s == 7.0
