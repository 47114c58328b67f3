"""Renders the pictures of a film from the frames of a run."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass, replace
from itertools import chain, groupby
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from modsim3d.core.arrays import Array, Indices
from modsim3d.render.id_pass import AnyIdRenderer
from modsim3d.runs.frames import Frame
from modsim3d.runs.selection import StepFrames
from modsim3d.scene.scene import Scene
from modsim3d.view import palette
from modsim3d.view.films.plan import TITLES, FilmPlan
from modsim3d.view.lights import ground_speeds
from modsim3d.view.map_marks import BirdsEye
from modsim3d.view.map_names import MapName
from modsim3d.view.map_picture import Map
from modsim3d.view.pictures.canvas import Window
from modsim3d.view.pictures.frame_picture import NO_TRACKS, CameraView, FrameTracks, frame_picture
from modsim3d.view.pictures.id_buffer import ids_picture
from modsim3d.view.pictures.layers import WEATHER
from modsim3d.view.pictures.plain import open_id_renderer
from modsim3d.view.sea_and_sky import RenderStyle
from modsim3d.view.shaded_picture import ShadedPictureRenderer

if TYPE_CHECKING:
    from matplotlib.artist import Artist

# ---- Maps one after another, fast ----

Pixels = NDArray[np.uint8]
Part = tuple[slice, slice]
BESIDE_PX = 4  # a name may colour pixels so far outside its box


class MapFilmRenderer:
    """Draws a map at one step after another, as `map_picture` does but for rounding.
    The artists lie in layers, of which every second one stays as it is. The lowest is a picture to draw on; a higher
    one is kept as the pixels that it covers, which are blended with what moves below them. `map` is the map at the step
    of the last picture."""

    def __init__(self, birds_eye: BirdsEye, size: tuple[int, int]) -> None:
        """Draw all that stays, at a width and height in pixels."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        self.map = Map(birds_eye, *size)
        self.map.show(0)
        canvas = FigureCanvasAgg(self.map.figure)
        self._renderer = canvas.get_renderer()
        self._pixels: Pixels = np.asarray(canvas.buffer_rgba())  # shares the renderer's memory
        layers = _layers(self.map)
        names = self.map.sheet.names.names
        for artist in (*chain(*layers), *(name.note for name in names)):
            artist.set_animated(True)  # the figure leaves them out
        canvas.draw()
        self._ground = self._pixels.copy()
        moving = set(self.map.sheet.moving)
        self._layers = [layer if layer[0] in moving else self._cover(layer) for layer in layers]
        self._names = [(name, self._stamp(name)) for name in names]

    def picture(self, step: int) -> Image.Image:
        """The map at a step."""
        self.map.show(step)
        self._pixels[:] = self._ground
        for layer in self._layers:
            if isinstance(layer, _Cover):
                layer.blend(self._pixels)
            else:
                self._draw(layer)
        for name, stamp in self._names:
            if name.middle_px is not None:
                stamp.blend(self._pixels, self._at(name.middle_px))
        height, width = self._pixels.shape[:2]
        return Image.frombytes("RGB", (width, height), self._pixels.tobytes(), "raw", "RGBX")

    def _draw(self, artists: list[Artist]) -> None:
        for artist in artists:
            artist.draw(self._renderer)

    def _at(self, place_px: Array) -> Indices:
        """Row and column of a whole place on the picture, whose rows count from below."""
        return np.array([len(self._pixels) - place_px[1], place_px[0]], dtype=np.int64)

    def _stamp(self, name: MapName) -> _Cover:
        """A name, drawn once; its pixels count from its middle."""
        x0, y0, x1, y1 = name.extent_px().tolist()
        name.put(np.ceil([BESIDE_PX - x0, BESIDE_PX - y0]))  # as low and as far to the left as it can be
        assert name.middle_px is not None
        middle = self._at(name.middle_px)
        part = np.s_[middle[0] - math.ceil(y1) - BESIDE_PX :, : middle[1] + math.ceil(x1) + BESIDE_PX]
        return self._cover([name.note], part, middle)

    def _cover(self, artists: list[Artist], part: Part = np.s_[:, :], origin: Indices | None = None) -> _Cover:
        """Area that some artists cover in a part of the picture; its pixels count from one of the picture's."""
        black, white = (self._on(artists, part, ground) for ground in (0, 255))
        covered = np.nonzero((black != 0).any(axis=2) | (white != 255).any(axis=2))
        kept = (white[covered] - np.float32(black[covered])) / np.float32(255)
        first = np.array([axis.start or 0 for axis in part], dtype=np.int64)
        places: Indices = np.array(covered) + first[:, None] - (0 if origin is None else origin[:, None])
        return _Cover(places, kept, black[covered] + np.float32(0.5))

    def _on(self, artists: list[Artist], part: Part, ground: int) -> Pixels:
        """The colours of a part of the picture when artists are drawn on one grey level."""
        self._pixels[part] = (ground, ground, ground, 255)
        self._draw(artists)
        return self._pixels[part][..., :3].copy()


