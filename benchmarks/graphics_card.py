"""Compares a graphics card with the software renderer, and writes benchmarks/GRAPHICS_CARD.md.

The same ID images are drawn by both and compared pixel by pixel, whole runs are compared file by file, and both are
timed in turn, in processes of their own. Needs OSMesa, a graphics card with EGL, and nothing that `script/setup test`
installs. Run it with `python -m benchmarks.graphics_card`; `--quick` is a trial that writes nothing.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import scenes
from benchmarks.measured import significant, spread, table
from benchmarks.processes import PATIENCE_S, ROOT, Answer, environment, say

RESULTS = ROOT / "benchmarks" / "GRAPHICS_CARD.md"
SOFTWARE, CARD = "osmesa", "egl"
SHIPPED = ("simulation_1", "simulation_2", "simulation_3", "strait", "harbour", "fairway")
REGION_PX = 256, 128
DRAWINGS = 50


@dataclass(frozen=True)
class Case:
    """A scene, and for how many steps it is run in the usual way and with whole images."""

    scene: str
    steps: int
    full_steps: int


def by(backend: str, do: str, **given: Any) -> Answer:
    """What a process of this file answers that draws with a backend."""
    command = [sys.executable, "-m", "benchmarks.graphics_card", do, json.dumps(given)]
    done = subprocess.run(
        command,
        env={**environment(), "MODSIM3D_GL": backend},
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        timeout=PATIENCE_S,
    )
    answer: Answer = json.loads(done.stdout.splitlines()[-1])
    return answer


# ---- in a process with one renderer ------------------------------------------------------------


def renderer_name() -> Answer:
    from modsim3d.render.context import open_context

    with open_context() as context:
        return {"name": context.description}


def draw_images(scene: str, images: int, out: str) -> Answer:
    """Whole ID images of all cameras at steps spread over a scene, into a file; milliseconds for each.

    Triangles are worked out before, so that only drawing and reading back is timed.
    """
    from modsim3d.render.context import open_context
    from modsim3d.render.id_pass import IdRenderer, Region
    from modsim3d.scene.reading import load_scene
    from modsim3d.truth.buffer_drawing import triangles_of

    loaded = load_scene(scene)
    times_ms = []
    with open_context() as context, Path(out).open("wb") as file:
        renderer = IdRenderer(context)
        for step in np.unique(np.linspace(0, loaded.steps - 1, images).astype(np.int64)):
            for camera in loaded.cameras:
                outlines = loaded.sight(camera, step[None]).outlines()
                triangles = triangles_of(outlines, camera.intrinsics)
                ids, region = outlines.occluder[triangles.row] + 1, Region(0, 0, *camera.intrinsics.image_size_px)
                for attempt in range(2):  # the first makes the buffer
                    started = time.perf_counter()
                    image = renderer.draw(triangles.corners_px, triangles.inverse_depth, ids, region)
                    if attempt:
                        times_ms.append(1e3 * (time.perf_counter() - started))
                file.write(image.tobytes())
    return {"ms": times_ms}


def draw_region(out: str) -> Answer:
    """Random triangles, many of them slivers and with corners on pixel centres, in a small region; milliseconds."""
    from modsim3d.render.context import open_context
    from modsim3d.render.id_pass import IdRenderer, Region

    rng, times_ms = np.random.default_rng(5), []
    with open_context() as context, Path(out).open("wb") as file:
        renderer = IdRenderer(context)
        for number in range(DRAWINGS):
            corners = rng.uniform(-200, 500, (60, 3, 2))
            corners[::3] = np.rint(2 * corners[::3]) / 2
            depth, ids = rng.uniform(0.01, 1, (60, 3)), np.arange(1, 61)
            started = time.perf_counter()
            image = renderer.draw(corners, depth, ids, Region(20 * (number % 3), 10, *REGION_PX))
            times_ms.append(1e3 * (time.perf_counter() - started))
            file.write(image.tobytes())
    return {"ms": times_ms[1:]}


def run_files(scene: str, steps: int, render: str) -> Answer:
    """The SHA-256 of the files of a run, by the way that it is drawn, and its frames a second."""
    from modsim3d.runs.run import run_scene
    from modsim3d.scene.reading import load_scene

    settings = {"annotation.render": render}
    with tempfile.TemporaryDirectory() as name:
        run_scene(load_scene(scene, steps=2, settings=settings), Path(name) / "warm")
        started = time.perf_counter()
        result = run_scene(load_scene(scene, steps=steps, settings=settings), Path(name) / "run")
        seconds = time.perf_counter() - started
        files = json.loads((result.folder / "run.json").read_text(encoding="utf-8"))["files"]
        return {"rate": result.counts.frames / seconds, "files": files}


# ---- both ---------------------------------------------------------------------------------------


def compared_images(do: str, **given: Any) -> tuple[int, int, dict[str, list[float]]]:
    """Pixels drawn by both, how many of them differ, and milliseconds of each."""
    with tempfile.TemporaryDirectory() as name:
        times = {}
        for backend in (SOFTWARE, CARD):
            times[backend] = by(backend, do, **given, out=str(Path(name) / backend))["ms"]
        software, card = (np.memmap(Path(name) / backend, dtype=np.uint32, mode="r") for backend in (SOFTWARE, CARD))
        if len(software) != len(card):
            raise RuntimeError(f"{do} {given}: {len(software)} px by {SOFTWARE}, {len(card)} by {CARD}")
        return len(card), int(np.count_nonzero(software != card)), times


def image_row(what: str, do: str, **given: Any) -> list[str]:
    pixels, wrong, times = compared_images(do, **given)
    return [what, f"{pixels:,}", f"{wrong:,}", *(f"{spread(times[backend])} ms" for backend in (SOFTWARE, CARD))]


def run_row(scene: str, steps: int, render: str, rounds: int) -> list[str]:
    """A row of runs: whether all files are the same bytes, and frames a second."""
    found: dict[str, list[Answer]] = {SOFTWARE: [], CARD: []}
    for _ in range(rounds):
        for backend, answers in found.items():
            answers.append(by(backend, "run_files", scene=scene, steps=steps, render=render))
    software, card = (answers[0]["files"] for answers in found.values())
    other = sorted(name for name in software.keys() | card.keys() if software.get(name) != card.get(name))
    rates = {backend: [answer["rate"] for answer in answers] for backend, answers in found.items()}
    gain = statistics.median(c / s for s, c in zip(*rates.values(), strict=True))
    return [
        f"{Path(scene).stem}, `{render}`, {steps} steps",
        ", ".join(other) if other else f"all {len(card)} files",
        *(spread(rates[backend]) for backend in (SOFTWARE, CARD)),
        f"{significant(gain)} ×",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a trial: little work, written nowhere")
    quick = parser.parse_args().quick
    names = {backend: by(backend, "renderer_name")["name"] for backend in (SOFTWARE, CARD)}
    if "llvmpipe" in names[CARD] or "softpipe" in names[CARD]:
        raise SystemExit(f"no graphics card: EGL gives {names[CARD]}")
    with tempfile.TemporaryDirectory(prefix="modsim3d-card-") as folder:
        thousand = Path(folder) / "thousand.yaml"
        detectors = (ROOT / "scenes" / "detectors").as_posix()
        thousand.write_text(scenes.thousand().replace("../scenes/detectors", detectors))
        images, rounds = (2, 1) if quick else (10, 3)
        few, many = (2, 20) if quick else (20, 200)
        cases = [Case(scene, many, few) for scene in (*SHIPPED, str(ROOT / "benchmarks" / "dense.yaml"))]
        cases += [Case(str(thousand), few, 0)]  # each of a thousand alone would take long
        image_rows = [image_row("random triangles, a third with all corners on half pixels", "draw_region")]
        run_rows = []
        for case in cases:
            say(case.scene)
            image_rows.append(image_row(Path(case.scene).stem, "draw_images", scene=case.scene, images=images))
            for render, steps in (("regions", case.steps), ("full", case.full_steps)):
                run_rows += [run_row(case.scene, steps, render, rounds)] if steps else []
    lines = [
        "# A graphics card against the software renderer",
        "",
        "Written by `python -m benchmarks.graphics_card`; do not edit.",
        "",
        *(f"- `MODSIM3D_GL={backend}`: {name}" for backend, name in names.items()),
        f"- {os.cpu_count()} processors, Python {sys.version.split()[0]}, NumPy {np.__version__}",
        "",
        "## ID images",
        "",
        "Whole images of all cameras at ten steps spread over each scene, drawn by both and compared pixel by pixel. "
        "Times are of drawing and reading back one image, its triangles given: median, least and greatest.",
        "",
        table(("Scene", "Pixels", "That differ", "Software", "Card"), image_rows),
        "",
        "## Whole runs",
        "",
        "Every file whose SHA-256 is in `run.json`. Frames a second of `run_scene` in a process that has run "
        "the scene before, the two in turn. `regions` is how runs draw, `full` whole images and each vessel alone.",
        "",
        table(("Scene", "Same bytes", "Software f/s", "Card f/s", "Gain"), run_rows),
    ]
    text = "\n".join(lines) + "\n"
    print(text)
    if not quick:
        RESULTS.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    here = {"renderer_name": renderer_name, "draw_images": draw_images, "draw_region": draw_region}
    if len(sys.argv) == 3:
        print(json.dumps({**here, "run_files": run_files}[sys.argv[1]](**json.loads(sys.argv[2]))))
    else:
        main()
