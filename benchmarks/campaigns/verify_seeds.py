"""verify_seeds: honest seeds of every detector model; at most 5 of 200 may be called dishonest.

Each scene's truth is made once; the detector is run over it in memory with one seed after the other, and `check run`
holds what comes out against the file that it was made with. The thesis's detector on all three of its simulations
with 200 seeds each; the thesis's with one further model switched on at a time (tests/detector_variants.py) with
fewer, and so the file that has every kind of model, in the harbour, whose vessels are given its labels in turn.
Models that persist or come in clumps are tried with two cameras as well.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.detector.file.reading import load_detector, parse_detector
from modsim3d.io.input_files import data_folder
from modsim3d.scene.reading import load_scene
from modsim3d.verify.error_fit import MomentTable
from modsim3d.verify.evidence import ManyDetections
from modsim3d.verify.independence_checks import GROUP as INDEPENDENCE
from modsim3d.verify.verification import verify_evidence
from tests.detector_variants import CHANGES, variant

OUT = Path(__file__).resolve().parents[2] / "docs" / "campaigns"
SEEDS, VARIANT_SEEDS, MAX_ALARMS_IN_200 = 200, 20, 5
PLAIN = ("simulation_1", "simulation_2", "simulation_3")
TWO_CAMERAS = (
    "persistence of misses, 1 s",
    "persistence of box errors, 1 s",
    "Student's t box errors",
    "persistent false positives",
    "doubled, split and merged boxes",
)
EVERY_MODEL = "rich.yaml: every kind of model"


def labelled_in_turn(many: ManyDetections, labels: int) -> ManyDetections:
    """The same boxes of vessels of other kinds."""
    inputs = [replace(part, targets=replace(part.targets, label=part.targets.vessel % labels)) for part in many.inputs]
    return replace(many, inputs=tuple(inputs))


def look_at(scene_name: str, name: str, seeds: int) -> dict[str, Any]:
    """Verify honest runs of one detector over one scene."""
    # The detector's models look at visible fractions, so occlusion counts.
    scene = load_scene(scene_name, source="analytic", mode=2 if name != "plain" else None)
    many = ManyDetections.of_scene(scene)
    if name == EVERY_MODEL:
        model = load_detector(data_folder("scenes") / "detectors" / "rich.yaml")
        many = labelled_in_turn(many, len(model.labels))
    else:
        model = parse_detector(variant(name))
    table, alarms, p_values, untested = MomentTable(), [], [], set()
    patterns: dict[str, list[float]] = {}
    tests = 0
    for seed in range(seeds):
        found = verify_evidence(model, many.detect(model, seed), table)
        tests = sum(verdict.p_value is not None for verdict in found.verdicts)
        untested |= {verdict.parameter.name for verdict in found.verdicts if verdict.p_value is None}
        p_values += [verdict.p_value for verdict in found.verdicts if verdict.p_value is not None]
        for verdict in found.verdicts:
            if verdict.parameter.group == INDEPENDENCE and verdict.p_value is not None:
                patterns.setdefault(verdict.parameter.name, []).append(verdict.p_value)
        if not found.obeys:
            alarms.append({"seed": seed, "failed": [verdict.parameter.name for verdict in found.failed]})
    return {
        "scene": scene_name,
        "detector": name,
        "seeds": seeds,
        "tests": tests,
        "alarms": alarms,
        "share_p_below_0.01": float(np.mean(np.array(p_values) < 0.01)),
        "share_p_below_0.001": float(np.mean(np.array(p_values) < 0.001)),
        "sometimes_untested": len(untested),
        "independence": {name: tallied(values) for name, values in patterns.items()},
    }


def tallied(p_values: list[float]) -> list[int]:
    """Number of p-values, and of those below 0.1, 0.01 and 0.001."""
    return [len(p_values), *(int((np.array(p_values) < level).sum()) for level in (0.1, 0.01, 0.001))]


def work(seeds: int | None) -> list[tuple[str, str, int]]:
    plain = [(scene, "plain", seeds or SEEDS) for scene in PLAIN]
    others = [name for name in CHANGES if name != "plain"]
    # Per camera takes two cameras; the others see most vessels in the first simulation.
    scenes = {name: "simulation_3" if name == "a chain for each camera" else "simulation_1" for name in others}
    others.append(EVERY_MODEL)
    scenes[EVERY_MODEL] = "harbour"
    pairs = [*((scenes[name], name) for name in others), *(("simulation_3", name) for name in TWO_CAMERAS)]
    return plain + [(scene, name, min(seeds or VARIANT_SEEDS, VARIANT_SEEDS)) for scene, name in pairs]


def with_the_others(found: list[dict[str, Any]], path: Path) -> list[dict[str, Any]]:
    """Rows that were looked at again in place of those that a file has."""
    rows = json.loads(path.read_text(encoding="utf-8"))["runs"] if path.exists() else []
    every = {(row["scene"], row["detector"]): row for row in [*rows, *found]}
    return [every[scene, name] for scene, name, _ in work(None) if (scene, name) in every]


def page(found: list[dict[str, Any]], versions: dict[str, str]) -> str:
    lines = [
        "# Honest runs that `check run` calls dishonest",
        "",
        "Written by `script/campaign verify_seeds`; the same figures are in `verify_seeds.json`.",
        "",
        "Every run was made with the detector file that it is held against. All tests of a run together are to fail "
        "with probability 1 % at most; of 200 seeds 5 alarms are the most that may be put down to chance "
        "(Pr(more) = 1.6 %). All detectors are given the same seeds, and what a model does not touch has the same "
        "noise in all of them: one unlucky seed may show in many rows. Seeds are the detector's; each scene has this "
        "traffic only.",
        "",
        "| Scene | Detector | Seeds | Tests each | Alarms | p < 0.01 | p < 0.001 |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in found:
        lines.append(
            f"| {row['scene']} | {row['detector']} | {row['seeds']} | {row['tests']} | **{len(row['alarms'])}** | "
            f"{row['share_p_below_0.01']:.2%} | {row['share_p_below_0.001']:.2%} |"
        )
    seeds, alarms = sum(row["seeds"] for row in found), sum(len(row["alarms"]) for row in found)
    lines += ["", f"Over all rows {alarms} of {seeds} runs ({alarms / seeds:.2%}) were called dishonest."]
    lines += independence(found)
    lines += ["", "With " + ", ".join(f"{name} {number}" for name, number in versions.items()) + "."]
    return "\n".join(lines) + "\n"


def independence(found: list[dict[str, Any]]) -> list[str]:
    """A table of the checks of independence, over all rows."""
    totals: dict[str, np.ndarray] = {}
    for row in found:
        for name, counts in row.get("independence", {}).items():
            totals[name] = totals.get(name, np.zeros(4, dtype=np.int64)) + counts
    lines = [
        "",
        "## Checks of independence",
        "",
        "Over all rows together. Many rows have the same noise, so one unlucky seed may count many times here as well.",
        "",
        "| Check | Tests | p < 0.1 | p < 0.01 | p < 0.001 |",
        "|---|---|---|---|---|",
    ]
    for name, (tests, *below) in totals.items():
        lines.append(f"| {name} | {tests} | " + " | ".join(f"{count / tests:.2%}" for count in below) + " |")
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(prog="script/campaign verify_seeds", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, help="fewer than the campaign's own, for a try")
    parser.add_argument("--only", help="detectors whose name contains this; the other rows stay as they are written")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=OUT, help="folder for verify_seeds.md and verify_seeds.json")
    asked = parser.parse_args()
    jobs = [job for job in work(asked.seeds) if asked.only is None or asked.only in job[1]]
    found = []
    with ProcessPoolExecutor(asked.processes, multiprocessing.get_context("spawn")) as pool:
        for row in pool.map(look_at, *zip(*jobs, strict=True)):
            found.append(row)
            said = f"{row['scene']}, {row['detector']}: {len(row['alarms'])} of {row['seeds']}"
            print(said, row["alarms"][:3], file=sys.stderr, flush=True)
    if asked.only is not None:
        found = with_the_others(found, asked.out / "verify_seeds.json")
    versions = {"modsim3d": version("modsim3d"), "NumPy": np.__version__}
    asked.out.mkdir(parents=True, exist_ok=True)
    data = json.dumps({"format": 1, "versions": versions, "runs": found}, indent=2)
    (asked.out / "verify_seeds.json").write_text(data + "\n", encoding="utf-8")
    (asked.out / "verify_seeds.md").write_text(page(found, versions), encoding="utf-8")
    return int(any(len(row["alarms"]) > MAX_ALARMS_IN_200 * row["seeds"] / 200 + 1 for row in found))


if __name__ == "__main__":
    sys.exit(main())