@dataclass(frozen=True, eq=False)
class _Cover:
    """The pixels that some artists cover."""

    places: Indices  # rows and columns, shape (2, n)
    kept: NDArray[np.float32]  # the share of each colour that shows through, shape (n, 3)
    added: NDArray[np.float32]  # the colour that is added, and a half, so that the result is rounded, shape (n, 3)

    def blend(self, pixels: Pixels, origin: Indices | None = None) -> None:
        """Lay them over an opaque picture, shape (h, w, 4), where they count from one of its pixels, shape (2,)."""
        rows, columns = self.places if origin is None else self.places + origin[:, None]
        where = rows * pixels.shape[1] + columns
        flat = pixels.reshape(-1, 4)
        flat[where, :3] = flat[where, :3] * self.kept + self.added


def _layers(drawn: Map) -> list[list[Artist]]:
    """The artists from the lowest that moves upwards, in layers that either move or stay, in turn."""
    axes, moving = drawn.sheet.axes, set(drawn.sheet.moving)
    title = axes.title  # it lies outside the map, so that it may be drawn at any time
    apart = {axes.patch, title, *(name.note for name in drawn.sheet.names.names)}
    inside = [artist for artist in axes.get_children() if artist not in apart]
    layers = [list(layer) for _, layer in groupby(sorted(inside, key=attrgetter("zorder")), moving.__contains__)]
    return [*(layers if layers[0][0] in moving else layers[1:]), [title]]


