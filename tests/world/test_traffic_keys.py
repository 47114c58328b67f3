"""Wrong keys of drawn traffic: each error names the key, the value and what would be right."""

from dataclasses import replace
from pathlib import Path

import pytest

from modsim3d.core.errors import InputError
from modsim3d.world.poses.base import PoseRequest
from modsim3d.world.poses.registry import read_source
from tests.world.drawn_traffic import OWN, TRAFFIC, draw, traffic_keys

FAIRWAY = "poses.traffic.lanes.fairway"
WRONG = {
    "unknown key": ({"lanes__fairway__perhour": 3}, f"{FAIRWAY}.perhour: unknown key (did you mean 'per_hour'?)"),
    "negative rate": (
        {"lanes__fairway__per_hour": -1},
        f"{FAIRWAY}.per_hour: Input should be greater than or equal to 0",
    ),
    "rate that is no number": ({"lanes__fairway__per_hour": float("nan")}, f"{FAIRWAY}.per_hour: a finite number"),
    "unknown kind": (
        {"lanes__fairway__kinds": ["tanke"]},
        f"{FAIRWAY}.kinds.tanke: no such kind (did you mean 'tanker'?)",
    ),
    "speed of an unknown kind": (
        {"lanes__fairway__speed_m_s": {"tugg": 3}},
        f"{FAIRWAY}.speed_m_s.tugg: no such kind (did you mean 'tug'?)",
    ),
    "no weight": ({"lanes__fairway__kinds": {"tug": 0}}, f"{FAIRWAY}.kinds: at least one kind with a weight above 0"),
    "same place twice": (
        {"lanes__fairway__waypoints_m": [[0, 0], [0, 0]]},
        f"{FAIRWAY}.waypoints_m: waypoint 1 is less",
    ),
    "turn back": (
        {"lanes__fairway__waypoints_m": [[0, 0], [900, 0], [0, 9]]},
        f"{FAIRWAY}.waypoints_m: turns by more than 149° at waypoint 1",
    ),
    "no room to turn": (
        {"lanes__fairway__waypoints_m": [[-2000, 0], [0, 0], [0, 700]]},
        f"{FAIRWAY}.waypoints_m[1]: container_ship turns on a radius of 540 m, and the legs leave room for 450",
    ),
    "short lane": (
        {"lanes__ferry__waypoints_m": [[-300, 0], [-300, 200]]},
        "poses.traffic.lanes.ferry.waypoints_m: the lane is 200 m long: at least 3 lengths of a ferry, 390 m",
    ),
    "lane over land": (
        {"lanes__fairway__waypoints_m": [[-300, 0], [-300, 3000]]},
        f"{FAIRWAY}.waypoints_m: leads over an obstacle at [-300, 1124]",
    ),
    "narrow lane": (
        {"lanes__fairway__width_m": 60},
        f"{FAIRWAY}.width_m: container_ship with a beam of 49 m needs 107 m",
    ),
    "crossed polygon": (
        {"leisure__bay__polygon_m": [[0, 0], [9, 9], [0, 9], [9, 0]]},
        "poses.traffic.leisure.bay.polygon_m: must be a polygon with an area, whose sides do not cross",
    ),
    "too many craft": ({"leisure__bay__per_km2": 9000}, "poses.traffic.leisure.bay.per_km2: means 152,7"),
    "too many for the time": (
        {"duration_s": 1e6},
        f"{FAIRWAY}.per_hour: means 8,353 vessels, of 11,706 in all; at most 2 can be planned for 1,000,001 s",
    ),
    "drive too long": ({"duration_s": 1e7}, "poses.traffic.duration_s: Input should be less than or equal to 1000000"),
    "two of one name": (
        {"leisure__fairway": TRAFFIC["leisure"]["bay"]},
        "poses.traffic.leisure.fairway: lanes.fairway has this name too",
    ),
    "unknown own ship": (
        {"own__owm": TRAFFIC["own"]["own"]},
        "poses.traffic.own.owm: no vessel 'owm' in the scene (did you mean 'own'?)",
    ),
    "own ship ashore": (
        {"own__own__waypoints_m": [[0, -1000], [0, -4000]]},
        "poses.traffic.own.own.waypoints_m: leads closer to an obstacle than clearance_m (10 m)",
    ),
    "own ship without room to turn": (
        {"own__own__waypoints_m": [[0, 0], [2000, 0], [2000, 20]]},
        "poses.traffic.own.own.waypoints_m[1]: she turns on a radius of 36 m, and the legs leave room for 20 m",
    ),
    "nobody to meet": ({"own": {}}, "poses.traffic.encounters.meets: with whom? `own` has no vessel"),
    "unknown one to meet": (
        {"encounters__meets__own": "onw"},
        "poses.traffic.encounters.meets.own: no vessel 'onw' in `own` (did you mean 'own'?)",
    ),
    "unknown encounter": (
        {"encounters__meets__kind": "headon"},
        "poses.traffic.encounters.meets.kind: Input should be",
    ),
    "falling range": (
        {"encounters__meets__closest_m": [90, 50]},
        "poses.traffic.encounters.meets.closest_m: must not fall: least first, greatest last (got [90.0, 50.0])",
    ),
    "hulls that would touch": (
        {"encounters__meets__closest_m": 5},
        "poses.traffic.encounters.meets.closest_m: the centres of hulls with clearance_m between them are 14 m apart",
    ),
    "too slow to overtake": (
        {"encounters__passes__kinds": "kayak"},
        "poses.traffic.encounters.passes.kinds: the fastest makes 1.6 m/s, and 'own' up to 6 m/s: one must be 1.15",
    ),
    "too fast to be overtaken": (
        {"encounters__passed__kinds": "pilot_boat"},
        "poses.traffic.encounters.passed.kinds: the slowest makes 7 m/s, and 'own' as little as 4.5 m/s: one must",
    ),
    "after the route": (
        {"encounters__meets__time_s": [100, 900]},
        "poses.traffic.encounters.meets.time_s: 'own' is at the end of her route after 672 s at 6 m/s",
    ),
    "unknown label": (
        {"labels": {"shp": "x"}},
        "poses.traffic.labels.shp: no kind has this label (did you mean 'ship'?)",
    ),
    "label that is no text": ({"labels": 3}, "poses.traffic.labels: one label for all vessels, or a mapping"),
    "unfinished kind": ({"kinds": {"raft": {"label": "boat"}}}, "poses.traffic.kinds.raft.length_m: missing"),
    "kind that stands still": ({"kinds": {"ferry": {"speed_m_s": 0}}}, "poses.traffic.kinds.ferry.speed_m_s[0]: Input"),
    "no clearance": ({"clearance_m": 0}, "poses.traffic.clearance_m: Input should be greater than or equal to 0.1"),
    "wind in degrees": (
        {"wind_from_rad": 90},
        "poses.traffic.wind_from_rad: Input should be less than or equal to 6.3",
    ),
}


