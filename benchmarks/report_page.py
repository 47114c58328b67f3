"""Times the page of a run, of long runs above all, and writes benchmarks/REPORT_PAGE.md.

A page is written once by `modsim3d report`, in a process of its own; processor times and memory are of the whole
program, from its start. Chromium then opens it from the disk, which has it in memory, and shows 400 steps one after the
other. Run it with `python -m benchmarks.report_page`; `--quick` is a trial that writes nothing, and `--runs DIR` keeps
the runs and takes those that are there.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.measured import significant, table
from benchmarks.processes import ROOT, Finished, modsim3d, say
from modsim3d.runs.stored_run import StoredRun, open_run
from modsim3d.view.report.report import parts_folder
from tests.view.report.browser import Browser, open_browser

RESULTS = ROOT / "benchmarks" / "REPORT_PAGE.md"
ROUNDS, SHOWN = 3, 400
WINDOW = 1280, 1600
MINUTE_S = 60
PLAY = """(async () => {
  const shown = [], drawn = [];
  for (let i = FIRST; i < FIRST + COUNT; i++) {
    const begin = performance.now();
    await player.go(i);
    shown.push(performance.now() - begin);
    drawn.push(player.drawn.milliseconds);
  }
  return { shown, drawn };
})()"""


@dataclass(frozen=True)
class Case:
    """A run whose page is measured.

    Attributes:
        title: The run in words.
        scene: Its scene.
        steps: Its steps.
        source: Where its truth comes from.
        duration_s: Time that all steps take together; None for the scene's own time step.
        beside: Whether the frames lie beside the page.
    """

    title: str
    scene: str
    steps: int
    source: str = "analytic"
    duration_s: float | None = None
    beside: bool = False

    def run(self, folder: Path, quick: bool) -> StoredRun:
        """The run, made if it is not there."""
        steps = max(self.steps // 100, 20) if quick else self.steps
        place = folder / f"{Path(self.scene).stem}_{steps}"
        if not (place / "run.json").is_file():
            step = ["--set", f"time_step_s={self.duration_s / self.steps}"] if self.duration_s else []
            # In a process of its own: what a started program is said to hold is at least what its starter held.
            options = ["--mode", "2", "--source", self.source, "--steps", str(steps), *step, "--no-sheet"]
            modsim3d("run", self.scene, "--out", place, "--quiet", *options)
        return open_run(place)


DENSE = str(ROOT / "benchmarks" / "dense.yaml")
CASES = (
    Case("Simulation 1: 5 vessels, 1,500 steps", "simulation_1", 1_500),
    Case("`dense.yaml`: 50 vessels, 5,000 steps in 60 s", DENSE, 5_000, duration_s=MINUTE_S),
    Case("Strait: meshes in waves, two cameras, 1,500 steps in 60 s", "strait", 1_500, "rendered", MINUTE_S),
    Case("Fairway: meshes in waves, two cameras, 600 steps", "fairway", 600, "rendered"),
    Case("Simulation 1, 200,000 steps", "simulation_1", 200_000),
    Case("the same with `--parts`", "simulation_1", 200_000, beside=True),
)
HEAD = ("Run", "Vessel-frames", "CPU s", "CPU s per 1,000", "Memory", "Page", "Opens in", "ms a frame", "slowest step")


def measure(case: Case, run: StoredRun, browser: Browser, folder: Path) -> list[str]:
    """The row of a case."""
    page = folder / "report.html"
    options = ["--parts"] if case.beside else []
    written = modsim3d("report", run.folder, "--out", page, "--overwrite", "--quiet", *options)
    vessel_frames = run.settings["counts"]["vessel_frames"]
    opened, played = [], {}
    for _ in range(ROUNDS):
        browser.open(page, WINDOW)
        opened.append(browser.run("performance.getEntriesByName('first frame')[0].startTime"))
        first = run.steps // 2
        script = PLAY.replace("FIRST", str(first)).replace("COUNT", str(min(SHOWN, run.steps - first)))
        played = browser.run(script)
    return [
        case.title,
        f"{vessel_frames:,}",
        *_cells(written, vessel_frames),
        _size(page, case),
        *_seen(opened, played),
    ]


def _cells(written: Finished, vessel_frames: int) -> list[str]:
    each = written.processor_s / vessel_frames * 1000
    return [significant(written.processor_s), significant(each), f"{written.peak_bytes / 1e6:.0f} MB"]


def _size(page: Path, case: Case) -> str:
    size = f"{page.stat().st_size / 1e6:.1f} MB"
    if not case.beside:
        return size
    beside = sum(file.stat().st_size for file in parts_folder(page).iterdir())
    return f"{size}, and {beside / 1e6:.1f} MB beside it"


def _seen(opened: list[float], played: dict[str, Any]) -> list[str]:
    middle = statistics.median(played["drawn"])
    return [f"{statistics.median(opened) / 1000:.2f} s", significant(middle), f"{max(played['shown']):.0f} ms"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a trial: a hundredth of the steps, written nowhere")
    parser.add_argument("--runs", type=Path, help="where runs are kept, and taken from if they are there")
    asked = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory(prefix="modsim3d-report-") as folder, open_browser() as browser:
        for case in CASES:
            say(case.title)
            run = case.run(asked.runs or Path(folder), asked.quick)
            rows.append(measure(case, run, browser, Path(folder)))
            say(" | ".join(rows[-1]))
    lines = [
        "# The page of a run",
        "",
        "Written by `python -m benchmarks.report_page`; do not edit.",
        "",
        "Promised are less than 0.1 s of processor time per 1,000 vessel-frames of boxes; 200,000 steps open in less "
        "than 2 s and take less than 50 MB. Processor time and memory are of `modsim3d report`, from its start, which "
        f"takes about 1 s. A page is opened from the disk, {ROUNDS} times; the median from the start of navigation to "
        f"the first frame. Then {SHOWN} steps are shown one after the other: the median time to draw one, and the "
        "longest from asking for a step to seeing it, with the parts that had to be unpacked.",
        "",
        table(HEAD, rows),
        "",
    ]
    text = "\n".join(lines)
    print(text)
    if not asked.quick:
        RESULTS.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
