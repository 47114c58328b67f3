"""The scene from above as a picture, after Jessen & Mohr (2023), Figures 9.2, 9.6 and 9.10."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from PIL import Image

from modsim3d.arrays import Array
from modsim3d.errors import ModsimError
from modsim3d.geometry.rotations import world_R_vehicle
from modsim3d.outputs.placing import put_in_place
from modsim3d.view import palette
from modsim3d.view.maps.birds_eye import BirdsEye, hull_m, ring_step, view_of
from modsim3d.view.maps.map_names import MapNames

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
WIDTH_IN = 10.0
"""A map is laid out at this width, so that text and lines grow with the picture."""
FURNITURE = 0.13
"""Height of title, axis and legend, as a share of the width."""
TRAIL_S = 60.0
"""The last part of a track, of this duration, is drawn bold."""
RINGS = 5
"""The most range rings from a camera to the farthest corner of the map."""
MARKER_SHARE = 0.018
"""A hull shorter than this share of the map's width has an arrowhead of that length around it."""
CAMERA_NAME_SHARE = 0.06
"""How far before a camera its name stands, as a share of the map's shorter side."""
SEA, LAND, SHORE, SOIL = "#eaf1f5", "#cfc8ba", "#8d8577", "#5c564b"
CAMERA, RING = "#c0392b", "#6d7b85"


def check_matplotlib() -> None:
    """Raise a ModsimError if matplotlib, which draws maps, is not installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise ModsimError("maps need matplotlib: pip install 'modsim3d[view]'") from None


def map_figure(birds_eye: BirdsEye, step: int, width_px: int, height_px: int | None = None) -> Figure:
    """The map at a step, as high as it needs if no height is given."""
    check_matplotlib()
    from matplotlib.figure import Figure

    height = height_px or map_height_px(birds_eye, width_px)
    dpi = width_px / WIDTH_IN
    figure = Figure(figsize=(WIDTH_IN, height / dpi), dpi=dpi, layout="constrained")
    _Map(figure, birds_eye, step).draw()
    return figure


def map_height_px(birds_eye: BirdsEye, width_px: int) -> int:
    """The height that a map of the given width needs; even, as films need it."""
    x0, x1, y0, y1 = birds_eye.extent_m
    return 2 * round(width_px * (0.92 * (y1 - y0) / (x1 - x0) + FURNITURE) / 2)


def save_map(birds_eye: BirdsEye, step: int, path: Path, width_px: int) -> Path:
    """Write the map at a step in the format of the path's ending; the same map gives the same bytes."""
    check_matplotlib()
    from matplotlib import rc_context

    ending = path.suffix.lower()
    metadata: dict[str, Any] = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    with rc_context({"svg.hashsalt": "modsim3d"}), put_in_place(path) as partial:
        figure = map_figure(birds_eye, step, width_px)
        figure.savefig(partial, format=ending[1:], metadata=metadata[ending], dpi=figure.dpi)
    return path


