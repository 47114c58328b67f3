"""Bodies: vessels' and obstacles' solids with their size and their places in the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.vessels.vessel import Solid, Vessel, shoebox


@dataclass(frozen=True, eq=False)
class Bodies:
    """B solids with the same faces in the world, at S steps.

    They are the step between a `Solid`, which has neither size nor place, and `Outlines`, which are what a camera sees
    of bodies. Bodies with the same faces form arrays, which are placed and projected together.

    Attributes:
        solid: The faces that the bodies share; its vertices are not used.
        occluder: Index into the scene's occluder names, shape (B,).
        boxed: Whether the bodies get a box: vessels do, obstacles and own ship do not.
        vertices_m: Vertices in the frame of each body, shape (B, K, 3).
        centres_m: Centres of the bounding boxes in the same frames, shape (B, 3).
        present: Which bodies are used at each step, shape (S, B).
        positions_m: Origins of the frames in WCF, shape (S, B, 3).
        world_R_body: Rotations to WCF, shape (S, B, 3, 3).
    """

    solid: Solid
    occluder: Indices
    boxed: bool
    vertices_m: Array
    centres_m: Array
    present: Mask
    positions_m: Array
    world_R_body: Array

    def at(self, steps: slice) -> Bodies:
        """The same bodies at some of the steps."""
        return replace(
            self,
            present=self.present[steps],
            positions_m=self.positions_m[steps],
            world_R_body=self.world_R_body[steps],
        )

    def vertices_world(self) -> Array:
        """Vertices in WCF in metres (Jessen & Mohr (2023), eq. 7.1), shape (S, B, K, 3)."""
        vertices: Array = self.vertices_m @ np.swapaxes(self.world_R_body, -1, -2)
        vertices += self.positions_m[:, :, None, :]
        return vertices

    def centres_world(self) -> Array:
        """Centres of the bounding boxes in WCF in metres, shape (S, B, 3)."""
        centres: Array = (self.world_R_body @ self.centres_m[:, :, None])[..., 0] + self.positions_m
        return centres


def vessel_bodies(
    vessels: Sequence[Vessel],
    present: Mask,
    positions_m: Array,
    world_R_vessel: Array,
    *,
    as_shoeboxes: bool = False,
    boxed: bool = True,
) -> list[Bodies]:
    """The vessels that are present at any of S steps, grouped by mesh.

    Args:
        vessels: V vessels.
        present: Which of them to take at each step, shape (S, V).
        positions_m: Origins of the vessels in WCF, shape (S, V, 3).
        world_R_vessel: Rotations VCF to WCF, shape (S, V, 3, 3).
        as_shoeboxes: Whether shoeboxes stand for meshes.
        boxed: As in `Bodies`.
    """
    members_of: dict[Solid, list[int]] = {}
    for index in np.nonzero(present.any(axis=0))[0].tolist():
        members_of.setdefault(shoebox() if as_shoeboxes else vessels[index].solid, []).append(index)
    bodies = []
    for solid, members in members_of.items():
        extents = np.array([vessels[index].extents_m for index in members])
        bodies.append(
            Bodies(
                solid=solid,
                occluder=np.array(members),
                boxed=boxed,
                vertices_m=solid.vertices * extents[:, None, :],
                centres_m=extents * (0.0, 0.0, 0.5),
                present=present[:, members],
                positions_m=positions_m[:, members],
                world_R_body=world_R_vessel[:, members],
            )
        )
    return bodies
