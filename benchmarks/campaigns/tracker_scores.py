"""tracker_scores: trackers behind the shipped scenes, over traffic seeds, with the references beside them.

The fairway draws its traffic, so its table is over traffic seeds, with detector seeds nested in them: the mean over the
detector seeds of each traffic, then the interval over these means. The other scenes replay one traffic, and their
intervals are over detector seeds: they hold for this traffic only. No seed here is one that settings were chosen on.
Trackers in the world have scores in metres; beside them stand those in images, with their boxes on the sea.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import sys
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.special import stdtrit

from benchmarks.tracker_trials import (
    OCCLUSION_EDGES_S,
    ORACLES,
    SCENES,
    looks,
    mean_and_interval,
    perfect_detector,
    scores,
    tracks_lost_when_hidden,
    tracks_of,
    world_tracks_of,
)
from modsim3d.scene.reading import load_scene
from modsim3d.tracking.trackers.registry import named_tracker
from modsim3d.tracking.world.scoring import score_world

OUT = Path(__file__).resolve().parents[2] / "docs" / "campaigns"
TRACKERS = ("reference", "sort", "bytetrack", "ocsort")
DRAWN = "fairway"
SEEDS, LOOKS, OTHER_LOOKS = 20, 2, 10
MISS_RATES, MISS_SEEDS, MISS_STEPS = (0.0, 0.1, 0.2, 0.4), 8, 300
PERFECT_LEAST = 0.9
"""HOTA that `reference` is to reach behind a perfect detector."""
PERFECT_SETTINGS = {
    "noise_share": 0.02,
    "noise_x_px": 0.03,
    "noise_y_px": 0.03,
    "first_speed_px_s": 40.0,
    "gate_probability": 1 - 1e-9,
    "start_confidence": 0.2,
    "confirm_hits": 1,
    "lost_s": 3.0,
    "coast_s": 0.05,
}
"""Of `reference` for a detector without errors; found by hand and by a search on seeds 1001 and 1002 of the fairway."""
PERFECT_IN: dict[str, dict[str, float]] = {
    "fairway": {"velocity_change_px_s": 15.0},
    "strait": {"velocity_change_px_s": 38.0},
    "harbour": {
        "velocity_change_px_s": 25.0,
        "first_speed_px_s": 14.0,
        "noise_share": 0.023,
        "noise_x_px": 0.022,
        "noise_y_px": 1.1,
        "gate_probability": 1 - 1e-11,
        "lost_s": 2.7,
    },
    "simulation_1": {"velocity_change_px_s": 30.0},
    "simulation_2": {"velocity_change_px_s": 330.0},
    "simulation_3": {"velocity_change_px_s": 400.0},
}
"""How fast boxes change their velocity in each scene, and what else is its own; found on that scene."""
MAIN = ("hota", "hota_centre", "deta", "assa", "idf1", "id_switches", "false_tracks")
WORLD_TRACKERS = {
    "world_gnn": ("world_gnn", {}),
    "world_gnn with AIS": ("world_gnn", {"ais": True}),
    "world_jpda": ("world_jpda", {}),
} | {f"{name}, boxes on the sea": (name, {}) for name in TRACKERS}
"""Name of each line in metres, with its tracker and what is set beside the settings chosen for the scene."""
WORLD = {
    "gospa_m": ("GOSPA, m", 0),
    "gospa_localisation_m": ("of it localisation", 0),
    "gospa_missed_m": ("missed", 0),
    "gospa_false_m": ("false", 0),
    "followed_share": ("Followed", 2),
    "rmse_m": ("RMSE, m", 1),
    "rmse_m_s": ("RMSE, m/s", 1),
    "anees": ("ANEES", 1),
    "id_switches": ("ID switches", 1),
    "false_tracks": ("False tracks", 1),
    "established_m": ("Established at, m", 0),
}
"""Scores in metres, with their headings and decimals."""
WORLD_STEPS = 200
"""The most steps of a scene in metres: trackers in the world take some 10 ms a frame."""
PARTS = ("detector", "perfect", "misses", "world")
CENTRE_DIFFERENCES = "differences_centre"
ROWS = "tracker_scores.parquet"
Row = dict[str, Any]


def trial(job: tuple[str, int, int, int | None]) -> list[Row]:
    """All trackers and references on the looks at one traffic."""
    name, seed, count, steps = job
    return [
        {"scene": name, "traffic_seed": seed, "detector_seed": look, "tracker": tracker}
        | scores(rows, tracks_of(rows, tracker))
        for look, rows in looks(name, seed, count, steps)
        for tracker in (*TRACKERS, *ORACLES)
    ]


def perfect_trial(job: tuple[str, int, int | None]) -> list[Row]:
    """The reference tracker behind a detector without errors, and tracks that lose what is wholly hidden."""
    name, seed, steps = job
    detector = perfect_detector(load_scene(name).detector.labels)
    ((_, rows),) = looks(name, seed, 1, steps, detector)
    settings = PERFECT_SETTINGS | PERFECT_IN[name]
    every = {"reference": tracks_of(rows, "reference", settings), "lost when hidden": tracks_lost_when_hidden(rows)}
    return [
        {"scene": name, "traffic_seed": seed, "tracker": tracker} | scores(rows, tracks, annotated=True)
        for tracker, tracks in every.items()
    ]


def miss_trial(job: tuple[str, int, float, int | None]) -> list[Row]:
    """All trackers behind a detector that does nothing but miss."""
    name, seed, miss_rate, steps = job
    detector = perfect_detector(load_scene(name).detector.labels, miss_rate)
    ((_, rows),) = looks(name, seed, 1, steps, detector)
    return [
        {"scene": name, "traffic_seed": seed, "miss_rate": miss_rate, "tracker": tracker}
        | scores(rows, tracks_of(rows, tracker), annotated=True)
        for tracker in TRACKERS
    ]


def world_trial(job: tuple[str, int, int, int | None]) -> list[Row]:
    """All trackers in metres on the looks at one traffic."""
    name, seed, count, steps = job
    found = []
    for look, rows in looks(name, seed, count, steps):
        for line, (tracker, settings) in WORLD_TRACKERS.items():
            scored = score_world(rows, world_tracks_of(rows, named_tracker(tracker, settings, name))).flat()
            seeds = {"scene": name, "traffic_seed": seed, "detector_seed": look, "tracker": line}
            found.append(seeds | {key: scored[key] for key in WORLD})
    return found


def nested(rows: Iterable[Row], key: str) -> dict[str, Any]:
    """Mean of a score and its interval: over the traffics if there are several, else over the looks at the one."""
    by_traffic: dict[int, list[float]] = {}
    for row in rows:
        if row[key] is not None:
            by_traffic.setdefault(row["traffic_seed"], []).append(row[key])
    traffics = list(by_traffic.values())
    means = [float(np.mean(each)) for each in traffics]
    return mean_and_interval(means if len(means) > 1 else traffics[0] if traffics else [])


def pooled(counts: Sequence[tuple[int, int]]) -> dict[str, Any]:
    """Share of all occlusions that are survived, and half its 95 % interval over seeds.

    Occlusions of one seed belong together, so the interval is that of a ratio of sums over seeds (Cochran (1977),
    "Sampling Techniques", equation 2.39, with Student's t). There is none where all seeds have the same share.

    Args:
        counts: How many occlusions there are in each seed, and how many of them are survived.
    """
    each = np.array([count for count in counts if count[0]], dtype=float).reshape(-1, 2)
    many, survived = each.sum(axis=0)
    found: dict[str, Any] = {"all": int(many), "survived": int(survived), "n": len(each), "mean": None, "half": None}
    if len(each):
        found["mean"] = float(survived / many)
        residual = each[:, 1] - found["mean"] * each[:, 0]
        if len(each) > 1 and not np.allclose(residual, 0):
            deviation = np.sqrt(len(each) / (len(each) - 1) * np.sum(residual**2)) / many
            found["half"] = float(stdtrit(len(each) - 1, 0.975) * deviation)
    return found


def shares(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Share of occlusions of each length that are survived, with an interval over traffics or looks."""
    seed = "traffic_seed" if len({row["traffic_seed"] for row in rows}) > 1 else "detector_seed"
    found = []
    for k in range(len(OCCLUSION_EDGES_S) - 1):
        counts: dict[int, tuple[int, int]] = {}
        for row in rows:
            before = counts.get(row[seed], (0, 0))
            counts[row[seed]] = (before[0] + row["occlusions"][k][0], before[1] + row["occlusions"][k][1])
        found.append(pooled(list(counts.values())))
    return found


def table(rows: Sequence[Row], scene: str) -> list[dict[str, Any]]:
    """The lines of a scene's table."""
    lines = []
    for tracker in (*TRACKERS, *ORACLES):
        own = [row for row in rows if row["scene"] == scene and row["tracker"] == tracker]
        states = sorted({state for row in own for state in row["states"]})
        with_states = [row | {f"state {state}": row["states"].get(state) for state in states} for row in own]
        lines.append(
            {"tracker": tracker}
            | {key: nested(own, key) for key in MAIN}
            | {"states": {state: nested(with_states, f"state {state}") for state in states}}
            | {"occlusions": shares(own)}
        )
    return lines


def differences(rows: Sequence[Row], key: str = "hota") -> list[dict[str, Any]]:
    """Paired differences of trackers on the drawn scene: the same traffic and detections for both."""
    means = {
        tracker: {
            seed: float(
                np.mean(
                    [
                        row[key]
                        for row in rows
                        if (row["tracker"], row["traffic_seed"], row["scene"]) == (tracker, seed, DRAWN)
                    ]
                )
            )
            for seed in sorted({row["traffic_seed"] for row in rows if row["scene"] == DRAWN})
        }
        for tracker in TRACKERS
    }
    return [
        {"a": a, "b": b} | mean_and_interval([means[a][seed] - means[b][seed] for seed in means[a]])
        for i, a in enumerate(TRACKERS)
        for b in TRACKERS[i + 1 :]
    ]


def world_lines(rows: Sequence[Row], scene: str) -> list[dict[str, Any]]:
    """The lines of a scene's table in metres."""
    own = {line: [row for row in rows if (row["scene"], row["tracker"]) == (scene, line)] for line in WORLD_TRACKERS}
    return [{"tracker": line} | {key: nested(of_line, key) for key in WORLD} for line, of_line in own.items()]


def perfect_lines(rows: Sequence[Row], scene: str) -> dict[str, Any]:
    """The scores of each kind of tracks behind a perfect detector."""
    return {
        tracker: {
            key: nested([row for row in rows if (row["scene"], row["tracker"]) == (scene, tracker)], key)
            for key in ("hota", "deta", "assa", "id_switches")
        }
        for tracker in ("reference", "lost when hidden")
    }


def falls(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """HOTA at each miss rate, and its paired change from the rate before."""
    found = []
    for tracker in TRACKERS:
        at = {
            rate: {
                row["traffic_seed"]: row["hota"]
                for row in rows
                if row["tracker"] == tracker and row["miss_rate"] == rate
            }
            for rate in MISS_RATES
        }
        for before, rate in zip((None, *MISS_RATES), MISS_RATES, strict=False):
            change = None if before is None else mean_and_interval([at[rate][s] - at[before][s] for s in at[rate]])
            found.append(
                {
                    "tracker": tracker,
                    "miss_rate": rate,
                    "hota": mean_and_interval(list(at[rate].values())),
                    "change": change,
                }
            )
    return found


def problems(data: dict[str, Any]) -> list[str]:
    """What does not hold that should."""
    found = [f"{name}: HOTA of reference behind a perfect detector is below {PERFECT_LEAST}" for name in _below(data)]
    for row in data["miss_rates"]:
        change = row["change"]
        if change is not None and (change["half"] is None or not change["mean"] + change["half"] < 0):
            found.append(f"{row['tracker']}: HOTA does not fall to miss rate {row['miss_rate']}: {change}")
    return found


def cell(value: dict[str, Any], digits: int = 2) -> str:
    if value["mean"] is None:
        return "–"
    half = f"{value['half']:.{digits}f}" if value["half"] else ""
    if half and not half.strip("0."):
        half = f"{value['half']:.1g}"  # no interval is of no width
    return f"{value['mean']:.{digits}f}{half and f' ± {half}'}"


def scene_table(lines: Sequence[dict[str, Any]]) -> list[str]:
    """A scene's tables in Markdown."""
    states = list(lines[0]["states"])
    bins = [
        f"{low:g} to {high:g} s" if np.isfinite(high) else f"over {low:g} s"
        for low, high in pairwise(OCCLUSION_EDGES_S)
    ]
    counts = [each["all"] for each in lines[-1]["occlusions"]]
    text = [
        "| Tracker | HOTA | HOTA by centre | DetA | AssA | IDF1 | ID switches | False tracks |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for line in lines:
        cells = [cell(line[key], 1 if key in ("id_switches", "false_tracks") else 2) for key in MAIN]
        text.append(f"| {line['tracker']} | {' | '.join(cells)} |")
    shown = [k for k, count in enumerate(counts) if count]
    head = [*(f"HOTA in `{state}`" for state in states), *(f"Survives {bins[k]}" for k in shown)]
    text += ["", f"| Tracker | {' | '.join(head)} |", "|---|" + "---|" * len(head)]
    for line in lines:
        cells = [cell(line["states"][state]) for state in states]
        cells += [f"{cell(line['occlusions'][k])} of {line['occlusions'][k]['all']}" for k in shown]
        text.append(f"| {line['tracker']} | {' | '.join(cells)} |")
    return text


def world_table(lines: Sequence[dict[str, Any]]) -> list[str]:
    """A scene's table in metres in Markdown."""
    heads = [head for head, _ in WORLD.values()]
    text = [f"| Tracker | {' | '.join(heads)} |", "|---|" + "---|" * len(heads)]
    for line in lines:
        text.append(f"| {line['tracker']} | {' | '.join(cell(line[key], WORLD[key][1]) for key in WORLD)} |")
    return text


def difference_table(found: Sequence[dict[str, Any]], score: str) -> list[str]:
    """Paired differences of a score, in Markdown."""
    lines = [f"| {each['a']} − {each['b']} | {cell(each, 3)} |" for each in found]
    return [f"| Difference | {score} |", "|---|---|", *lines]


def readme_table(data: dict[str, Any]) -> list[str]:
    """HOTA by centre of all trackers in all scenes, in Markdown, as the README has it; and its paired differences."""
    scenes = list(data["scenes"])
    lines = [f"| Tracker | {' | '.join(f'`{name}`' for name in scenes)} |", "|---|" + "---|" * len(scenes)]
    for k, line in enumerate(data["scenes"][scenes[0]]):
        cells = [cell(data["scenes"][name][k]["hota_centre"]) for name in scenes]
        lines.append(f"| {line['tracker']} | {' | '.join(cells)} |")
    if CENTRE_DIFFERENCES in data:
        lines += difference_table(data[CENTRE_DIFFERENCES], f"HOTA by centre on `{DRAWN}`")
    return lines


def _world_seeds(world: dict[str, Any], scene: str) -> str:
    """The seeds of a table in metres."""
    if scene == DRAWN:
        return f"{world['seeds']} traffic seeds, detector seeds for each: {world['looks']}"
    return f"{world['other_looks']} detector seeds"


def _below(data: dict[str, Any]) -> list[str]:
    """The scenes in which `reference` behind a perfect detector has less than is asked for."""
    return [name for name, each in data["perfect"].items() if each["reference"]["hota"]["mean"] < PERFECT_LEAST]


def _survival(data: dict[str, Any]) -> str:
    """The kind of share that a table has: figures from before rows were kept have no number of those survived."""
    if "survived" in data["scenes"][DRAWN][0]["occlusions"][0]:
        return "share"
    return "mean over the seeds of the share (a seed with few counts as much as one with many; N is of all seeds)"


def rows_table(*parts: Sequence[Row]) -> pa.Table:
    """All runs as rows, for the parts in `PARTS`: what was run, its seeds and its scores; states, and occlusions by
    length, as JSON."""
    flat = [
        {"part": part} | row | {key: json.dumps(row[key]) for key in ("states", "occlusions") if key in row}
        for part, of_part in zip(PARTS, parts, strict=True)
        for row in of_part
    ]
    names = dict.fromkeys(key for row in flat for key in row)
    versions = {name: version(name) for name in ("modsim3d", "trackers", "stonesoup", "trackeval")}
    columns = {name: [row.get(name) for row in flat] for name in names}
    return pa.table(columns).replace_schema_metadata({"versions": json.dumps(versions)})


def stored_rows(path: Path) -> list[list[Row]]:
    """The rows of a table as they were: of the shipped detectors, of perfect ones, of those that miss, and in the
    world."""
    parts: dict[str, list[Row]] = {part: [] for part in PARTS}
    for row in pq.read_table(path).to_pylist():
        unpacked = row | {key: json.loads(row[key]) for key in ("states", "occlusions") if row[key]}
        parts[unpacked.pop("part")].append(unpacked)
    return list(parts.values())


def page(data: dict[str, Any]) -> str:
    """The page of the results."""
    below = " and ".join(f"`{name}`" for name in _below(data)) or "no scene"
    lines = [
        "# Trackers behind the shipped scenes",
        "",
        "Written by `script/campaign tracker_scores`; the same figures are in `tracker_scores.json`. "
        "[Scores](../scores.md) says what each means, [Trackers](../trackers.md) what they are and how their "
        "settings were chosen.",
        "",
        "Truth is `full`. HOTA compares boxes by IoU; *by centre* by 1 − distance / 150 px, as do the columns of "
        "states and occlusions. ± is half the 95 % interval of the mean; there is none where all values are the same. "
        f"*Survives*: {_survival(data)} of the "
        "occlusions of that length (less than half of the vessel visible) after which the same track follows the "
        "vessel, of those that it followed before. The oracle-association references have the same detections; a "
        "tracker that smooths better may exceed them.",
        "",
        f"Tables *in the world* are in metres ([their scores](../world_tracks.md#the-scores)), over at most the first "
        f"{WORLD_STEPS} steps of a scene: GOSPA has c = 50 m, and a track follows a vessel within 50 m. `world_gnn` "
        "and `world_jpda` have no boxes, so they are in these tables alone. *Boxes on the sea* are those of a tracker "
        "of images: each lies where the ray through its foot meets the sea, without velocity. A vessel that two "
        "cameras see then has two tracks, which is one too many.",
    ]
    for scene in data["scenes"]:
        over = (
            f"{data['seeds']} traffic seeds with {data['looks']} detector seeds each; intervals are over traffic seeds."
            if scene == DRAWN
            else f"{data['other_looks']} detector seeds; intervals are over these, and hold for this traffic only."
        )
        lines += ["", f"## {scene}", "", over, "", *scene_table(data["scenes"][scene])]
        if lines_in_metres := data["world"]["scenes"][scene]:
            lines += [
                "",
                f"In the world, over {_world_seeds(data['world'], scene)}:",
                "",
                *world_table(lines_in_metres),
            ]
    by_both = [("HOTA", data["differences"])]
    by_both += [("HOTA by centre", data[CENTRE_DIFFERENCES])] if CENTRE_DIFFERENCES in data else []
    for score, found in by_both:
        lines += ["", f"Paired differences of {score} on `{DRAWN}`, over traffic seeds:", ""]
        lines += difference_table(found, score)
    lines += [
        "",
        "## A perfect detector",
        "",
        "`reference` where the detector makes no error, with truth `annotated` and settings for exact boxes. *Lost "
        "when hidden* are tracks that are right in every other way: they have the true boxes, and a new number "
        "after each stretch in which the vessel is wholly hidden. What is missing to 1 there is the cost of not "
        "bridging these stretches; after long ones no box tells who comes out. Where `reference` is below these "
        "tracks, the difference is its own: it also loses vessels that are not wholly hidden. "
        f"`{DRAWN}` is over {data['miss_seeds']} traffic seeds. HOTA is below {PERFECT_LEAST} in {below}.",
        "",
        "| Scene | HOTA | DetA | AssA | ID switches | Lost when hidden: HOTA | AssA | ID switches |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, each in data["perfect"].items():
        own = [cell(each["reference"][key], 3) for key in ("hota", "deta", "assa")]
        own.append(cell(each["reference"]["id_switches"], 1))
        own += [cell(each["lost when hidden"][key], 3) for key in ("hota", "assa")]
        own.append(cell(each["lost when hidden"]["id_switches"], 1))
        lines.append(f"| {name} | {' | '.join(own)} |")
    lines += [
        "",
        "## Misses",
        "",
        f"The same perfect detector on `{DRAWN}`, which misses a share of the vessels in each frame: "
        f"{data['miss_seeds']} traffic seeds of {MISS_STEPS} steps, the same for each share. *Change* is the paired "
        "change from the share before.",
        "",
        "| Tracker | Missed | HOTA | Change |",
        "|---|---|---|---|",
    ]
    for row in data["miss_rates"]:
        change = "" if row["change"] is None else cell(row["change"], 3)
        lines.append(f"| {row['tracker']} | {row['miss_rate']:.0%} | {cell(row['hota'], 3)} | {change} |")
    if "rows" in data:
        lines += ["", f"Each run is a row of `{ROWS}` (SHA-256 {data['rows']}), for tests of other pairs and scores."]
    lines += ["", "With " + ", ".join(f"{name} {number}" for name, number in data["versions"].items()) + "."]
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(prog="script/campaign tracker_scores", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=SEEDS, help="traffic seeds of the drawn scene")
    parser.add_argument("--looks", type=int, default=LOOKS, help="detector seeds of each of them")
    parser.add_argument("--other-looks", type=int, default=OTHER_LOOKS, help="detector seeds of the other scenes")
    parser.add_argument("--miss-seeds", type=int, default=MISS_SEEDS, help="traffic seeds of the miss rates")
    parser.add_argument(
        "--part", choices=PARTS, nargs="+", default=PARTS, help="run these, keep the rows of the others"
    )
    parser.add_argument("--steps", type=int, help="steps of each scene, in place of its own: a trial of the campaign")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=OUT, help="folder for tracker_scores.md, .json and .parquet")
    parser.add_argument("--stored", action="store_true", help=f"make the page out of {ROWS} there, and run nothing")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    if not asked.stored:
        before = stored_rows(asked.out / ROWS) if set(asked.part) < set(PARTS) else [[] for _ in PARTS]
        pq.write_table(rows_table(*run(asked, before)), asked.out / ROWS, compression="zstd")
    data = figures(*stored_rows(asked.out / ROWS))
    data["versions"] = json.loads(pq.read_schema(asked.out / ROWS).metadata[b"versions"])
    data["rows"] = hashlib.sha256((asked.out / ROWS).read_bytes()).hexdigest()
    (asked.out / "tracker_scores.json").write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")
    (asked.out / "tracker_scores.md").write_text(page(data), encoding="utf-8")
    for problem in problems(data):
        print(problem, file=sys.stderr)
    return int(bool(problems(data)))


def run(asked: argparse.Namespace, before: Sequence[list[Row]]) -> Iterator[list[Row]]:
    """The rows of the shipped detectors, of perfect ones, of those that miss, and in the world; those from before of
    the parts that are not asked for."""
    drawn = [(DRAWN, seed, asked.looks, asked.steps) for seed in range(1, asked.seeds + 1)]
    others = [(name, 0, asked.other_looks, asked.steps) for name in SCENES if name != DRAWN]
    miss_seeds = range(1, asked.miss_seeds + 1)
    perfect = [(name, seed, asked.steps) for name in SCENES for seed in (miss_seeds if name == DRAWN else (0,))]
    misses = [(DRAWN, seed, rate, asked.steps or MISS_STEPS) for seed in miss_seeds for rate in MISS_RATES]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(asked.workers, mp_context=context) as pool:
        in_world = [
            (name, seed, looks, min(load_scene(name).steps, steps or WORLD_STEPS))
            for name, seed, looks, steps in drawn + others
        ]
        work = ((trial, drawn + others), (perfect_trial, perfect), (miss_trial, misses), (world_trial, in_world))
        for part, (task, jobs), kept in zip(PARTS, work, before, strict=True):
            yield [row for found in pool.map(task, jobs) for row in told(found)] if part in asked.part else kept


def seed_counts(rows: Sequence[Row]) -> dict[str, int]:
    """Numbers of traffic seeds of the drawn scene, of detector seeds of each, and of detector seeds of the others."""
    seeds = {
        name: {(row["traffic_seed"], row["detector_seed"]) for row in rows if row["scene"] == name} for name in SCENES
    }
    traffics = len({traffic for traffic, _ in seeds[DRAWN]})
    others = max(len(seeds[name]) for name in SCENES if name != DRAWN)
    return {"seeds": traffics, "looks": len(seeds[DRAWN]) // max(traffics, 1), "other_looks": others}


def figures(
    rows: Sequence[Row], alone: Sequence[Row], missed: Sequence[Row], in_world: Sequence[Row]
) -> dict[str, Any]:
    """The figures of the page."""
    world = {name: world_lines(in_world, name) if in_world else [] for name in SCENES}
    return {
        "format": 1,
        **seed_counts(rows),
        "world": seed_counts(in_world) | {"scenes": world},
        "miss_seeds": len({row["traffic_seed"] for row in missed}),
        "scenes": {name: table(rows, name) for name in SCENES},
        "differences": differences(rows),
        CENTRE_DIFFERENCES: differences(rows, "hota_centre"),
        "perfect": {name: perfect_lines(alone, name) for name in SCENES},
        "miss_rates": falls(missed),
    }


def told(part: list[Row]) -> list[Row]:
    """Say that a part is done."""
    first = part[0]
    print(first["scene"], first["traffic_seed"], first.get("miss_rate", ""), file=sys.stderr, flush=True)
    return part


if __name__ == "__main__":
    sys.exit(main())
