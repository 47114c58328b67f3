"""Summary of a scene before it runs: its cameras, its kinds of vessels, and doubts about what is probably not meant."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import shapely

from modsim3d.detector.file.unread_keys import dead_lines
from modsim3d.geometry.camera import Camera, Intrinsics
from modsim3d.geometry.camera_poses import poses_ashore
from modsim3d.geometry.kinematics import HullTracks
from modsim3d.scene.lens import point_problem
from modsim3d.scene.scene import Scene
from modsim3d.world.bodies import Obstacle, misfits
from modsim3d.world.encounters import speeds_m_s
from modsim3d.world.floating_vessels import GRAVITY_M_S2
from modsim3d.world.traffic.clearance import Land
from modsim3d.world.traffic.generate import DrawnTraffic


@dataclass(frozen=True)
class CameraSummary:
    """A camera at the first step; of a live scene as if its vessel lay at the origin, heading along w1."""

    name: str
    image_size_px: tuple[int, int]
    field_of_view_deg: tuple[float, float]  # across and down the image, through the principal point
    vessel: str | None  # that carries it
    height_m: float
    bearing_deg: float  # on board to starboard of the bow; ashore its heading, counter-clockwise from w1
    down_deg: float
    horizon_row: float | None  # in the middle column, also outside the image; None if there is none

    def __str__(self) -> str:
        """The facts on a line."""
        (width, height), (across, down), row = self.image_size_px, self.field_of_view_deg, self.horizon_row
        turn, tilt = _rounded(abs(self.bearing_deg), 1), _rounded(abs(self.down_deg), 1)
        side = f"{turn}° to {'starboard' if self.bearing_deg > 0 else 'port'}"
        looks = {"0": "ahead", "180": "astern"}.get(turn, side)
        looks = looks if self.vessel else f"towards heading {_rounded(self.bearing_deg, 1)}°"
        horizon = "no horizon" if row is None else f"horizon {'above' if row < 0 else 'below'} the image"
        horizon = f"horizon at row {row:.0f}" if row is not None and 0 <= row <= height else horizon
        size = f"{width} × {height}, {across:.1f}° × {down:.1f}°, {_rounded(self.height_m, 1)} m up"
        return f"{self.name}: {size}, looks {looks} and {tilt}° {'up' if self.down_deg < 0 else 'down'}, {horizon}"


def camera_summaries(scene: Scene) -> list[CameraSummary]:
    """Facts about the cameras of a scene, in its order; none of a scene of labels, whose cameras are not known."""
    return [] if scene.labels is not None else [_summary_of(scene, camera) for camera in scene.cameras]


def _summary_of(scene: Scene, camera: Camera) -> CameraSummary:
    vessel, lens, heading_rad = camera.mount.vessel, camera.intrinsics, 0.0
    poses = poses_ashore(camera.mount, 1)
    if vessel is not None and not scene.live:
        first = np.array([0])
        motion = scene.own_motion.at(first)
        poses = scene.camera_poses(camera, motion, first)
        heading_rad = float(motion.poses.headings_rad[0, scene.vessel_names.index(vessel)])
    ahead = poses.camera_R_world[0, 2]
    bearing = math.degrees(math.atan2(ahead[1], ahead[0]) - heading_rad) * (1 if vessel is None else -1)
    down = -math.degrees(math.asin(np.clip(ahead[2], -1, 1)))
    a, b, c = lens.sea_half_plane(poses.camera_R_world)[0].tolist()
    row = -(a * lens.image_size_px[0] / 2 + c) / b if abs(b) > 1e-6 else None
    size, height_m, bearing = lens.image_size_px, float(poses.positions_m[0, 2]), 180 - (180 - bearing) % 360
    return CameraSummary(camera.name, size, _field_of_view_deg(lens), vessel, height_m, bearing, down, row)


def _rounded(value: float, digits: int) -> str:
    return f"{round(value, digits) + 0.0:.7g}"


def _field_of_view_deg(lens: Intrinsics) -> tuple[float, float]:
    (width, height), (x, y) = lens.image_size_px, np.clip(lens.principal_point_px, 0, lens.image_size_px).tolist()
    rays = lens.unproject([[(0, y), (width, y)], [(x, 0), (x, height)]], np.ones((2, 2)))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    across, down = np.degrees(np.arccos((rays[:, 0] * rays[:, 1]).sum(axis=-1).clip(-1, 1))).tolist()
    return across, down


MAX_STEPS = 2000  # steps at which vessels are looked at; of a longer scene so many, evenly over it


def sampled_tracks(scene: Scene) -> HullTracks | None:
    """The tracks of a scene's vessels at some of its steps; None where nobody knows them before it runs."""
    if scene.live or scene.labels is not None:
        return None
    steps = np.unique(np.linspace(0, scene.steps - 1, min(scene.steps, MAX_STEPS)).astype(np.int64))
    samples = [scene.poses.poses(step, step + 1) for step in steps.tolist()]
    present = np.concatenate([sample.present for sample in samples])
    places = np.concatenate([sample.positions_m[..., :2] for sample in samples])
    headings = np.concatenate([sample.headings_rad for sample in samples])
    return HullTracks(
        times_s=scene.times_s(0, scene.steps)[steps],
        centres_m=np.where(present[..., None], places, np.nan),
        headings_rad=np.where(present, headings, np.nan),
        half_sizes_m=np.array([vessel.extents_m[:2] / 2 for vessel in scene.vessels]).reshape(-1, 2),
    )


