"""fuzz: 200,000 spoiled inputs of every reader; each is accepted or refused with a clear error, in time and memory.

tests/fuzz makes the inputs: good files (shipped scenes, samples, small runs) with wrong, huge, missing, repeated or
nested values, keys and entries, and with changed bytes. A case is a reader and a number, and its number alone makes it:
`script/campaign fuzz --reader coco --case 12345` does that case again and keeps its files. Exit status 1 if a case
fails: an exception that is no ModsimError, a warning, an unclear message, too much time or memory, a hang, a crash.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import sys
import tempfile
import warnings
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tests.fuzz.workers import Result

OUT = Path(__file__).resolve().parents[2] / "docs" / "campaigns"
LISTED = 3
"""Failures of one cause that are listed."""
HEADER = ("Reader", "Cases", "Accepted", "Refused", "Failed", "Slowest", "Most memory")


@dataclass
class Tally:
    """What became of a reader's cases."""

    cases: int = 0
    accepted: int = 0
    refused: int = 0
    failed: int = 0
    slowest_cpu_s: float = 0.0
    slowest_case: int = 0
    most_memory_mb: float = 0.0
    most_memory_case: int = 0
    causes: dict[str, int] = field(default_factory=dict)
    failures: list[dict[str, Any]] = field(default_factory=list)

    def add(self, result: Result) -> None:
        """Count a case."""
        from tests.fuzz.workers import within_limits

        outcome = within_limits(result)
        self.cases += 1
        setattr(self, outcome.verdict, getattr(self, outcome.verdict) + 1)
        if result.cpu_s > self.slowest_cpu_s:
            self.slowest_cpu_s, self.slowest_case = round(result.cpu_s, 3), result.number
        if result.memory_bytes / 1e6 > self.most_memory_mb:
            self.most_memory_mb, self.most_memory_case = round(result.memory_bytes / 1e6, 1), result.number
        if outcome.verdict == "failed":
            count = self.causes[outcome.place] = self.causes.get(outcome.place, 0) + 1
            if count <= LISTED:
                self.failures.append({"case": result.number, "cause": outcome.place, "said": outcome.said})


def table(found: dict[str, dict[str, Any]]) -> str:
    """The figures of all readers as Markdown."""
    rows = [f"| {' | '.join(HEADER)} |", "|---|" + "---:|" * (len(HEADER) - 1)]
    for name, row in found.items():
        rows.append(
            f"| {name} | {row['cases']:,} | {row['accepted']:,} | {row['refused']:,} | **{row['failed']}** | "
            f"{row['slowest_cpu_s']:.2f} s | {row['most_memory_mb']:.0f} MB |"
        )
    total = {key: sum(row[key] for row in found.values()) for key in ("cases", "accepted", "refused", "failed")}
    slowest = max(row["slowest_cpu_s"] for row in found.values())
    most = max(row["most_memory_mb"] for row in found.values())
    counts = f"{total['cases']:,} | {total['accepted']:,} | {total['refused']:,} | **{total['failed']}**"
    return "\n".join([*rows, f"| all | {counts} | {slowest:.2f} s | {most:.0f} MB |"])


def page(found: dict[str, dict[str, Any]], limits: dict[str, Any], versions: dict[str, str]) -> str:
    lines = [
        "# Spoiled inputs",
        "",
        "Written by `script/campaign fuzz`; the same figures are in `fuzz.json`.",
        "",
        "Each case is a good input – a shipped scene, a sample, a small run – with one to eight things wrong: a value "
        "of another kind, huge, tiny, negative, not finite, of 400 digits, empty or very long; a key or an entry that "
        "is missing, repeated, renamed or nested; aliases and tags of YAML; lost, repeated or retyped columns of "
        "tables, mostly with checksums that are right again; flipped, cut and inserted bytes; files that are missing, "
        "empty, packed or in another encoding. A case may be accepted, and what was read is then used for a moment, or "
        "refused: with a ModsimError that names its source, "
        f"in at most {limits['lines']} lines of at most {limits['characters']} characters, without control characters. "
        "Anything else is a failure: another exception, a warning, a crash, a hang, more than "
        f"{limits['cpu_s']:g} s of processor time, or more than {limits['memory_mb']:g} MB above the warm process.",
        "",
        "`script/campaign fuzz --reader coco --case 12345` does one case again and keeps its files.",
        "",
        table(found),
        "",
    ]
    for name, row in found.items():
        lines += [f"- {name} {each['case']}: {each['cause']}" for each in row["failures"]]
    lines += ["With " + ", ".join(f"{name} {number}" for name, number in versions.items()) + "."]
    return "\n".join(lines) + "\n"