def map_picture(birds_eye: BirdsEye, step: int, size: tuple[int, int]) -> Image.Image:
    """The map at a step as a picture of a size."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(map_figure(birds_eye, step, *size))
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


@dataclass(eq=False)
class _Map:
    """One map while it is drawn."""

    figure: Figure
    birds_eye: BirdsEye
    step: int
    axes: Axes = field(init=False)
    names: MapNames = field(init=False)
    explained: set[str] = field(default_factory=set)

    def draw(self) -> None:
        """Everything, from the bottom to the top."""
        scene, (x0, x1, y0, y1) = self.birds_eye.scene, self.birds_eye.extent_m
        self.axes = self.figure.add_subplot()
        self.names = MapNames(self.axes)
        self.axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal", facecolor=SEA, xlabel="w1 (m)", ylabel="w2 (m)")
        self.axes.set_autoscale_on(False)
        self.axes.tick_params(labelsize=8)
        (time,) = scene.timestamps(self.step, self.step + 1)
        self.axes.set_title(f"{scene.name}    {time} s    step {self.step}", fontsize=11)
        self._vessels()
        self._cameras()
        self._obstacles()
        handles = self.axes.get_legend_handles_labels()[0]
        self.figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=8, frameon=False)
        self.figure.draw_without_rendering()
        self.names.place()

    def _once(self, text: str) -> str:
        """A label for the legend, for the first of its kind only."""
        said = text in self.explained
        self.explained.add(text)
        return "_" if said else text

    def _line(self, points: Array, **keys: Any) -> None:
        self.axes.plot(*points.T, **keys)

    def _area(self, ring: Array, **keys: Any) -> None:
        from matplotlib.patches import Polygon

        self.axes.add_patch(Polygon(ring, **keys))

    def _obstacles(self) -> None:
        obstacles = self.birds_eye.scene.obstacles
        for obstacle, shape in zip(obstacles, self.birds_eye.land, strict=True):
            for part in shapely.get_parts(shape).tolist():
                ring = shapely.get_coordinates(part.exterior)
                self._area(ring, facecolor=LAND, edgecolor=SHORE, lw=0.6, zorder=2, label=self._once("obstacle"))
            middle, (x0, y0, x1, y1) = shape.representative_point(), shape.bounds
            half_m = np.array([x1 - x0, y1 - y0]) / 2
            self.names.add(obstacle.name, np.array([middle.x, middle.y]), half_m, fontsize=7, color=SOIL)

    def _cameras(self) -> None:
        x0, x1, y0, y1 = self.birds_eye.extent_m
        corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
        for place, index in enumerate(self.birds_eye.cameras):
            camera = self.birds_eye.scene.cameras[index]
            at, view = view_of(self.birds_eye.scene, camera, self.step)
            farthest = float(np.linalg.norm(corners - at, axis=1).max())
            if not place:
                self._rings(at, farthest)
            edge = at + 2 * farthest * view
            seen = np.concatenate([at[None], edge])
            self._area(seen, facecolor=CAMERA, alpha=0.09, lw=0, zorder=1, label=self._once("field of view"))
            for end in (edge[0], edge[-1]):
                self._line(np.array([at, end]), color=CAMERA, lw=0.7, alpha=0.8, zorder=4)
            style = {"marker": "o", "ls": "", "ms": 5 if camera.mount.vessel is None else 3.5, "mec": "white"}
            self._line(at[None], color=CAMERA, mew=0.6, zorder=8, label=self._once("camera"), **style)
            if len(self.birds_eye.cameras) > 1:
                ahead = at + CAMERA_NAME_SHARE * min(x1 - x0, y1 - y0) * view[len(view) // 2]
                self.names.add(camera.name, ahead, np.zeros(2), fontsize=8, color=CAMERA)

    def _rings(self, at: Array, farthest_m: float) -> None:
        """Circles of round radii about the first camera, each with its radius where there is sea for it."""
        step = ring_step(farthest_m / RINGS)
        angles = np.linspace(0, 2 * np.pi, 361)
        x0, x1, y0, y1 = self.birds_eye.extent_m
        middle, room = np.array([x0 + x1, y0 + y1]) / 2, np.array([x1 - x0, y1 - y0]) / 2 - 0.04 * (x1 - x0)
        for radius in np.arange(step, farthest_m, step).tolist():
            circle = at + radius * np.column_stack([np.cos(angles), np.sin(angles)])
            dashes, label = (0, (4, 4)), self._once("range from camera")
            self._line(circle, color=RING, lw=0.5, ls=dashes, zorder=1.5, label=label)
            free = circle[(np.abs(circle - middle) < room).all(axis=1)]
            if len(free):
                x, y = free[np.argmin(free[:, 1])].tolist()
                self.axes.text(x, y, f"{radius:g} m", fontsize=6.5, color=RING, ha="center", va="bottom", zorder=3)

    def _vessels(self) -> None:
        scene, step = self.birds_eye.scene, self.step
        poses, rotations = scene.poses.poses(step, step + 1), scene.motion.at(np.array([step])).world_R_vessel[0]
        colours = [palette.unit_rgb(palette.vessel_colour(index)) for index in range(len(scene.vessels))]
        for circle, colour in zip(self.birds_eye.circles_m, colours, strict=False):
            self._line(circle, color=colour, lw=0.7, ls=":", zorder=3, label=self._once("circle"))
        steps, times = self.birds_eye.track_steps, scene.times_s(0, self.birds_eye.steps)
        recent = (steps <= step) & (times[steps] >= times[step] - TRAIL_S)
        order = sorted(range(len(scene.vessels)), key=lambda i: (i not in scene.own_ships, -scene.vessels[i].length_m))
        for index in order:
            track = self.birds_eye.tracks_m[:, index]
            label = self._once("track in the run")
            self._line(track, color=colours[index], lw=0.8, alpha=0.4, zorder=4, label=label)
            if poses.present[0, index]:
                here = poses.positions_m[0, index, :2]
                trail, label = np.concatenate([track[recent], here[None]]), self._once(f"its last {TRAIL_S:g} s")
                self._line(trail, color=colours[index], lw=2.0, zorder=5, label=label)
                self._vessel(index, here, rotations[index], float(poses.headings_rad[0, index]), colours[index])

    def _vessel(self, index: int, here: Array, rotation: Array, heading_rad: float, colour: Any) -> None:
        scene = self.birds_eye.scene
        vessel, own = scene.vessels[index], index in scene.own_ships
        least_m = MARKER_SHARE * (self.birds_eye.extent_m[1] - self.birds_eye.extent_m[0])
        weight = 2.2 if own else 0.7
        label = self._once("own ship" if own else "vessel, at its size")
        hull = hull_m(vessel, rotation) + here
        if vessel.length_m < least_m:
            hull_half_m = np.full(2, 0.5 * least_m)
            arrow = least_m * _ARROW @ world_R_vehicle(heading_rad)[:2, :2].T + here
            self.names.bodies_m[index] = arrow
            self._area(arrow, facecolor=colour, edgecolor="black", lw=0.7 * weight, zorder=6)
            self._area(hull, facecolor="none", edgecolor="black", lw=0.5, zorder=7)
            self._area(np.full((3, 2), np.nan), facecolor=colour, edgecolor="black", lw=weight, label=label)
        else:
            ahead = np.array([np.cos(heading_rad), np.sin(heading_rad)])
            bow = here + vessel.length_m / 2 * ahead
            self._line(np.array([bow, bow + 0.8 * least_m * ahead]), color="black", lw=max(1.0, 0.6 * weight), zorder=6)
            hull_half_m = np.ptp(hull, axis=0) / 2
            self.names.bodies_m[index] = hull
            self._area(hull, facecolor=colour, edgecolor="black", lw=weight, zorder=7, label=label)
        self.names.add(vessel.name, here, hull_half_m, index, fontsize=7.5, weight="bold" if own else "normal")


_ARROW = np.array([(0.6, 0.0), (-0.4, 0.36), (-0.2, 0.0), (-0.4, -0.36)])
