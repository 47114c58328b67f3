"""Vessel shapes from plug-ins."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array
from modsim3d.errors import InputError
from modsim3d.inputs.plugins import SHAPES, Plugin, failed, load_plugin
from modsim3d.vessels.meshes.shape import is_closed, signed_volume
from modsim3d.vessels.vessel import Solid

LOW, HIGH = np.array([-0.5, -0.5, 0.0]), np.array([0.5, 0.5, 1.0])
"""Corners of the box that a shape fills, in units of length, beam and air draft, each of shape (3,)."""
SLACK = 1e-6


def find_shape(name: str, path: str, built_in: tuple[str, ...] = ()) -> tuple[Solid, Plugin]:
    """A vessel shape of the group `modsim3d.shapes`.

    The plug-in is a function without arguments that returns vertices, shape (K, 3), and faces, shape (F, 3), of a
    closed triangle mesh: v1 forward and v2 to port from −1/2 to 1/2, v3 up from 0 to 1, in units of length, beam and
    air draft; faces are counter-clockwise seen from outside.

    Errors name the path of the key; `built_in` are names that need no plug-in, for the hint at an unknown name.

    Raises:
        InputError: There is no such plug-in, it fails, or it returns something else.
    """
    found, plugin = load_plugin(SHAPES, name, path, built_in)
    if not callable(found):
        raise InputError(path, [f"{plugin} must be a function that returns vertices and faces, not {found!r}"])
    try:
        vertices, faces = found()
        vertices, faces = np.array(vertices, dtype=np.float64), np.array(faces)
    except Exception as error:
        raise InputError(path, [str(failed(plugin, error))]) from error
    if problem := shape_problem(vertices, faces):
        raise InputError(path, [f"{plugin}: {problem}"])
    solid = Solid(vertices, faces.astype(np.int64))
    solid.vertices.setflags(write=False)
    solid.faces.setflags(write=False)
    return solid, plugin


def shape_problem(vertices: Array, faces: np.ndarray) -> str | None:
    """Reason why vertices (K, 3) and faces (F, 3) cannot be a vessel's shape; None if they can.

    The vertices are in units of length, beam and air draft.
    """
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not len(vertices) or not np.isfinite(vertices).all():
        return f"vertices must be finite, of shape (K, 3) (got {vertices.shape})"
    if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces) or faces.dtype.kind not in "iu":
        return f"faces must be vertex indices of shape (F, 3) (got {faces.dtype} {faces.shape})"
    if faces.min() < 0 or faces.max() >= len(vertices):
        return f"faces name vertices 0 to {len(vertices) - 1} (got {faces.min()} to {faces.max()})"
    used = vertices[np.unique(faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    if np.abs(low - LOW).max() > SLACK or np.abs(high - HIGH).max() > SLACK:
        return f"it must fill the box from {LOW.tolist()} to {HIGH.tolist()}, not {low.tolist()} to {high.tolist()}"
    faces = faces.astype(np.int64)
    if not is_closed(faces):
        return "its surface is not closed: each edge must belong to two faces, once in each direction"
    if signed_volume(vertices, faces) <= 0:
        return "its faces point inwards: they must be counter-clockwise seen from outside"
    return None