class FilmRenderer:
    """Draws the pictures of a film one by one."""

    def __init__(
        self,
        scene: Scene,
        plan: FilmPlan,
        id_renderer: AnyIdRenderer,
        shaded_renderer: ShadedPictureRenderer | None = None,
    ) -> None:
        """Take what all pictures share; `shaded_renderer` draws the scene where the plan asks for light and shade."""
        self._scene, self._plan = scene, plan
        self._id_renderer, self._shaded_renderer = id_renderer, shaded_renderer
        self._layout = plan.layout(scene)
        # Made here and not with the first map, so that all that stays is drawn before the first picture.
        maps = (size for (_, kind), size in zip(plan.panels(), self._layout.panel_sizes, strict=True) if kind == "map")
        self._map = next((MapFilmRenderer(plan.birds_eye(scene), size) for size in maps), None)

    def draw(self, step_frames: StepFrames) -> Image.Image:
        """The picture of a step, from what each camera of the plan shows."""
        kinds = {place: kind for place, kind in self._plan.panels() if kind != "map"}
        views = {place: self._view(step_frames.frames[place]) for place in kinds}
        panels = [
            self._map.picture(step_frames.step)
            if kind == "map" and self._map is not None
            else self._panel(views[place], kind, self._plan.window(self._scene, place, size))
            for (place, kind), size in zip(self._plan.panels(), self._layout.panel_sizes, strict=True)
        ]
        titles = [self._title(step_frames, place, kind) for place, kind in self._plan.panels()]
        return self._layout.compose(self._head(step_frames), titles, panels)

    def _view(self, frame: Frame | None) -> CameraView | None:
        if frame is None:
            return None
        followed = self._plan.tracks
        tracks = NO_TRACKS if followed is None else FrameTracks.of(followed, self._scene, frame)
        return CameraView.of(self._scene, frame, tracks)

    def _title(self, step_frames: StepFrames, place: int, kind: str) -> str:
        several = len(step_frames.frames) > 1 and kind != "map"
        camera = several and self._scene.cameras[self._plan.cameras[place]].name
        name = len(self._plan.kinds) > 1 and TITLES.get(kind, kind)
        age = several and _age(step_frames, place)
        return " · ".join(part for part in (camera, name, age) if part)

    def _panel(self, camera_view: CameraView | None, kind: str, window: Window) -> Image.Image:
        if camera_view is None:
            return Image.new("RGB", window.size, palette.SOFT_INK)
        nominal = self._layout.nominal_width
        if kind == "ids":
            return ids_picture(camera_view.solids, window, self._id_renderer, nominal)
        layers, on_scene = self._plan.layers_of(kind), kind == "scene" or self._plan.boxes_on_scene
        ground = None
        if self._shaded_renderer is not None and self._scene.labels is None and kind != "corners" and on_scene:
            style = self._plan.style.in_state(self._scene, camera_view.frame.state)
            speeds_m_s = ground_speeds(self._scene, camera_view.frame.step)
            ground = self._shaded_renderer.styled(style).picture(camera_view.solids, window, speeds_m_s)
            layers = replace(layers, horizon=False, silhouettes=False)
        return frame_picture(camera_view, window, layers, self._id_renderer, ground=ground, nominal_width_px=nominal)

    def _head(self, step_frames: StepFrames) -> str:
        states = dict.fromkeys(frame.state for frame in step_frames.frames if frame)
        single = len(step_frames.frames) == 1
        camera = single and self._scene.cameras[self._plan.cameras[0]].name
        time, step = f"{step_frames.timestamp} s", f"step {step_frames.step}"
        detector, age = states and f"detector {', '.join(states)}", single and _age(step_frames, 0)
        drawn = self._plan.style.shaded and self._scene.labels is None
        drawn = drawn and ("scene" in self._plan.kinds or self._plan.boxes_on_scene)
        weather = states and not drawn and WEATHER
        parts = (self._scene.name, camera, time, step, detector, age, self._plan.note, weather)
        return "    ".join(part for part in parts if part)


def _age(step_frames: StepFrames, place: int) -> str:
    """The time of a camera's frame, where it was not taken at the step itself."""
    frame = step_frames.frames[place]
    if frame is None:
        return "no frame yet"
    return "" if frame.step == step_frames.step else f"frame of {frame.timestamp} s"


@contextmanager
def open_film_renderer(scene: Scene, plan: FilmPlan) -> Iterator[FilmRenderer]:
    """A film renderer, with OpenGL where there is some.
    Raises RendererError if shaded pictures are asked for and there is no OpenGL library."""
    shaded_pictures = open_shaded_picture_renderer(plan.style) if plan.style.shaded else nullcontext()
    with open_id_renderer(scene) as id_renderer, shaded_pictures as shaded_renderer:
        yield FilmRenderer(scene, plan, id_renderer, shaded_renderer)


@contextmanager
def open_shaded_picture_renderer(style: RenderStyle) -> Iterator[ShadedPictureRenderer]:
    """Open a renderer of shaded pictures; without an OpenGL library that is an error."""
    from modsim3d.render.context import open_context
    from modsim3d.render.shaded_pass import ShadedRenderer

    with open_context() as context, closing(ShadedRenderer(context)) as renderer:
        yield ShadedPictureRenderer(renderer, style)
