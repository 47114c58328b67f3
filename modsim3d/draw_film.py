"""Films and single pictures of a stored run, drawn from its directory alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from modsim3d.errors import ModsimError, RendererError
from modsim3d.film_plan import TITLES, FilmPlan
from modsim3d.processes import in_order, open_pool
from modsim3d.render.plain_ids import IdDrawer, PlainIds
from modsim3d.scene import Scene
from modsim3d.selection import Selection, Shown
from modsim3d.simulate import open_renderer
from modsim3d.view import palette
from modsim3d.view.film_files import MOST_RATE, EncodedFrame, put_in_place, write_film
from modsim3d.view.gif import film_palette
from modsim3d.view.ids_picture import ids_picture
from modsim3d.view.look import Look
from modsim3d.view.map_picture import map_picture
from modsim3d.view.painter import Subject, paint
from modsim3d.view.scene_picture import scene_picture
from modsim3d.view.shaded_picture import ShadedPainter
from modsim3d.view.timetable import Timetable
from modsim3d.view.window import Window

STEPS_TOGETHER = 4
"""Steps that a worker draws at a time."""
PALETTE_SAMPLES = 4

Piece = list[Shown]


class Draughtsman:
    """Draws the pictures of a film one by one."""

    def __init__(self, scene: Scene, plan: FilmPlan, drawer: IdDrawer, painter: ShadedPainter | None = None) -> None:
        """Take what all pictures share.

        Args:
            scene: The scene.
            plan: What every picture shows.
            drawer: Draws ID buffers.
            painter: Draws the scene in light and shade, where the plan asks for it.
        """
        self._scene = scene
        self._plan = plan
        self._drawer = drawer
        self._painter = painter
        self._layout = plan.layout(scene)
        self._birds_eye = plan.birds_eye(scene)

    def draw(self, shown: Shown) -> Image.Image:
        """The picture of a step, from what each camera of the plan shows."""
        subjects = [None if frame is None else Subject.of(self._scene, frame) for frame in shown.frames]
        sizes = self._layout.panel_sizes
        panels = [
            map_picture(self._birds_eye, shown.step, size)
            if kind == "map"
            else self._panel(subjects[place], kind, self._plan.window(self._scene, place, size))
            for (place, kind), size in zip(self._plan.panels(), sizes, strict=True)
        ]
        titles = [self._title(shown, place, kind) for place, kind in self._plan.panels()]
        return self._layout.compose(self._head(shown), titles, panels)

    def _title(self, shown: Shown, place: int, kind: str) -> str:
        several = len(shown.frames) > 1 and kind != "map"
        camera = [self._scene.cameras[self._plan.cameras[place]].name] if several else []
        age = [_age(shown, place)] if several and _age(shown, place) else []
        name = [TITLES.get(kind, kind)] if len(self._plan.kinds) > 1 else []
        return " · ".join(camera + name + age)

    def _panel(self, subject: Subject | None, kind: str, window: Window) -> Image.Image:
        if subject is None:
            return Image.new("RGB", window.size, palette.SOFT_INK)
        nominal = self._layout.nominal_width
        if kind == "ids":
            return ids_picture(subject.solids, window, self._drawer, nominal)
        layers, ground = self._plan.layers_of(kind), None
        if self._painter is not None and (kind == "scene" or (kind == "detections" and self._plan.boxes_on_scene)):
            ground = self._painter.picture(subject.solids, window, self._scene.vessels)
            layers = replace(layers, horizon=False, silhouettes=False)
        elif kind == "scene" and self._plan.layers is None:
            return scene_picture(self._scene, subject.solids.camera, subject.frame.step, window, self._drawer)
        return paint(subject, window, layers, self._drawer, ground=ground, nominal_width_px=nominal)

    def _head(self, shown: Shown) -> str:
        states = dict.fromkeys(frame.state for frame in shown.frames if frame)
        single = len(shown.frames) == 1
        camera = [self._scene.cameras[self._plan.cameras[0]].name] if single else []
        parts = [self._scene.name, *camera, f"{shown.timestamp} s", f"step {shown.step}"]
        parts += [f"detector {', '.join(states)}"] if states else []
        return "    ".join([*parts, _age(shown, 0)] if single and _age(shown, 0) else parts)


def _age(shown: Shown, place: int) -> str:
    """Of when a camera's picture is, where it is not of the step itself."""
    frame = shown.frames[place]
    if frame is None:
        return "no frame yet"
    return "" if frame.step == shown.step else f"frame of {frame.timestamp} s"


@contextmanager
def open_drawer(scene: Scene) -> Iterator[IdDrawer]:
    """What draws ID buffers for pictures: the renderer, or NumPy where there is none or the scene uses none."""
    with ExitStack() as stack:
        try:
            renderer = stack.enter_context(open_renderer(scene))
        except RendererError:
            renderer = None  # a picture of a run that was made elsewhere
        yield renderer or PlainIds()


@contextmanager
def open_draughtsman(scene: Scene, plan: FilmPlan) -> Iterator[Draughtsman]:
    """A draughtsman with what he needs: ID buffers, and pyrender in the same context for shaded pictures.

    Raises:
        RendererError: Shaded pictures are asked for and there is no OpenGL library.
    """
    with open_drawer(scene) as drawer, ExitStack() as stack:
        painter = stack.enter_context(open_painter(plan.look)) if plan.look.shaded else None
        yield Draughtsman(scene, plan, drawer, painter)


