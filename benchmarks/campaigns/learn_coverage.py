"""learn_coverage: do the intervals of modsim3d learn hold what they claim? Simulated, exported, learned, by seeds.

Simulation 1 and the harbour, their vessels relabelled, are run with tests/data/learn/round_trip.yaml (three labels, two
states, relative errors, misses by size, persistence, confidence, a map of false positives), written as COCO and learned
again, matched by IoU and by provenance. Of every number it is counted how often the asked one is inside its interval.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.matching import Rule, match
from modsim3d.formats.reading.coco import read_coco
from modsim3d.formats.writing.coco import write_coco
from modsim3d.learn.learned import Settings, learn
from modsim3d.learn.observed import Observed
from modsim3d.learn.states import each_its_own, transitions_of
from tests.learn.round_trip import asked_of, simulate

OUT = Path(__file__).resolve().parents[2] / "docs" / "campaigns"
SCENES = {"simulation_1": (0, 1500), "harbour": (2, 400)}  # annotation mode, steps
METHODS = {"confidence": "IoU", "provenance": "provenance"}
SEEDS_AT_ONCE = 20
LEVELS = (0.95, 0.99)
TOGETHER = 0.99


def kind_of(path: str) -> str:
    """States of one kind of number together."""
    return ".".join(part for part in path.split(".") if part not in ("states", "clear", "haze"))


def one(scene: str, seed: int, method: str, folder: Path) -> dict[str, Any]:
    """Simulate with a seed and learn: how many numbers of each kind are inside at each level."""
    mode, steps = SCENES[scene]
    run = folder / scene / str(seed) / "run"
    if not run.is_dir():
        simulate(scene, run.parent, mode, steps, seed)
    labelled, _ = labelled_run(run)
    if method != "provenance":
        labelled = read_coco("all", *write_coco(labelled, run.parent / "coco"))
    states = each_its_own(("clear", "haze"))
    image_state = states.of_images(labelled.images, labelled.conditions)
    transitions = transitions_of(labelled.images, image_state, 2, 1.0)
    settings = Settings(Rule(method), seed=seed)
    matched = match(labelled, settings.rule, settings.threshold)
    learned = learn(Observed(labelled, matched, states.names, image_state, settings.threshold), transitions, settings)
    asked = asked_of()
    total = sum(value.size for value in asked.values())
    result: dict[str, Any] = {"numbers": total}
    for level in (*LEVELS, 1 - (1 - TOGETHER) / total):
        inside: dict[str, list[int]] = defaultdict(lambda: [0, 0])
        intervals = {each.key.path: (each.low, each.high) for each in learned.intervals(level)}
        result["not_learned"] = [path for path in asked if path not in intervals]
        for path, value in asked.items():
            if path not in intervals:
                continue
            low, high = intervals[path]
            right = (value >= low - 1e-9) & (value <= high + 1e-9)
            tally = inside[kind_of(path)]
            tally[0], tally[1] = tally[0] + int(right.sum()), tally[1] + right.size
        result["all together" if level not in LEVELS else f"{level:g}"] = dict(inside)
    return result


def summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Coverage over seeds."""
    found: dict[str, Any] = {"seeds": len(runs), "numbers": runs[0]["numbers"]}
    for level in LEVELS:
        kinds: dict[str, list[int]] = defaultdict(lambda: [0, 0])
        for run in runs:
            for kind, (inside, of) in run[f"{level:g}"].items():
                kinds[kind][0] += inside
                kinds[kind][1] += of
        found[f"{level:g}"] = {kind: inside / of for kind, (inside, of) in sorted(kinds.items())}
        every = np.sum(list(kinds.values()), axis=0)
        found[f"{level:g}"]["every number"] = float(every[0] / every[1])
    whole = [all(inside == of for inside, of in run["all together"].values()) for run in runs]
    found["all numbers inside their intervals of 99 % together"] = float(np.mean(whole))
    found["not learned, of the seeds"] = {
        path: sum(path in run["not_learned"] for run in runs) for run in runs for path in run["not_learned"]
    }
    return found


def text(results: dict[str, Any], seeds: int) -> str:
    """The page."""
    lines = [
        "# Coverage of learned intervals",
        "",
        f"`script/campaign learn_coverage`, {seeds} seeds. Simulation 1 has another traffic with each, the "
        "harbour this traffic only. Share of asked numbers inside their intervals:",
        "",
    ]
    names = list(results)
    for level in LEVELS:
        kinds = list(dict.fromkeys(kind for name in names for kind in results[name][f"{level:g}"]))
        lines += [f"| intervals of {level:.0%} | {' | '.join(names)} |", f"|---|{'---|' * len(names)}"]
        for kind in kinds:
            cells = (results[name][f"{level:g}"].get(kind) for name in names)
            lines.append(f"| {kind} | {' | '.join('–' if cell is None else f'{cell:.3f}' for cell in cells)} |")
        lines.append("")
    key = "all numbers inside their intervals of 99 % together"
    lines += [f"| | {' | '.join(names)} |", f"|---|{'---|' * len(names)}"]
    lines.append(f"| {key}, share of seeds | {' | '.join(f'{results[name][key]:.2f}' for name in names)} |")
    lacking = [len(results[name]["not learned, of the seeds"]) for name in names]
    most = [max(results[name]["not learned, of the seeds"].values(), default=0) for name in names]
    lines.append(f"| numbers that some seed had too little for | {' | '.join(map(str, lacking))} |")
    lines.append(f"| seeds without the one that failed most often | {' | '.join(map(str, most))} |")
    lines += ["", "A number that a seed had too little data to learn is left simple, and not counted in that seed."]
    return "\n".join(lines) + "\n"


def both(scene: str, seed: int) -> list[dict[str, Any]]:
    """One seed, by both ways of matching."""
    with tempfile.TemporaryDirectory() as folder:
        return [one(scene, seed, method, Path(folder)) for method in METHODS]


def main() -> None:
    """Run, and write after every few seeds: what is there is a result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    runs: dict[str, list[dict[str, Any]]] = {f"{scene}, {name}": [] for scene in SCENES for name in METHODS.values()}
    OUT.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(asked.workers) as pool:
        for first in range(0, asked.seeds, SEEDS_AT_ONCE):
            seeds = range(first, min(first + SEEDS_AT_ONCE, asked.seeds))
            for scene in SCENES:
                for pair in pool.map(both, [scene] * len(seeds), seeds):
                    for name, run in zip(METHODS.values(), pair, strict=True):
                        runs[f"{scene}, {name}"].append(run)
            results = {name: summary(done) for name, done in runs.items()}
            (OUT / "learn_coverage.json").write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
            (OUT / "learn_coverage.md").write_text(text(results, seeds.stop), encoding="utf-8")
    print(text(results, asked.seeds))


if __name__ == "__main__":
    main()
