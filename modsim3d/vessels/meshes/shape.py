"""From triangles in a file's own axes and units to a solid in units of length, beam and air draft."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.vessels.meshes.fit import FileBox
from modsim3d.vessels.meshes.limits import MAX_COORDINATE, Refused, check_faces, check_vertices
from modsim3d.vessels.vessel import Solid

SAME_VERTEX = 1e-7
"""Vertices that are closer than this, in units of the box, are merged: STL repeats each, in single precision."""
MOST_FACES_OF_CONVEX = 64
"""A convex mesh with more faces is treated as not convex, because sorting by its planes would take too long."""
EXTENTS = ("length", "beam", "height")


def axis(name: str) -> Array:
    """The unit vector that `+x` or `-z` names, shape (3,)."""
    direction: Array = np.eye(3)["xyz".index(name[1])]
    return direction if name[0] == "+" else -direction


def vehicle_R_file(forward: str, up: str) -> Array:
    """The rotation from a file's axes to VCF, shape (3, 3)."""
    return np.array([axis(forward), np.cross(axis(up), axis(forward)), axis(up)])


def to_solid(vertices: Array, faces: Indices, forward: str, up: str) -> Solid:
    """The solid of a mesh, its bounding box scaled to the unit box.

    The vertices, shape (K, 3), are in any unit; faces are their indices, shape (F, 3). `forward` and `up` are the axes
    of the file that point to the bow and up, such as `+x`.

    Raises:
        Refused: A vertex is not finite, there are no faces, or the mesh is flat along an axis.
    """
    check_faces(len(faces))
    check_vertices(len(vertices))
    bad = ~(np.abs(vertices) <= MAX_COORDINATE).all(axis=1)
    if bad.any():
        first = int(np.argmax(bad))
        value = [float(x) for x in vertices[first]]
        raise Refused(
            f"has {int(bad.sum())} of {len(vertices)} vertices that are NaN, infinite or beyond {MAX_COORDINATE:g} "
            f"(the first is number {first}, {value}): export it again"
        )
    used, corners = np.unique(faces, return_inverse=True)
    box, extents = _unit_box(vertices[used] @ vehicle_R_file(forward, up).T)
    vertices, faces = _merge(box, corners.reshape(-1, 3))
    check_faces(len(faces))
    closed = is_closed(faces)
    volume = signed_volume(vertices, faces) if closed else 0.0
    if volume < 0.0:
        faces = faces[:, ::-1].copy()
    closed = closed and volume != 0.0
    vertices.setflags(write=False)
    faces.setflags(write=False)
    convex = closed and len(faces) <= MOST_FACES_OF_CONVEX and _is_convex(vertices, abs(volume))
    return Solid(vertices, faces, convex=convex, closed=closed, file_box=FileBox(extents, forward, up))


def _unit_box(vertices: Array) -> tuple[Array, Array]:
    """Vertices, shape (K, 3), scaled and moved so that they fill the unit box exactly, and their extents before."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    extents = high - low
    # A flat mesh that was rotated or stored in single precision has some rounding.
    rounding = 1e-6 * float(extents.max())
    if (extents <= rounding).any():
        flat = [name for name, extent in zip(EXTENTS, extents, strict=True) if extent <= rounding]
        raise Refused(f"has no {' and no '.join(flat)}: a solid is needed, or other axes (`forward` and `up`)")
    unit: Array = np.clip((vertices - low) / extents, 0.0, 1.0) - np.array([0.5, 0.5, 0.0])
    return unit, extents


def _merge(vertices: Array, faces: Indices) -> tuple[Array, Indices]:
    """Merge vertices that coincide, and drop faces that then have fewer than three corners."""
    _, kept, where = np.unique(np.rint(vertices / SAME_VERTEX), axis=0, return_index=True, return_inverse=True)
    faces = where.reshape(-1)[faces].astype(np.int64)
    a, b, c = faces.T
    return vertices[kept], faces[(a != b) & (b != c) & (a != c)]


def is_closed(faces: Indices) -> bool:
    """Whether faces, shape (F, 3), traverse each edge equally often in both directions: no holes, one orientation."""
    count = int(faces.max()) + 1
    starts, ends = faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel()
    return bool(np.array_equal(np.sort(starts * count + ends), np.sort(ends * count + starts)))


def signed_volume(vertices: Array, faces: Indices) -> float:
    """Volume Σ a · (b × c) / 6 in a closed mesh of shapes (K, 3) and (F, 3); negative if it is inside out."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0


def _is_convex(vertices: Array, volume: float) -> bool:
    """Whether a closed mesh fills its convex hull."""
    from scipy.spatial import ConvexHull, QhullError  # takes 0.1 s

    try:
        return bool(np.isclose(ConvexHull(vertices).volume, volume, rtol=1e-9, atol=0.0))
    except QhullError:
        return False
