"""Marks on a map: obstacles, cameras, vessels, detections and tracks, as artists that are moved step by step."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import shapely

from modsim3d.core.arrays import Array, Indices
from modsim3d.geometry.camera import Camera
from modsim3d.geometry.camera_poses import world_R_vehicle
from modsim3d.geometry.kinematics import union_of
from modsim3d.scene.scene import Scene
from modsim3d.tracks.tracks import TrackEstimates, WorldTracks
from modsim3d.view import palette
from modsim3d.view.map_names import MapNames
from modsim3d.view.palette import Colour
from modsim3d.view.pictures.layers import NO_LAYERS, MapLayers
from modsim3d.view.pictures.plain import Solids
from modsim3d.world.bodies import Obstacle, solid_footprint
from modsim3d.world.poses.base import Poses
from modsim3d.world.poses.circular import CircularMotion
from modsim3d.world.vessels import Vessel

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D
    from matplotlib.patches import Polygon

MAX_TRACK_POINTS = 1500
MARGIN = 0.06  # around everything that is shown, as a share of the map
MIN_ASPECT, MAX_ASPECT = 0.65, 2.4
REACH, REACH_M = 1.5, 2000.0
"""A camera ashore is on the map unless it is farther from the traffic than this many of its extents, and metres."""
NEAR, NEAR_M = 0.06, 50.0  # so far beyond the traffic, in shares of its extent or metres, obstacles are shown
VIEW_POINTS = 33


@dataclass(frozen=True, eq=False)
class BirdsEye:
    """Content of a map of a scene, in metres in the world: tracks over a number of steps, and some of the cameras."""

    scene: Scene
    steps: int
    cameras: tuple[int, ...]
    layers: MapLayers = NO_LAYERS
    world_tracks: WorldTracks | None = None  # of a tracker

    @cached_property
    def estimates(self) -> TrackEstimates | None:
        """The estimates that stand for the tracks in the world at each step."""
        if self.world_tracks is None or not self.layers.tracks:
            return None
        return TrackEstimates.of(self.scene.times_s(0, self.steps), self.world_tracks)

    @cached_property
    def track_steps(self) -> Indices:
        """The steps at which tracks have a point, shape (n,)."""
        return np.unique(np.rint(np.linspace(0, self.steps - 1, min(self.steps, MAX_TRACK_POINTS))).astype(np.int64))

    @cached_property
    def track_times_s(self) -> Array:
        """The times of `track_steps`, shape (n,)."""
        return self.scene.times_s(0, self.steps)[self.track_steps]

    @cached_property
    def tracks_m(self) -> Array:
        """w1 and w2 of each vessel at `track_steps`, NaN where it is absent, shape (n, V, 2)."""
        poses = self.scene.poses.poses(0, self.steps)
        return np.where(poses.present[..., None], poses.positions_m[..., :2], np.nan)[self.track_steps]

    @cached_property
    def circles_m(self) -> tuple[Array, ...]:
        """The whole circle of each vessel in circular motion, even if the run ends earlier, shape (181, 2) each."""
        motion = self.scene.poses
        if not isinstance(motion, CircularMotion):
            return ()
        angles = np.linspace(0, 2 * np.pi, 181)
        unit = np.column_stack([np.cos(angles), np.sin(angles)])
        return tuple(np.array(motion.centre_m) + radius * unit for radius in motion.radii_m)

    @cached_property
    def land(self) -> tuple[Any, ...]:
        """The footprint of each obstacle, as shapely geometry."""
        return tuple(footprint(obstacle) for obstacle in self.scene.obstacles)

    @cached_property
    def ashore_m(self) -> tuple[Array, ...]:
        """w1 and w2 of each camera ashore, shape (2,) each."""
        mounts = [self.scene.cameras[index].mount for index in self.cameras]
        return tuple(np.array(mount.position_m[:2]) for mount in mounts if mount.vessel is None)

    @cached_property
    def extent_m(self) -> tuple[float, float, float, float]:
        """Least and greatest w1, least and greatest w2: all tracks, and the cameras ashore and obstacles near them."""
        self.scene.check_world("a map")
        half = np.array([vessel.length_m for vessel in self.scene.vessels])[:, None] / 2
        points = [(self.tracks_m + half).reshape(-1, 2), (self.tracks_m - half).reshape(-1, 2), *self.circles_m]
        points = points if any(np.isfinite(some).any() for some in points) else [*self.ashore_m, *_corners(self.land)]
        low, high = _bounds(points)
        span = float((high - low).max())
        reach, near = max(REACH * span, REACH_M), max(NEAR * span, NEAR_M)
        cameras = [at for at in self.ashore_m if np.all((low - reach <= at) & (at <= high + reach))]
        shown = shapely.box(*(low - near), *(high + near))
        low, high = _bounds([np.array([low, high]), *cameras, *_corners(shape & shown for shape in self.land)])
        middle, size = (low + high) / 2, (high - low) * (1 + 2 * MARGIN)
        size = np.maximum(size, [size[1] * MIN_ASPECT, size[0] / MAX_ASPECT])
        (x0, y0), (x1, y1) = (middle - size / 2).tolist(), (middle + size / 2).tolist()
        return x0, x1, y0, y1


def _corners(shapes: Iterable[Any]) -> list[Array]:
    """Two corners of the box around each shape that is not empty, shape (2, 2) each."""
    return [np.array(shape.bounds).reshape(2, 2) for shape in shapes if not shape.is_empty]


def _bounds(points: Sequence[Array]) -> tuple[Array, Array]:
    """Least and greatest w1 and w2 of points, shape (..., 2) each, without those that are NaN; shape (2,) each."""
    every = np.concatenate([some.reshape(-1, 2) for some in points])
    every = every[np.isfinite(every).all(axis=1)]
    return every.min(axis=0), every.max(axis=0)


def view_of(scene: Scene, camera: Camera, step: int) -> tuple[Array, Array]:
    """w1 and w2 of a camera in metres, shape (2,), and where its image looks: horizontal unit vectors, shape (n, 2).
    They are of the row of the principal point, about where the horizon is, from left to right; zero straight down."""
    poses = scene.sight(camera, np.array([step])).camera_poses
    width, height = camera.intrinsics.image_size_px
    row = float(np.clip(camera.intrinsics.principal_point_px[1], 0, height))
    pixels = np.column_stack([np.linspace(0, width, VIEW_POINTS), np.full(VIEW_POINTS, row)])
    rays = camera.intrinsics.unproject(pixels, np.ones(VIEW_POINTS)) @ poses.camera_R_world[0]
    flat: Array = rays[:, :2] / np.maximum(np.linalg.norm(rays[:, :2], axis=1, keepdims=True), 1e-12)
    return poses.positions_m[0, :2], flat


def footprint(obstacle: Obstacle) -> Any:
    """The footprint of an obstacle, with what it stands over, as a shapely multipolygon in metres."""
    whole = union_of([solid_footprint(solid, vertices) for solid, vertices in obstacle.solids])
    pieces = [part for part in shapely.get_parts(whole).tolist() if part.geom_type == "Polygon"]
    return shapely.multipolygons(pieces)


def hull_m(vessel: Vessel, world_R_vessel: Array) -> Array:
    """The outline of a vessel from above, in metres about its centre, shape (k, 2)."""
    turned = (vessel.solid.vertices * vessel.extents_m) @ world_R_vessel.T
    ring: Array = shapely.get_coordinates(shapely.convex_hull(shapely.multipoints(turned[:, :2])))
    return ring


def ring_step(about_m: float) -> float:
    """A distance rounded up to 1, 2, 5, 10, ... metres."""
    power = 10.0 ** np.floor(np.log10(about_m))
    return float(min(factor * power for factor in (1, 2, 5, 10) if factor * power >= about_m * (1 - 1e-9)))


NM_M = 1852.0
TRAIL_S = 60.0  # the last part of a track, of this duration, is drawn bold
TRAIL_POINTS = 12  # names keep off a trail through so many of its points
RINGS = 5  # the most range rings from a camera to the farthest corner of the map
RADIUS_PT = 6.5  # size of the radii of range rings
MARKER_SHARE = 0.018  # a hull shorter than this share of the map's width has an arrowhead of that length around it
CAMERA_NAME_SHARE = 0.06  # how far before a camera its name stands, as a share of the map's shorter side
CAMERA, RING = "#c0392b", "#6d7b85"
_ARROW = np.array([(0.6, 0.0), (-0.4, 0.36), (-0.2, 0.0), (-0.4, -0.36)])
_HULL = np.array([(-1, -0.3), (0.6, -0.3), (0.6, 0), (1, 0), (0.6, 0), (0.6, 0.3), (-1, 0.3)])  # with the tick ahead
NOWHERE = np.full((2, 2), np.nan)


@dataclass(eq=False)
class MapSheet:
    """The axes of a map, on which artists are put."""

    axes: Axes  # in metres
    birds_eye: BirdsEye
    names: MapNames
    moving: list[Artist] = field(default_factory=list)  # those that differ from step to step, but for the names
    symbols: dict[Artist, Array | str] = field(default_factory=dict)  # outline in the key, (n, 2), or marker's name
    _explained: set[str] = field(default_factory=set)

    def once(self, text: str) -> str:
        """A label for the legend, for the first of its kind only."""
        repeat = text in self._explained
        self._explained.add(text)
        return "_" if repeat else text

    def line(self, points: Array, *, moves: bool = False, **keys: Any) -> Line2D:
        """A line through points, shape (n, 2)."""
        (line,) = self.axes.plot(*points.T, **keys)
        self.moving += [line] * moves
        return line

    def area(self, ring: Array, *, moves: bool = False, **keys: Any) -> Polygon:
        """An area within corners, shape (n, 2)."""
        from matplotlib.patches import Polygon

        area = Polygon(ring, **keys)
        self.axes.add_patch(area)
        self.moving += [area] * moves
        return area

    def lines(self, label: str, **look: Any) -> LineCollection:
        """Lines of several colours, which `put` moves."""
        from matplotlib.collections import LineCollection

        lines = LineCollection([NOWHERE], label=label, **look)
        self.axes.add_collection(lines, autolim=False)
        self.moving.append(lines)
        return lines


@dataclass(frozen=True, eq=False)
class Bearing:
    """The bearing of a detection, or of a track with a number, from a camera."""

    at_m: Array  # w1 and w2 of the camera, shape (2,)
    direction: Array  # horizontal unit vector, shape (2,)
    colour: Colour
    track: int | None = None

    @classmethod
    def of(cls, solids: Solids, box_px: Array, colour: Colour, track: int | None = None) -> Self:
        """The bearing of the middle of a box's lower edge, shape (4,), in the image of a camera."""
        poses, at_px = solids.sight.camera_poses, np.array([[(box_px[0] + box_px[2]) / 2, box_px[3]]])
        (ray,) = solids.intrinsics.unproject(at_px, np.ones(1)) @ poses.camera_R_world[0]
        return cls(poses.positions_m[0, :2], ray[:2] / max(float(np.hypot(*ray[:2])), 1e-12), colour, track)


