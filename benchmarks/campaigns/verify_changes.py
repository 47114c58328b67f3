"""verify_changes: each parameter changed after the run must be caught and named nine times in ten.

Runs are made with a detector file, and held against the same file with one parameter changed: a false negative rate,
false discovery rate, standard deviation or stay-rate by 20 %, a mean by 0.2 standard deviations, a correlation by 0.1;
the other entries of a column keep their proportions. A change counts where the report on that very run says that it
would have noticed one of that size.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.model import DetectorModel
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene
from modsim3d.verify.box_error_checks import box_error_checks
from modsim3d.verify.class_checks import class_checks
from modsim3d.verify.confidence_checks import confidence_checks
from modsim3d.verify.error_fit import MomentTable
from modsim3d.verify.evidence import Evidence, ManyDetections
from modsim3d.verify.false_positive_checks import false_positive_checks
from modsim3d.verify.parameters import Parameter, judge
from modsim3d.verify.verification import state_checks, verify_evidence
from tests.detector_changes import Change, single_changes
from tests.detector_variants import variant

OUT = Path(__file__).resolve().parents[2] / "docs" / "campaigns"
SEEDS, FIRST_SEED, SHARE = 10, 7000, 0.9
RATES = ("stay-rate", "false negative rate", "false discovery rate")


@dataclass(frozen=True)
class Case:
    """A scene, a detector and what of it is changed.

    Attributes:
        scene: One of the thesis's.
        steps: Its own number if None.
        detector: The thesis's with a further model, see tests/detector_variants.py.
        kinds: Beginnings of the kinds of changes that are made; all if empty.
    """

    scene: str
    steps: int | None = None
    detector: str = "plain"
    kinds: tuple[str, ...] = ()

    def load(self) -> Scene:
        """The scene with the detector."""
        return replace(
            load_scene(self.scene, source="analytic", steps=self.steps), detector=parse_detector(variant(self.detector))
        )

    def changes(self, scene: Scene) -> list[Change]:
        """Those that are made, as they stand in the file."""
        first, second = scene.times_s(0, 2)
        every = single_changes(scene.detector, float(second - first))
        return [change for change in every if not self.kinds or change.kind.startswith(self.kinds)]


CASES = {
    "simulation_3": Case("simulation_3"),
    "simulation_1": Case("simulation_1"),
    "simulation_2": Case("simulation_2"),
    # In the thesis's short runs hardly a rate can be measured to a tenth of itself.
    "simulation_1, 15000 steps": Case("simulation_1", steps=15_000, kinds=RATES),
    "simulation_3, relative box errors": Case("simulation_3", detector="relative box errors", kinds=("box error",)),
    "simulation_1, misses persist for 1 s": Case(
        "simulation_1", detector="persistence of misses, 1 s", kinds=("correlation in time", *RATES)
    ),
    "simulation_1, box errors persist for 1 s": Case(
        "simulation_1", detector="persistence of box errors, 1 s", kinds=("correlation in time", "box error s")
    ),
}


@dataclass(frozen=True, eq=False)
class Run:
    """One seed's run and what `check run` says of each parameter of the file that it was made with."""

    evidence: Evidence
    parameters: Sequence[Parameter]

    def held_against(self, change: Change, table: MomentTable) -> Any:
        """The verdicts against a changed file: only the part of the state that changed is looked at again."""
        state = next(p.state for p in self.parameters if p.name == change.name)
        states = None if state is None else [state]
        box_errors = partial(box_error_checks, table=table, states=states)
        part = {
            "stay": state_checks,
            "false n": class_checks,
            "correlation in time": box_errors if change.name.endswith("box_s") else class_checks,
            "false d": false_positive_checks,
            "confid": confidence_checks,
            "box er": box_errors,
        }
        checks = next(check for begin, check in part.items() if change.kind.startswith(begin))
        again = {p.name: p for p in checks(change.model, self.evidence) if state is None or p.state in (state, None)}
        if change.kind.startswith("box er"):  # the correlation over all states takes what is off out of itself
            again = {name: p for name, p in again.items() if p.state == state}
        return judge([again.get(parameter.name, parameter) for parameter in self.parameters])


def make_runs(many: ManyDetections, model: DetectorModel, seeds: int, table: MomentTable) -> list[Run]:
    """Honest runs."""
    runs = []
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        evidence = many.detect(model, seed)
        runs.append(Run(evidence, [verdict.parameter for verdict in verify_evidence(model, evidence, table).verdicts]))
    return runs


def look_at(change: Change, runs: Sequence[Run], table: MomentTable) -> dict[str, Any]:
    """How often a change is noticeable, caught and named."""
    branch = table.branch()
    noticeable = caught = named = caught_in_all = named_in_all = 0
    needed, mistaken = [], []
    for run in runs:
        found = run.held_against(change, branch)
        verdict = next(verdict for verdict in found.verdicts if verdict.parameter.name == change.name)
        # The file asks for more than the run was made with: the run is below what is asked.
        reach = verdict.noticed[0 if change.up else 1]
        needed.append(np.inf if reach is None else reach / change.size)
        right = found.cause is not None and found.cause.parameter.name == change.name
        caught_in_all += verdict.fails
        named_in_all += right
        if needed[-1] <= 1:
            noticeable, caught, named = noticeable + 1, caught + verdict.fails, named + right
            if verdict.fails and not right:
                mistaken.append(found.cause.parameter.name)
    return {
        "kind": change.kind,
        "parameter": change.name,
        "size": change.size if change.up else -change.size,
        "seeds": len(runs),
        "needed_over_size": float(np.median(needed)),
        "noticeable": noticeable,
        "caught": int(caught),
        "named": int(named),
        "caught_in_all": int(caught_in_all),
        "named_in_all": int(named_in_all),
        "mistaken_for": sorted(set(mistaken)),
    }


