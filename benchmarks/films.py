"""Times whole films as a user draws them, and writes benchmarks/FILMS.md.

Every kind of film of three scenes is drawn once by `modsim3d view`, in a process of its own. Times are processor times
of the program and the encoder together, from the start of the program, so that another program on the machine disturbs
them little. Run it with `python -m benchmarks.films`; `--quick` is a trial that writes nothing.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from benchmarks.measured import significant, table
from benchmarks.processes import ROOT, modsim3d, say
from modsim3d.runs.selection import select, select_cameras
from modsim3d.runs.stored_run import open_run
from modsim3d.view.films.plan import Timetable

RESULTS = ROOT / "benchmarks" / "FILMS.md"
KINDS = {
    "detections": ("--kind", "detections"),
    "scene": ("--kind", "scene"),
    "scene, plain": ("--kind", "scene", "--look", "plain"),
    "ids": ("--kind", "ids"),
    "corners": ("--kind", "corners"),
    "all, cropped": ("--kind", "all", "--crop", "vessels"),
    "map": ("--kind", "map"),
}
SCENES = {
    "simulation_1": "a camera ashore, five vessels",
    "strait": "two cameras, one of them on board, eight vessels and meshes",
    "harbour": "a camera ashore, 30 vessels",
}
STEPS, QUICK_STEPS = 100, 10
MAX_RATE = 60


def films_of(folder: Path) -> list[list[str]]:
    """For each kind of film of a run: frames, milliseconds a frame, playing time, ratio of the two times, memory."""
    run = open_run(folder)
    selection = select(run, select_cameras(run, []))
    frames, plays_s = len(selection.steps), Timetable.of(selection.durations_s, 1.0, MAX_RATE).duration_s
    rows = []
    for kind, options in KINDS.items():
        done = modsim3d("view", "film", folder, *options, "--out", folder.with_suffix(".mp4"), "--overwrite")
        ratio, per_frame = done.processor_s / plays_s, 1e3 * done.processor_s / frames
        memory = f"{done.peak_bytes / 1e6:.0f} MB"
        rows.append([kind, str(frames), significant(per_frame), f"{plays_s:.0f} s", significant(ratio, 2), memory])
        say(f"  {kind}: {done.processor_s:.1f} s for {plays_s:.0f} s of film")
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a trial: little work, written nowhere")
    quick = parser.parse_args().quick
    steps = QUICK_STEPS if quick else STEPS
    lines = [
        "# Whole films",
        "",
        "Written by `python -m benchmarks.films`; do not edit.",
        "",
        f"`modsim3d view film RUN --kind KIND`, MP4 in real time, one worker, {steps} steps. Times are those of the "
        "processor for the program and the encoder together, from the start of the program, which takes about 2 s. A "
        "ratio below 1 means that one core draws a film faster than it plays. Memory is the program's, at its highest.",
        "",
    ]
    head = ("Scene", "Film", "Frames", "ms a frame", "Plays for", "Drawing / playing", "Memory")
    rows = []
    with tempfile.TemporaryDirectory(prefix="modsim3d-films-") as folder:
        for name, words in SCENES.items():
            say(name)
            run = Path(folder) / name
            modsim3d("run", name, "--mode", "2", "--steps", str(steps), "--no-sheet", "--out", run)
            rows += [[f"{name}: {words}", *row] for row in films_of(run)]
    text = "\n".join([*lines, table(head, rows)]) + "\n"
    print(text)
    if not quick:
        RESULTS.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