@dataclass(frozen=True, eq=False)
class Moment:
    """A step of a run, with the poses and rotations of all vessels then."""

    birds_eye: BirdsEye
    step: int
    bearings: Sequence[Bearing] = ()

    @cached_property
    def poses(self) -> Poses:
        """Poses of the vessels at the one step."""
        return self.birds_eye.scene.poses.poses(self.step, self.step + 1)

    @cached_property
    def rotations(self) -> Array:
        """Rotations VCF to WCF, waves included, shape (V, 3, 3)."""
        rotations: Array = self.birds_eye.scene.motion.at(np.array([self.step])).world_R_vessel[0]
        return rotations

    @cached_property
    def recent(self) -> slice:
        """Points of the tracks that are drawn bold."""
        times = self.birds_eye.track_times_s
        (now,) = self.birds_eye.scene.times_s(self.step, self.step + 1)
        end = int(np.searchsorted(self.birds_eye.track_steps, self.step, side="right"))
        return slice(int(np.searchsorted(times[:end], now - TRAIL_S)), end)


class VesselMark:
    """A vessel with its track and its name."""

    def __init__(self, sheet: MapSheet, index: int) -> None:
        """Draw the whole track, and put the rest where `show` finds it."""
        birds_eye, scene = sheet.birds_eye, sheet.birds_eye.scene
        self._sheet, self._index, self._vessel = sheet, index, scene.vessels[index]
        own, colour = index in scene.own_ships, palette.unit_rgb(palette.vessel_colour(index, scene.own_ships))
        weight = 2.2 if own else 0.7
        self._track = birds_eye.tracks_m[:, index]
        sheet.line(self._track, color=colour, lw=0.8, alpha=0.4, zorder=4, label=sheet.once("track in the run"))
        trail = sheet.once(f"its last {TRAIL_S:g} s")
        self._trail = sheet.line(NOWHERE, moves=True, color=colour, lw=2.0, zorder=5, label=trail)
        self._least_m = MARKER_SHARE * (birds_eye.extent_m[1] - birds_eye.extent_m[0])
        self._arrow: Polygon | None = None
        self._bow: Line2D | None = None
        filled: dict[str, Any] = {"facecolor": colour, "edgecolor": "black"}
        if self._vessel.length_m < self._least_m:
            label = sheet.once("own ship" if own else "small vessel, with its heading")
            self._arrow = sheet.area(NOWHERE, moves=True, **filled, lw=0.7 * weight, zorder=6, label=label)
            self._hull = sheet.area(NOWHERE, moves=True, facecolor="none", edgecolor="black", lw=0.5, zorder=7)
            sheet.symbols[self._arrow] = _ARROW
        else:
            label = sheet.once("own ship, with a tick ahead" if own else "vessel at its size, with a tick ahead")
            self._bow = sheet.line(NOWHERE, moves=True, color="black", lw=max(1.0, 0.6 * weight), zorder=6)
            self._hull = sheet.area(NOWHERE, moves=True, **filled, lw=weight, zorder=7, label=label)
            sheet.symbols[self._hull] = _HULL
        self._name = sheet.names.add(self._vessel.name, index, fontsize=7.5, weight="bold" if own else "normal")

    def show(self, moment: Moment) -> None:
        """Move the vessel to where it is, or hide it while it is absent."""
        present = bool(moment.poses.present[0, self._index])
        for artist in (self._trail, self._hull, self._arrow, self._bow):
            if artist is not None:
                artist.set_visible(present)
        self._name.place_m = None
        if present:
            self._move(moment)

    def _move(self, moment: Moment) -> None:
        here = moment.poses.positions_m[0, self._index, :2]
        heading_rad = float(moment.poses.headings_rad[0, self._index])
        trail = np.concatenate([self._track[moment.recent], here[None]])
        self._trail.set_data(*trail.T)
        body = hull_m(self._vessel, moment.rotations[self._index]) + here
        half_m = np.ptp(body, axis=0) / 2
        self._hull.set_xy(body)
        if self._bow is not None:
            ahead = np.array([np.cos(heading_rad), np.sin(heading_rad)])
            bow = here + self._vessel.length_m / 2 * ahead
            tick = np.array([bow, bow + 0.8 * self._least_m * ahead])
            self._bow.set_data(*tick.T)
            self._sheet.names.ticks_m[self._index] = tick
        elif self._arrow is not None:
            body = self._least_m * _ARROW @ world_R_vehicle(heading_rad)[:2, :2].T + here
            half_m = np.full(2, 0.5 * self._least_m)
            self._arrow.set_xy(body)
        self._sheet.names.bodies_m[self._index] = body
        trail = trail[np.isfinite(trail).all(axis=1)]
        self._sheet.names.trails_m[self._index] = trail[np.linspace(0, len(trail) - 1, TRAIL_POINTS).astype(int)]
        self._name.place_m, self._name.half_m = here, half_m


