"""Times the drawing of films from a stored run, and writes benchmarks/DRAWING.md.

Cameras of 3600 × 2400 px, films 1280 px wide. What is compared is timed in turn, one round after another, in one
process on one core; a figure is the median of the rounds. Times are processor times, so that another program on the
machine disturbs them little. Run it with `python -m benchmarks.drawing`; `--quick` is a trial that writes nothing.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from PIL import Image

from benchmarks import scenes
from modsim3d.runs.run import run_scene
from modsim3d.runs.selection import StepFrames, select, select_cameras
from modsim3d.runs.stored_run import open_run
from modsim3d.scene.reading import load_scene
from modsim3d.view.films.files import EncodedFrame, write_film
from modsim3d.view.films.plan import FilmPlan
from modsim3d.view.films.renderer import FilmRenderer, open_shaded_picture_renderer
from modsim3d.view.pictures.plain import open_id_renderer
from modsim3d.view.sea_and_sky import PLAIN_STYLE, RenderStyle

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "DRAWING.md"
WIDTH_PX, PROMISED = 1280, 10.0
KINDS = {
    "detections": ("detections", PLAIN_STYLE),
    "scene, plain": ("scene", PLAIN_STYLE),
    "scene, shaded": ("scene", RenderStyle(shaded=True)),
    "ids": ("ids", PLAIN_STYLE),
}
SCENES = {
    "simulation_1": "Simulation 1: five vessels",
    "small": "`small.yaml`: 50 boats far apart",
    "dense": "`dense.yaml`: 50 vessels, ships before ships",
}


@dataclass(frozen=True)
class Rate:
    """Frames a second of processor time: median, least and greatest of the rounds."""

    rounds: tuple[float, ...]

    def __str__(self) -> str:
        """As it stands in the table."""
        return f"{statistics.median(self.rounds):.1f} ({min(self.rounds):.1f}–{max(self.rounds):.1f})"


def timed(work: Callable[[], None], frames: int) -> float:
    """Frames a second of processor time."""
    before = time.process_time()
    work()
    return frames / (time.process_time() - before)


def measure(name: str, folder: Path, steps: int, rounds: int) -> list[str]:
    """A row of the table for each kind of film."""
    path = name if name == "simulation_1" else str(scenes.HERE / f"{name}.yaml")
    run_scene(load_scene(path, mode=2, steps=steps), folder / name)
    run = open_run(folder / name)
    selection = select(run, select_cameras(run, []))
    frames = list(selection.step_frames())
    assert run.scene.cameras[0].intrinsics.image_size_px == (3600, 2400)
    rows = []
    with open_id_renderer(run.scene) as id_renderer, ExitStack() as stack:
        for title, (kind, style) in KINDS.items():
            painter = stack.enter_context(open_shaded_picture_renderer(style)) if style.shaded else None
            plans = (FilmPlan((kind,), selection.cameras, width, style=style) for width in (WIDTH_PX, 3600))
            at_size, at_full = (FilmRenderer(run.scene, plan, id_renderer, painter) for plan in plans)
            drawn, shrunk = [], []
            some = frames[:: max(1, len(frames) // 3)]
            for _ in range(rounds):
                drawn.append(timed(lambda draw=at_size: draw_all(draw, frames), len(frames)))
                shrunk.append(timed(lambda draw=at_full, some=some: shrink_all(draw, some), len(some)))
            ratio = statistics.median(a / b for a, b in zip(drawn, shrunk, strict=True))
            met = "yes" if statistics.median(drawn) >= PROMISED else "**no**" if kind == "detections" else "no"
            cells = SCENES[name], title, str(Rate(tuple(drawn))), met, str(Rate(tuple(shrunk))), f"{ratio:.1f}"
            rows.append(f"| {' | '.join(cells)} |")
            print(rows[-1], file=sys.stderr, flush=True)
        plan = FilmPlan(("detections",), selection.cameras, WIDTH_PX)
        film = whole_film(FilmRenderer(run.scene, plan, id_renderer), frames, folder / f"{name}.mp4")
    rows.append(f"| {SCENES[name]} | detections, with the encoder's time | {film:.1f} (one round) | – | – | – |")
    return rows


def draw_all(film_renderer: FilmRenderer, frames: list[StepFrames]) -> None:
    for step in frames:
        film_renderer.draw(step)


def shrink_all(film_renderer: FilmRenderer, frames: list[StepFrames]) -> None:
    """The slow way: at the camera's size, then smaller."""
    for step in frames:
        picture = film_renderer.draw(step)
        picture.resize((WIDTH_PX, picture.height * WIDTH_PX // picture.width), Image.Resampling.BOX)


def whole_film(film_renderer: FilmRenderer, frames: list[StepFrames], path: Path) -> float:
    """Frames a second of this process and the encoder's together."""
    before = os.times()
    encoded = (EncodedFrame.of(step.step, film_renderer.draw(step), "mp4", None) for step in frames)
    write_film("mp4", path, ((frame, 1) for frame in encoded), Fraction(5))
    after = os.times()
    return len(frames) / sum(after[i] - before[i] for i in range(4))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a trial: little work, written nowhere")
    quick = parser.parse_args().quick
    lines = [
        "# Drawing films",
        "",
        "Written by `python -m benchmarks.drawing`; do not edit.",
        "",
        f"Cameras of 3600 × 2400 px, films {WIDTH_PX} px wide, one core; frames a second of processor time, reading "
        "the run excluded. The promise is 10, for overlays. The last two columns are the same pictures drawn at the "
        "camera's size and then made smaller.",
        "",
        "| Scene | Film | Frames/s, drawn at its size | ≥ 10 | Frames/s, drawn large | Times faster |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    with tempfile.TemporaryDirectory() as folder:
        for name in SCENES:
            lines += measure(name, Path(folder), 10 if quick else 30, 1 if quick else 3)
    text = "\n".join(lines) + "\n"
    print(text)
    if not quick:
        RESULTS.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
