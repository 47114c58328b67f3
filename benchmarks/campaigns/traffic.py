"""traffic: many seeds of a scene with drawn traffic; what its section asks for comes out, and no hulls touch.

Every requirement on a vessel holds for every vessel of every seed. Every rate is held against the distribution that it
is asked to have, summed over the seeds, by exact two-sided tests. All tests together are to fail with probability 1 %
at most if the traffic is as asked (Bonferroni).
"""

from __future__ import annotations

import argparse
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

from benchmarks.traffic_measures import Drawn, look_at
from modsim3d.scene.scene import Scene
from modsim3d.world.traffic.generate import TrafficKeys
from modsim3d.world.traffic.keys import LaneKeys

OUT = Path(__file__).resolve().parents[2] / "docs" / "campaigns"
SCENE, SEEDS, FAMILY = "fairway", 200, 0.01


@dataclass(frozen=True)
class RateTest:
    """A number against the distribution that it should have."""

    name: str
    found: int
    expected: float
    law: str
    p_value: float

    @classmethod
    def poisson(cls, name: str, found: int, mean: float) -> RateTest:
        return cls(name, found, mean, "Poisson", _two_sided(stats.poisson(mean), found))

    @classmethod
    def binomial(cls, name: str, found: int, of: int, share: float) -> RateTest:
        return cls(name, found, of * share, f"binomial of {of}", _two_sided(stats.binom(of, share), found))


def _two_sided(law: Any, found: int) -> float:
    return float(min(1.0, 2 * min(law.cdf(found), law.sf(found - 1))))


def rates_of(rows: Sequence[dict[str, Any]], scene: Scene, keys: TrafficKeys) -> list[RateTest]:
    """Every rate of the section, over all seeds."""
    found = [test for name, lane in keys.lanes.items() for test in _lane_tests(rows, scene, keys, name, lane)]
    land = shapely.union_all([shapely.MultiPoint(v[:, :2]).convex_hull for o in scene.obstacles for _, v in o.solids])
    for name, area in keys.leisure.items():
        water_km2 = shapely.Polygon(area.polygon_m).difference(land).area / 1e6
        total = sum(row["leisure"][name] + row["left_out"].get(f"leisure.{name}", 0) for row in rows)
        found.append(RateTest.poisson(f"leisure.{name}: craft", total, len(rows) * area.per_km2 * water_km2))
    for name in keys.encounters:
        met = [each for row in rows for each in row["encounters"] if each["section"] == f"encounters.{name}"]
        found.append(RateTest.binomial(f"encounters.{name}: farther than the middle", _sum(met, "far"), len(met), 0.5))
        found.append(RateTest.binomial(f"encounters.{name}: later than the middle", _sum(met, "late"), len(met), 0.5))
        sides = [each for each in met if each["from_starboard"] is not None]
        if sides:
            found.append(
                RateTest.binomial(f"encounters.{name}: from starboard", _sum(sides, "from_starboard"), len(sides), 0.5)
            )
    return found


def _lane_tests(
    rows: Sequence[dict[str, Any]], scene: Scene, keys: TrafficKeys, name: str, lane: LaneKeys
) -> Iterator[RateTest]:
    counts = [row["lanes"][name] for row in rows]
    duration_s = float(scene.times_s(scene.steps - 1, scene.steps)[0])
    entering, weights = _sum(counts, "entering"), sum(lane.kinds.values())
    yield RateTest.poisson(f"lanes.{name}: enter", entering, len(rows) * lane.per_hour * duration_s / 3600)
    length_m = float(np.hypot(*np.diff(np.array(lane.waypoints_m), axis=0).T).sum())
    slowness = sum(w / weights * _mean_slowness(keys.speed_range(lane, kind)) for kind, w in lane.kinds.items())
    present = len(rows) * lane.per_hour / 3600 * length_m * slowness
    yield RateTest.poisson(f"lanes.{name}: there at the start", _sum(counts, "at_start"), present)
    if lane.both_ways:
        yield RateTest.binomial(f"lanes.{name}: outbound", _sum(counts, "outbound"), entering, 0.5)
    yield RateTest.binomial(f"lanes.{name}: faster than the middle of the range", _sum(counts, "fast"), entering, 0.5)
    for kind, weight in lane.kinds.items():
        if len(lane.kinds) > 1:
            drawn = sum(each["kinds"].get(kind, 0) for each in counts)
            yield RateTest.binomial(f"lanes.{name}: {kind}", drawn, entering, weight / weights)


def _mean_slowness(speeds: tuple[float, float]) -> float:
    """Mean of 1/v of an evenly drawn speed, in s/m."""
    low, high = speeds
    return float(np.log(high / low) / (high - low)) if high > low else 1 / low


def _sum(rows: Sequence[Mapping[str, Any]], key: str) -> int:
    return int(sum(row[key] for row in rows))


def verdict(rows: Sequence[dict[str, Any]], tests: Sequence[RateTest]) -> list[str]:
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


def page(
    scene_name: str, rows: Sequence[dict[str, Any]], tests: Sequence[RateTest], versions: Mapping[str, str]
) -> str:
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
        "| vessels nearer than `clearance_m`, out of their kind's range of speeds, on the port half of their lane, "
        f"outside their area, or in another encounter than asked | {sum(len(row['faults']) for row in rows)} |",
        f"| encounters | {len(met)} |",
        f"| greatest error of the closest approach asked for | {max(each['closest_error_m'] for each in met):.2f} m |",
        f"| greatest error of its time | {max(each['time_error_s'] for each in met):.2f} s |",
        f"| seeds with the same traffic as another | {len(rows) - len({row['poses'] for row in rows})} |",
        "| vessels left out for want of room | "
        + (", ".join(f"{name} {count}" for name, count in sorted(left_out.items())) or "none")
        + " |",
        *(f"| share of steps outside the lane `{name}`, making way | {share:.2%} |" for name, share in outside.items()),
        "",
        f"Rates over all seeds, by exact two-sided tests: {FAMILY:.0%} for all {len(tests)} tests together, so each is "
        f"to have p of at least {FAMILY / len(tests):.1g}.",
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
    tests = rates_of(rows, drawn.scene, drawn.keys)
    versions = {"modsim3d": version("modsim3d"), "NumPy": np.__version__, "Shapely": shapely.__version__}
    content = {
        "format": 1,
        "scene": asked.scene,
        "versions": versions,
        "tests": [vars(t) for t in tests],
        "seeds": rows,
    }
    asked.out.mkdir(parents=True, exist_ok=True)
    lines = json.dumps(content).replace('{"seed":', '\n{"seed":')  # a line for each seed
    (asked.out / "traffic.json").write_text(lines + "\n", encoding="utf-8")
    (asked.out / "traffic.md").write_text(page(asked.scene, rows, tests, versions), encoding="utf-8")
    return int(bool(verdict(rows, tests)))


if __name__ == "__main__":
    sys.exit(main())
