"""pyrender's images of the frames that our passes are timed with; benchmarks/child.py runs it in its own process."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from benchmarks.processes import Answer

BYTES_PER_PIXEL = 4 + 4
"""Of colour and of depth."""


class PyrenderPass:
    """pyrender's SEG image of the same frames, and the boxes in it; scene, meshes and renderer are made once.

    One image tells what is visible, and only that is timed. The full box of a vessel that is hidden takes another
    image, of it alone: those are drawn for the check that both give the same boxes, and not timed.
    """

    DEPTHS_M = 100.0, 4000.0

    def __init__(self, scene: str) -> None:
        from modsim3d.render.shaded_pass import import_pyrender

        self._pyrender = pyrender = import_pyrender()
        import trimesh

        from modsim3d.scene.reading import load_scene

        self._loaded = loaded = load_scene(scene)
        intrinsics = loaded.cameras[0].intrinsics
        self._scene = pyrender.Scene(bg_color=[0, 0, 0, 0], ambient_light=[1, 1, 1])
        camera = pyrender.IntrinsicsCamera(
            *intrinsics.focal_px, *intrinsics.principal_point_px, znear=self.DEPTHS_M[0], zfar=self.DEPTHS_M[1]
        )
        self._camera = self._scene.add(camera)
        self._nodes = [
            self._scene.add(pyrender.Mesh.from_trimesh(trimesh.creation.box(extents=vessel.extents_m), smooth=False))
            for vessel in loaded.vessels
        ]
        self._colours = {node: (0, 0, number) for number, node in enumerate(self._nodes, start=1)}
        self._drawer = pyrender.OffscreenRenderer(*intrinsics.image_size_px)
        self._pixels = int(np.prod(intrinsics.image_size_px))
        self._render_s = 0.0
        self.time([0, 1])

    def time(self, frames: list[int]) -> Answer:
        """Seconds for some frames; poses are at hand as matrices."""
        matrices = [self._matrices(frame) for frame in frames]
        self._render_s = 0.0
        started = time.perf_counter()
        for poses in matrices:
            self._boxes(poses, self._colours)
        seconds = time.perf_counter() - started
        drawn_bytes = self._pixels * BYTES_PER_PIXEL * len(frames)
        return {"seconds": seconds, "render_seconds": self._render_s, "drawn_bytes": drawn_bytes}

    def boxes(self, frames: list[int]) -> Answer:
        """Full and visible box of each vessel in each frame, None where there is none."""
        found = []
        for frame in frames:
            poses = self._matrices(frame)
            seen = self._boxes(poses, self._colours)
            names = self._loaded.vessel_names
            alone = [self._boxes(poses, {node: self._colours[node]})[index] for index, node in enumerate(self._nodes)]
            boxes = zip(names, alone, seen, strict=True)
            found.append({name: [full, visible] for name, full, visible in boxes if full is not None})
        return {"boxes": found}

    def _matrices(self, frame: int) -> list[np.ndarray]:
        """Of the camera and the vessels."""
        from modsim3d.geometry.camera_poses import world_R_vehicle

        loaded = self._loaded
        sight = loaded.sight(loaded.cameras[0], np.array([frame]))
        camera, poses = sight.camera_poses, sight.poses
        cv_to_gl = np.diag([1.0, -1.0, -1.0])
        rotations = [camera.camera_R_world[0].T @ cv_to_gl, *world_R_vehicle(poses.headings_rad[0])]
        heights = np.array([[0, 0, vessel.air_draft_m / 2] for vessel in loaded.vessels])
        places = [camera.positions_m[0], *(poses.positions_m[0] + heights)]
        matrices = np.tile(np.eye(4), (len(places), 1, 1))
        matrices[:, :3, :3], matrices[:, :3, 3] = rotations, places
        return list(matrices)

    def _boxes(self, poses: list[np.ndarray], colours: dict[Any, Any]) -> list[list[float] | None]:
        for node, pose in zip((self._camera, *self._nodes), poses, strict=True):
            self._scene.set_pose(node, pose)
        flags = self._pyrender.RenderFlags.SEG
        started = time.perf_counter()
        ids = self._drawer.render(self._scene, flags=flags, seg_node_map=colours)[0][..., 2]
        self._render_s += time.perf_counter() - started
        return boxes_in(ids, len(self._nodes))


def boxes_in(ids: np.ndarray, count: int) -> list[list[float] | None]:
    """Half-open box of the pixels of each ID from 1 to `count`; the empty rows above and below are left out first."""
    from scipy.ndimage import find_objects

    rows = np.flatnonzero(ids.any(axis=1))
    if not len(rows):
        return [None] * count
    top = int(rows[0])
    slices = find_objects(ids[top : int(rows[-1]) + 1].astype(np.int32), count)
    return [
        None if found is None else [found[1].start, found[0].start + top, found[1].stop, found[0].stop + top]
        for found in slices
    ]
