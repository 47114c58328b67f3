"""A scene at one step: as ID buffers, and as a trimesh scene for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from modsim3d.arrays import Array, Mask
from modsim3d.errors import ModsimError
from modsim3d.inputs.validation import nearest
from modsim3d.motion.vessel_motion import PosesInWaves
from modsim3d.scene.sight import Sight
from modsim3d.vessels.obstacles import PREFIX, Obstacle
from modsim3d.vessels.vessel import Vessel

if TYPE_CHECKING:
    import trimesh

    from modsim3d.render.id_pass import Ids

CV_TO_GL = np.diag([1.0, -1.0, -1.0])
"""From camera axes as in computer vision (c2 down, c3 forward) to those of OpenGL and glTF (y up, z backward)."""
BASE_FRAME = "#world"
CAMERA_PREFIX = "camera#"
"""A vessel's ID never has a '#', so no vessel has the name of a camera's frame or of the base frame."""


@dataclass(frozen=True, eq=False)
class IdImage:
    """What is in front at each pixel of a camera's image, drawn by OpenGL with a depth test.

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


@dataclass(frozen=True, eq=False)
class Snapshot:
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
        return self._drawn(camera, _place(vessel, [each.name for each in self.vessels], "vessel")) > 0

    def _drawn(self, camera: str, vessel: int | None = None) -> Ids:
        from modsim3d.render.context import open_context  # no OpenGL where none is needed
        from modsim3d.render.id_pass import IdRenderer

        sight = self.sights[_place(camera, [each.camera.name for each in self.sights], "camera")]
        drawing = sight.drawing(0, self.supersample)
        with open_context() as context:
            return (drawing if vessel is None else drawing.only(vessel)).ids(IdRenderer(context), drawing.image)

    def to_trimesh(self) -> trimesh.Scene:
        """The scene in the world's axes, in metres, w3 up; the sea is flat.

        Each vessel that is present is a geometry and a node under its ID, with its pose in waves. An obstacle is one
        under `obstacle:NAME`. A camera is a frame `camera#NAME` that looks along its −z, with y up, as in OpenGL and
        glTF. The first camera is also the trimesh scene's camera, which has no skew, distortion or principal point.
        """
        import trimesh  # takes 0.4 s

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
        first = self.sights[0].camera
        lens = first.intrinsics
        scene.camera = trimesh.scene.Camera(
            CAMERA_PREFIX + first.name, lens.image_size_px, lens.focal_px, z_near=lens.near_clip_m
        )
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
