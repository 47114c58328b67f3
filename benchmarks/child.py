"""What is timed, each in a process of its own: `python -m benchmarks.child NAME JSON` prints its answer as JSON.

OpenGL has one context a process, pyrender wants another than the ID pass, and a process that has run before is warm.
"""

from __future__ import annotations

import cProfile
import importlib
import json
import platform
import pstats
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.processes import Answer
from benchmarks.pyrender_pass import BYTES_PER_PIXEL, PyrenderPass

ROOT = Path(__file__).resolve().parents[1]
WARM_UP_STEPS = 20
FILL_BYTES, FILLS = 1 << 29, 11
PROFILE_ROWS = 12


@dataclass
class Drawn:
    """What was drawn so far."""

    draws: int = 0
    pixels: int = 0

    @property
    def bytes(self) -> int:
        """Of colour and depth that the drawn regions hold."""
        return self.pixels * BYTES_PER_PIXEL


def count_drawing() -> Drawn:
    """Let every drawing of this process be counted from now on."""
    from modsim3d.render.id_pass import IdRenderer

    drawn, draw = Drawn(), IdRenderer.draw_sheet

    def counted(self: IdRenderer, corners: Any, depth: Any, ids: Any, counts: Any, sheet: Any) -> Any:
        if len(ids):
            drawn.draws += 1
            drawn.pixels += sheet.size[0] * sheet.size[1]
        return draw(self, corners, depth, ids, counts, sheet)

    IdRenderer.draw_sheet = counted  # type: ignore[method-assign]
    return drawn


def run(scene: str, warm: bool = False, workers: int = 1, thesis_json: bool = True, **given: Any) -> Answer:
    """Time a scene from its file to the finished run directory, imports apart.

    Args:
        scene: File, or name of a shipped one.
        warm: Run a few steps first, so that the renderer's start is not in the time.
        workers: Processes.
        thesis_json: Write the thesis's JSON.
        given: Steps, mode, source, in place of the scene's.
    """
    from modsim3d.runs.run import run_scene
    from modsim3d.scene.reading import load_scene

    drawn = count_drawing()
    if given.get("source", "rendered") == "rendered":
        import_renderer()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        if warm:
            from modsim3d.render.context import open_context

            stack.enter_context(open_context())  # the runs below find this one
            run_scene(load_scene(scene, **{**given, "steps": WARM_UP_STEPS}), folder / "warm")
        pixels = drawn.pixels
        started = time.perf_counter()
        result = run_scene(load_scene(scene, **given), folder / "run", workers=workers, thesis_json=thesis_json)
        seconds = time.perf_counter() - started
    frames = result.counts.frames
    return {"seconds": seconds, "frames": frames, "drawn_bytes": (drawn.pixels - pixels) * BYTES_PER_PIXEL}


def import_renderer() -> None:
    """Import what a rendered run imports when it begins."""
    from modsim3d.render.context import choose_backend, prepare_environment

    backend = choose_backend()
    prepare_environment(backend)
    backend_module = {"osmesa": "OpenGL.osmesa", "egl": "OpenGL.EGL"}[backend]
    for module in ("modsim3d.truth.rendered", "OpenGL.GL.shaders", backend_module):
        importlib.import_module(module)


def profile(**asked: Any) -> Answer:
    """Where the time of a run goes."""
    run(**{**asked, "steps": WARM_UP_STEPS, "workers": 1})  # imports
    return {"rows": _profiled(lambda: run(**asked))}


def _profiled(work: Callable[[], object]) -> list[list[str]]:
    profiler = cProfile.Profile()
    profiler.runcall(work)
    stats = pstats.Stats(profiler).stats  # type: ignore[attr-defined]
    rows = sorted(stats.items(), key=lambda item: -item[1][2])[:PROFILE_ROWS]
    return [[f"{own:.3f}", f"{total:.3f}", str(calls), _place(*place)] for place, (_, calls, own, total, _) in rows]


def _place(file: str, line: int, function: str) -> str:
    if line == 0:
        return function
    parts = Path(file).parts
    start = next((i for i, part in enumerate(parts) if part in ("modsim3d", "site-packages")), len(parts) - 2)
    return f"{'/'.join(parts[start:]).removeprefix('site-packages/')} {function}"


def shares(scene: str, looks: int = 25) -> Answer:
    """How many vessels overlap others, at some steps spread over a scene.

    Returns:
        The shares of vessels in images whose box overlaps another's; that are hidden in part or wholly; wholly.
    """
    from modsim3d.runs.pipeline import open_renderer, truth_block
    from modsim3d.scene.reading import load_scene
    from modsim3d.truth.occlusion_order import overlapping_pairs

    loaded = load_scene(scene)
    rows = overlapping = hidden = wholly = 0
    with open_renderer(loaded) as renderer:
        for step in np.linspace(0, loaded.steps - 1, looks).astype(int).tolist():
            truth = truth_block(loaded, step, step + 1, renderer)
            pairs = overlapping_pairs(truth.step, truth.full_boxes_px)
            rows += len(truth)
            overlapping += len(np.unique(np.concatenate(pairs)))
            hidden += int((truth.visible_fraction < 1).sum())
            wholly += int((truth.visible_fraction == 0).sum())
    return {
        "in_image": rows / looks,
        "overlapping": overlapping / rows,
        "hidden": hidden / rows,
        "wholly_hidden": wholly / rows,
    }


