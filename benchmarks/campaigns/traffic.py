"""traffic: many seeds of a scene with drawn traffic; what its section asks for comes out, and no hulls touch.

Every requirement on a vessel holds for every vessel of every seed. Every rate is held against the distribution that it
is asked to have, summed over the seeds, by exact two-sided tests. All tests together are to fail with probability 1 %
at most if the traffic is as asked (Bonferroni).
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from scipy import stats

from modsim3d.arrays import Array
from modsim3d.geometry.closest_approach import HullTracks, closest_approach, least_hull_distance
from modsim3d.motion.encounters import Encounter, encounter, hull_tracks, inside, lane_offsets, speeds_m_s
from modsim3d.motion.poses import read_source
from modsim3d.motion.poses.traffic import TrafficKeys
from modsim3d.motion.poses.traffic.craft import Craft
from modsim3d.motion.poses.traffic.keys import LaneKeys
from modsim3d.motion.poses.traffic.source import DrawnTraffic
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene

OUT = Path(__file__).resolve().parents[2] / "docs" / "campaigns"
SCENE, SEEDS, FAMILY = "fairway", 200, 0.01
SPEED_TOLERANCE = 0.02
"""A vessel's speed may leave its range by this share: a step is the chord of a turn."""
CLOSEST_TOLERANCE_M, TIME_TOLERANCE_S = 0.5, 1.0
LOOKED_AT_BEFORE_S = 600.0
"""Bearings tell the kind of an encounter while the two are far apart: so long before the closest approach, on the
courses and speeds that they have there. Whoever overtakes does so until past and clear (rule 13 d)."""
KINDS = {
    "head_on": Encounter.HEAD_ON,
    "crossing_from_starboard": Encounter.GIVES_WAY,
    "crossing_from_port": Encounter.STANDS_ON,
    "overtaking": Encounter.OVERTAKEN,
    "overtaken": Encounter.OVERTAKING,
}
"""What own ship is in an encounter of each kind."""


@dataclass(frozen=True)
class Drawn:
    """A scene of one seed, and what the measures need of it."""

    scene: Scene
    keys: TrafficKeys
    tracks: HullTracks
    craft: tuple[Craft, ...]

    @classmethod
    def of_seed(cls, scene_name: str, seed: int, settings: Mapping[str, object] | None = None) -> Drawn:
        scene = load_scene(scene_name, seed=seed, settings=settings)
        keys = read_source(scene.copy.document["poses"], scene.title).keys
        if not (isinstance(keys, TrafficKeys) and isinstance(scene.poses, DrawnTraffic)):
            raise SystemExit(f"{scene_name} has no drawn traffic")
        return cls(scene, keys, hull_tracks(scene.vessels, scene.poses, scene.steps), scene.poses.craft)

    def column(self, craft: Craft) -> int:
        return self.scene.vessel_names.index(craft.name)

    @property
    def left_out(self) -> dict[str, int]:
        return dict(self.scene.poses.left_out) if isinstance(self.scene.poses, DrawnTraffic) else {}


def look_at(scene_name: str, seed: int, settings: Mapping[str, object] | None = None) -> dict[str, Any]:
    """What is measured of one seed: requirements that are broken, counts for the tests, and the least distances."""
    drawn = Drawn.of_seed(scene_name, seed, settings)
    hulls, land = nearest_hulls_m(drawn.tracks), nearest_land_m(drawn)
    faults = [*speed_faults(drawn), *lane_faults(drawn), *area_faults(drawn)]
    meetings = [meeting(drawn, craft) for craft in drawn.craft if craft.asked]
    faults += [fault for found in meetings for fault in found.pop("faults")]
    clearance = drawn.keys.clearance_m
    faults += [f"hulls come to {hulls:.2f} m"] if hulls < clearance - 0.05 else []
    faults += [f"a hull comes to {land:.2f} m of land"] if land < clearance - 0.5 else []
    return {
        "seed": seed,
        "vessels": len(drawn.scene.vessels),
        "left_out": drawn.left_out,
        "least_hull_distance_m": round(hulls, 2),
        "least_land_distance_m": round(land, 2),
        "faults": faults,
        "lanes": {name: lane_counts(drawn, name, lane) for name, lane in drawn.keys.lanes.items()},
        "leisure": {name: sum(c.section == f"leisure.{name}" for c in drawn.craft) for name in drawn.keys.leisure},
        "encounters": meetings,
        "poses": hashlib.sha256(drawn.tracks.centres_m.tobytes()).hexdigest()[:16],
    }