def one_case(reader: str, number: int) -> int:
    """Do a case in this process, say what became of it, and keep its files."""
    from tests.fuzz.workers import measured, memory_bytes, warm_up, within_limits

    folder = Path(tempfile.gettempdir()) / f"modsim3d_fuzz_{reader}_{number}"
    shutil.rmtree(folder, ignore_errors=True)
    with tempfile.TemporaryDirectory() as warm:
        warm_up(reader, Path(warm))
    warnings.simplefilter("error")
    result = measured(reader, number, folder, memory_bytes("VmRSS"))
    outcome = within_limits(result)
    print(f"{outcome.verdict} {outcome.place}\n{outcome.said}")
    print(f"{result.cpu_s:.3f} s of processor time, {result.memory_bytes / 1e6:.0f} MB\nfiles  {folder}")
    return int(outcome.verdict == "failed")


def campaign(readers: list[str], first: int, most: int | None, processes: int) -> dict[str, dict[str, Any]]:
    """The figures of some readers."""
    from tests.fuzz.readers import READERS
    from tests.fuzz.workers import tried

    found = {}
    for name in readers:
        tally, count = Tally(), min(READERS[name].cases, most or READERS[name].cases)
        for result in tried(name, range(first, first + count), processes):
            tally.add(result)
        found[name] = asdict(tally)
        used_s = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        said = f"{name}: {tally.failed} of {tally.cases} failed {tally.causes}; {used_s:.0f} s so far"
        print(said, file=sys.stderr, flush=True)
    return found


def keep_failed(found: dict[str, dict[str, Any]]) -> None:
    """Keep an input of each cause of failure, so that the tests try it from now on."""
    from tests.fuzz.cases import keep

    for name, row in found.items():
        for cause in row["causes"]:
            keep(name, cause, [each["case"] for each in row["failures"] if each["cause"] == cause])


def with_the_others(found: dict[str, dict[str, Any]], path: Path) -> dict[str, dict[str, Any]]:
    """The figures that a file has, in the order of the readers, with these in place of theirs."""
    from tests.fuzz.readers import READERS

    stored = json.loads(path.read_text(encoding="utf-8"))["readers"] if path.exists() else {}
    every = {**stored, **found}
    return {name: every[name] for name in READERS if name in every}


def main() -> int:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line has it; before NumPy is imported
    os.environ.setdefault("JE_ARROW_MALLOC_CONF", "background_thread:false")
    from tests.fuzz.outcomes import MAX_CHARACTERS, MAX_LINES
    from tests.fuzz.readers import READERS
    from tests.fuzz.workers import MAX_BYTES, MAX_CPU_S, preload

    parser = argparse.ArgumentParser(prog="script/campaign fuzz", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--reader", action="append", choices=READERS, help="repeatable; the others stay as written")
    parser.add_argument("--case", type=int, help="do this case of a reader alone, and keep its files")
    parser.add_argument("--cases", type=int, help="fewer of each reader than the campaign's own, for a try")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--keep", action="store_true", help="keep a failed input of each cause, for the tests")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=OUT, help="folder for fuzz.md and fuzz.json")
    options = parser.parse_args()
    preload()
    readers = options.reader or list(READERS)
    if options.case is not None:
        return one_case(readers[0], options.case)
    found = campaign(readers, options.first, options.cases, options.processes)
    if options.keep:
        keep_failed(found)
    if options.reader:
        found = with_the_others(found, options.out / "fuzz.json")
    limits = {"cpu_s": MAX_CPU_S, "memory_mb": MAX_BYTES / 1e6, "lines": MAX_LINES, "characters": MAX_CHARACTERS}
    versions = {
        name: version(name) for name in ("modsim3d", "numpy", "pyarrow", "pydantic", "PyYAML", "trimesh", "pyais")
    }
    options.out.mkdir(parents=True, exist_ok=True)
    data = json.dumps({"format": 1, "versions": versions, "limits": limits, "readers": found}, indent=2)
    (options.out / "fuzz.json").write_text(data + "\n", encoding="utf-8")
    (options.out / "fuzz.md").write_text(page(found, limits, versions), encoding="utf-8")
    print(table(found))
    return int(any(row["failed"] for row in found.values()))


if __name__ == "__main__":
    sys.exit(main())
