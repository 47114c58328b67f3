"""mutants: one small change at a time to camera, truth, renderer, verdicts and detector must make a test fail.

A mutant is a module with one operator, number, index, condition, argument, result or statement changed. Each meets the
tests that reach the changed line, the quickest first, until one fails or `BUDGET_S` of processor time is used up. The
mutants of the camera are tried in full, of each other file a random share. What survives is looked at by hand: the
verdicts are in `mutants_verdicts.yaml` beside the result.
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import json
import math
import os
import random
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import yaml

from benchmarks.mutants.mutations import Mutant, mutants_of, mutated
from benchmarks.mutants.processes import KILLED, SURVIVED, TIMED_OUT, preload
from benchmarks.mutants.reach import SLOW_S, Reach, map_tests
from benchmarks.mutants.trials import Trial, outcomes, run_trials

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "docs" / "campaigns"
ROOMS = {"geometry": 1.0, "truth": 0.4, "render": 0.4, "campaign/verdicts": 0.3, "detector": 0.1}
"""Share of the mutants of each file of these folders of modsim3d that is tried."""
TESTS = {
    "geometry": ("geometry", "truth", "world", "scene"),
    "truth": ("truth", "geometry", "render", "world", "scene"),
    "render": ("render", "truth", "view/test_shaded.py"),
    "campaign/verdicts": ("campaign",),
    "detector": ("detector", "verify"),
}
"""Where the tests of a room are, its own first."""
BUDGET_S = 2.0
SEED = 1


def sources(only: str | None) -> list[str]:
    every = [
        f"modsim3d/{room}/{path.name}" for room in ROOMS for path in sorted((ROOT / "modsim3d" / room).glob("*.py"))
    ]
    return [path for path in every if only is None or only in path]


def room_of(path: str) -> str:
    return path.removeprefix("modsim3d/").rpartition("/")[0]


def sampled(path: str, share: float | None) -> tuple[int, list[Mutant]]:
    """How many mutants a file has, and a random share of them, the same every time."""
    every = mutants_of((ROOT / path).read_text(encoding="utf-8"))
    share = ROOMS[room_of(path)] if share is None else share
    chosen = random.Random(f"{SEED} {path}").sample(every, math.ceil(share * len(every)))
    return len(every), sorted(chosen, key=lambda mutant: mutant.index)


def trial_of(path: str, mutant: Mutant, reach: Reach, budget_s: float) -> Trial:
    tests = reach.of_lines(path, mutant.lines)
    if not mutant.function:  # constants and defaults, which no test is seen to reach
        own = f"tests/{TESTS[room_of(path)][0]}/"
        tests = reach.of_file(path) | {name for name in reach.cost_s if name.startswith(own)}
    chosen = {name: reach.alone_s(name) for name in reach.quickest(tests, budget_s)}
    tree = functools.partial(mutated, (ROOT / path).read_text(encoding="utf-8"), mutant.index)
    return Trial(key(path, mutant.index), path, mutant.function, tree, chosen)


def key(path: str, index: int) -> str:
    return f"{path} {digest(path)[:12]} {index}"


def digest(path: str) -> str:
    return hashlib.sha256((ROOT / path).read_bytes()).hexdigest()


def names(mutants: Sequence[Mutant]) -> dict[int, str]:
    """A name for each mutant that stays when lines move: its function, its change, and which of several it is."""
    seen: Counter[str] = Counter()
    found = {}
    for mutant in mutants:
        name = f"{mutant.function or 'module'}: {mutant.change}"
        seen[name] += 1
        found[mutant.index] = name if seen[name] == 1 else f"{name} ({seen[name]})"
    return found


def summed_up(path: str, count: int, tried: list[Mutant], ends: list[str]) -> dict[str, Any]:
    name = names(mutants_of((ROOT / path).read_text(encoding="utf-8")))
    survivors = [
        {"line": mutant.lines[0], "mutant": name[mutant.index], "index": mutant.index}
        for mutant, end in zip(tried, ends, strict=True)
        if end == SURVIVED
    ]
    counts = Counter(ends)
    return {
        "sha256": digest(path),
        "mutants": count,
        "tried": len(tried),
        "killed": counts[KILLED],
        "timed_out": counts[TIMED_OUT],
        "killed_later": 0,
        "survivors": survivors,
    }


def chosen_mutants(asked: argparse.Namespace, before: dict[str, Any]) -> dict[str, tuple[int, list[Mutant]]]:
    """What is to be tried of each file: a share of its mutants or, on request, the survivors that are open."""
    chosen = {path: sampled(path, asked.share) for path in sources(asked.only)}
    if not asked.survivors:
        return chosen
    known = {path: (count, mutants) for path, (count, mutants) in chosen.items() if path in before}
    changed = [path for path in known if before[path]["sha256"] != digest(path)]
    if changed:
        raise SystemExit(f"{', '.join(changed)}: changed since the campaign; run it without --survivors")
    alive = {path: {row["index"] for row in still_open(path, before[path], asked.out)} for path in known}
    return {
        path: (
            count,
            [mutant for mutant in mutants_of((ROOT / path).read_text("utf-8")) if mutant.index in alive[path]],
        )
        for path, (count, _) in known.items()
    }


def still_open(path: str, row: dict[str, Any], folder: Path) -> list[dict[str, Any]]:
    judged = verdicts(folder)
    return [survivor for survivor in row["survivors"] if (path, survivor["mutant"]) not in judged]


def updated(path: str, row: dict[str, Any], again: dict[str, Any], folder: Path) -> dict[str, Any]:
    """A file's row after its open survivors were tried again."""
    tried = [survivor["index"] for survivor in still_open(path, row, folder)]
    explained = [survivor for survivor in row["survivors"] if survivor["index"] not in tried]
    return {
        **row,
        "killed": row["killed"] + again["killed"],
        "timed_out": row["timed_out"] + again["timed_out"],
        "killed_later": row.get("killed_later", 0) + again["killed"] + again["timed_out"],
        "survivors": sorted(explained + again["survivors"], key=lambda survivor: survivor["index"]),
    }


