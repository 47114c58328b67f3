"""Wrong keys of drawn traffic: each error names the key, the value and what would be right."""

from dataclasses import replace
from pathlib import Path

import pytest

from modsim3d.core.errors import InputError
from modsim3d.world.poses.base import PoseRequest
from modsim3d.world.poses.registry import read_source
from tests.world.drawn_traffic import OWN, TRAFFIC, draw, traffic_keys

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
