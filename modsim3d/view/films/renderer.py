"""Renders the pictures of a film from the frames of a run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, nullcontext
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np
from PIL import Image

from modsim3d.core.arrays import NOBODY
from modsim3d.render.id_pass import AnyIdRenderer
from modsim3d.runs.frames import Frame
from modsim3d.runs.selection import StepFrames
from modsim3d.scene.scene import Scene
from modsim3d.view import palette
from modsim3d.view.films.plan import TITLES, FilmPlan
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.lights import ground_speeds
from modsim3d.view.map_marks import Bearing, BirdsEye
from modsim3d.view.map_picture import Map
from modsim3d.view.pictures.canvas import Window
from modsim3d.view.pictures.close_up import close_up, inset_of
from modsim3d.view.pictures.frame_picture import CameraView, FrameTracks, frame_picture
from modsim3d.view.pictures.id_buffer import ids_picture
from modsim3d.view.pictures.layers import WEATHER
from modsim3d.view.pictures.plain import open_id_renderer
from modsim3d.view.sea_and_sky import RenderStyle
from modsim3d.view.shaded_picture import ShadedPictureRenderer, caption_box


class MapFilmRenderer:
    """Draws a map at one step after another, as `map_picture` does; what lies below all that moves is drawn once.
    `map` is the map at the step of the last picture."""

    def __init__(self, birds_eye: BirdsEye, size: tuple[int, int]) -> None:
        """Draw what stays, at a width and height in pixels."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        self.map = Map(birds_eye, *size)
        self.map.show(0)
        axes, moving = self.map.sheet.axes, {*self.map.sheet.moving} - {self.map.sheet.axes.title}
        lowest = min(artist.zorder for artist in moving)
        above = [artist for artist in axes.get_children() if artist is not axes.patch and artist.zorder >= lowest]
        self._above = [*sorted(above, key=attrgetter("zorder")), *[axes.title][: axes.title.zorder < lowest]]
        for artist in self._above:
            artist.set_animated(True)  # the figure leaves them out
        canvas = FigureCanvasAgg(self.map.figure)
        canvas.draw()
        self._renderer, self._pixels = canvas.get_renderer(), np.asarray(canvas.buffer_rgba())  # they share memory
        self._ground = self._pixels.copy()

    def picture(self, step: int, bearings: Sequence[Bearing] = ()) -> Image.Image:
        """The map at a step, with bearings of detections and tracks."""
        self.map.show(step, bearings)
        self._pixels[:] = self._ground
        for artist in self._above:
            artist.draw(self._renderer)
        return Image.fromarray(self._pixels[..., :3].copy())


