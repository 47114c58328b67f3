"""platforms: the shipped scenes on other processors, numerical libraries and renderers; which files are the same bytes.

One machine stands in for others. NumPy, the C library, OpenBLAS and Mesa are told by their environment variables not to
use what an older processor lacks, and other Pythons with other versions of NumPy and SciPy are given with
`--python PATH`. Each platform runs each scene; a file that differs from the first platform's is listed with the rows
and columns that differ, and by how much. Exit status 1 if a number of a detection differs.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from modsim3d.runs.repeat_run import SAME_ROWS, difference

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "docs" / "campaigns"
SCENES = ("simulation_1", "simulation_2", "simulation_3", "harbour", "strait")
STEPS = 60
NO_FMA = "glibc.cpu.hwcaps=-AVX512F,-AVX2,-FMA,-FMA4"
RUN = """
import sys
import modsim3d.runs.pipeline
from modsim3d.cli.main import main
folder, block_steps, scenes, *options = sys.argv[1:]
modsim3d.runs.pipeline.MAX_BLOCK_STEPS = int(block_steps)
for scene in scenes.split(","):
    sys.argv = ["modsim3d", "run", scene, "--no-sheet", "--out", f"{folder}/{scene}", *options]
    try:
        main()
    except SystemExit as stopped:
        if stopped.code:
            raise
"""
ASK = """
import json, platform, numpy, scipy
try:
    from numpy._core import _multiarray_umath as core
except ImportError:
    from numpy.core import _multiarray_umath as core
found = [name for name in core.__cpu_dispatch__ if core.__cpu_features__.get(name)]
print(json.dumps({"python": platform.python_version(), "numpy": numpy.__version__, "scipy": scipy.__version__,
                  "cpu": found}))
