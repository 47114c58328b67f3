"""Bodies: vessels' and obstacles' solids with their size and their places in the world."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import TYPE_CHECKING

import numpy as np
import shapely

from modsim3d.core.arrays import Array, Indices, Mask, read_only
from modsim3d.geometry.camera_poses import world_R_vehicle
from modsim3d.geometry.curved_sea import drop_m
from modsim3d.geometry.kinematics import union_of
from modsim3d.world.vessels import Solid, Vessel, misfit, shoebox

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True, eq=False)
class Bodies:
    """B solids with the same faces in the world, at S steps. They are the step between a `Solid`, which has neither
    size nor place, and `Outlines`, which are what a camera sees of bodies. Bodies with the same faces form arrays,
    which are placed and projected together."""

    solid: Solid  # the faces that the bodies share; its vertices are not used
    occluder: Indices  # index into the scene's occluder names: (B,)
    boxed: bool  # whether the bodies get a box: vessels do, obstacles and own ship do not
    vertices_m: Array  # in the frame of each body: (B, K, 3)
    centres_m: Array  # of the bounding boxes in the same frames: (B, 3)
    present: Mask  # which bodies are used at each step: (S, B)
    positions_m: Array  # origins of the frames in WCF: (S, B, 3)
    world_R_body: Array  # rotations to WCF: (S, B, 3, 3)

    def at(self, steps: slice) -> Bodies:
        """Bodies at some of the steps."""
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
        return (self.world_R_body @ self.centres_m[:, :, None])[..., 0] + self.positions_m


def vessel_bodies(
    vessels: Sequence[Vessel],
    present: Mask,
    positions_m: Array,
    world_R_vessel: Array,
    *,
    as_shoeboxes: bool = False,
    boxed: bool = True,
) -> list[Bodies]:
    """The vessels that are present at any of S steps, grouped by mesh. `present` says which of V vessels to take at
    each step: (S, V); positions in WCF are (S, V, 3), rotations VCF to WCF (S, V, 3, 3). Shoeboxes may stand for
    meshes; for `boxed` see `Bodies`."""
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


PREFIX = "obstacle:"


@dataclass(frozen=True, eq=False)
class Obstacle:
    """An obstacle as the scene describes it; the truth writes its name after `PREFIX`. `solids` are the faces of its
    parts, each with its own vertices in WCF in metres: (K, 3)."""

    name: str
    solids: tuple[tuple[Solid, Array], ...]

    @property
    def centre_m(self) -> Array:
        """Centre of its bounding box in WCF, in metres, shape (3,)."""
        vertices = np.concatenate([vertices for _, vertices in self.solids])
        centre: Array = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        return centre

    def to_trimesh(self) -> trimesh.Trimesh:
        """The obstacle's solids in WCF, in metres."""
        import trimesh  # takes 0.3 s

        parts = [trimesh.Trimesh(vertices, solid.faces, process=False) for solid, vertices in self.solids]
        return trimesh.util.concatenate(parts)


def solid_footprint(solid: Solid, vertices_m: Array) -> shapely.Geometry:
    """The footprint of a solid with its vertices in WCF in metres, shape (K, 3)."""
    flat = vertices_m[:, :2]
    if solid.convex:
        return shapely.convex_hull(shapely.multipoints(flat))
    faces = shapely.polygons(flat[solid.faces])
    return union_of(faces[shapely.area(faces) > 0])


def extruded(polygon_m: Array, base_m: float, height_m: float) -> tuple[tuple[Solid, Array], ...]:
    """An upright prism over a polygon, as convex prisms: over the polygon's triangles if it is not convex. The
    polygon's corners are on the sea in WCF, in either direction: (k, 2). The lower face lies at `base_m` above the sea.
    Each solid comes with its vertices in WCF in metres: (K, 3)."""
    outline = shapely.Polygon(polygon_m)
    hull = shapely.convex_hull(outline)
    is_convex = shapely.area(hull) - shapely.area(outline) <= 1e-9 * shapely.area(hull)
    pieces = [hull] if is_convex else shapely.get_parts(shapely.constrained_delaunay_triangles(outline)).tolist()
    return tuple(
        _prism(shapely.get_coordinates(shapely.orient_polygons(piece))[:-1], base_m, height_m) for piece in pieces
    )


def placed(solid: Solid, size_m: Array, position_m: Array, heading_rad: float) -> tuple[Solid, Array]:
    """A mesh scaled to length, beam and height (3,), with the centre of its bottom at a place (3,) in WCF and a heading
    counter-clockwise from w1: the mesh, and its vertices in WCF in metres, (K, 3)."""
    return solid, (solid.vertices * size_m) @ world_R_vehicle(heading_rad).T + position_m


