"""Where a camera is: its mount in the world or on a vessel, and the poses that follow from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from modsim3d.arrays import Array, read_only
from modsim3d.geometry.rotations import camera_R_parent, vehicle_R_nominal, world_R_vehicle


@dataclass(frozen=True)
class Mount:
    """A camera's place in the world (`vessel` None) or in the VCF of a vessel.

    Attributes:
        position_m: Camera centre in that frame.
        roll_rad: Angle about c3.
        pitch_rad: Angle about c1.
        yaw_rad: Angle about c2.
        vessel: ID of the vessel that carries the camera.
    """

    position_m: tuple[float, float, float]
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0
    vessel: str | None = None

    @cached_property
    def camera_R_parent(self) -> Array:
        """Rotation from the world or the VCF of the vessel to CCF, shape (3, 3)."""
        return read_only(camera_R_parent(self.roll_rad, self.pitch_rad, self.yaw_rad))


@dataclass(frozen=True, eq=False)
class CameraPoses:
    """Poses of a camera at S steps.

    Attributes:
        camera_R_world: Rotations WCF to CCF, shape (S, 3, 3).
        positions_m: Camera centres in WCF, shape (S, 3).
    """

    camera_R_world: Array
    positions_m: Array

    def at(self, steps: slice) -> CameraPoses:
        """The poses at some of the steps."""
        return CameraPoses(self.camera_R_world[steps], self.positions_m[steps])

    def to_camera(self, points_world: Array) -> Array:
        """World points in camera coordinates, both in metres and of shape (S, ..., 3): R · (p − s) (eq. 7.16)."""
        steps = len(self.positions_m)
        offsets = points_world.reshape(steps, -1, 3) - self.positions_m[:, None, :]
        return (offsets @ np.swapaxes(self.camera_R_world, 1, 2)).reshape(points_world.shape)


def poses_ashore(mount: Mount, steps: int) -> CameraPoses:
    """The same pose in the world at each of S steps (Jessen & Mohr (2023), eq. 7.15, 7.16)."""
    position = np.array(mount.position_m, dtype=np.float64)
    return CameraPoses(np.broadcast_to(mount.camera_R_parent, (steps, 3, 3)), np.broadcast_to(position, (steps, 3)))


def poses_on_board(
    mount: Mount, positions_m: Array, headings_rad: Array, waves_rad: Array, composition: str = "rigid"
) -> CameraPoses:
    """Poses of a camera on board a vessel in waves, at S steps.

    `rigid`: camera = mount ∘ wave ∘ heading, lever arm included, so that a camera that looks abeam sees its vessel's
    roll as pitch. `additive` is the source's rule (eq. 7.32–7.34): it adds the wave's angles to the camera's own and
    leaves out the lever arm, which is right only for a camera that looks forward.

    Args:
        mount: Place in VCF.
        positions_m: Origins of the vessel in WCF, shape (S, 3).
        headings_rad: Counter-clockwise from w1, shape (S,).
        waves_rad: Roll, pitch and yaw of the vessel in waves, shape (S, 3).
        composition: `rigid` or `additive`.
    """
    place = np.array(mount.position_m, dtype=np.float64)
    nominal = world_R_vehicle(headings_rad)
    if composition == "additive":
        roll, pitch, yaw = waves_rad.T
        turned = camera_R_parent(mount.roll_rad + roll, mount.pitch_rad + pitch, mount.yaw_rad + headings_rad + yaw)
        return CameraPoses(turned, positions_m + nominal @ place)
    vcf_R_world = vehicle_R_nominal(waves_rad) @ np.swapaxes(nominal, -1, -2)
    return CameraPoses(mount.camera_R_parent @ vcf_R_world, positions_m + np.swapaxes(vcf_R_world, -1, -2) @ place)