def bandwidth() -> Answer:
    """Bytes a second that a plain fill of a large array writes."""
    array = np.empty(FILL_BYTES // 8)
    times = []
    for value in range(FILLS + 1):
        started = time.perf_counter()
        array.fill(value)
        times.append(time.perf_counter() - started)
    return {"bytes_per_s": FILL_BYTES / statistics.median(times[1:])}  # the first fetches the memory


def machine() -> Answer:
    """What runs all this."""
    from modsim3d.render.context import open_context

    models = [line.partition(":")[2].strip() for line in _lines("/proc/cpuinfo") if line.startswith("model name")]
    memory = next((int(line.split()[1]) for line in _lines("/proc/meminfo") if line.startswith("MemTotal")), 0)
    with open_context() as context:
        renderer = context.description
    return {
        "processor": models[0] if models else platform.machine(),
        "memory_gib": memory / 2**20,
        "renderer": renderer,
        "versions": {
            "Python": platform.python_version(),
            "NumPy": np.__version__,
            "scikit-robot-pyrender": version("scikit-robot-pyrender"),
            "PyOpenGL": version("PyOpenGL"),
        },
    }


def _lines(file: str) -> list[str]:
    path = Path(file)
    return path.read_text(encoding="utf-8").splitlines() if path.exists() else []


class OurPass:
    """From the vessels' poses to their full and visible boxes, by the fast path or by ID buffers of whole images."""

    def __init__(self, scene: str, render: str = "regions") -> None:
        from modsim3d.render.context import open_context
        from modsim3d.render.id_pass import IdRenderer
        from modsim3d.runs.pipeline import block_steps
        from modsim3d.scene.reading import load_scene

        self._drawn = count_drawing()
        self._scene = load_scene(scene, mode=2, render=render)
        self._block = block_steps(self._scene)
        self._open = ExitStack()  # as long as this process lives
        self._renderer = IdRenderer(self._open.enter_context(open_context()))
        self.time(list(range(WARM_UP_STEPS)))

    def time(self, frames: list[int]) -> Answer:
        """Seconds for some frames, in blocks as a run makes them; poses are at hand."""
        poses = [self._sight(frames[first : first + self._block]) for first in range(0, len(frames), self._block)]
        before = self._drawn.bytes
        started = time.perf_counter()
        for block in poses:
            self._boxes(block)
        seconds = time.perf_counter() - started
        return {"seconds": seconds, "drawn_bytes": self._drawn.bytes - before}

    def boxes(self, frames: list[int]) -> Answer:
        """Full and visible box of each vessel in each frame, None where there is none."""
        found = []
        for frame in frames:
            vessels, occlusion = self._boxes(self._sight([frame]))
            names = [self._scene.vessel_names[vessel] for vessel in vessels]
            pairs = zip(occlusion.full_boxes_px.tolist(), occlusion.visible_boxes_px.tolist(), strict=True)
            found.append(
                {
                    name: [full, None if np.isnan(seen[0]) else seen]
                    for name, (full, seen) in zip(names, pairs, strict=True)
                }
            )
        return {"boxes": found}

    def profile(self, frames: list[int]) -> Answer:
        """Where the time goes."""
        return {"rows": _profiled(lambda: self.time(frames))}

    def _sight(self, frames: list[int]) -> Any:
        return self._scene.sight(self._scene.cameras[0], np.array(frames))

    def _boxes(self, sight: Any) -> tuple[Any, Any]:
        from modsim3d.runs.pipeline import occlusion_by

        scene, intrinsics = self._scene, self._scene.cameras[0].intrinsics
        outlines = sight.outlines()
        return outlines.occluder, occlusion_by(outlines, intrinsics, scene.annotation, self._renderer)


def serve(passes: str, scene: str, lines: Iterable[str] = sys.stdin) -> None:
    """Answer requests, a line each, so that two processes can be timed in turn."""
    made = {"ours": OurPass, "buffers": partial(OurPass, render="full"), "pyrender": PyrenderPass}
    server = made[passes](scene)
    print("{}", flush=True)
    for line in lines:
        asked = json.loads(line)
        print(json.dumps(getattr(server, asked["do"])(asked["frames"])), flush=True)


def main() -> None:
    name, given = sys.argv[1], json.loads(sys.argv[2]) if len(sys.argv) > 2 else {}
    if name == "serve":
        serve(**given)
        return
    do = {"run": run, "profile": profile, "shares": shares, "bandwidth": bandwidth, "machine": machine}[name]
    print(json.dumps(do(**given)))


if __name__ == "__main__":
    main()
