"""Views of cameras: what is in front of one, and from where it looks, as bodies for the truth and for pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.document import Result
from modsim3d.core.errors import ModsimError
from modsim3d.geometry.camera import Camera
from modsim3d.geometry.camera_poses import CameraPoses
from modsim3d.geometry.curved_sea import lowered
from modsim3d.io.validation import nearest
from modsim3d.truth.crosscheck.drawing import Drawing, WorldTriangles, obstacle_triangles, vessel_triangles
from modsim3d.truth.outlines import Outlines, first_body_around, outline
from modsim3d.world.bodies import PREFIX, Bodies, Obstacle, obstacle_bodies, vessel_bodies
from modsim3d.world.poses.base import Poses
from modsim3d.world.vessel_motion import PosesInWaves
from modsim3d.world.vessels import Vessel

if TYPE_CHECKING:
    import trimesh

    from modsim3d.render.id_pass import Ids


@dataclass(frozen=True, eq=False)
class Sight:
    """View of a camera at S steps: what is in front of it, and from where it looks. It makes `Bodies` of the solids of
    all V vessels and of the obstacles, and of these the `Outlines` that the camera sees."""

    camera: Camera
    steps: Indices  # (S,)
    vessels: tuple[Vessel, ...]
    poses: Poses  # of all vessels as the camera sees them: on a curved sea, the other vessels lie lower
    world_R_vessel: Array  # VCF to WCF, waves included, (S, V, 3, 3)
    others: Mask  # present vessels that do not carry the camera, (S, V)
    carriers: Mask  # the vessel that carries the camera, (S, V)
    camera_poses: CameraPoses
    obstacles: tuple[Obstacle, ...] = ()
    curved: bool = False

    def outlines(self, *, as_shoeboxes: bool = False, measured: bool = True) -> Outlines:
        """Outlines of the other vessels, the obstacles, and the hull that carries the camera if that has a mesh. With
        `as_shoeboxes`, shoeboxes replace meshes, and the hull that carries the camera is left out. For `measured` see
        `outline`."""
        bodies = self._bodies(self.others, as_shoeboxes=as_shoeboxes)
        if not as_shoeboxes:
            bodies += self._own_hull()
        bodies += self._obstacle_bodies()
        return outline(self.camera.intrinsics, self.camera_poses, bodies, measured=measured)

    def drawing(self, row: int, supersample: int = 1) -> Drawing:
        """View at one of the S steps, projected by the code of the cross-check. It is of the vessels, the obstacles,
        and the hull that carries the camera if that has a mesh."""
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
    """View of a camera with some poses at S ascending steps, shape (S,); see `Sight`."""
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


CV_TO_GL = np.diag([1.0, -1.0, -1.0])
"""From camera axes as in computer vision (c2 down, c3 forward) to those of OpenGL and glTF (y up, z backward)."""
BASE_FRAME = "#world"
CAMERA_PREFIX = "camera#"
"""A vessel's ID never has a '#', so no vessel has the name of a camera's frame or of the base frame."""


@dataclass(frozen=True, eq=False, repr=False)
class IdImage(Result):
    """Image of who is in front at each pixel of a camera's image, drawn by OpenGL with a depth test.

    Attributes:
        ids: ID at each pixel, 0 for nothing, shape (height, width), both `supersample` times those of the image.
        names: Vessel or obstacle (`obstacle:NAME`) of each ID, of those that are not seen too.
        supersample: Pixels for each pixel of the image and axis, as `annotation.supersample` has it.
    """

    ids: Ids
    names: dict[int, str]
    supersample: int

    def counts(self) -> list[tuple[int, int]]:
        """The IDs that are seen, and the number of pixels of each in `ids`."""
        counts = np.bincount(self.ids.reshape(-1))
        return [(number, int(counts[number])) for number in np.flatnonzero(counts).tolist() if number]


@dataclass(frozen=True, eq=False, repr=False)
class Snapshot(Result):
    """A scene at one step: all its vessels and obstacles, and what each camera has before it at the one step."""

    vessels: tuple[Vessel, ...]
    vessel_poses: PosesInWaves
    obstacles: tuple[Obstacle, ...]
    sights: tuple[Sight, ...]
    supersample: int

    def render_ids(self, camera: str) -> IdImage:
        """The ID buffer of a camera: the vessels, the obstacles, and own ship if it has a mesh.

        Raises:
            ModsimError: There is no such camera.
            RendererError: There is no OpenGL library.
        """
        names = [vessel.name for vessel in self.vessels] + [PREFIX + obstacle.name for obstacle in self.obstacles]
        return IdImage(self._drawn(camera), {place + 1: name for place, name in enumerate(names)}, self.supersample)

    def render_silhouette(self, camera: str, vessel: str) -> Mask:
        """The pixels of a vessel drawn alone, parts that others hide included; its shape is that of `IdImage.ids`.

        Raises:
            ModsimError: There is no such camera or vessel.
            RendererError: There is no OpenGL library.
        """
        return self._drawn(camera, _place(vessel, [entry.name for entry in self.vessels], "vessel")) > 0

    def _drawn(self, camera: str, vessel: int | None = None) -> Ids:
        from modsim3d.render.context import open_context  # no OpenGL where none is needed
        from modsim3d.render.id_pass import IdRenderer

        sight = self.sights[_place(camera, [view.camera.name for view in self.sights], "camera")]
        drawing = sight.drawing(0, self.supersample)
        with open_context() as context:
            return (drawing if vessel is None else drawing.only(vessel)).ids(IdRenderer(context), drawing.image)

    def to_trimesh(self) -> trimesh.Scene:
        """The scene in the world's axes, in metres, w3 up; the sea is flat. Each vessel that is present is a geometry
        and a node under its ID, with its pose in waves. An obstacle is one under `obstacle:NAME`. A camera is a frame
        `camera#NAME` that looks along its −z, with y up, as in OpenGL and glTF. The first camera is also the trimesh
        scene's camera, which has no skew, distortion or principal point."""
        import trimesh  # takes 0.3 s

        scene = trimesh.Scene(base_frame=BASE_FRAME)
        poses = self.vessel_poses.poses
        for index in np.flatnonzero(poses.present[0]).tolist():
            vessel = self.vessels[index]
            pose = _transform(self.vessel_poses.world_R_vessel[0, index], poses.positions_m[0, index])
            scene.add_geometry(vessel.to_trimesh(), vessel.name, vessel.name, transform=pose)
        for obstacle in self.obstacles:
            name = PREFIX + obstacle.name
            scene.add_geometry(obstacle.to_trimesh(), name, name)
        for sight in self.sights:
            place = sight.camera_poses
            pose = _transform(place.camera_R_world[0].T @ CV_TO_GL, place.positions_m[0])
            scene.graph.update(CAMERA_PREFIX + sight.camera.name, matrix=pose)
        name, lens = CAMERA_PREFIX + self.sights[0].camera.name, self.sights[0].camera.intrinsics
        scene.camera = trimesh.scene.Camera(name, lens.image_size_px, lens.focal_px, z_near=lens.near_clip_m)
        return scene


def _place(name: str, names: list[str], kind: str) -> int:
    if name not in names:
        raise ModsimError(f"there is no {kind} '{name}' ({nearest(name, names)})")
    return names.index(name)


def _transform(rotation: Array, position_m: Array) -> Array:
    """Homogeneous transform, shape (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, position_m
    return matrix
