"""Where the vessels and the camera of a scene are at any time, between its steps too."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.geometry.camera import Camera
from modsim3d.geometry.camera_poses import CameraPoses, poses_ashore, poses_on_board
from modsim3d.geometry.rotations import vehicle_R_nominal, world_R_vehicle
from modsim3d.scene.scene import Scene
from modsim3d.voyage.attitude import Attitude
from modsim3d.voyage.sampling import Sampler

BEYOND_S = 60.0
"""How long before the first step and after the last one vessels go on."""

MEAN_S = 30.0


@dataclass(frozen=True, eq=False)
class Traffic:
    """The poses of V vessels at S ascending times, to interpolate between.

    Vessels go on at their speed where they are absent, and before the first step and after the last one. A fit of the
    clock moves the times of its matches: a match near the end of a track must not tear away when that is passed.

    Attributes:
        camera: The camera that looks at them.
        times_s: Times of the steps since the scene's first, with one `BEYOND_S` before and one after them, shape (S,).
        present: Whether each vessel is there, shape (S, V); nowhere at the first and the last of these times.
        places_m: Positions and then unwrapped heading, roll, pitch and yaw in waves, in metres and radians, shape
            (S, V, 7).
        carrier: Index of the vessel that carries the camera; None ashore.
        composition: How its angles and the camera's combine; see `poses_on_board`.
        curved: Whether the sea is curved.
    """

    camera: Camera
    times_s: Array
    present: Mask
    places_m: Array
    carrier: int | None
    composition: str
    curved: bool

    @classmethod
    def of(cls, scene: Scene, camera: Camera, attitude: Attitude | None = None) -> Traffic:
        """That of a scene, all its steps, before one of its cameras; an attitude as it was measured replaces waves."""
        motion = Sampler(scene, attitude).at(scene.times_s(0, scene.steps))
        headings = motion.poses.headings_rad[..., None]
        places = np.concatenate([motion.poses.positions_m, headings, motion.angles_rad], axis=-1)
        name = camera.mount.vessel
        steps_s = scene.times_s(0, scene.steps)
        times_s = np.concatenate([[steps_s[0] - BEYOND_S], steps_s, [steps_s[-1] + BEYOND_S]])
        present = np.pad(motion.poses.present, ((1, 1), (0, 0)))
        return cls(
            camera,
            times_s,
            present,
            _continued(times_s, present, np.pad(places, ((1, 1), (0, 0), (0, 0)))),
            None if name is None else scene.vessel_names.index(name),
            scene.waves.composition if scene.waves else "rigid",
            scene.sea == "curved",
        )

    @property
    def span_s(self) -> tuple[float, float]:
        """Times of the scene's first and last step."""
        return float(self.times_s[1]), float(self.times_s[-2])

    def there(self, times_s: Array, vessel: Indices) -> Mask:
        """Whether vessels are there at times: at the steps before and after, shape (n,)."""
        before, share = self._between(times_s)
        after = np.where(share > 0, before + 1, before)
        found: Mask = self.present[before, vessel] & self.present[after, vessel]
        return found

    def at(self, times_s: Array, vessel: Indices) -> tuple[Array, Array]:
        """Positions in WCF, shape (n, 3), and rotations VCF to WCF, (n, 3, 3), of vessels at times, both (n,)."""
        places = self._placed(times_s, vessel)
        nominal = world_R_vehicle(places[:, 3])
        if not self.places_m[..., 4:].any():
            return places[:, :3], nominal
        return places[:, :3], nominal @ np.swapaxes(vehicle_R_nominal(places[:, 4:]), -1, -2)

    def velocities(self, times_s: Array, vessel: Indices) -> Array:
        """Mean velocities along and across from `MEAN_S` before to `MEAN_S` after n times, in m/s, shape (n, 2).

        They turn with the vessel: one that goes round in a circle keeps its speed ahead.
        """
        known = [np.flatnonzero(column) for column in self.present.T]
        first, last = (np.array([self.times_s[rows[end]] if len(rows) else 0.0 for rows in known]) for end in (0, -1))
        start, stop = (
            np.clip(times_s + side, first[vessel], np.maximum(last[vessel], first[vessel] + 1e-3))
            for side in (-MEAN_S, MEAN_S)
        )
        moved = self._interpolated(self._travelled_m, stop, vessel) - self._interpolated(
            self._travelled_m, start, vessel
        )
        found: Array = moved / np.maximum(stop - start, 1e-3)[:, None]
        return found

    def camera_at(self, times_s: Array, turn_rad: Array, raised_m: float) -> CameraPoses:
        """Poses of the camera at n times, with roll, pitch and yaw (3,) added to its mount's, and so much higher."""
        mount = self.camera.mount
        roll, pitch, yaw = (np.array([mount.roll_rad, mount.pitch_rad, mount.yaw_rad]) + turn_rad).tolist()
        along, port, up = mount.position_m
        mount = replace(mount, position_m=(along, port, up + raised_m), roll_rad=roll, pitch_rad=pitch, yaw_rad=yaw)
        if self.carrier is None:
            return poses_ashore(mount, len(times_s))
        places = self._placed(times_s, np.full(len(times_s), self.carrier))
        return poses_on_board(mount, places[:, :3], places[:, 3], places[:, 4:], self.composition)

    def _between(self, times_s: Array) -> tuple[Indices, Array]:
        """The step before each time, and the share of the way to the next."""
        before = np.clip(np.searchsorted(self.times_s, times_s, side="right") - 1, 0, len(self.times_s) - 2)
        share = (times_s - self.times_s[before]) / (self.times_s[before + 1] - self.times_s[before])
        return before, np.clip(share, 0.0, 1.0)

    @cached_property
    def _travelled_m(self) -> Array:
        """How far vessels have come since the first of the times, along and across their headings, shape (S, V, 2)."""
        moved, heading = np.diff(self.places_m[..., :2], axis=0), self.places_m[..., 3]
        midway = (heading[1:] + heading[:-1]) / 2
        cosine, sine = np.cos(midway), np.sin(midway)
        along, across = moved[..., 0] * cosine + moved[..., 1] * sine, moved[..., 1] * cosine - moved[..., 0] * sine
        return np.pad(np.cumsum(np.stack([along, across], axis=-1), axis=0), ((1, 0), (0, 0), (0, 0)))

    def _placed(self, times_s: Array, vessel: Indices) -> Array:
        return self._interpolated(self.places_m, times_s, vessel)

    def _interpolated(self, of_steps: Array, times_s: Array, vessel: Indices) -> Array:
        """Values of vessels at the steps, shape (S, V, k), at times (n,), shape (n, k)."""
        before, share = self._between(times_s)
        start, end = of_steps[before, vessel], of_steps[before + 1, vessel]
        found: Array = start + share[:, None] * (end - start)
        return found


def _continued(times_s: Array, present: Mask, places_m: Array) -> Array:
    """Places with those of absent vessels filled in and headings that go on beyond a full turn, shape (S, V, 7).

    Between two stretches they are linear. Before the first one and after the last one the position goes on at its
    speed, and the angles stay.
    """
    filled = places_m.copy()
    for vessel in np.flatnonzero(present.any(axis=0)).tolist():
        steps = np.flatnonzero(present[:, vessel])
        known_s, known = times_s[steps], places_m[steps, vessel]
        known[:, 3] = filled[steps, vessel, 3] = np.unwrap(known[:, 3])
        columns = [np.interp(times_s, known_s, column) for column in known.T]
        absent = np.flatnonzero(~present[:, vessel])
        filled[absent, vessel] = np.stack(columns, axis=-1)[absent]
        if len(steps) > 1:
            for edge, inner, beyond in ((0, 1, absent < steps[0]), (-1, -2, absent > steps[-1])):
                speed = (known[edge, :2] - known[inner, :2]) / (known_s[edge] - known_s[inner])
                rows = absent[beyond]
                filled[rows, vessel, :2] += (times_s[rows] - known_s[edge])[:, None] * speed
    return filled