@dataclass(frozen=True)
class VesselType:
    """The vessels of one label, with the least and the greatest of each number; None if it is not known."""

    label: str
    count: int
    length_m: tuple[float, float] | None
    beam_m: tuple[float, float] | None
    air_draft_m: tuple[float, float] | None
    speed_m_s: tuple[float, float] | None

    def __str__(self) -> str:
        """The facts on a line."""
        sides = [_span(side, 2) for side in (self.length_m, self.beam_m, self.air_draft_m) if side]
        speed = [f"{_span(self.speed_m_s, 1)} m/s"] if self.speed_m_s else []
        return f"{self.label}: {', '.join([str(self.count), *([' × '.join(sides) + ' m'] if sides else []), *speed])}"


def _span(span: tuple[float, float], digits: int) -> str:
    return " to ".join(dict.fromkeys(_rounded(value, digits) for value in span))


def vessel_types(scene: Scene, tracks: HullTracks | None) -> list[VesselType]:
    """The vessels of a scene by their labels, in the order of the first of each."""
    labels = np.array([vessel.label for vessel in scene.vessels])
    speeds = np.full((1, len(labels)), np.nan) if tracks is None else speeds_m_s(tracks)
    types = []
    for label in dict.fromkeys(labels.tolist()):
        members = np.flatnonzero(labels == label)
        sides = np.array([scene.vessels[index].extents_m for index in members.tolist()]).T
        numbers = (values[np.isfinite(values)].tolist() for values in (*sides, speeds[:, members]))
        spans = ((min(values), max(values)) if values else None for values in numbers)
        types.append(VesselType(label, len(members), *spans))
    return types


USUAL_M = {"length_m": ("long", 1, 500), "beam_m": ("wide", 0.3, 130), "air_draft_m": ("high", 0.1, 200)}
"""Sizes of vessels; the longest ever was 458 m (Seawise Giant), the widest is 124 m (Pioneering Spirit)."""
MAX_FROUDE, MAX_SPEED_M_S, LARGE_M15_S = 6.0, 36.0, 350.0
"""Greatest speed over √(g length), of jet skis; greatest speed of any vessel, 70 knots; and speed times √length of
large ones: the ferry Francisco did 29.8 m/s with 99 m in 2013, the liner United States 19.7 m/s with 302 m in 1952."""
ASHORE_M = 0.5  # a path that reaches so far into an obstacle leads through it; at a quay it may touch
MAX_COMPARED = 10_000_000  # pairs of vessels at a step that are compared; with more, fewer steps are looked at


def scene_warnings(scene: Scene) -> list[str]:
    """Vessels that found no room, meshes that do not fit, and lines of the detector file that change nothing."""
    left_out = scene.poses.left_out if isinstance(scene.poses, DrawnTraffic) else {}
    others = [*misfits(scene.vessels, scene.obstacles), *dead_lines(scene.detector)]
    if not left_out:
        return others
    missing = ", ".join(f"{count} of {section}" for section, count in left_out.items())
    total = sum(left_out.values())
    return [f"poses.traffic: {total} of the vessels that were drawn found no room and are left out: {missing}", *others]


def doubts(scene: Scene, tracks: HullTracks | None) -> list[str]:
    """Sentences on cameras, sizes, speeds, paths through obstacles, and vessels in one place, the first of each kind.
    The tracks are those of the scene."""
    lenses = ((f"cameras.{camera.name}: ", camera.intrinsics) for camera in scene.cameras)
    points = ((name, point_problem(lens.principal_point_px, lens.image_size_px)) for name, lens in lenses)
    kinds: list[Iterable[str]] = [[name + problem] for name, problem in points if problem]
    kinds += [_narrow(scene), *(_sizes(scene, key) for key in USUAL_M)]
    if tracks is not None:
        through = (_through(scene, tracks, obstacle) for obstacle in scene.obstacles)
        kinds += [_fast(scene, tracks), *through, _in_one_place(scene, tracks)]
    firsts = [(first, len(more)) for first, *more in filter(None, map(list, kinds))]
    return [first + (f" (and {more} more like it)" if more else "") for first, more in firsts]


