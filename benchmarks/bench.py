"""Times modsim3d against what was promised, and writes benchmarks/RESULTS.md.

Everything that is compared is timed in turn, in processes of its own, one round after another; a figure is the median
of the rounds. A figure that falls short is reported as it is, with a profile. Exit status 0 unless something breaks.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

from benchmarks.figures import FIGURES
from benchmarks.measured import BUSY_LOAD, Bench, Found, table
from benchmarks.processes import ROOT, child, say

RESULTS = ROOT / "benchmarks" / "RESULTS.md"

METHOD = """\
## How it was measured

- What a figure compares was timed in turn, round by round, each time in a new process; a figure is the median, with \
the least and the greatest of the rounds in brackets, and a ratio is the median of the rounds' ratios.
- Frames per second are those of `run_scene` in a process that has not run before: from reading the scene file to the \
finished run directory, the renderer's start included (its context, its shaders), Python's imports and the contact \
sheet not. Where a ratio is \
meant to show how time grows (image size, number of vessels), a few steps are run first, as a constant start-up would \
make the growth look smaller. `--workers`, memory and cold start are those of the command itself, by the clock. \
Python keeps its byte code, as that of an installed package; the start that writes it is not counted.
- Harbour and strait are the shipped scenes with all their steps; the strait has two cameras, and the frames of both \
count. The thousand boats are those of `scenes.thousand` in `benchmarks/scenes.py`.
- Python's start, reading the scene and the renderer's start come before the first block of a run, and checksums and \
waits for the disk after the last: with two workers they take as long as with one. So the longer run gains more.
- A live step is that of `modsim3d stream` with Simulation 2's poses on standard input, as in \
[LATENCY.md](LATENCY.md): from writing the line of poses to having read the step's last line in another process.
- The fast path is from poses to full and visible boxes, in a process that is warm, in blocks as a run makes them, \
averaged over all 1,500 frames. In these OpenGL draws nothing. The ID pass has the same task and draws buffers for \
it, as with `annotation.render: full`; it and pyrender draw 15 of the frames a round. Of pyrender, the renderer, \
scene and meshes are made once; timed are setting the nodes' poses, one SEG image, and the boxes of its colours. That \
image shows visible boxes only; those of whole vessels take an image of each alone, which are drawn for the check \
that both give the same boxes (within one pixel a side) and not timed. All have `LP_NUM_THREADS=0`.
- Times the limit: the bytes of colour (4) and depth (4) of the pixels in the regions that were drawn, over the \
bandwidth of a plain NumPy fill, is the least time that drawing could take; the column says how many times that the \
measured time is. Where only overlaps are drawn, it is little, and the time is spent on everything else.
- Overlapping: the share of vessels whose box overlaps another's. The `small` scenes are seen from the higher, the \
more boats there are, so that this share stays."""


def page(found: Found, quick: bool, bytes_per_s: float, load: float) -> str:
    """RESULTS.md."""
    machine = child("machine")
    cores = len(os.sched_getaffinity(0))
    versions = ", ".join(f"{name} {number}" for name, number in machine["versions"].items())
    lines = ["# Benchmarks", "", "Written by `script/bench`; do not edit.", ""]
    if quick:
        lines += ["**A quick trial: one round of little work. These are not the figures.**", ""]
    lines += [
        f"- Processor: {machine['processor']}, {cores} cores; memory: {machine['memory_gib']:.1f} GiB",
        f"- Renderer: {machine['renderer']}",
        f"- {versions}",
        f"- Memory bandwidth, a plain NumPy fill: {bytes_per_s / 1e9:.1f} GB/s",
    ]
    if load > BUSY_LOAD:
        lines.append(f"- **The machine was not idle: a load of {load:.1f} before it began.**")
    lines += ["", table(("Figure", "Promise", "Measured", "Met", "× the limit"), [row.cells() for row in found.rows])]
    for section in (*found.sections, METHOD):
        lines += ["", section]
    if found.profiles:
        lines += ["", "## Profiles of what falls short", "", "Under cProfile, which slows small functions down."]
        for profile in found.profiles:
            lines += ["", profile]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(prog="script/bench", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="one round of little work, to try it out")
    parser.add_argument("--only", action="append", choices=FIGURES, metavar="NAME", help=", ".join(FIGURES))
    parser.add_argument("--out", type=Path, help="file (benchmarks/RESULTS.md if everything is measured, else none)")
    asked = parser.parse_args()
    load = os.getloadavg()[0]
    bytes_per_s = child("bandwidth")["bytes_per_s"]
    found = Found()
    with tempfile.TemporaryDirectory(prefix="modsim3d-bench-") as folder:
        for name in asked.only or FIGURES:
            say(name)
            figure = FIGURES[name](Bench(asked.quick, Path(folder), bytes_per_s))
            for kind in ("rows", "sections", "profiles"):
                getattr(found, kind).extend(getattr(figure, kind))
            for row in figure.rows:
                say(f"  {' | '.join(row.cells())}")
    text = page(found, asked.quick, bytes_per_s, load)
    out = asked.out or (RESULTS if not (asked.quick or asked.only) else None)
    if out is not None:
        out.write_text(text, encoding="utf-8", newline="\n")
    print(text, end="")


if __name__ == "__main__":
    main()
