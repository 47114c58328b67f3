"""What a camera has in front of it, and from where it looks: bodies for the truth and for pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.geometry.camera import Camera
from modsim3d.geometry.camera_poses import CameraPoses
from modsim3d.geometry.curved_sea import lowered
from modsim3d.motion.poses import Poses
from modsim3d.motion.vessel_motion import PosesInWaves
from modsim3d.truth.camera_inside import first_body_around
from modsim3d.truth.crosscheck.drawing import Drawing
from modsim3d.truth.crosscheck.world_triangles import WorldTriangles, obstacle_triangles, vessel_triangles
from modsim3d.truth.outlines import Outlines, outline
from modsim3d.vessels.bodies import Bodies, vessel_bodies
from modsim3d.vessels.obstacles import Obstacle, obstacle_bodies
from modsim3d.vessels.vessel import Vessel


@dataclass(frozen=True, eq=False)
class Sight:
    """What a camera has in front of it at S steps, and from where it looks.

    It makes `Bodies` of the vessels' and obstacles' solids, and of these the `Outlines` that the camera sees.

    Attributes:
        steps: The steps, shape (S,).
        vessels: All V vessels of the scene.
        poses: Poses of all vessels as the camera sees them: on a curved sea, the other vessels lie lower.
        world_R_vessel: Rotations VCF to WCF, waves included, shape (S, V, 3, 3).
        others: Vessels that are present and do not carry the camera, shape (S, V).
        carriers: The vessel that carries the camera, shape (S, V).
        obstacles: All obstacles of the scene.
        curved: Whether the sea is curved.
    """

    camera: Camera
    steps: Indices
    vessels: tuple[Vessel, ...]
    poses: Poses
    world_R_vessel: Array
    others: Mask
    carriers: Mask
    camera_poses: CameraPoses
    obstacles: tuple[Obstacle, ...] = ()
    curved: bool = False

    def outlines(self, *, as_shoeboxes: bool = False, measured: bool = True) -> Outlines:
        """Outlines of the other vessels, the obstacles, and the hull that carries the camera if that has a mesh.

        With `as_shoeboxes`, shoeboxes replace meshes, and the hull that carries the camera is left out. For `measured`
        see `outline`.
        """
        bodies = self._bodies(self.others, as_shoeboxes=as_shoeboxes)
        if not as_shoeboxes:
            bodies += self._own_hull()
        bodies += self._obstacle_bodies()
        return outline(self.camera.intrinsics, self.camera_poses, bodies, measured=measured)

    def drawing(self, row: int, supersample: int = 1) -> Drawing:
        """What the camera has in front of it at one of the S steps, projected by the code of the cross-check.

        It is of the vessels, the obstacles, and the hull that carries the camera if that has a mesh.
        """
        with_mesh = np.array([vessel.has_mesh for vessel in self.vessels])
        present = self.others[row] | (self.carriers[row] & with_mesh)
        camera_R_world, camera_m = self.camera_poses.camera_R_world[row], self.camera_poses.positions_m[row]
        vessels = vessel_triangles(self.vessels, present, self.poses.positions_m[row], self.world_R_vessel[row])
        obstacles = obstacle_triangles(self.obstacles, len(self.vessels), camera_m if self.curved else None)
        triangles = WorldTriangles.joined([vessels, obstacles])
        return Drawing.of(triangles, camera_R_world, camera_m, self.camera.intrinsics, supersample)

    def body_around(self) -> tuple[int, int] | None:
        """The first step (as an index) and the occluder that the camera is inside of, or None."""
        near = np.zeros(len(self.vessels), dtype=bool)
        near[self.vessels_within_reach] = True
        bodies = self._bodies(self.others & near) + self._own_hull() + self._obstacle_bodies()
        return first_body_around(self.camera_poses.positions_m, bodies)

    @cached_property
    def vessels_within_reach(self) -> Indices:
        """Other vessels that the camera may be inside of at one of the steps, however waves move them, shape (k,)."""
        reach_m = np.array([vessel.reach_m for vessel in self.vessels])
        away_m = self.poses.positions_m - self.camera_poses.positions_m[:, None]
        near = self.others & (np.hypot(away_m[..., 0], away_m[..., 1]) <= reach_m)
        return np.flatnonzero(near.any(axis=0))

    def _own_hull(self) -> list[Bodies]:
        """The vessel that carries the camera, if it has a mesh: it hides others and has no box."""
        if self.camera.mount.vessel is None:
            return []
        with_mesh = np.array([vessel.has_mesh for vessel in self.vessels])
        return self._bodies(self.carriers & with_mesh, boxed=False)

    def _bodies(self, present: Mask, *, as_shoeboxes: bool = False, boxed: bool = True) -> list[Bodies]:
        places_m, rotations = self.poses.positions_m, self.world_R_vessel
        return vessel_bodies(self.vessels, present, places_m, rotations, as_shoeboxes=as_shoeboxes, boxed=boxed)

    def _obstacle_bodies(self) -> list[Bodies]:
        cameras_m = self.camera_poses.positions_m if self.curved else None
        return obstacle_bodies(self.obstacles, len(self.vessels), len(self.steps), cameras_m)


def line_of_sight(
    camera: Camera,
    camera_poses: CameraPoses,
    steps: Indices,
    vessels: tuple[Vessel, ...],
    vessel_poses: PosesInWaves,
    obstacles: tuple[Obstacle, ...],
    curved: bool,
) -> Sight:
    """What a camera with some poses at S ascending steps, shape (S,), has in front of it; see `Sight`."""
    carrier = np.array([vessel.name == camera.mount.vessel for vessel in vessels])
    poses = vessel_poses.poses
    if curved:
        lower = lowered(poses.positions_m, camera_poses.positions_m[:, None])
        poses = replace(poses, positions_m=np.where(carrier[:, None], poses.positions_m, lower))
    return Sight(
        camera,
        steps,
        vessels,
        poses,
        vessel_poses.world_R_vessel,
        others=poses.present & ~carrier,
        carriers=poses.present & carrier,
        camera_poses=camera_poses,
        obstacles=obstacles,
        curved=curved,
    )
