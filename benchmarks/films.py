"""Times whole films as a user draws them, and writes benchmarks/FILMS.md.

Every kind of film of three scenes is drawn by `modsim3d view` in a process of its own, one kind after another, round
after round; a figure is the median of the rounds. Times are processor times of the program and the encoder together,
from the start of the program, so that another program on the machine disturbs them little. Run it with
`python -m benchmarks.films`; `--quick` is a trial that writes nothing.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from dataclasses import dataclass
from pathlib import Path

from benchmarks.measured import significant, table
from benchmarks.processes import ROOT, modsim3d, say
from modsim3d.runs.selection import select, select_cameras
from modsim3d.runs.stored_run import open_run
from modsim3d.view.films.timetable import Timetable

RESULTS = ROOT / "benchmarks" / "FILMS.md"
KINDS = {
    "detections": ("--film", "detections"),
    "scene": ("--film", "scene"),
    "scene, plain": ("--film", "scene", "--look", "plain"),
    "ids": ("--film", "ids"),
    "corners": ("--film", "corners"),
    "all, cropped": ("--film", "all", "--crop", "vessels"),
    "map": ("--film", "map"),
}
SCENES = {
    "simulation_1": "a camera ashore, five vessels",
    "strait": "two cameras, one of them on board, eight vessels and meshes",
    "harbour": "a camera ashore, 30 vessels",
}
STEPS, QUICK_STEPS, ROUNDS = 200, 20, 3
MOST_RATE = 60


@dataclass(frozen=True)
class Film:
    """A film of one kind: frames, playing time in seconds, and the seconds that each round took."""

    frames: int
    plays_s: float
    rounds_s: tuple[float, ...]
    peak_mb: float

    def cells(self) -> list[str]:
        """Milliseconds a frame, seconds of drawing for a second of film, and memory."""
        seconds = statistics.median(self.rounds_s)
        per_frame = [1e3 * each / self.frames for each in (seconds, min(self.rounds_s), max(self.rounds_s))]
        middle, least, most = (significant(each) for each in per_frame)
        return [
            str(self.frames),
            f"{middle} ({least}–{most})",
            f"{self.plays_s:.0f} s",
            f"{significant(seconds / self.plays_s, 2)}",
            f"{self.peak_mb:.0f} MB",
        ]


def films_of(folder: Path, workers: int, rounds: int) -> dict[str, Film]:
    """The films of a run, one kind after another in each round."""
    run = open_run(folder)
    selection = select(run, select_cameras(run, []))
    plays_s = Timetable.of(selection.durations_s, 1.0, MOST_RATE).duration_s
    taken: dict[str, list[float]] = {kind: [] for kind in KINDS}
    peak: dict[str, float] = dict.fromkeys(KINDS, 0.0)
    for number in range(rounds):
        for kind, options in KINDS.items():
            out = folder.with_suffix(".mp4")
            done = modsim3d("view", folder, *options, "--workers", str(workers), "--out", out, "--overwrite")
            taken[kind].append(done.processor_s)
            peak[kind] = max(peak[kind], done.peak_bytes / 1e6)
            say(f"  round {number + 1}, {kind}: {done.processor_s:.1f} s for {plays_s:.0f} s of film")
    return {kind: Film(len(selection.steps), plays_s, tuple(taken[kind]), peak[kind]) for kind in KINDS}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a trial: little work, written nowhere")
    parser.add_argument("--workers", type=int, default=1, help="processes that draw (1)")
    asked = parser.parse_args()
    steps, rounds = (QUICK_STEPS, 1) if asked.quick else (STEPS, ROUNDS)
    lines = [
        "# Whole films",
        "",
        "Written by `python -m benchmarks.films`; do not edit.",
        "",
        f"`modsim3d view RUN --film KIND --workers {asked.workers}`, MP4 in real time, {steps} steps. Times are "
        f"processor times of the program and the encoder together, from the start of the program; median of {rounds} "
        "rounds, least and greatest. A ratio below 1 means that one core draws a film faster than it plays. Memory is "
        "that of the process that draws, at its highest.",
        "",
    ]
    head = ("Scene", "Film", "Frames", "ms a frame", "Plays for", "Drawing / playing", "Memory")
    rows = []
    with tempfile.TemporaryDirectory(prefix="modsim3d-films-") as folder:
        for name, words in SCENES.items():
            say(name)
            run = Path(folder) / name
            modsim3d("run", name, "--mode", "2", "--steps", str(steps), "--no-sheet", "--out", run)
            films = films_of(run, asked.workers, rounds)
            rows += [[f"{name}: {words}", kind, *film.cells()] for kind, film in films.items()]
    text = "\n".join([*lines, table(head, rows)]) + "\n"
    print(text)
    if not asked.quick:
        RESULTS.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
