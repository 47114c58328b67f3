"""Place of a camera: its mount in the world or on a vessel, and the poses that follow from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from modsim3d.core.arrays import Array, read_only

# ---- Rotations and rigid transforms between the world ----

BASE_R_WORLD: Array = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Camera base pose: c3 along w1, c1 = −w2, c2 = −w3 (Jessen & Mohr (2023), eq. 7.14)."""
BASE_R_WORLD.setflags(write=False)


def rotation(axis: int, angle_rad: ArrayLike) -> Array:
    """Right-handed rotation about coordinate axis 0, 1 or 2, shape (...) to (..., 3, 3) (eq. 7.9, 7.11, 7.13)."""
    angle = np.asarray(angle_rad, dtype=np.float64)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.zeros((*angle.shape, 3, 3))
    matrix[..., axis, axis] = 1.0
    matrix[..., i, i] = matrix[..., j, j] = np.cos(angle)
    matrix[..., j, i] = np.sin(angle)
    matrix[..., i, j] = -matrix[..., j, i]
    return matrix


def attitude(roll_rad: ArrayLike, pitch_rad: ArrayLike, yaw_rad: ArrayLike) -> Array:
    """Rotation in camera-base axes, Rz(roll) · Rx(pitch) · Ry(yaw), shape (...) to (..., 3, 3) (eq. 7.15, 7.25). Roll
    is about c3, pitch about c1, yaw about c2. Passive: it maps coordinates before the rotation to coordinates in the
    rotated frame. Positive yaw turns to port, positive pitch bow down, positive roll port side down."""
    return rotation(2, roll_rad) @ rotation(0, pitch_rad) @ rotation(1, yaw_rad)


def camera_R_parent(roll_rad: ArrayLike, pitch_rad: ArrayLike, yaw_rad: ArrayLike) -> Array:
    """Rotation from the frame that carries a camera, WCF or VCF, to CCF, shape (...) to (..., 3, 3) (eq. 7.15)."""
    return attitude(roll_rad, pitch_rad, yaw_rad) @ BASE_R_WORLD


def world_R_vehicle(heading_rad: ArrayLike) -> Array:
    """Rotation from the nominal vehicle frame to the world, shape (...) to (..., 3, 3) (eq. 7.2)."""
    return rotation(2, heading_rad)


def vehicle_R_nominal(angles_rad: ArrayLike) -> Array:
    """Rotation from the nominal vehicle frame to the one that waves have turned, shape (..., 3) to (..., 3, 3). It is
    eq. 7.25 in vehicle axes. The angles are roll, pitch and yaw of a camera that looks forward: positive roll lowers
    the port side, positive pitch the bow, positive yaw turns to port."""
    angles = np.asarray(angles_rad, dtype=np.float64)
    return BASE_R_WORLD.T @ attitude(angles[..., 0], angles[..., 1], angles[..., 2]) @ BASE_R_WORLD


def rotation_vector(matrix: ArrayLike) -> Array:
    """Axis times angle, in [0, π], of rotations (..., 3, 3), shape (..., 3): the inverse of the exponential map."""
    turn = np.asarray(matrix, dtype=np.float64)
    odd = turn - np.swapaxes(turn, -1, -2)
    sine_axis = np.stack([odd[..., 2, 1], odd[..., 0, 2], odd[..., 1, 0]], axis=-1) / 2
    sine, cosine = np.linalg.norm(sine_axis, axis=-1), (np.trace(turn, axis1=-2, axis2=-1) - 1) / 2
    angle = np.arctan2(sine, cosine)
    by_sine = sine_axis * np.where(sine < 1e-12, 1.0, angle / np.where(sine < 1e-12, 1.0, sine))[..., None]
    # Near half a turn the sine is too small; the even part, (1 − cos) n nᵀ + cos I, still gives the axis.
    even = (turn + np.swapaxes(turn, -1, -2)) / 2 - cosine[..., None, None] * np.eye(3)
    longest = np.argmax(np.diagonal(even, axis1=-2, axis2=-1), axis=-1)
    column = np.take_along_axis(even, longest[..., None, None], axis=-1)[..., 0]
    side = np.where((column * sine_axis).sum(axis=-1) < 0, -1.0, 1.0)
    length = np.linalg.norm(column, axis=-1)
    by_even = column * (side * angle / np.where(length == 0, 1.0, length))[..., None]
    return np.where((cosine < -0.9)[..., None], by_even, by_sine)


