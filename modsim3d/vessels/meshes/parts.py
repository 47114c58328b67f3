"""Parts of a mesh file, and all of them joined in the file's own axes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.vessels.meshes.limits import Refused, check_faces

NO_CHANGE = 1e-8
"""A transform that differs less than this from the identity is taken for it."""


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a file: its vertices (K, 3), their indices in its faces (F, 3), and its transform (4, 4)."""

    vertices: Array
    faces: Indices
    file_T_part: Array


def joined(parts: Iterable[Part]) -> tuple[Array, Indices]:
    """Vertices and faces of all parts with their transforms applied, shapes (K, 3) and (F, 3).

    Raises:
        Refused: There are no faces or too many, or a part contradicts itself.
    """
    vertices: list[Array] = []
    faces: list[Indices] = []
    count = 0
    for part in parts:
        if len(part.faces):
            _check(part)
            faces.append(_mirrored(part) + count)
            vertices.append(placed(part.vertices, part.file_T_part))
            count += len(part.vertices)
    check_faces(sum(map(len, faces)))
    return np.concatenate(vertices), np.concatenate(faces)


def is_identity(transform: Array) -> bool:
    """Whether a transform (4, 4) changes nothing."""
    return bool(np.abs(transform - np.eye(4)).max() < NO_CHANGE)


def placed(points: Array, transform: Array) -> Array:
    """Points (K, 3) moved by a transform (4, 4)."""
    if is_identity(transform):
        return points
    moved: Array = np.dot(transform, np.column_stack([points, np.ones(len(points))]).T).T[:, :3]
    return moved


def _check(part: Part) -> None:
    """Refuse vertices without three coordinates, and faces with vertices that do not exist."""
    vertices, faces = part.vertices, part.faces
    if vertices.shape[1] != 3 or faces.shape[1] != 3:
        raise Refused(f"has vertices of {vertices.shape[1]} coordinates; three are needed, x, y and z")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise Refused(f"has faces that use vertex {int(faces.max())} of {len(vertices)}: is it damaged?")


def _mirrored(part: Part) -> Indices:
    """Faces of a part, shape (F, 3), reversed if the transform mirrors: that turns a part inside out."""
    return part.faces[:, ::-1] if np.linalg.det(part.file_T_part[:3, :3]) < 0 else part.faces