def verdicts(folder: Path) -> dict[tuple[str, str], dict[str, str]]:
    path = folder / "mutants_verdicts.yaml"
    if not path.exists():
        return {}
    data = yaml.safe_load(path.read_text(encoding="utf-8")) or {}
    return {(file, row["mutant"]): row for file, rows in data.items() for row in rows}


def page(files: dict[str, Any], judged: dict[tuple[str, str], dict[str, str]], packages: dict[str, str]) -> str:
    lines = [
        "# Mutants: do the tests notice a wrong line?",
        "",
        "Written by `script/campaign mutants`; the same figures are in `mutants.json`, the verdicts on survivors in "
        "`mutants_verdicts.yaml`.",
        "",
        "A mutant is a module with one operator, number, index, condition, argument, result or statement changed. It "
        "is killed if a test fails, or if a test needs more than three times its processor time (timed out). It "
        f"meets the tests that reach its line, the quickest first, for up to {BUDGET_S:.0f} s; tests of more than "
        f"{SLOW_S:.0f} s, and those of other rooms, are left out, and can only kill more.",
        "",
        "Tried is a random share of the mutants of each file: "
        + ", ".join(f"{share:.0%} in `{room}`" for room, share in ROOMS.items())
        + ".",
        "",
        "Killed later are those that survived the first run, but not one with more tests. A survivor is explained "
        "if it changes no result that a user can see: it is equivalent, within a tolerance, or changes the text of a "
        "message or the speed only; or if tests that are left out notice it, which was tried by hand: those of other "
        "rooms, and those that start a program, as the campaign changes its own process only. The others are open.",
        "",
        "| File | Mutants | Tried | Killed | of these later | Timed out | Survived | Explained | Open |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    total: Counter[str] = Counter()
    for room in ROOMS:
        part: Counter[str] = Counter()
        for path, row in files.items():
            if room_of(path) == room and row["tried"]:
                counts = figures(path, row, judged)
                part += counts
                lines.append(table_row(f"`{path.removeprefix('modsim3d/')}`", counts))
        total += part
        lines.append(table_row(f"**{room}**", part))
    lines.append(table_row("**all**", total))
    lines += ["", "## Survivors", ""]
    for path, row in files.items():
        if row["survivors"]:
            lines += [f"### `{path.removeprefix('modsim3d/')}`", "", "| Line | Mutant | Verdict |", "|---|---|---|"]
            lines += [survivor_row(path, each, judged) for each in row["survivors"]]
            lines.append("")
    lines.append("With " + ", ".join(f"{name} {number}" for name, number in packages.items()) + ".")
    return "\n".join(lines) + "\n"


def figures(path: str, row: dict[str, Any], judged: dict[tuple[str, str], dict[str, str]]) -> Counter[str]:
    known = [judged.get((path, each["mutant"])) for each in row["survivors"]]
    explained = sum(verdict is not None for verdict in known)
    return Counter(
        mutants=row["mutants"],
        tried=row["tried"],
        killed=row["killed"],
        killed_later=row["killed_later"],
        timed_out=row["timed_out"],
        survived=len(known),
        explained=explained,
        open=len(known) - explained,
    )


def table_row(name: str, counts: Counter[str]) -> str:
    columns = ("mutants", "tried", "killed", "killed_later", "timed_out", "survived", "explained", "open")
    return f"| {name} | " + " | ".join(f"{counts[column]:,}" for column in columns) + " |"


def survivor_row(path: str, survivor: dict[str, Any], judged: dict[tuple[str, str], dict[str, str]]) -> str:
    verdict = judged.get((path, survivor["mutant"]))
    said = f"{verdict['verdict']}: {verdict['why']}" if verdict else "**open**"
    return f"| {survivor['line']} | `` {survivor['mutant'].replace('|', chr(92) + '|')} `` | {said} |"


def main() -> int:
    parser = argparse.ArgumentParser(prog="script/campaign mutants", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", help="files whose path contains this; the other rows stay as they are written")
    parser.add_argument("--share", type=float, help="another share of each file's mutants, for a try")
    parser.add_argument("--survivors", action="store_true", help="only survivors of the last time without a verdict")
    parser.add_argument("--page", action="store_true", help="only write the page anew, after a change of the verdicts")
    parser.add_argument("--budget", type=float, default=BUDGET_S, help="seconds of tests for each mutant")
    parser.add_argument("--keep", type=Path, help="folder that keeps what is found, to go on after an interruption")
    parser.add_argument("--out", type=Path, default=OUT, help="folder for mutants.md and mutants.json")
    asked = parser.parse_args()
    os.chdir(ROOT)
    preload()
    path = asked.out / "mutants.json"
    before = json.loads(path.read_text(encoding="utf-8"))["files"] if path.exists() else {}
    files = {**before, **({} if asked.page else campaign(asked, before))}
    files = {name: files[name] for name in sources(None) if name in files}
    packages = {"modsim3d": version("modsim3d"), "NumPy": version("numpy"), "pytest": version("pytest")}
    asked.out.mkdir(parents=True, exist_ok=True)
    data = {"format": 1, "versions": packages, "seed": SEED, "files": files}
    path.write_text(json.dumps(data, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    judged = verdicts(asked.out)
    (asked.out / "mutants.md").write_text(page(files, judged, packages), encoding="utf-8")
    return int(any((name, each["mutant"]) not in judged for name, row in files.items() for each in row["survivors"]))


def reach_of(folder: Path, rooms: list[str], options: list[str]) -> Reach:
    """What the tests of some rooms reach, from files in a folder where these are."""
    places = dict.fromkeys(place for room in rooms for place in TESTS[room])
    kept = {place: folder / f"{place.replace('/', '_')}.json" for place in places}
    folder.mkdir(exist_ok=True)
    for place in places:
        if not kept[place].exists():
            print(f"what tests/{place} reach", file=sys.stderr)
            map_tests(ROOT, sources(None), [*options, f"tests/{place}"], kept[place])
    return Reach.joined([Reach.load(path) for path in kept.values()])


def campaign(asked: argparse.Namespace, before: dict[str, Any]) -> dict[str, Any]:
    """The rows of the files that are looked at."""
    chosen = chosen_mutants(asked, before)
    with tempfile.TemporaryDirectory() as folder:
        kept, options = asked.keep or Path(folder), [f"--basetemp={folder}/tests"]
        reach = reach_of(kept, [room_of(name) for name in chosen], options)
        done = {} if asked.survivors else outcomes(kept / "outcomes")
        trials = [
            trial_of(name, mutant, reach, asked.budget) for name, (_, mutants) in chosen.items() for mutant in mutants
        ]
        run_trials([trial for trial in trials if trial.key not in done], kept / "outcomes", options)
        done = outcomes(kept / "outcomes")
    rows = {}
    for name, (count, mutants) in chosen.items():
        row = summed_up(name, count, mutants, [done[key(name, mutant.index)] for mutant in mutants])
        rows[name] = updated(name, before[name], row, asked.out) if asked.survivors else row
    return rows


if __name__ == "__main__":
    sys.exit(main())
