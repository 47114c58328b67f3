"""By how much a true box changes with the place, heading and size of its vessel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.geometry.camera import Camera
from modsim3d.geometry.camera_poses import CameraPoses
from modsim3d.geometry.curved_sea import lowered
from modsim3d.geometry.rotations import world_R_vehicle
from modsim3d.motion.vessel_motion import PosesInWaves
from modsim3d.scene.scene import Scene
from modsim3d.voyage.hulls import hull_of, stacked
from modsim3d.voyage.truth_noise.noise import PARAMETERS

_STEPS = (0.5, 0.5, 0.005, 0.1, 0.1, 0.1)
"""By how much places, headings and dimensions are moved to either side."""


@dataclass(frozen=True, eq=False)
class View:
    """What one camera looked at, with a row for each of F frames.

    Attributes:
        camera: The camera, as it was registered.
        poses: Vessels in each frame.
        images: Rows of the labelled set's images, shape (F,).
        first_identity: The identity in these images of the scene's first vessel; `joined` sets count on.
        moved: Which vessels registration has put where their detections are, shape (V,); None for none.
    """

    camera: Camera
    poses: PosesInWaves
    images: Indices
    first_identity: int = 0
    moved: Mask | None = None


def box_jacobians(scene: Scene, view: View, frame: Indices, vessel: Indices) -> Array:
    """Derivatives of boxes by the `PARAMETERS`, shape (n, 4, 8).

    Boxes are whole ones, as if the image had no edge, given as centre x, centre y, width and height in pixels. They are
    NaN for a vessel that is absent or partly behind the camera.

    Args:
        scene: The scene.
        view: Its vessels as a camera saw them.
        frame: Row of the view, shape (n,).
        vessel: Index of the vessel, shape (n,).
    """
    placed = _Placed.of(scene, view, frame, vessel)
    result = np.full((len(frame), 4, len(PARAMETERS)), np.nan)
    for column, step in enumerate(_STEPS):
        move = np.zeros(len(_STEPS))
        move[column] = step
        result[..., column] = (placed.boxes(move) - placed.boxes(-move)) / (2 * step)
    cosine, sine = np.cos(placed.heading_rad)[:, None], np.sin(placed.heading_rad)[:, None]
    east, north = result[..., 0], result[..., 1]
    result[..., 6], result[..., 7] = cosine * east + sine * north, cosine * north - sine * east
    return result


@dataclass(frozen=True, eq=False)
class _Placed:
    """n vessels before a camera: hulls in VCF (n, K, 3), positions (n, 3), headings (n,), and rotations by waves."""

    camera: Camera
    camera_poses: CameraPoses
    unit_hulls: Array
    extents_m: Array
    positions_m: Array
    heading_rad: Array
    nominal_R_vessel: Array
    curved: bool

    @classmethod
    def of(cls, scene: Scene, view: View, frame: Indices, vessel: Indices) -> _Placed:
        """Those in some frames of a view."""
        poses = view.poses
        cameras = scene.camera_poses(view.camera, poses, np.arange(len(view.images)))
        cameras = CameraPoses(cameras.camera_R_world[frame], cameras.positions_m[frame])
        padded = stacked([hull_of(each.solid) for each in scene.vessels])
        heading = poses.poses.headings_rad[frame, vessel]
        positions = np.where(
            poses.poses.present[frame, vessel][:, None], poses.poses.positions_m[frame, vessel], np.nan
        )
        turned = np.swapaxes(world_R_vehicle(heading), -1, -2) @ poses.world_R_vessel[frame, vessel]
        extents = np.array([each.extents_m for each in scene.vessels])[vessel]
        curved = scene.sea == "curved"
        return cls(view.camera, cameras, padded[vessel], extents, positions, heading, turned, curved)

    def boxes(self, move: Array) -> Array:
        """Centre x and y, width and height once the first six parameters have moved, shape (6,) to (n, 4)."""
        positions = self.positions_m + np.array([move[0], move[1], 0.0])
        if self.curved:
            positions = lowered(positions, self.camera_poses.positions_m)
        rotations = world_R_vehicle(self.heading_rad + move[2]) @ self.nominal_R_vessel
        hulls = self.unit_hulls * (self.extents_m + move[3:])[:, None, :]
        world = hulls @ np.swapaxes(rotations, -1, -2) + positions[:, None, :]
        pixels = self.camera.intrinsics.project(self.camera_poses.to_camera(world))
        low, high = pixels.min(axis=1), pixels.max(axis=1)
        boxes: Array = np.concatenate([(low + high) / 2, high - low], axis=1)
        return boxes
