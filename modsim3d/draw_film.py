"""Films and single pictures of a stored run, drawn from its directory alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from modsim3d.errors import RendererError
from modsim3d.film_plan import TITLES, FilmPlan
from modsim3d.processes import open_workers
from modsim3d.render.plain_ids import IdDrawer, PlainIds
from modsim3d.scene import Scene
from modsim3d.selection import LatestFrames, Selection
from modsim3d.simulate import open_renderer
from modsim3d.view import palette
from modsim3d.view.film_files import MOST_RATE, encoded, open_film
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
IF_KILLED = "draw the film again, perhaps with fewer --workers"

Piece = list[LatestFrames]


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

    def draw(self, shown: LatestFrames) -> Image.Image:
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

    def _title(self, shown: LatestFrames, place: int, kind: str) -> str:
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

    def _head(self, shown: LatestFrames) -> str:
        states = dict.fromkeys(frame.state for frame in shown.frames if frame)
        single = len(shown.frames) == 1
        camera = [self._scene.cameras[self._plan.cameras[0]].name] if single else []
        parts = [self._scene.name, *camera, f"{shown.timestamp} s", f"step {shown.step}"]
        parts += [f"detector {', '.join(states)}"] if states else []
        return "    ".join([*parts, _age(shown, 0)] if single and _age(shown, 0) else parts)


def _age(shown: LatestFrames, place: int) -> str:
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
        picture = draughtsman.draw(next(selection.latest_frames()))
    partial = path.with_name(f".{path.name}.partial")
    picture.save(partial, format="PNG")
    partial.replace(path)
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
        workers: Number of processes; the bytes of the film do not depend on it.
        progress: Called with the number of frames done since its last call.

    Raises:
        ModsimError: The film cannot be drawn or encoded.
    """
    scene = selection.run.scene
    timetable = Timetable.of(selection.durations_s, speed, MOST_RATE[kind])
    shown = dict(zip(selection.steps, timetable.shown.tolist(), strict=True))
    drawn = [step for step in selection.steps if shown[step] or kind == "png"]
    with open_workers(workers, IF_KILLED, open_draughtsman, scene, plan) as draughtsmen:
        colours = None
        samples: list[_Drawn] = []
        if kind == "gif":
            chosen = dict.fromkeys(drawn[i * len(drawn) // PALETTE_SAMPLES] for i in range(PALETTE_SAMPLES))
            pieces = [[_shown_at(selection, step)] for step in chosen]
            jobs = (_Job("mp4", None, piece) for piece in pieces)
            samples = [one for piece in draughtsmen.map(_draw_job, jobs) for one in piece]
            colours = film_palette([Image.frombytes("RGB", one.size, one.data) for one in samples])
        jobs = (_Job(kind, colours, piece) for piece in _pieces(selection, set(drawn)))
        pictures = (one for piece in draughtsmen.map(_draw_job, jobs) for one in piece)
        first = next(pictures)
        # Opened after the workers have started: they must not hold its end of the encoder's pipe open.
        with open_film(kind, path, first.size, timetable.rate, colours) as film:
            for one in _chain(first, pictures):
                film.add(one.step, one.data, shown[one.step])
                progress(1)
    return DrawnFilm(path, first.size, len(drawn), timetable)


def _chain(first: _Drawn, others: Iterable[_Drawn]) -> Iterator[_Drawn]:
    yield first
    yield from others


def _shown_at(selection: Selection, step: int) -> LatestFrames:
    return next(replace(selection, steps=(step,), durations_s=np.ones(1)).latest_frames())


def _pieces(selection: Selection, steps: set[int]) -> Iterator[Piece]:
    piece: Piece = []
    for shown in selection.latest_frames():
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


@dataclass(frozen=True, eq=False)
class _Drawn:
    """A step's picture, encoded."""

    step: int
    size: tuple[int, int]
    data: bytes


def _draw_job(draughtsman: Draughtsman, job: _Job) -> list[_Drawn]:
    pictures = [(shown.step, draughtsman.draw(shown)) for shown in job.piece]
    return [_Drawn(step, picture.size, encoded(picture, job.kind, job.colours)) for step, picture in pictures]