def nearest_hulls_m(tracks: HullTracks) -> float:
    """Least distance of any two hulls at any time; pairs whose centres stay farther apart than that are left out."""
    count, best = tracks.centres_m.shape[1], np.inf
    reach = np.hypot(*tracks.half_sizes_m.T)
    moved = np.nanmax(np.nan_to_num(np.hypot(*np.moveaxis(np.diff(tracks.centres_m, axis=0), -1, 0))), initial=0.0)
    bounds = []
    for one in range(count):
        apart = np.hypot(*np.moveaxis(tracks.centres_m - tracks.centres_m[:, one, None], -1, 0))
        least = np.where(np.isnan(apart), np.inf, apart).min(axis=0) - reach - reach[one] - moved
        bounds += [(float(least[other]), one, other) for other in range(one)]
    for bound, one, other in sorted(bounds):
        if bound >= best:
            break
        best = min(best, least_hull_distance(tracks, one, other)[0])
    return float(best)


def nearest_land_m(drawn: Drawn) -> float:
    """Least distance of any hull from what stands in its way, at the steps."""
    tracks, best = drawn.tracks, np.inf
    parts = [
        (v[:, 2].min(), shapely.MultiPoint(v[:, :2]).convex_hull) for o in drawn.scene.obstacles for _, v in o.solids
    ]
    for column, vessel in enumerate(drawn.scene.vessels):
        land = shapely.union_all([part for base, part in parts if base < vessel.air_draft_m])
        there = np.isfinite(tracks.headings_rad[:, column])
        heading, (length, beam) = tracks.headings_rad[there, column], tracks.half_sizes_m[column]
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        across = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
        centre = tracks.centres_m[there, column]
        corners = [centre + x * length * ahead + y * beam * across for x, y in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
        if there.any():
            best = min(best, float(shapely.distance(shapely.polygons(np.stack(corners, axis=1)), land).min()))
    return best


def speed_faults(drawn: Drawn) -> Iterator[str]:
    """Vessels whose speed leaves the range of their kind."""
    speeds, sections = speeds_m_s(drawn.tracks), drawn.keys.drawing
    for craft in drawn.craft:
        low, high = drawn.keys.speed_range(sections[craft.section], craft.track.hull.kind)
        found = speeds[:, drawn.column(craft)]
        found = found[np.isfinite(found)]
        if len(found) and not (
            low * (1 - SPEED_TOLERANCE) <= found.min() and found.max() <= high * (1 + SPEED_TOLERANCE)
        ):
            yield f"{craft.name}: {found.min():.2f} to {found.max():.2f} m/s, asked for {low} to {high}"


def lane_faults(drawn: Drawn) -> Iterator[str]:
    """Vessels of a lane that come onto its port half, or leave it by that side."""
    for craft, lane in _of_lanes(drawn):
        _, starboard = _in_lane(drawn, craft, lane)
        least = drawn.tracks.half_sizes_m[drawn.column(craft), 1] if lane.both_ways else -lane.width_m / 2
        if len(starboard) and starboard.min() < least - 0.5:
            yield f"{craft.name}: comes to {starboard.min():.1f} m to starboard of the middle of her lane"


def area_faults(drawn: Drawn) -> Iterator[str]:
    """Leisure craft that leave their area."""
    for craft in drawn.craft:
        group, _, name = craft.section.partition(".")
        if group == "leisure":
            places = drawn.tracks.centres_m[:, drawn.column(craft)]
            corners = np.array(drawn.keys.leisure[name].polygon_m, dtype=np.float64)
            outside = int((np.isfinite(places[:, 0]) & ~inside(corners, places)).sum())
            if outside:
                yield f"{craft.name}: is outside her area at {outside} steps"


def _of_lanes(drawn: Drawn) -> Iterator[tuple[Craft, LaneKeys]]:
    for craft in drawn.craft:
        group, _, name = craft.section.partition(".")
        if group == "lanes":
            yield craft, drawn.keys.lanes[name]


def _in_lane(drawn: Drawn, craft: Craft, lane: LaneKeys) -> tuple[Array, Array]:
    """Way that a vessel has come in her lane, and her distance to starboard of its middle, in metres.

    Corners of the middle are rounded, and the line through the waypoints is not, so places near one are left out.
    """
    places = drawn.tracks.centres_m[:, drawn.column(craft)]
    places = places[np.isfinite(places[:, 0])]
    waypoints = np.array(lane.waypoints_m if craft.outbound else lane.waypoints_m[::-1], dtype=np.float64)
    along, starboard = lane_offsets(waypoints, places)
    corners = np.cumsum(np.hypot(*np.diff(waypoints, axis=0).T))[:-1]
    straight = (np.abs(along[:, None] - corners) > CORNER_M).all(axis=1)
    return along[straight], starboard[straight]


CORNER_M = 700.0


def lane_counts(drawn: Drawn, name: str, lane: LaneKeys) -> dict[str, Any]:
    """How many vessels are in a lane at the start, and how many enter it, by kind and direction; steps outside it."""
    own = [craft for craft, keys in _of_lanes(drawn) if keys is lane]
    there = np.isfinite(drawn.tracks.headings_rad)
    entering = [craft for craft in own if not there[0, drawn.column(craft)] and there[:, drawn.column(craft)].any()]
    offsets = [_in_lane(drawn, craft, lane)[1] for craft in own]
    beyond = [(np.abs(found) > lane.width_m / 2).sum() for found in offsets]
    ranges = [drawn.keys.speed_range(lane, craft.track.hull.kind) for craft in entering]
    return {
        "at_start": sum(bool(there[0, drawn.column(craft)]) for craft in own),
        "entering": len(entering),
        "outbound": sum(craft.outbound for craft in entering),
        "kinds": dict(Counter(craft.track.hull.kind for craft in entering)),
        "fast": sum(c.track.speed_m_s > sum(both) / 2 for c, both in zip(entering, ranges, strict=True)),
        "steps": int(sum(map(len, offsets))),
        "steps_outside": int(sum(beyond)),
    }


def meeting(drawn: Drawn, craft: Craft) -> dict[str, Any]:
    """What was asked of an encounter, and what came of it."""
    asked, tracks = craft.asked, drawn.tracks
    if asked is None:
        raise ValueError(craft.name)
    own, other = drawn.scene.vessel_names.index(asked.own), drawn.column(craft)
    distance, when = closest_approach(tracks.times_s, tracks.centres_m[:, own], tracks.centres_m[:, other])
    keys = drawn.keys.encounters[craft.section.partition(".")[2]]
    step = min(int(np.searchsorted(tracks.times_s, asked.time_s)), len(tracks.times_s) - 2)
    places, headings = tracks.centres_m[step], tracks.headings_rad[step]
    moved = (tracks.centres_m[step + 1] - places) / (tracks.times_s[step + 1] - tracks.times_s[step])
    before = places - LOOKED_AT_BEFORE_S * moved
    kind = encounter(before[own], headings[own], before[other], headings[other])
    faults = []
    if not abs(distance - asked.closest_m) <= CLOSEST_TOLERANCE_M or not abs(when - asked.time_s) <= TIME_TOLERANCE_S:
        wanted = f"{asked.closest_m:.1f} m at {asked.time_s:.1f} s"
        faults.append(f"{craft.name}: {distance:.1f} m at {when:.1f} s, drawn as {wanted}")
    if kind is not KINDS[asked.kind]:
        faults.append(f"{craft.name}: {kind.name} by bearings, drawn as {asked.kind}")
    for value, (low, high), what in ((asked.closest_m, keys.closest_m, "m"), (asked.time_s, keys.time_s, "s")):
        if not low <= value <= high:
            faults.append(f"{craft.name}: {value:.1f} {what} is not in [{low}, {high}]")
    return {
        "section": craft.section,
        "kind": asked.kind,
        "far": asked.closest_m > sum(keys.closest_m) / 2,
        "late": asked.time_s > sum(keys.time_s) / 2,
        "from_starboard": asked.kind == "crossing_from_starboard" if keys.kind == "crossing" else None,
        "closest_error_m": round(abs(distance - asked.closest_m), 3),
        "time_error_s": round(abs(when - asked.time_s), 3),
        "faults": faults,
    }


@dataclass(frozen=True)
class Test:
    """A number against the distribution that it should have."""

    name: str
    found: int
    expected: float
    law: str
    p_value: float

    @classmethod
    def poisson(cls, name: str, found: int, mean: float) -> Test:
        return cls(name, found, mean, "Poisson", _two_sided(stats.poisson(mean), found))

    @classmethod
    def binomial(cls, name: str, found: int, of: int, share: float) -> Test:
        return cls(name, found, of * share, f"binomial of {of}", _two_sided(stats.binom(of, share), found))


def _two_sided(law: Any, found: int) -> float:
    return float(min(1.0, 2 * min(law.cdf(found), law.sf(found - 1))))


def tests_of(rows: Sequence[dict[str, Any]], scene: Scene, keys: TrafficKeys) -> list[Test]:
    """Every rate of the section, over all seeds."""
    found = [test for name, lane in keys.lanes.items() for test in _lane_tests(rows, scene, keys, name, lane)]
    land = shapely.union_all([shapely.MultiPoint(v[:, :2]).convex_hull for o in scene.obstacles for _, v in o.solids])
    for name, area in keys.leisure.items():
        water_km2 = shapely.Polygon(area.polygon_m).difference(land).area / 1e6
        total = sum(row["leisure"][name] + row["left_out"].get(f"leisure.{name}", 0) for row in rows)
        found.append(Test.poisson(f"leisure.{name}: craft", total, len(rows) * area.per_km2 * water_km2))
    for name in keys.encounters:
        met = [each for row in rows for each in row["encounters"] if each["section"] == f"encounters.{name}"]
        found.append(Test.binomial(f"encounters.{name}: farther than the middle", _sum(met, "far"), len(met), 0.5))
        found.append(Test.binomial(f"encounters.{name}: later than the middle", _sum(met, "late"), len(met), 0.5))
        sides = [each for each in met if each["from_starboard"] is not None]
        if sides:
            found.append(
                Test.binomial(f"encounters.{name}: from starboard", _sum(sides, "from_starboard"), len(sides), 0.5)
            )
    return found


def _lane_tests(
    rows: Sequence[dict[str, Any]], scene: Scene, keys: TrafficKeys, name: str, lane: LaneKeys
) -> Iterator[Test]:
    counts = [row["lanes"][name] for row in rows]
    duration_s = float(scene.times_s(scene.steps - 1, scene.steps)[0])
    entering, weights = _sum(counts, "entering"), sum(lane.kinds.values())
    yield Test.poisson(f"lanes.{name}: enter", entering, len(rows) * lane.per_hour * duration_s / 3600)
    length_m = float(np.hypot(*np.diff(np.array(lane.waypoints_m), axis=0).T).sum())
    slowness = sum(w / weights * _mean_slowness(keys.speed_range(lane, kind)) for kind, w in lane.kinds.items())
    present = len(rows) * lane.per_hour / 3600 * length_m * slowness
    yield Test.poisson(f"lanes.{name}: there at the start", _sum(counts, "at_start"), present)
    if lane.both_ways:
        yield Test.binomial(f"lanes.{name}: outbound", _sum(counts, "outbound"), entering, 0.5)
    yield Test.binomial(f"lanes.{name}: faster than the middle of the range", _sum(counts, "fast"), entering, 0.5)
    for kind, weight in lane.kinds.items():
        if len(lane.kinds) > 1:
            drawn = sum(each["kinds"].get(kind, 0) for each in counts)
            yield Test.binomial(f"lanes.{name}: {kind}", drawn, entering, weight / weights)


def _mean_slowness(speeds: tuple[float, float]) -> float:
    """Mean of 1/v of an evenly drawn speed, in s/m."""
    low, high = speeds
    return float(np.log(high / low) / (high - low)) if high > low else 1 / low


def _sum(rows: Sequence[Mapping[str, Any]], key: str) -> int:
    return int(sum(row[key] for row in rows))


def verdict(rows: Sequence[dict[str, Any]], tests: Sequence[Test]) -> list[str]:
    """Everything that is not as asked; empty if all is."""
    said = [f"seed {row['seed']}: {fault}" for row in rows for fault in row["faults"]]
    said += [
        f"{test.name}: {test.found}, expected {test.expected:.1f}"
        for test in tests
        if test.p_value < FAMILY / len(tests)
    ]
    if len({row["poses"] for row in rows}) < len(rows):
        said.append("two seeds have the same traffic")
    return said


def page(scene_name: str, rows: Sequence[dict[str, Any]], tests: Sequence[Test], versions: Mapping[str, str]) -> str:
    met = [each for row in rows for each in row["encounters"]]
    left_out = Counter[str]()
    for row in rows:
        left_out.update(row["left_out"])
    lanes = {name: [row["lanes"][name] for row in rows] for name in rows[0]["lanes"]}
    outside = {name: _sum(counts, "steps_outside") / max(_sum(counts, "steps"), 1) for name, counts in lanes.items()}
    wrong = verdict(rows, tests)
    lines = [
        "# Drawn traffic comes out as asked",
        "",
        f"Written by `script/campaign traffic`; the same figures are in `traffic.json`. {len(rows)} traffic seeds of "
        f"the scene `{scene_name}`, {sum(row['vessels'] for row in rows):,} vessels.",
        "",
        f"**{len(wrong)} of the requirements below are broken.**" + "".join(f"\n- {each}" for each in wrong[:20]),
        "",
        "| For every vessel of every seed | |",
        "|---|---|",
        f"| least distance of two hulls, at steps and between them | {_least(rows, 'least_hull_distance_m')} |",
        f"| least distance of a hull from land, at steps | {_least(rows, 'least_land_distance_m')} |",
        "| vessels nearer than `clearance_m`, out of their kind's range of speeds, on the port half of their lane, outside "
        f"their area, or in another encounter than asked | {sum(len(row['faults']) for row in rows)} |",
        f"| encounters | {len(met)} |",
        f"| greatest error of the closest approach asked for | {max(each['closest_error_m'] for each in met):.2f} m |",
        f"| greatest error of its time | {max(each['time_error_s'] for each in met):.2f} s |",
        f"| seeds with the same traffic as another | {len(rows) - len({row['poses'] for row in rows})} |",
        "| vessels left out for want of room | "
        + (", ".join(f"{name} {count}" for name, count in sorted(left_out.items())) or "none")
        + " |",
        *(f"| share of steps outside the lane `{name}`, making way | {share:.2%} |" for name, share in outside.items()),
        "",
        f"Rates over all seeds, by exact two-sided tests. A rate is as asked if p is at least {FAMILY:g} / {len(tests)} "
        f"= {FAMILY / len(tests):.1g}; where all rates are as asked, this fails with probability {FAMILY:.0%} at most.",
        "",
        "| Rate | Found | Expected | Law | p |",
        "|---|---|---|---|---|",
        *(f"| {t.name} | {t.found} | {t.expected:.1f} | {t.law} | {t.p_value:.2g} |" for t in tests),
        "",
        "With " + ", ".join(f"{name} {number}" for name, number in versions.items()) + ".",
    ]
    return "\n".join(lines) + "\n"


def _least(rows: Sequence[Mapping[str, Any]], key: str) -> str:
    return f"{min(row[key] for row in rows):.1f} m"


def main() -> int:
    parser = argparse.ArgumentParser(prog="script/campaign traffic", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scene", default=SCENE)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=OUT, help="folder for traffic.md and traffic.json")
    asked = parser.parse_args()
    rows = []
    with ProcessPoolExecutor(asked.processes, multiprocessing.get_context("spawn")) as pool:
        for row in pool.map(look_at, [asked.scene] * asked.seeds, range(asked.seeds)):
            rows.append(row)
            print(row["seed"], row["vessels"], row["left_out"], *row["faults"], sep="  ", file=sys.stderr, flush=True)
    drawn = Drawn.of_seed(asked.scene, 0)
    tests = tests_of(rows, drawn.scene, drawn.keys)
    versions = {"modsim3d": version("modsim3d"), "NumPy": np.__version__, "Shapely": shapely.__version__}
    content = {
        "format": 1,
        "scene": asked.scene,
        "versions": versions,
        "seeds": rows,
        "tests": [vars(t) for t in tests],
    }
    asked.out.mkdir(parents=True, exist_ok=True)
    (asked.out / "traffic.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    (asked.out / "traffic.md").write_text(page(asked.scene, rows, tests, versions), encoding="utf-8")
    return int(bool(verdict(rows, tests)))


if __name__ == "__main__":
    sys.exit(main())
