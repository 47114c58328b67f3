"""The commands besides `run`, each over an older output of its own.

`export --format rerun` and `check truth` are not among them: no recording of the Rerun SDK has the same bytes twice,
and a comparison says how long it took.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks.faults.commands import run
from benchmarks.faults.jobs import Job

AIS = Path(__file__).resolve().parents[2] / "tests" / "data" / "ais"
STEPS = 60
SMALL = ("--end", 1, "--width", 320, "--overwrite")
OVERWRITE = ("--overwrite",)


def sources(folder: Path) -> tuple[Path, Path]:
    """Two finished runs, from which the new and the old output are made."""
    found = []
    for seed in (0, 1):
        out = folder / f"source{seed}"
        options = ("--steps", STEPS, "--source", "analytic", "--seed", seed, "--no-sheet", "--out", out)
        if (ended := run(["run", "simulation_1", *options])).status != 0:
            raise RuntimeError(ended.said)
        found.append(out)
    return found[0], found[1]


def arguments_of(source: Path, other: bool, out: Path) -> dict[str, tuple[object, ...]]:
    """The command line of each command.

    Args:
        source: A run.
        other: Whether the older output is made, which must differ.
        out: The folder to write to.
    """
    csv = AIS / ("marinecadastre.csv" if other else "danish.csv")
    return {
        "detect": ("detect", source, "--detector-seed", 3, "--out", out, "--overwrite"),
        "learn": ("learn", source, "--replicates", 20, "--out", out / "detector.yaml", "--overwrite"),
        "export": ("export", source, "--format", "coco", "--out", out, "--overwrite"),
        "ais": ("ais", csv, "--out", out, "--overwrite"),
        "report": ("report", source, "--out", out / "report.html", "--overwrite"),
        "verify": ("check", "run", source, "--out", out, "--overwrite"),
        "film.mp4": ("view", "film", source, "--kind", "detections", *SMALL, "--out", out / "film.mp4"),
        "film.gif": ("view", "film", source, "--kind", "detections", *SMALL, "--out", out / "film.gif"),
        "film.png": ("view", "film", source, "--kind", "detections", *SMALL, "--format", "png", "--out", out / "film"),
        "picture": ("view", "frame", source, "1.0", "--width", 320, "--overwrite", "--out", out / "picture.png"),
        "map": ("view", "map", source, "--overwrite", "--out", out / "map.svg"),
        "contact sheet": ("view", "sheet", out, "--overwrite"),
    }


def output_jobs(folder: Path, target: Path, names: Sequence[str] = ()) -> Iterator[Job]:
    """Every command, undisturbed once.

    Args:
        folder: For the sources and the older outputs.
        target: Where the commands write.
        names: Of some only.
    """
    new, old = sources(folder)
    for name, arguments in arguments_of(new, False, target).items():
        if names and name not in names:
            continue
        start = folder / "old" / name.replace(" ", "_")
        shutil.rmtree(target, ignore_errors=True)
        if name == "contact sheet":
            shutil.copytree(new, target)
            shutil.copy(AIS / "danish.csv", target / "contact_sheet.png")
        else:
            target.mkdir(parents=True)
            ended = run(arguments_of(old, True, target)[name])
            if ended.status not in (0, 1):  # `verify` and `compare` may find something
                raise RuntimeError(f"{name}: {ended.said}")
        shutil.rmtree(start, ignore_errors=True)
        shutil.copytree(target, start)
        job = Job(name, arguments, target, start=start, is_run=name == "detect")
        yield replace(job.known(), name=name)