@pytest.mark.parametrize(("changes", "message"), WRONG.values(), ids=WRONG)
def test_wrong_key_is_named(changes, message):
    with pytest.raises(InputError) as caught:
        draw(traffic_keys(**changes), steps=20)
    assert any(message in problem for problem in caught.value.problems), caught.value


def test_crowd_without_room_is_an_error_after_a_bounded_time(monkeypatch):
    monkeypatch.setattr("modsim3d.world.traffic.clearance.MAX_WORK", 3_000_000)
    with pytest.raises(InputError, match=r"too many vessels for the water or the time: [0-9]+ found room so far"):
        draw(traffic_keys(leisure__bay__per_km2=5), seed=77, steps=200)


def test_comparing_many_vessels_takes_long_in_a_short_drive_too(monkeypatch):
    monkeypatch.setattr("modsim3d.world.traffic.clearance.MAX_WORK", 1_000_000)
    pond = {"polygon_m": [[0, 0], [300, 0], [300, 300], [0, 300]], "per_km2": 500, "kinds": "kayak"}
    with pytest.raises(InputError, match=r"too many vessels for the water or the time: [0-9]+ found room so far"):
        draw({"leisure": {"pond": pond}}, steps=2, land={})


def test_two_vessels_of_the_scene_file_must_keep_clear_of_each_other():
    there, back = [[0, 0], [900, 0]], [[900, 0], [0, 0]]
    own = {name: {"waypoints_m": way, "speed_m_s": 3} for name, way in (("own", there), ("other", back))}
    source = read_source({"traffic": {"own": own}}, "scene").keys
    request = PoseRequest(Path(), ("own", "other"), (OWN, replace(OWN, name="other")), 400, 0.5, 0)
    with pytest.raises(InputError, match=r"own\.other: comes closer to 'own' than clearance_m .* at 150 s"):
        source.vessels(request)