def look_at_case(name: str, seeds: int) -> tuple[str, list[dict[str, Any]]]:
    """Every change of a case's detector."""
    scene = CASES[name].load()
    table = MomentTable()
    runs = make_runs(ManyDetections.of_scene(scene), scene.detector, seeds, table)
    return name, [look_at(change, runs, table) for change in CASES[name].changes(scene)]


def holds(rows: list[dict[str, Any]]) -> bool:
    """Whether of every kind of change nine in ten of those that can be noticed are caught and named."""
    kinds = {row["kind"] for row in rows}
    of_kind = [[row for row in rows if row["kind"] == kind] for kind in kinds]
    return all(sum(r["named"] for r in ours) >= SHARE * sum(r["noticeable"] for r in ours) for ours in of_kind)


def page(found: dict[str, list[dict[str, Any]]], versions: dict[str, str]) -> str:
    lines = [
        "# Changes made to the detector file after the run",
        "",
        "Written by `script/campaign verify_changes`; the same figures are in `verify_changes.json`.",
        "",
        (__doc__ or "").split("\n\n", 1)[1].replace("\n", " ").strip(),
        "",
        "*Needed* is the smallest change that such a run notices, over the change made; *noticeable* in how many of "
        "the seeds it is at most one; of those *caught* and *named* (what stands out is what was changed). "
        "Seeds are the detector's; each scene has this traffic only.",
        "",
        "| Scene | Kind | Parameters | Runs | Noticeable | Caught | Named |",
        "|---|---|---|---|---|---|---|",
    ]
    for scene, rows in found.items():
        for kind in dict.fromkeys(row["kind"] for row in rows):
            ours = [row for row in rows if row["kind"] == kind]
            total = {key: sum(row[key] for row in ours) for key in ("seeds", "noticeable", "caught", "named")}
            shares = [
                f"{total[key]} ({total[key] / total['noticeable']:.1%})" if total["noticeable"] else "–"
                for key in ("caught", "named")
            ]
            lines.append(
                f"| {scene} | {kind} | {len(ours)} | {total['seeds']} | {total['noticeable']} | {' | '.join(shares)} |"
            )
    for scene, rows in found.items():
        lines += ["", f"## {scene}", "", "| Parameter | Change | Needed | Noticeable | Caught | Named |"]
        lines += ["|---|---|---|---|---|---|"]
        for row in rows:
            needed = f"{row['needed_over_size']:.2f}" if np.isfinite(row["needed_over_size"]) else "–"
            lines.append(
                f"| `{row['parameter']}` | {row['size']:+.4g} | {needed} | {row['noticeable']} of {row['seeds']} | "
                f"{row['caught']} | {row['named']} |"
            )
    lines += ["", "With " + ", ".join(f"{name} {number}" for name, number in versions.items()) + "."]
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(prog="script/campaign verify_changes", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=SEEDS, help="for each change")
    parser.add_argument("--only", nargs="+", choices=CASES, help="the others stay as they are written")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=OUT, help="folder for verify_changes.md and verify_changes.json")
    asked = parser.parse_args()
    names = asked.only or list(CASES)
    found = {} if asked.only is None else written(asked.out)
    with ProcessPoolExecutor(asked.processes, multiprocessing.get_context("spawn")) as pool:
        for name, rows in pool.map(look_at_case, names, [asked.seeds] * len(names)):
            print(f"{name}: {len(rows)} changes", file=sys.stderr, flush=True)
            found = {case: rows if case == name else found[case] for case in CASES if case == name or case in found}
            write(found, asked.out)
    return int(not all(holds(rows) for rows in found.values()))


def written(folder: Path) -> dict[str, list[dict[str, Any]]]:
    """What a folder has already."""
    path = folder / "verify_changes.json"
    changes: dict[str, list[dict[str, Any]]] = json.loads(path.read_text("utf-8"))["changes"] if path.exists() else {}
    for row in (row for rows in changes.values() for row in rows):
        row["needed_over_size"] = np.inf if row["needed_over_size"] is None else row["needed_over_size"]
    return changes


def write(found: dict[str, list[dict[str, Any]]], folder: Path) -> None:
    versions = {"modsim3d": version("modsim3d"), "NumPy": np.__version__}
    folder.mkdir(parents=True, exist_ok=True)
    data = json.dumps({"format": 1, "versions": versions, "changes": found}, indent=2).replace("Infinity", "null")
    (folder / "verify_changes.json").write_text(data + "\n", encoding="utf-8")
    (folder / "verify_changes.md").write_text(page(found, versions), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