def bearings_of(scene: Scene, frames: Iterable[Frame | None], followed: FollowedTracks | None) -> list[Bearing]:
    """The bearings of all detections and tracks in frames."""
    bearings = []
    for frame in filter(None, frames):
        view = CameraView.of(scene, frame, FrameTracks.of(followed, scene, frame))
        detections, tracks = view.frame.detections, view.tracks
        for box_px, vessel in zip(detections.boxes_px, detections.vessels, strict=True):
            bearings.append(Bearing.of(view.solids, box_px, palette.ALARM if vessel is None else view.colour(vessel)))
        for box_px, vessel, track in zip(tracks.boxes_px, tracks.vessel.tolist(), tracks.number.tolist(), strict=True):
            colour = palette.ALARM if vessel == NOBODY else view.colour(view.vessels[vessel])
            bearings.append(Bearing.of(view.solids, box_px, colour, track))
    return bearings


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
        panels: list[Image.Image] = []
        insets: list[Image.Image | None] = []
        for (place, kind), size in zip(self._plan.panels(), self._layout.panel_sizes, strict=True):
            if kind == "map" and self._map is not None:
                bearings = bearings_of(self._scene, step_frames.frames, self._plan.tracks)
                panels.append(self._map.picture(step_frames.step, bearings))
                insets.append(None)
                continue
            window = self._plan.window(self._scene, place, size, step_frames.step)
            panels.append(self._panel(views[place], kind, window, step_frames.step))
            insets.append(self._inset(views[place], kind, window))
        titles = [self._title(step_frames, place, kind) for place, kind in self._plan.panels()]
        return self._layout.compose(self._head(step_frames), titles, panels, insets)

    def _inset(self, camera_view: CameraView | None, kind: str, window: Window) -> Image.Image | None:
        """The part of the image that the panels of a camera show, beside the title of the first."""
        if camera_view is None or not self._plan.insets or kind != self._plan.kinds[0]:
            return None
        return inset_of(camera_view, window, self._layout.inset_px)

    def _view(self, frame: Frame | None) -> CameraView | None:
        if frame is None:
            return None
        only = self._plan.close_up.tracks if self._plan.close_up else None
        tracks = FrameTracks.of(self._plan.tracks, self._scene, frame, only)
        return CameraView.of(self._scene, frame, tracks)

    def _title(self, step_frames: StepFrames, place: int, kind: str) -> str:
        several = len(step_frames.frames) > 1 and kind != "map"
        camera = several and self._scene.cameras[self._plan.cameras[place]].name
        name = len(self._plan.kinds) > 1 and TITLES.get(kind, kind)
        age = several and _age(step_frames, place)
        return " · ".join(part for part in (camera, name, age) if part)

    def _panel(self, camera_view: CameraView | None, kind: str, window: Window, step: int) -> Image.Image:
        if camera_view is None:
            return Image.new("RGB", window.size, palette.SOFT_INK)
        nominal = self._layout.nominal_width
        if kind == "ids":
            return ids_picture(camera_view.solids, window, self._id_renderer, nominal)
        layers, on_scene = self._plan.layers_of(kind), kind == "scene" or self._plan.boxes_on_scene
        ground, options = None, dict[str, Any](nominal_width_px=nominal)
        if self._shaded_renderer is not None and self._scene.labels is None and kind != "corners" and on_scene:
            style = self._plan.style.in_state(self._scene, camera_view.frame.state)
            speeds_m_s = ground_speeds(self._scene, camera_view.frame.step)
            ground = self._shaded_renderer.styled(style).picture(camera_view.solids, window, speeds_m_s)
            layers = replace(layers, horizon=False, silhouettes=False)
            options["keep_clear"] = [caption_box(style, ground)]
        options["ground"] = ground
        if (followed := self._plan.close_up) is not None:
            focus_px, options["wanted"] = np.array(followed.boxes_px[step]), followed.wanted
            return close_up(camera_view, window, focus_px, layers, self._id_renderer, **options)
        return frame_picture(camera_view, window, layers, self._id_renderer, **options)

    def _head(self, step_frames: StepFrames) -> tuple[str, ...]:
        states = dict.fromkeys(frame.state for frame in step_frames.frames if frame)
        single = len(step_frames.frames) == 1
        camera = self._scene.cameras[self._plan.cameras[0]].name if single else ""
        time, step = f"{step_frames.timestamp} s", f"step {step_frames.step}"
        shaded = self._plan.style.shaded and self._scene.labels is None
        scene_alone = shaded and "scene" in self._plan.kinds
        drawn = shaded and (self._plan.boxes_on_scene or self._plan.kinds == ("scene",))
        rest = (
            f"detector {', '.join(states)}" if states else "",
            _age(step_frames, 0) if single else "",
            WEATHER + " around boxes" * scene_alone if states and not drawn else "",
        )
        parts: tuple[str, ...] = (self._scene.name, camera, time, step, *rest)
        if self._plan.close_up is not None:
            caption = self._plan.close_up.captions[step_frames.step]
            parts = f"{time}    {caption}", "    ".join(filter(None, (camera, *rest)))
        return tuple(filter(None, parts))


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