class CameraMark:
    """A camera with its field of view; the first one has range rings."""

    def __init__(self, sheet: MapSheet, index: int, *, moves: bool) -> None:
        """Put the artists where `show` finds them; those of a map without cameras on board never move again."""
        self._birds_eye, self._camera = sheet.birds_eye, sheet.birds_eye.scene.cameras[index]
        self._sheet, self._index = sheet, index
        first = index == self._birds_eye.cameras[0]
        self._rings = RangeRings(sheet, moves=moves) if first else None
        label = sheet.once("field of view")
        self._seen = sheet.area(NOWHERE, moves=moves, facecolor=CAMERA, alpha=0.09, lw=0, zorder=1, label=label)
        edge = {"color": CAMERA, "lw": 0.7, "alpha": 0.8, "zorder": 4}
        self._edges = [sheet.line(NOWHERE, moves=moves, **edge) for _ in range(2)]
        dot = {"marker": "o", "ls": "", "ms": 5 if self._camera.mount.vessel is None else 3.5, "mec": "white"}
        label = sheet.once("camera")
        self._dot = sheet.line(NOWHERE[:1], moves=moves, color=CAMERA, mew=0.6, zorder=8, label=label, **dot)
        self._name = None
        mount, (x0, x1, y0, y1), beyond_m = self._camera.mount, self._birds_eye.extent_m, 0.0
        if mount.vessel is None:
            beyond_m = float(shapely.distance(shapely.box(x0, y0, x1, y1), shapely.Point(mount.position_m[:2])))
        if beyond_m or len(self._birds_eye.cameras) > 1:
            text = f"{self._camera.name}, {beyond_m:.0f} m away" if beyond_m else self._camera.name
            self._name = sheet.names.add(text, fontsize=8, color=CAMERA)

    def show(self, moment: Moment) -> None:
        """Move the camera to where it is."""
        x0, x1, y0, y1 = self._birds_eye.extent_m
        at, view = view_of(self._birds_eye.scene, self._camera, moment.step)
        corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
        farthest = float(np.linalg.norm(corners - at, axis=1).max())
        if self._rings is not None:
            self._rings.show(at, farthest)
        edge = at + 2 * farthest * view
        self._seen.set_xy(np.concatenate([at[None], edge]))
        for line, end in zip(self._edges, (edge[0], edge[-1]), strict=True):
            line.set_data(*np.array([at, end]).T)
        self._dot.set_data(*at[None].T)
        self._sheet.names.dots_m[self._index] = at
        if self._name is not None:
            edge_m = CAMERA_NAME_SHARE * min(x1 - x0, y1 - y0)
            self._name.end_m = np.clip(at, (x0, y0), (x1, y1))
            before = at + edge_m * view[len(view) // 2]
            self._name.place_m = np.clip(before, (x0 + edge_m, y0 + edge_m), (x1 - edge_m, y1 - edge_m))


class RangeRings:
    """Circles of round radii about the first camera, each with its radius where there is sea for it."""

    def __init__(self, sheet: MapSheet, *, moves: bool) -> None:
        """Put as many rings as there may be where `show` finds them."""
        self._sheet, self._extent_m = sheet, sheet.birds_eye.extent_m
        ring = {"color": RING, "lw": 0.5, "ls": (0, (4, 4)), "zorder": 1.5}
        labels = [sheet.once("range from camera") for _ in range(RINGS)]
        self._rings = [sheet.line(NOWHERE, moves=moves, label=label, **ring) for label in labels]
        self._names = [sheet.names.add("", fontsize=RADIUS_PT, color=RING) for _ in range(RINGS)]

    def show(self, at: Array, farthest_m: float) -> None:
        """Draw the rings about a place, out to a distance, each with its radius at its lowest place."""
        x0, x1, y0, y1 = self._extent_m
        middle, room = np.array([x0 + x1, y0 + y1]) / 2, np.array([x1 - x0, y1 - y0]) / 2 - 0.04 * (x1 - x0)
        layers = self._sheet.birds_eye.layers
        unit, metres = ("nm", NM_M) if layers.nm else ("cables", NM_M / 10) if layers.cables else ("m", 1.0)
        step = ring_step(farthest_m / metres / RINGS)
        radii = np.arange(step, farthest_m / metres, step).tolist()
        angles = np.linspace(0, 2 * np.pi, 361)
        around = np.column_stack([np.cos(angles), np.sin(angles)])
        for i, (line, name) in enumerate(zip(self._rings, self._names, strict=True)):
            circle = at + radii[i] * metres * around if i < len(radii) else NOWHERE
            line.set_data(*circle.T)
            free = circle[(np.abs(circle - middle) < room).all(axis=1)]
            name.place_m = None
            if len(free):
                name.show(f"{radii[i]:g} {unit}", free[np.argmin(free[:, 1])])


def moving_marks(sheet: MapSheet) -> Iterator[VesselMark | CameraMark]:
    """The vessels, over their circles: own ships first, then the longest, so that no other hides a short one; then the
    cameras, which move where one of them is on board."""
    birds_eye, scene = sheet.birds_eye, sheet.birds_eye.scene
    for index, circle in enumerate(birds_eye.circles_m):
        colour = palette.unit_rgb(palette.vessel_colour(index))
        sheet.line(circle, color=colour, lw=0.7, ls=":", zorder=3, label=sheet.once("circle"))
    order = sorted(range(len(scene.vessels)), key=lambda i: (i not in scene.own_ships, -scene.vessels[i].length_m))
    yield from (VesselMark(sheet, index) for index in order)
    on_board = any(scene.cameras[index].mount.vessel is not None for index in birds_eye.cameras)
    yield from (CameraMark(sheet, index, moves=on_board) for index in birds_eye.cameras)


def draw_obstacles(sheet: MapSheet) -> None:
    """Draw the footprint and the name of each obstacle, which stay."""
    for obstacle, shape in zip(sheet.birds_eye.scene.obstacles, sheet.birds_eye.land, strict=True):
        colours = palette.obstacle_colours(obstacle.name)
        shore, _, soil, pale = map(palette.css, colours)
        for part in shapely.get_parts(shape).tolist():
            label = sheet.once("land" if colours is palette.LAND else "obstacle")
            ring = shapely.get_coordinates(part.exterior)
            sheet.area(ring, facecolor=pale, edgecolor=shore, lw=0.6, zorder=2, label=label)
        shown = shape & shapely.box(*np.array(sheet.birds_eye.extent_m)[[0, 2, 1, 3]])
        if shown.is_empty:
            continue
        middle, (x0, y0, x1, y1) = shown.representative_point(), shown.bounds
        name = sheet.names.add(obstacle.name, fontsize=7, color=soil)
        name.place_m, name.half_m = np.array([middle.x, middle.y]), np.array([x1 - x0, y1 - y0]) / 2
