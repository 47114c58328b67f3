"""Renders the pictures of a film from the frames of a run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager, nullcontext
from dataclasses import replace

from PIL import Image

from modsim3d.render.plain_ids import AnyIdRenderer
from modsim3d.runs.frames import Frame
from modsim3d.runs.selection import StepFrames
from modsim3d.scene.scene import Scene
from modsim3d.view import palette
from modsim3d.view.films.plan import TITLES, FilmPlan
from modsim3d.view.maps.map_film import MapFilmRenderer
from modsim3d.view.outcome_words import WEATHER
from modsim3d.view.pictures.frame_picture import CameraView, frame_picture
from modsim3d.view.pictures.ids_picture import ids_picture
from modsim3d.view.pictures.solids import open_id_renderer
from modsim3d.view.pictures.track_marks import NO_TRACKS, FrameTracks
from modsim3d.view.pictures.window import Window
from modsim3d.view.shaded.lights.seen import ground_speeds
from modsim3d.view.shaded.render_style import RenderStyle
from modsim3d.view.shaded.shaded_picture import ShadedPictureRenderer


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
        self._scene = scene
        self._plan = plan
        self._id_renderer = id_renderer
        self._shaded_renderer = shaded_renderer
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
        if self._shaded_renderer is not None and kind != "corners" and on_scene:
            night = self._shaded_renderer.style.night
            speeds_m_s = ground_speeds(self._scene, camera_view.frame.step) if night else None
            ground = self._shaded_renderer.picture(camera_view.solids, window, speeds_m_s)
            layers = replace(layers, horizon=False, silhouettes=False)
        return frame_picture(camera_view, window, layers, self._id_renderer, ground=ground, nominal_width_px=nominal)

    def _head(self, step_frames: StepFrames) -> str:
        states = dict.fromkeys(frame.state for frame in step_frames.frames if frame)
        single = len(step_frames.frames) == 1
        camera = single and self._scene.cameras[self._plan.cameras[0]].name
        time, step = f"{step_frames.timestamp} s", f"step {step_frames.step}"
        detector, age = states and f"detector {', '.join(states)}", single and _age(step_frames, 0)
        weather = states and not self._plan.style.caption and WEATHER
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

    Raises:
        RendererError: Shaded pictures are asked for and there is no OpenGL library.
    """
    shaded_pictures = open_shaded_picture_renderer(plan.style) if plan.style.shaded else nullcontext()
    with open_id_renderer(scene) as id_renderer, shaded_pictures as shaded_renderer:
        yield FilmRenderer(scene, plan, id_renderer, shaded_renderer)


@contextmanager
def open_shaded_picture_renderer(style: RenderStyle) -> Iterator[ShadedPictureRenderer]:
    """What draws shaded pictures; without an OpenGL library that is an error."""
    from modsim3d.render.context import open_context
    from modsim3d.render.shaded_pass import ShadedRenderer

    with open_context() as context, closing(ShadedRenderer(context)) as renderer:
        yield ShadedPictureRenderer(renderer, style)