@contextmanager
def open_painter(look: Look) -> Iterator[ShadedPainter]:
    """What draws shaded pictures.

    Raises:
        RendererError: There is no OpenGL library.
    """
    from modsim3d.render.context import open_context
    from modsim3d.render.shaded_pass import ShadedRenderer

    with open_context() as context:
        renderer = ShadedRenderer(context)
        try:
            yield ShadedPainter(renderer, look)
        finally:
            renderer.close()


@dataclass(frozen=True)
class DrawnFilm:
    """A film that was drawn.

    Attributes:
        path: The file, or the folder of PNG files.
        size: Width and height.
        frames: Different ones.
        timetable: How long each is shown.
    """

    path: Path
    size: tuple[int, int]
    frames: int
    timetable: Timetable


def draw_picture(selection: Selection, plan: FilmPlan, path: Path) -> Path:
    """Draw the first step of a selection into a PNG."""
    scene = selection.run.scene
    with open_draughtsman(scene, plan) as draughtsman:
        picture = draughtsman.draw(next(selection.shown()))
    with put_in_place(path) as partial:
        picture.save(partial, format="PNG")
    return path


def draw_film(
    selection: Selection,
    plan: FilmPlan,
    kind: str,
    path: Path,
    *,
    speed: float = 1.0,
    workers: int = 1,
    progress: Callable[[int], None] = lambda frames: None,
) -> DrawnFilm:
    """Draw a film.

    Args:
        selection: Steps and cameras.
        plan: What every picture shows.
        kind: Of `FORMATS`.
        path: The file, or the folder of PNG files.
        speed: Seconds of the run in one of the film.
        workers: Processes that draw; the film is the same bytes whatever their number.
        progress: Called with the number of frames done since its last call.

    Raises:
        ModsimError: The film cannot be drawn or encoded.
    """
    scene = selection.run.scene
    timetable = Timetable.of(selection.durations_s, speed, MOST_RATE[kind])
    shown = dict(zip(selection.steps, timetable.shown.tolist(), strict=True))
    drawn = [step for step in selection.steps if shown[step] or kind == "png"]
    with _open_draughtsmen(scene, plan, workers) as draw:
        colours = _gif_palette(selection, drawn, draw) if kind == "gif" else None

        def frames() -> Iterator[tuple[EncodedFrame, int]]:
            for piece in draw(_Job(kind, colours, piece) for piece in _pieces(selection, set(drawn))):
                for frame in piece:
                    yield frame, shown[frame.step]
                    progress(1)

        write_film(kind, path, frames(), timetable.rate, colours)
    return DrawnFilm(path, plan.layout(scene).size, len(drawn), timetable)


def _gif_palette(selection: Selection, steps: Sequence[int], draw: Draw) -> Image.Image:
    """The palette of a film, from some of its pictures."""
    chosen = dict.fromkeys(steps[i * len(steps) // PALETTE_SAMPLES] for i in range(PALETTE_SAMPLES))
    samples = draw(_Job("mp4", None, [_shown_at(selection, step)]) for step in chosen)
    return film_palette([Image.frombytes("RGB", frame.size, frame.data) for piece in samples for frame in piece])


def _shown_at(selection: Selection, step: int) -> Shown:
    return next(replace(selection, steps=(step,), durations_s=np.ones(1)).shown())


def _pieces(selection: Selection, steps: set[int]) -> Iterator[Piece]:
    piece: Piece = []
    for shown in selection.shown():
        if shown.step in steps:
            piece.append(shown)
        if len(piece) == STEPS_TOGETHER:
            yield piece
            piece = []
    if piece:
        yield piece


@dataclass(frozen=True, eq=False)
class _Job:
    """Steps to draw, and what their pictures are to be encoded for."""

    kind: str
    colours: Image.Image | None
    piece: Piece


Draw = Callable[[Iterable[_Job]], Iterator[list[EncodedFrame]]]


@contextmanager
def _open_draughtsmen(scene: Scene, plan: FilmPlan, workers: int) -> Iterator[Draw]:
    """Somebody who draws: this process for one worker, or that many others."""
    if workers == 1:
        with open_draughtsman(scene, plan) as draughtsman:
            yield lambda jobs: (_draw_job(draughtsman, job) for job in jobs)
        return
    with open_pool(workers, _start, scene, plan) as pool:
        yield lambda jobs: in_order(pool, workers, _work, jobs, "draw the film again, perhaps with fewer --workers")


def _draw_job(draughtsman: Draughtsman, job: _Job) -> list[EncodedFrame]:
    pictures = [(shown.step, draughtsman.draw(shown)) for shown in job.piece]
    return [EncodedFrame.of(step, picture, job.kind, job.colours) for step, picture in pictures]


_draughtsman: Draughtsman | None = None
_open = ExitStack()


def _start(scene: Scene, plan: FilmPlan) -> None:
    """Set a worker up once; its context lives as long as it does."""
    global _draughtsman
    _draughtsman = _open.enter_context(open_draughtsman(scene, plan))


def _work(job: _Job) -> list[EncodedFrame]:
    if _draughtsman is None:
        raise ModsimError("this process was not set up as a worker")
    return _draw_job(_draughtsman, job)