def _prism(ring: Array, base_m: float, height_m: float) -> tuple[Solid, Array]:
    """The prism over a convex, counter-clockwise ring, shape (k, 2)."""
    vertices = np.concatenate([np.column_stack([ring, np.full(len(ring), z)]) for z in (base_m, base_m + height_m)])
    # No two sides of a triangle are parallel, so all triangles can share one solid and be handled together.
    return (_triangular_prism() if len(ring) == 3 else Solid(vertices, _prism_faces(len(ring)))), vertices


@cache
def _triangular_prism() -> Solid:
    ring = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
    return Solid(np.array([(x, y, z) for z in (0.0, 1.0) for x, y in ring]), _prism_faces(3))


def _prism_faces(sides: int) -> Indices:
    """Triangles of a prism whose vertices are the lower corners, counter-clockwise from above, then the upper ones."""
    low = np.arange(sides)
    after = np.roll(low, -1)
    walls = np.stack([low, after, after + sides, low, after + sides, low + sides], axis=1).reshape(-1, 3)
    fan = [(0, i, i + 1) for i in range(1, sides - 1)]
    bottom, top = [(a, c, b) for a, b, c in fan], [(a + sides, b + sides, c + sides) for a, b, c in fan]
    return np.array([*walls, *bottom, *top], dtype=np.int64)


def obstacle_bodies(
    obstacles: Sequence[Obstacle], first_occluder: int, steps: int, cameras_m: Array | None = None
) -> list[Bodies]:
    """The obstacles at S steps, grouped by their faces; `first_occluder` is the first one's occluder index. On a curved
    sea `cameras_m` are the camera centres in WCF: (S, 3), and obstacles are lowered by the drop; None on a flat sea."""
    bodies = []
    for solid, index, vertices in _grouped(tuple(obstacles)):
        count = len(index)
        positions = np.zeros((steps, count, 3))
        if cameras_m is not None:
            centres = np.array([obstacles[number].centre_m for number in index.tolist()])
            positions[..., 2] -= drop_m(centres, cameras_m[:, None])
        bodies.append(
            Bodies(
                solid=solid,
                occluder=first_occluder + index,
                boxed=False,
                vertices_m=vertices,
                centres_m=(vertices.min(axis=1) + vertices.max(axis=1)) / 2,
                present=np.ones((steps, count), dtype=bool),
                positions_m=positions,
                world_R_body=np.broadcast_to(np.eye(3), (steps, count, 3, 3)),
            )
        )
    return bodies


@lru_cache(maxsize=16)
def _grouped(obstacles: tuple[Obstacle, ...]) -> tuple[tuple[Solid, Indices, Array], ...]:
    """Solids, and for each the index of its obstacles (B,) and their vertices (B, K, 3); a live step has no time."""
    members_of: dict[Solid, list[tuple[int, Array]]] = {}
    for index, obstacle in enumerate(obstacles):
        for solid, vertices in obstacle.solids:
            members_of.setdefault(solid, []).append((index, vertices))
    return tuple(
        (solid, np.array([index for index, _ in members]), read_only([vertices for _, vertices in members]))
        for solid, members in members_of.items()
    )


def misfits(vessels: Iterable[Vessel], obstacles: Iterable[Obstacle]) -> list[str]:
    """One sentence for each mesh that does not fit a vessel or an obstacle; it names the first of them."""
    bodies = [(f"vessel '{hull.name}'", f"the mesh {hull.shape}", hull.solid, hull.extents_m) for hull in vessels]
    for obstacle in obstacles:
        for solid, corners_m in obstacle.solids:  # scaled, and then turned and placed
            linear = np.linalg.lstsq(np.column_stack([solid.vertices, np.ones(len(corners_m))]), corners_m)[0][:3]
            bodies.append((f"obstacle '{obstacle.name}'", "the mesh", solid, np.linalg.norm(linear, axis=1)))
    faults: dict[Solid, list[tuple[str, str]]] = {}
    for name, mesh, solid, size_m in bodies:
        if problem := misfit(solid, size_m):
            faults.setdefault(solid, []).append((name, f"{mesh} {problem}"))
    firsts = ((*named[0], len(named) - 1) for named in faults.values())
    return [f"{name}{f' and {more} more' if more else ''}: {problem}" for name, problem, more in firsts]
