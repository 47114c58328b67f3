"""Where vessels and cameras are at each step, for the view from above on a run's page.

Lengths are whole centimetres, angles 65,536ths of a turn, counter-clockwise from w1. w1 is to the right, w2 upwards.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.geometry.camera import Camera
from modsim3d.scene.scene import Scene
from modsim3d.view.maps.birds_eye import footprint
from modsim3d.view.report.recording.packing import ROW_BEFORE, Coded, Column
from modsim3d.view.report.recording.part_motion import PartMotion

PER_METRE, PER_TURN = 100, 1 << 16


class Places:
    """Places at a run's shown steps, and how far they reach."""

    def __init__(self, scene: Scene) -> None:
        """Begin with the scene's obstacles."""
        self._scene = scene
        self._land = [footprint(obstacle) for obstacle in scene.obstacles]
        self._reach: list[Array] = []
        self._half_m = np.array([vessel.length_m for vessel in scene.vessels])[:, None] / 2

    def columns(self, steps: Indices, motion: PartMotion) -> dict[str, Column | Coded]:
        """The places at ascending steps, shape (S,): a row a step, with a column for each vessel or camera."""
        scene, poses = self._scene, motion.at(steps).poses
        there, place_m = poses.present, poses.positions_m[..., :2]
        cameras = [_camera_places(scene, camera, steps, motion) for camera in scene.cameras]
        camera_m, looks, camera_there = (np.stack(columns, axis=1) for columns in zip(*cameras, strict=True))
        self._reach += [(place_m + side * self._half_m)[there] for side in (-1, 1)]
        self._reach.append(camera_m[camera_there])
        every = np.concatenate(self._reach)
        self._reach = [np.array([every.min(axis=0), every.max(axis=0)])]
        return {
            "placed": there.astype(np.uint8),
            "place": Coded(
                _centimetres(np.where(there[..., None], place_m, 0.0)).reshape(len(steps), -1), by=ROW_BEFORE
            ),
            "heading": Coded(_turns(np.where(there, poses.headings_rad, 0.0)), by=ROW_BEFORE),
            "cameraPlaced": camera_there.astype(np.uint8),
            "cameraPlace": Coded(_centimetres(camera_m).reshape(len(steps), -1), by=ROW_BEFORE),
            "cameraLooks": Coded(_turns(looks).reshape(len(steps), -1), by=ROW_BEFORE),
        }

    def facts(self) -> dict[str, Any]:
        """Dimensions of vessels, outlines of obstacles, least and greatest w1 and w2 of what moves, in metres."""
        return {
            "dimensions": [[round(v.length_m, 2), round(v.beam_m, 2)] for v in self._scene.vessels],
            "obstacles": [_rings(shape) for shape in self._land],
            "extent": np.round(self._reach[0], 2).tolist(),
        }


def _camera_places(scene: Scene, camera: Camera, steps: Indices, motion: PartMotion) -> tuple[Array, Array, Mask]:
    """Where a camera is and looks at ascending steps, shape (S,).

    Returns:
        w1 and w2, shape (S, 2); the directions to the left and the right end of its horizon, shape (S, 2); whether it
        is there, shape (S,): not while the vessel that carries it is absent, which may be so between its frames.
    """
    there = np.ones(len(steps), dtype=bool)
    if camera.mount.vessel is not None:
        there = motion.at(steps).poses.present[:, scene.vessel_names.index(camera.mount.vessel)]
    place_m, looks_rad = np.zeros((2, len(steps), 2))
    if there.any():
        poses = scene.camera_poses(camera, motion.at(steps[there]), steps[there])
        width, height = camera.intrinsics.image_size_px
        row = float(np.clip(camera.intrinsics.principal_point_px[1], 0, height))
        rays = camera.intrinsics.unproject(np.array([[0.0, row], [width, row]]), np.ones(2)) @ poses.camera_R_world
        place_m[there], looks_rad[there] = poses.positions_m[:, :2], np.arctan2(rays[..., 1], rays[..., 0])
    return place_m, looks_rad, there


def _centimetres(metres: Array) -> Column:
    return np.rint(metres * PER_METRE).astype(np.int32)


def _turns(angles_rad: Array) -> Column:
    return np.rint(angles_rad / (2 * np.pi) * PER_TURN).astype(np.int64).astype(np.uint16)


def _rings(shape: Any) -> list[list[list[float]]]:
    """The closed lines of a footprint, outer and inner ones, in metres."""
    rings = [ring for part in shapely.get_parts(shape).tolist() for ring in (part.exterior, *part.interiors)]
    return [np.round(shapely.get_coordinates(ring)[:-1], 2).tolist() for ring in rings]