def heading_of(direction: ArrayLike) -> Array:
    """Headings in (−π, π] of world vectors, shape (..., 2) or (..., 3) to (...). By atan2, because the arccos of
    eq. 7.3 loses the sign."""
    vector = np.asarray(direction, dtype=np.float64)
    return np.arctan2(vector[..., 1], vector[..., 0])


@dataclass(frozen=True)
class Mount:
    """A camera's place in the world (`vessel` None) or in the VCF of a vessel, by its ID."""

    position_m: tuple[float, float, float]  # camera centre in that frame
    roll_rad: float = 0.0  # about c3
    pitch_rad: float = 0.0  # about c1
    yaw_rad: float = 0.0  # about c2
    vessel: str | None = None

    @cached_property
    def camera_R_parent(self) -> Array:
        """Rotation from the world or the VCF of the vessel to CCF, shape (3, 3)."""
        return read_only(camera_R_parent(self.roll_rad, self.pitch_rad, self.yaw_rad))


@dataclass(frozen=True, eq=False)
class CameraPoses:
    """Poses of a camera at S steps."""

    camera_R_world: Array  # rotations WCF to CCF, shape (S, 3, 3)
    positions_m: Array  # camera centres in WCF, shape (S, 3)

    def at(self, steps: slice) -> CameraPoses:
        """The poses at some of the steps."""
        return CameraPoses(self.camera_R_world[steps], self.positions_m[steps])

    def to_camera(self, points_world: Array) -> Array:
        """World points in camera coordinates, both in metres and of shape (S, ..., 3): R · (p − s) (eq. 7.16)."""
        steps = len(self.positions_m)
        offsets = points_world.reshape(steps, -1, 3) - self.positions_m[:, None, :]
        return (offsets @ np.swapaxes(self.camera_R_world, 1, 2)).reshape(points_world.shape)


def poses_ashore(mount: Mount, steps: int) -> CameraPoses:
    """Poses of a camera ashore, equal at each of S steps (Jessen & Mohr (2023), eq. 7.15, 7.16)."""
    position = np.array(mount.position_m, dtype=np.float64)
    return CameraPoses(np.broadcast_to(mount.camera_R_parent, (steps, 3, 3)), np.broadcast_to(position, (steps, 3)))


def poses_on_board(
    mount: Mount, positions_m: Array, headings_rad: Array, waves_rad: Array, composition: str = "rigid"
) -> CameraPoses:
    """Poses of a camera with a place in VCF on board a vessel in waves, at S steps. The vessel has its origin in WCF
    (S, 3), a heading counter-clockwise from w1 (S,), and roll, pitch and yaw (S, 3). `rigid`: camera = mount ∘ wave ∘
    heading, lever arm included, so that a camera that looks abeam sees its vessel's roll as pitch. `additive` is the
    source's rule (eq. 7.32–7.34): it adds the wave's angles to the camera's own and leaves out the lever arm, which is
    right only for a camera that looks forward."""
    place = np.array(mount.position_m, dtype=np.float64)
    nominal = world_R_vehicle(headings_rad)
    if composition == "additive":
        roll, pitch, yaw = waves_rad.T
        turned = camera_R_parent(mount.roll_rad + roll, mount.pitch_rad + pitch, mount.yaw_rad + headings_rad + yaw)
        return CameraPoses(turned, positions_m + nominal @ place)
    vcf_R_world = vehicle_R_nominal(waves_rad) @ np.swapaxes(nominal, -1, -2)
    return CameraPoses(mount.camera_R_parent @ vcf_R_world, positions_m + np.swapaxes(vcf_R_world, -1, -2) @ place)
