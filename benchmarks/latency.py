"""Times `modsim3d stream` from a line of poses in to the last line of detections out, and writes benchmarks/LATENCY.md.

Poses go to standard input, one step at a time: the next step is sent when all lines of the one before have come. Run
it with `python -m benchmarks.latency`; `--quick` is a trial that writes nothing.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
import yaml

from benchmarks.measured import BUSY_LOAD, significant, table
from benchmarks.processes import ROOT, child, environment, say
from modsim3d.scene.reading import load_scene

RESULTS = ROOT / "benchmarks" / "LATENCY.md"
SCENES = {
    "simulation_1": (ROOT / "scenes" / "simulation_1.yaml", "five vessels, one camera"),
    "simulation_2": (ROOT / "scenes" / "simulation_2.yaml", "six vessels, one camera on board in waves"),
    "strait": (ROOT / "scenes" / "strait.yaml", "9 vessels with meshes and 11 obstacles, two cameras"),
    "small": (ROOT / "benchmarks" / "small.yaml", "50 boats far apart, one camera"),
}
WAYS = {"standard output": "-", "TCP": "tcp://127.0.0.1:0"}
ROUNDS, STEPS, QUICK_STEPS = 3, 200, 20
FIRST = 10
"""Steps at the beginning that are not counted: libraries are loaded, and the renderer starts."""


def live_scene(scene: Path, folder: Path, steps: int) -> list[bytes]:
    """Write a scene with live poses into a folder; the lines of its poses.

    A live scene's waves cannot be a sea with a spectrum, which needs the velocities of later steps.
    """
    loaded = load_scene(scene)
    poses = loaded.poses.poses(0, steps)
    lines = []
    for step, timestamp in enumerate(loaded.timestamps(0, steps)):
        there = np.flatnonzero(poses.present[step])
        entries = {
            loaded.vessel_names[vessel]: {
                "center_position_m": poses.positions_m[step, vessel].tolist(),
                "heading_rad": float(poses.headings_rad[step, vessel]),
            }
            for vessel in there
        }
        lines.append(json.dumps({timestamp: entries}).encode() + b"\n")
    keys: dict[str, Any] = yaml.safe_load(scene.read_text(encoding="utf-8"))
    for key in ("steps", "time_step_s"):
        keys.pop(key, None)
    keys["poses"] = {"stream": "-"}
    for key in ("detector", "vessels"):
        if isinstance(keys[key], str):
            keys[key] = str((scene.parent / keys[key]).resolve())
    if "spectrum" in keys.get("waves", {}):
        keys["waves"] = {"level": "small", "apply_to": "all"}
    (folder / "live.yaml").write_text(yaml.safe_dump(keys), encoding="utf-8")
    return lines


@contextlib.contextmanager
def stream(scene: Path, to: str) -> Iterator[tuple[IO[bytes], IO[bytes]]]:
    """Start the command; where its poses go, and where its lines come from."""
    command = [Path(sys.executable).parent / "modsim3d", "stream", scene, "--to", to]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, env=environment(), cwd=ROOT, stdin=pipe, stdout=pipe) as process:
        assert process.stdin is not None and process.stdout is not None
        if to == "-":
            yield process.stdin, process.stdout
            return
        port = int(process.stdout.readline().rpartition(b":")[2])
        with socket.create_connection(("127.0.0.1", port)) as reader, reader.makefile("rb") as lines:
            yield process.stdin, lines


def latencies_s(scene: Path, poses: list[bytes], to: str) -> list[float]:
    """Seconds from each line of poses in to the last line of its step out."""
    found = []
    with stream(scene, to) as (given, lines):
        lines.readline()
        for line in poses:
            started = time.perf_counter()
            given.write(line)
            given.flush()
            answer = lines.readline()
            ended = time.perf_counter()
            for _ in range(json.loads(answer)["frames_in_step"] - 1):
                lines.readline()
                ended = time.perf_counter()
            found.append(ended - started)
        given.close()
        if lines.readline():
            raise RuntimeError("more lines than the steps have")
    return found


def measured(quick: bool) -> list[list[str]]:
    """The rows of the table."""
    rows, steps = [], QUICK_STEPS if quick else STEPS
    with tempfile.TemporaryDirectory(prefix="modsim3d-latency-") as name:
        for scene, (path, words) in SCENES.items():
            folder = Path(name) / scene
            folder.mkdir()
            poses = live_scene(path, folder, steps)
            found: dict[str, list[float]] = {way: [] for way in WAYS}
            for number in range(1 if quick else ROUNDS):
                say(f"{scene}: round {number + 1}")
                for way, to in WAYS.items():
                    found[way] += latencies_s(folder / "live.yaml", poses, to)[FIRST:]
            for way, seconds in found.items():
                numbers = [np.percentile(seconds, 50), np.percentile(seconds, 99), max(seconds)]
                cells = [f"{significant(1e3 * float(number))} ms" for number in numbers]
                rows.append([f"{scene}: {words}", way, f"{len(seconds):,}", *cells])
            shutil.rmtree(folder)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a trial: little work, written nowhere")
    quick, load = parser.parse_args().quick, os.getloadavg()[0]
    machine = child("machine")
    lines = [
        "# Latency of a stream",
        "",
        "Written by `python -m benchmarks.latency`; do not edit.",
        "",
        f"- Processor: {machine['processor']}, {len(os.sched_getaffinity(0))} cores",
        f"- Renderer: {machine['renderer']}",
    ]
    if load > BUSY_LOAD:
        lines.append(f"- **The machine was not idle: a load of {load:.1f} before it began.**")
    lines += [
        "",
        "`modsim3d stream SCENE` with live poses on standard input: the time from writing a line of poses to having "
        "read the last line of its step, in another process. The next step is sent when the one before has come. "
        f"{ROUNDS} rounds of {STEPS} steps, each in a new process, standard output and TCP in turn; the first {FIRST} "
        "steps of a process are left out. The scenes are as they are shipped, with the poses of their files sent line "
        "by line; the strait's sea has the level `small`, since a spectrum needs later steps.",
        "",
    ]
    head = ("Scene", "Lines go to", "Steps", "Median", "99th percentile", "Greatest")
    text = "\n".join([*lines, table(head, measured(quick))]) + "\n"
    print(text)
    if not quick:
        RESULTS.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