"""


@dataclass(frozen=True)
class Platform:
    """A way to run: its name, environment variables, interpreter, options of `modsim3d run` and steps of a block."""

    name: str
    variables: dict[str, str] = field(default_factory=dict)
    python: str = sys.executable
    options: tuple[str, ...] = ()
    block_steps: int = 250

    def run(self, scenes: Sequence[str], steps: int, folder: Path) -> None:
        """Run scenes into folders of their names; one process, because starting it takes longest."""
        arguments = (str(folder), str(self.block_steps), ",".join(scenes), "--steps", str(steps))
        self.call("-c", RUN, *arguments, *self.options)

    def call(self, *arguments: str) -> str:
        """Run the interpreter and return what it prints."""
        environment = {**os.environ, "PYTHONPATH": str(ROOT), **self.variables}
        done = subprocess.run(
            [self.python, *arguments], env=environment, cwd=ROOT, capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise SystemExit(f"{self.name}: exit status {done.returncode}\n{done.stderr}")
        return done.stdout

    def ask(self) -> dict[str, Any]:
        """Versions, and what NumPy uses of this processor beyond what every processor has."""
        answer: dict[str, Any] = json.loads(self.call("-c", ASK))
        return answer


def without_avx(cpu: Sequence[str]) -> dict[str, str]:
    """Variables that make NumPy, which found these features, the C library, OpenBLAS and Mesa do without AVX."""
    features = {"NPY_DISABLE_CPU_FEATURES": " ".join(cpu)}
    return {**features, "GLIBC_TUNABLES": NO_FMA, "OPENBLAS_CORETYPE": "Prescott", "LP_NATIVE_VECTOR_WIDTH": "128"}


def platforms(pythons: Sequence[str]) -> list[Platform]:
    """All platforms; the first is this one as it is."""
    cpu = Platform("here").ask()["cpu"]
    no_avx512 = {"NPY_DISABLE_CPU_FEATURES": " ".join(name for name in cpu if not name.startswith(("X86_V3", "AVX2")))}
    plain = {"NPY_DISABLE_CPU_FEATURES": " ".join(cpu)}
    found = [
        Platform("this machine"),
        Platform("2 workers", options=("--workers", "2")),
        Platform("blocks of 7 steps", block_steps=7),
        Platform("OSMesa", {"MODSIM3D_GL": "osmesa"}),
        Platform("EGL", {"MODSIM3D_GL": "egl"}),
        Platform("rasteriser with vectors of 128 bits", {"LP_NATIVE_VECTOR_WIDTH": "128"}),
        Platform("NumPy without AVX-512", no_avx512),
        Platform("NumPy without AVX2 and FMA", plain),
        Platform("C library without AVX2 and FMA", {"GLIBC_TUNABLES": NO_FMA}),
        Platform("OpenBLAS for Skylake-X", {"OPENBLAS_CORETYPE": "SkylakeX"}),
        Platform("OpenBLAS for Haswell", {"OPENBLAS_CORETYPE": "Haswell"}),
        Platform("OpenBLAS for Prescott", {"OPENBLAS_CORETYPE": "Prescott"}),
        Platform("OpenBLAS with 2 threads", {"OPENBLAS_NUM_THREADS": "2"}),
        Platform("all of a processor without AVX", without_avx(cpu)),
    ]
    for python in pythons:
        answer = Platform(python, python=python).ask()
        name = "Python {python}, NumPy {numpy}, SciPy {scipy}".format(**answer)
        older = Platform(f"{name}, without AVX", without_avx(answer["cpu"]), python)
        found += [Platform(name, python=python), older]
    return found


def files_of(folder: Path) -> dict[str, bytes]:
    """The files that a run makes, without the copy of its scene and what names versions."""
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.suffix in (".json", ".parquet")}


def differences_of(first: Path, other: Path) -> Iterator[tuple[str, str]]:
    """Name and difference of each file that is not the same, `run.json` left out, which names versions."""
    ours, theirs = files_of(first), files_of(other)
    for name in sorted(ours.keys() | theirs.keys()):
        if name != "run.json" and ours.get(name) != theirs.get(name):
            yield name, difference(first / name, other / name)


def campaign(chosen: Sequence[Platform], scenes: Sequence[str], steps: int, work: Path) -> list[dict[str, Any]]:
    """What differs from the first platform, a row for each other one."""
    rows = []
    for number, platform in enumerate(chosen):
        differs: dict[str, dict[str, str]] = {}
        platform.run(scenes, steps, work / str(number))
        for scene in scenes:
            found = dict(differences_of(work / "0" / scene, work / str(number) / scene))
            differs |= {scene: found} if found else {}
        print(f"{platform.name}: {sum(map(len, differs.values()))} files differ", flush=True)
        if number:
            rows.append({"platform": platform.name, "variables": platform.variables, "differs": differs})
    return rows


def markdown(result: dict[str, Any]) -> str:
    """The page of a result."""
    lines = [
        "# The same scenes on other platforms",
        "",
        f"Written by `script/campaign platforms`: {', '.join(result['scenes'])}, {result['steps']} steps each,",
        f"on {result['reference']}, and again on each platform of the table. {result['files']} files are compared.",
        "",
        "| Platform | Files that differ |",
        "|---|---|",
    ]
    for row in result["platforms"]:
        names = [f"{scene}: {', '.join(files)}" for scene, files in row["differs"].items()]
        lines.append(f"| {row['platform']} | {'; '.join(names) or '**none**'} |")
    lines += ["", "## By how much", ""]
    for row in result["platforms"]:
        for scene, files in row["differs"].items():
            lines += [f"- {row['platform']}, {scene}, `{name}`: {text}" for name, text in files.items()]
    return "\n".join(lines).rstrip() + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--python", nargs="*", default=[], help="other interpreters with modsim3d's packages")
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args()
    chosen = platforms(arguments.python)
    with tempfile.TemporaryDirectory() as folder:
        rows = campaign(chosen, arguments.scenes, arguments.steps, Path(folder))
        files = sum(len(files_of(Path(folder) / "0" / scene)) - 1 for scene in arguments.scenes)
    here = chosen[0].ask()
    reference = "Python {python}, NumPy {numpy} and SciPy {scipy} with {cpu}".format(
        **{**here, "cpu": ", ".join(here["cpu"])}
    )
    result = {
        "scenes": list(arguments.scenes),
        "steps": arguments.steps,
        "reference": reference,
        "files": files,
        "platforms": rows,
    }
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "platforms.json").write_text(json.dumps(result, indent=2) + "\n")
    (arguments.out / "platforms.md").write_text(markdown(result))
    found = [item for row in rows for files in row["differs"].values() for item in files.items()]
    if any(name.startswith("detections") and text != SAME_ROWS for name, text in found):
        sys.exit(1)


if __name__ == "__main__":
    main()
