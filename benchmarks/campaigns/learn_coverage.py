"""learn_coverage: do the intervals of modsim3d learn hold what they claim? Simulated, exported, learned, by seeds.

A case is a shipped scene, its vessels relabelled, and a detector file of tests/data/learn. It is run with many seeds,
written as COCO and learned again, matched by IoU or by provenance. Of every number of the file it is counted how often
it lies inside its interval, and of the rates of misses in another scene how often they lie among those of the detectors
that a campaign would draw. Of the shipped detectors it is counted which models are learned that they do not have.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterable
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy import stats

from benchmarks.elsewhere import (
    BASIN,
    HARBOUR,
    SAID,
    STRAIT,
    OtherScene,
    OtherTruth,
    elsewhere,
    mean_elsewhere,
    table,
)
from benchmarks.invented import SHIPPED, invented, section
from modsim3d.detector.chain import target_statistics
from modsim3d.detector.file.reading import load_detector
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.matching import Rule, match
from modsim3d.formats.reading.coco import read_coco
from modsim3d.formats.writing.coco import write_coco
from modsim3d.learn.learned_detector import LearnSettings, learn
from modsim3d.learn.matches import Outcomes
from modsim3d.learn.self_check import parts_of
from modsim3d.learn.states import each_its_own, transitions_of
from tests.learn.round_trip import DETECTOR, asked_of, simulate

OUT = Path(__file__).resolve().parents[2] / "docs" / "campaigns"
METHODS = {"confidence": "IoU", "provenance": "provenance"}
SEEDS_AT_ONCE = 20
LEVELS = (0.95, 0.99)
UNLIKELY = 0.01
TOGETHER = 0.99
REPLICATES = 100
SLOPES = ("visibility_slope", "size_slope")
OTHER = {"harbour": STRAIT, "strait": HARBOUR, "simulation_1": BASIN}
"""The scene in which misses are checked, by that which they are learned in."""


@dataclass(frozen=True)
class Case:
    """What is simulated and learned again.

    Attributes:
        name: What it is called on the page and by `--case`.
        scene: A shipped scene.
        mode: Its annotation mode.
        steps: Its steps.
        detector: File in tests/data/learn.
        methods: Ways of matching.
        image_size_px: Size of the images, if it is not the scene's.
        said: What is special about it.
    """

    name: str
    scene: str
    mode: int
    steps: int
    detector: str = DETECTOR.name
    methods: tuple[str, ...] = ("confidence",)
    image_size_px: tuple[int, int] | None = None
    said: str = ""

    @property
    def path(self) -> Path:
        """The detector file."""
        return DETECTOR.parent / self.detector

    @property
    def other(self) -> OtherScene:
        """Where misses are checked."""
        return OTHER[self.scene]


BOTH = tuple(METHODS)
CASES = (
    Case("simulation_1", "simulation_1", 0, 1500, methods=BOTH, said="Another traffic with each seed."),
    Case("harbour", "harbour", 2, 400, methods=BOTH, said="The same traffic with all seeds."),
    Case("vessels", "harbour", 2, 400, "vessels.yaml", said="Each vessel keeps a share of its misses and box errors."),
    Case("edges", "harbour", 2, 200, "edges.yaml", BOTH, (800, 540),
         "Large box errors, which partly grow in one state and have heavy tails in the other; the images' edges cut "
         "many boxes. What IoU loses counts as false, with the confidence of true detections."),
    Case("multiple_boxes", "harbour", 2, 200, "multiple_boxes.yaml", BOTH, said="Duplicates, merges and splits."),
    Case("staying", "simulation_1", 0, 1200, "staying.yaml",
         said="False positives that stay, drift, and thin out below the horizon."),
    Case("near_horizon", "strait", 2, 300, "near_horizon.yaml",
         said="False positives in a band below the horizon, some of which stay, before a camera that rolls "
         "and one that does not."),
    Case("slopes", "harbour", 2, 150, "slopes.yaml",
         said="Confidence that depends on visibility and size and persists; misses of hidden vessels."),
    Case("state_effects", "harbour", 2, 400, "state_effects.yaml",
         said="Misses rise with the distance, more steeply in haze."),
    Case("score", "harbour", 2, 400, "score.yaml", BOTH,
         said="One score behind misses and confidence, in parts that last differently long."),
    Case("on_vessels", "harbour", 2, 400, "on_vessels.yaml", BOTH, said="False positives stay on vessels."),
)  # fmt: skip


def kind_of(path: str, states: Iterable[str]) -> str:
    """States of one kind of number together."""
    return ".".join(part for part in path.split(".") if part not in ("states", *states))


def learned_again(case: Case, seed: int) -> dict[str, Any]:
    """Simulate a case with a seed, and learn by each way of matching: how many numbers are inside their intervals."""
    with tempfile.TemporaryDirectory() as folder:
        run = simulate(case.scene, Path(folder), case.mode, case.steps, seed, case.path, case.image_size_px)
        return {method: _inside(case, run, method, seed) for method in case.methods}


def _inside(case: Case, run: Path, method: str, seed: int) -> dict[str, Any]:
    """How many numbers of each kind are inside at each level."""
    as_run, _ = labelled_run(run)
    labelled = as_run
    if method != "provenance":
        labelled = read_coco("all", *write_coco(labelled, run.parent / "coco"))
    file = yaml.safe_load(case.path.read_text())
    states = each_its_own(tuple(file["states"]))
    image_state = states.of_images(labelled.images, labelled.conditions)
    transitions = transitions_of(labelled.images, image_state, len(states.names), file["transition_interval_s"])
    settings = LearnSettings(Rule(method), replicates=REPLICATES, seed=seed)
    matched = match(labelled, settings.rule, settings.threshold)
    learned = learn(Outcomes(labelled, matched, states.names, image_state, settings.threshold), transitions, settings)
    asked, other = asked_of(case.path), of_another_model(file, learned.detector())
    total = sum(value.size for value in asked.values())
    result: dict[str, Any] = {"numbers": total}
    true, parts = load_detector(str(case.path)), parts_of(as_run, image_state)
    statistics = target_statistics(true, ((part.frames, part.targets) for part in parts))
    result["elsewhere"] = elsewhere(OtherTruth.of(case.other, case.path), true, statistics, learned)
    for level in (*LEVELS, 1 - (1 - TOGETHER) / total):
        inside: dict[str, list[int]] = defaultdict(lambda: [0, 0])
        intervals = {
            each.key.path: (each.low, each.high)
            for each in learned.intervals(level)
            if not each.key.path.startswith(other)
        }
        result["not_learned"] = [path for path in asked if path not in intervals]
        result["not_asked"] = [path for path in intervals if path not in asked and _is_written(path)]
        for path, value in asked.items():
            if path not in intervals or np.isnan(intervals[path][0]).any():  # not learned, or said not to be known
                continue
            low, high = intervals[path]
            if np.shape(low) != np.shape(value):  # parts of a memory with other times
                continue
            right = (value >= low - 1e-9) & (value <= high + 1e-9)
            tally = inside[kind_of(path, states.names)]
            tally[0], tally[1] = tally[0] + int(right.sum()), tally[1] + right.size
        result["all together" if level not in LEVELS else f"{level:g}"] = dict(inside)
    return result


def of_another_model(asked: dict[str, Any], learned: dict[str, Any]) -> tuple[str, ...]:
    """How paths begin of numbers that stand for something else in a learned file than in the one that was asked for.

    Those are box errors in another unit, confidences for which other slopes were made up, and times of noise of which
    things keep a share in one of the files only.
    """
    found, kept = [], [file.get("persistence", {}) for file in (asked, learned)]
    for name in ("class", "box"):
        if len({f"{name}_vessel_share" in each for each in kept}) == 2:
            found.append(f"persistence.{name}_")
    for name, state in asked["states"].items():
        again = learned["states"][name]
        if state["box_error"]["unit"] != again["box_error"]["unit"]:
            found.append(f"states.{name}.box_error_")
        if any((slope in state["confidence"]) != (slope in again["confidence"]) for slope in SLOPES):
            found.append(f"states.{name}.confidence.")
    return tuple(found)


def _is_written(path: str) -> bool:
    """Whether a learned number is in the file of a detector; both numbers of false positives are always learned, and
    the intercept stands for an anchor."""
    return not path.endswith(("false_discovery_rate", "false_positives_per_image", "dropout.intercept"))


def summary(case: Case, runs: list[dict[str, Any]]) -> dict[str, Any]:
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
    found["elsewhere"] = mean_elsewhere([run["elsewhere"] for run in runs])
    for key in ("not_learned", "not_asked"):
        found[f"{key.replace('_', ' ')}, of the seeds"] = dict(Counter(path for run in runs for path in run[key]))
    return found


def text(results: dict[str, dict[str, Any]]) -> str:
    """The page."""
    lines = [
        "# Coverage of learned intervals",
        "",
        "`script/campaign learn_coverage` simulates a detector, learns it again and counts how often each number of "
        "its file lies inside the interval of what was learned. Each case below is a shipped scene with a detector "
        "file of `tests/data/learn`. An interval that holds more often than it says is too wide (▲), one that holds "
        "less often too narrow (▼): so marked where chance alone gives that in less than 1 % of the campaigns, with "
        "as many numbers as seeds, since those of one seed hang together.",
        "",
        SAID,
        "",
    ]
    for case in CASES:
        if case.name in results:
            lines += _section(case, results[case.name])
    lines += section({each.name: results[each.name] for each in SHIPPED if each.name in results})
    lines.append(
        "A number that a seed had too little data to learn is left simple, and not counted in that seed. Nor are box "
        "errors in another unit than was asked for, and confidences with other slopes."
    )
    return "\n".join(lines) + "\n"


def _section(case: Case, found: dict[str, Any]) -> list[str]:
    """One case: the share inside of each kind of number, by way of matching and level."""
    ways = [found[method] for method in case.methods]
    heads = [f"{METHODS[method]}, {level:.0%}" for method in case.methods for level in LEVELS]
    title = case.name.replace("_", " ").capitalize()
    source = f"`tests/data/learn/{case.detector}` in {case.scene}, {case.steps:,} steps, {ways[0]['seeds']} seeds."
    lines = [f"## {title}", "", f"{source} {case.said}".strip(), ""]
    lines += [f"| inside | {' | '.join(heads)} |", f"|---|{'---|' * len(heads)}"]
    kinds = dict.fromkeys(kind for way in ways for level in LEVELS for kind in way[f"{level:g}"])
    for kind in sorted(kinds, key=lambda kind: (kind == "every number", kind)):
        cells = (_share(way[f"{level:g}"].get(kind), level, way["seeds"]) for way in ways for level in LEVELS)
        lines.append(f"| {kind} | {' | '.join(cells)} |")
    lines += ["", f"| | {' | '.join(METHODS[method] for method in case.methods)} |", f"|---|{'---|' * len(ways)}"]
    key = "all numbers inside their intervals of 99 % together"
    lines.append(f"| {key}, share of seeds | {' | '.join(f'{way[key]:.2f}' for way in ways)} |")
    for key, words in (("not learned", "numbers that some seed did not learn"),
                       ("not asked", "numbers learned that the file does not have")):  # fmt: skip
        lines.append(f"| {words}, with the seeds | {' | '.join(_seeds(way[f'{key}, of the seeds']) for way in ways)} |")
    if all("elsewhere" in way for way in ways):
        named = zip(case.methods, ways, strict=True)
        lines += ["", *table(case.other, {METHODS[method]: way["elsewhere"] for method, way in named})]
    return [*lines, ""]


def _share(share: float | None, level: float, seeds: int) -> str:
    """A share of intervals that hold, marked where it surely is not the level."""
    if share is None:
        return "–"
    held = share * seeds
    low, high = stats.binom.cdf(np.ceil(held), seeds, level), stats.binom.sf(np.floor(held) - 1, seeds, level)
    return f"{share:.3f}" + (" ▼" if low < UNLIKELY / 2 else " ▲" if high < UNLIKELY / 2 else "")


def _seeds(counts: dict[str, int]) -> str:
    """Paths with the number of seeds of each; `none` if there are none."""
    return ", ".join(f"{path} {number}" for path, number in sorted(counts.items())) or "none"


def main() -> None:
    """Run, and write after every few seeds: what is there is a result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument(
        "--case", action="append", choices=[case.name for case in (*CASES, *SHIPPED)], help="this one alone"
    )
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the page and the numbers")
    asked = parser.parse_args()
    cases = [case for case in CASES if not asked.case or case.name in asked.case]
    shipped = [each for each in SHIPPED if not asked.case or each.name in asked.case]
    page, numbers = asked.out / "learn_coverage.md", asked.out / "learn_coverage.json"
    asked.out.mkdir(parents=True, exist_ok=True)
    kept = json.loads(numbers.read_text(encoding="utf-8")) if asked.case and numbers.is_file() else {}
    results = {name: kept[name] for name in (case.name for case in (*CASES, *SHIPPED)) if name in kept}
    runs: dict[str, list[dict[str, Any]]] = {case.name: [] for case in cases}
    found: dict[str, list[dict[str, list[str]]]] = {each.name: [] for each in shipped}
    with ProcessPoolExecutor(asked.workers) as pool:
        for first in range(0, asked.seeds, SEEDS_AT_ONCE):
            seeds = range(first, min(first + SEEDS_AT_ONCE, asked.seeds))
            begun: dict[str, list[Future[dict[str, Any]]]] = {
                case.name: [pool.submit(learned_again, case, seed) for seed in seeds] for case in cases
            }
            for case in cases:
                runs[case.name] += [each.result() for each in begun[case.name]]
                by_method = {method: [run[method] for run in runs[case.name]] for method in case.methods}
                results[case.name] = {method: summary(case, done) for method, done in by_method.items()}
            for each in shipped:
                found[each.name] += pool.map(invented, [each] * len(seeds), seeds)
                results[each.name] = {"runs": found[each.name]}
            numbers.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
            page.write_text(text(results), encoding="utf-8")
    print(text(results))


if __name__ == "__main__":
    main()
