"""Films and single pictures of a stored run, drawn from its directory alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
from PIL import Image

from modsim3d.io.atomic_write import encoded, put_in_place
from modsim3d.io.processes import WorkerCount, Workers, open_workers
from modsim3d.runs.selection import Selection, StepFrames
from modsim3d.view.films.files import MAX_RATE, EncodedFrame, film_palette, write_film
from modsim3d.view.films.plan import FilmPlan, Timetable
from modsim3d.view.films.renderer import FilmRenderer, open_film_renderer

STEPS_TOGETHER = 4  # that a worker draws at a time
PALETTE_SAMPLES = 4
IF_KILLED = "draw the film again, perhaps with fewer --workers"


@dataclass(frozen=True, eq=False)
class ShownSteps:
    """Steps that a film shows, ascending, and when."""

    steps: tuple[int, ...]
    timetable: Timetable
    pace: str  # how many, and of a film how long and how fast

    @classmethod
    def of(cls, selection: Selection, kind: str, speed: float) -> ShownSteps:
        """The steps of a selection in a film of one of `FORMATS`; at a high speed some are left out."""
        timetable = Timetable.of(selection.durations_s, speed, MAX_RATE[kind])
        shown = [step for step, repeats in zip(selection.steps, timetable.repeats, strict=True) if repeats]
        pace = f", {timetable.duration_s:.1f} s at {float(timetable.rate):g} pictures/s" if kind != "png" else ""
        steps = selection.steps if kind == "png" else tuple(shown)
        return cls(steps, timetable, f"{len(steps)} frames{pace}")


def draw_picture(selection: Selection, plan: FilmPlan, path: Path) -> Path:
    """Draw the first step of a selection into a PNG."""
    with open_film_renderer(selection.run.scene, plan) as film_renderer:
        picture = film_renderer.draw(next(selection.step_frames()))
    with put_in_place(path) as partial:
        partial.write_bytes(encoded(picture))
    return path


def draw_film(
    selection: Selection,
    plan: FilmPlan,
    kind: str,
    path: Path,
    *,
    speed: float = 1.0,
    workers: WorkerCount = 1,
    progress: Callable[[int], None] = lambda frames: None,
) -> tuple[int, int]:
    """Draw a film of one of `FORMATS` into a file, or a folder of PNG files, at `speed` seconds of the run in one
    second of the film. `workers` processes draw, with `auto` one for each CPU; their number does not change the film.
    `progress` is called with the number of frames drawn since its last call.
    Returns the film's width and height in pixels."""
    scene = selection.run.scene
    showing = ShownSteps.of(selection, kind, speed)
    repeats = dict(zip(selection.steps, showing.timetable.repeats.tolist(), strict=True))
    with open_workers(workers, IF_KILLED, open_film_renderer, scene, plan) as renderers:
        colours = _gif_palette(selection, showing.steps, renderers) if kind == "gif" else None

        def frames() -> Iterator[tuple[EncodedFrame, int]]:
            jobs = (_Job(kind, colours, piece) for piece in _pieces(selection, set(showing.steps)))
            for piece in renderers.map(_draw_job, jobs):
                for frame in piece:
                    yield frame, repeats[frame.step]
                    progress(1)

        write_film(kind, path, frames(), showing.timetable.rate, colours)
    return plan.layout(scene).size


def _gif_palette(selection: Selection, steps: Sequence[int], renderers: Workers[FilmRenderer]) -> Image.Image:
    chosen = tuple(dict.fromkeys(steps[i * len(steps) // PALETTE_SAMPLES] for i in range(PALETTE_SAMPLES)))
    shown = replace(selection, steps=chosen, durations_s=np.ones(len(chosen)))
    samples = renderers.map(_draw_job, (_Job("mp4", None, [step_frames]) for step_frames in shown.step_frames()))
    return film_palette([Image.frombytes("RGB", frame.size, frame.data) for piece in samples for frame in piece])


def _pieces(selection: Selection, steps: set[int]) -> Iterator[list[StepFrames]]:
    """The frames of some steps of a selection, a few steps at a time."""
    chosen = (step_frames for step_frames in selection.step_frames() if step_frames.step in steps)
    while piece := list(islice(chosen, STEPS_TOGETHER)):
        # A worker has the scene, which may be large.
        yield [
            replace(step, frames=tuple(frame and replace(frame, scene=None) for frame in step.frames)) for step in piece
        ]


@dataclass(frozen=True, eq=False)
class _Job:
    """Steps to draw, and what their pictures are to be encoded for."""

    kind: str
    colours: Image.Image | None
    piece: list[StepFrames]


def _draw_job(film_renderer: FilmRenderer, job: _Job) -> list[EncodedFrame]:
    pictures = [(step_frames.step, film_renderer.draw(step_frames)) for step_frames in job.piece]
    return [EncodedFrame.of(step, picture, job.kind, job.colours) for step, picture in pictures]
