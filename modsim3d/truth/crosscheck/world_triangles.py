"""The solids of a scene at one step as one list of triangles in the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.geometry.curved_sea import drop_m
from modsim3d.vessels.obstacles import Obstacle
from modsim3d.vessels.vessel import Solid, Vessel


@dataclass(frozen=True, eq=False)
class WorldTriangles:
    """T triangles, those of a solid together, in order of occluder.

    Attributes:
        corners_m: In WCF, shape (T, 3, 3).
        occluder: Index into the scene's occluder names of the solid of each, shape (T,).
        closed: Number of the closed solid that it bounds, 1 or more; 0 for a surface with holes, shape (T,).
    """

    corners_m: Array
    occluder: Indices
    closed: Indices

    @classmethod
    def joined(cls, parts: Sequence[WorldTriangles]) -> WorldTriangles:
        """The triangles of several lists."""
        none = np.empty(0, dtype=np.int64)
        parts = [cls(np.empty((0, 3, 3)), none, none), *parts]
        return cls(*(np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(cls)))

    @classmethod
    def of_solid(cls, corners_m: Array, solid: Solid, occluder: int, number: int) -> WorldTriangles:
        """The triangles of one solid, whose number is not below 1."""
        count = len(corners_m)
        return cls(corners_m, np.full(count, occluder), np.full(count, number if solid.closed else 0))


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
        parts.append(WorldTriangles.of_solid(corners, vessels[index].solid, index, index + 1))
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
    return replace(triangles, corners_m=corners)


@lru_cache(maxsize=4)
def _standing(obstacles: tuple[Obstacle, ...], first_occluder: int) -> WorldTriangles:
    solids = [(index, *each) for index, obstacle in enumerate(obstacles) for each in obstacle.solids]
    return WorldTriangles.joined(
        [
            WorldTriangles.of_solid(vertices[solid.faces], solid, first_occluder + index, first_occluder + number + 1)
            for number, (index, solid, vertices) in enumerate(solids)
        ]
    )