def _narrow(scene: Scene) -> Iterator[str]:
    for camera in scene.cameras:
        angle = max(_field_of_view_deg(camera.intrinsics))
        if 0.2 < angle < math.pi:
            turned = f"{angle:.3g} radians are {math.degrees(angle):.0f}°"
            yield f"camera '{camera.name}' sees {angle:.3g}° only, and {turned}: hfov_deg and vfov_deg are in degrees"


def _sizes(scene: Scene, key: str) -> Iterator[str]:
    word, low, high = USUAL_M[key]
    for vessel in scene.vessels:
        if (value := getattr(vessel, key)) < low or value > high:
            usual = f"vessels are {low} to {high} m {word}"
            yield f"vessel '{vessel.name}' is {value:g} m {word}, and {usual}: {key} is in metres"
        elif key == "length_m" and value < vessel.beam_m:
            size = f"is {value:g} m long and {vessel.beam_m:g} m wide"
            yield f"vessel '{vessel.name}' {size}: are length_m and beam_m swapped?"


def _fast(scene: Scene, tracks: HullTracks) -> Iterator[str]:
    speeds = np.nan_to_num(speeds_m_s(tracks)).max(axis=0, initial=0.0)
    length = 2 * tracks.half_sizes_m[:, 0]
    large = np.minimum(LARGE_M15_S / np.sqrt(length), MAX_SPEED_M_S)
    most = np.minimum(MAX_FROUDE * np.sqrt(GRAVITY_M_S2 * length), large)
    for index in np.flatnonzero(speeds > most).tolist():
        speed = f"{speeds[index]:.3g} m/s, and {length[index]:g} m long it can hardly do more than {most[index]:.2g}"
        yield f"vessel '{scene.vessel_names[index]}' does {speed}: look at its path, its times and their units"


def _through(scene: Scene, tracks: HullTracks, obstacle: Obstacle) -> Iterator[str]:
    inner = [(base, shapely.buffer(area, -ASHORE_M)) for base, area in Land.of([obstacle]).levels]
    low, high = np.fmin.reduce(tracks.centres_m) - 1, np.fmax.reduce(tracks.centres_m) + 1
    around = shapely.box(*low.T, *high.T)
    for index, vessel in enumerate(scene.vessels):
        area = next((area for base, area in reversed(inner) if base < vessel.air_draft_m), shapely.Polygon())
        if not shapely.intersects(area, around[index]):  # false for one that is never there
            continue
        path = tracks.centres_m[:, index]
        steps = np.flatnonzero(np.isfinite(path[:, 0]))
        legs = steps[:-1][np.diff(steps) == 1]
        crossed = shapely.intersects(area, shapely.linestrings(np.stack([path[legs], path[legs + 1]], axis=1)))
        rows = np.concatenate([steps[shapely.contains_xy(area, *path[steps].T)], legs[crossed]])
        if len(rows):
            place = f"obstacle '{obstacle.name}' {tracks.times_s[rows.min()]:g} s after the first step"
            bridge = f"move one of them; under a bridge that has a base_m above {vessel.air_draft_m:g} it can pass"
            yield f"the path of vessel '{vessel.name}' leads through {place}: {bridge}"


def _in_one_place(scene: Scene, tracks: HullTracks) -> Iterator[str]:
    pairs, names = set(), scene.vessel_names
    for row in range(0, len(tracks.times_s), 1 + tracks.headings_rad.size * len(names) // MAX_COMPARED):
        centres, headings = tracks.centres_m[row], tracks.headings_rad[row][:, None]
        x, y = np.moveaxis(centres - centres[:, None], -1, 0)
        along, across = (x * np.cos(headings) + y * np.sin(headings)), (y * np.cos(headings) - x * np.sin(headings))
        inside = (np.abs(along) < tracks.half_sizes_m[:, :1]) & (np.abs(across) < tracks.half_sizes_m[:, 1:])
        for pair in np.argwhere(np.triu(inside | inside.T, 1)).tolist():
            if tuple(pair) not in pairs:
                pairs.add(tuple(pair))
                one, other = (names[index] for index in pair)
                when = f"{tracks.times_s[row]:g} s after the first step"
                yield f"vessels '{one}' and '{other}' are in one place {when}: move one of them"
