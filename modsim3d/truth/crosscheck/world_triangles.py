"""The solids of a scene at one step as one list of triangles in the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.geometry.curved_sea import drop_m
from modsim3d.vessels.obstacles import Obstacle
from modsim3d.vessels.vessel import Vessel


@dataclass(frozen=True, eq=False)
class WorldTriangles:
    """T triangles of solids, in no order.

    Attributes:
        corners_m: In WCF, shape (T, 3, 3).
        occluder: Index into the scene's occluder names of the solid of each, shape (T,).
    """

    corners_m: Array
    occluder: Indices

    @classmethod
    def joined(cls, parts: Sequence[WorldTriangles]) -> WorldTriangles:
        """The triangles of several lists."""
        nothing = cls(np.empty((0, 3, 3)), np.empty(0, dtype=np.int64))
        parts = [nothing, *parts]
        return cls(np.concatenate([p.corners_m for p in parts]), np.concatenate([p.occluder for p in parts]))


def vessel_triangles(
    vessels: Sequence[Vessel], present: Mask, positions_m: Array, world_R_vessel: Array
) -> WorldTriangles:
    """The solids of V vessels at one step: R · x + s for each corner (Jessen & Mohr (2023), eq. 7.1).

    Args:
        vessels: V vessels; the index of each is its occluder index.
        present: Which of them to take, shape (V,).
        positions_m: Origins of the vessels in WCF, shape (V, 3).
        world_R_vessel: Rotations VCF to WCF, shape (V, 3, 3).
    """
    parts = []
    for index in np.flatnonzero(present).tolist():
        corners = vessels[index].triangles_m @ world_R_vessel[index].T + positions_m[index]
        parts.append(WorldTriangles(corners, np.full(len(corners), index)))
    return WorldTriangles.joined(parts)


def obstacle_triangles(obstacles: tuple[Obstacle, ...], first_occluder: int, camera_m: Array | None) -> WorldTriangles:
    """The solids of obstacles; `first_occluder` is the occluder index of the first one.

    On a curved sea `camera_m` is the camera's centre in WCF, shape (3,), and each obstacle is lowered by the drop at
    its centre. On a flat sea it is None.
    """
    triangles = _standing(obstacles, first_occluder)
    if camera_m is None or not obstacles:
        return triangles
    corners = triangles.corners_m.copy()
    drops = np.array([drop_m(obstacle.centre_m, camera_m) for obstacle in obstacles])
    corners[..., 2] -= drops[triangles.occluder - first_occluder, None]
    return WorldTriangles(corners, triangles.occluder)


@lru_cache(maxsize=4)
def _standing(obstacles: tuple[Obstacle, ...], first_occluder: int) -> WorldTriangles:
    parts = []
    for index, obstacle in enumerate(obstacles):
        for solid, vertices in obstacle.solids:
            parts.append(WorldTriangles(vertices[solid.faces], np.full(len(solid.faces), first_occluder + index)))
    return WorldTriangles.joined(parts)
