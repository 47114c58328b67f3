"""The triangles of binary glTF 2.0, and where its scene puts them.

Section numbers are those of the glTF 2.0 specification (The Khronos Group, 2021). `read_glb` has checked the references
and counts that are used here. trimesh gives the same vertices and faces in the same order, but loses parts of a mesh
whose random names coincide, and importing it adds 0.3 s to the 1.6 s of processor time of `run strait --steps 10`.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array, Indices
from modsim3d.vessels.meshes.glb import (
    COMPONENTS,
    POINTS_LINES,
    STRIP,
    Accessor,
    Glb,
    Node,
    Primitive,
    indices_of,
    positions_of,
    view_of,
)
from modsim3d.vessels.meshes.limits import Refused
from modsim3d.vessels.meshes.parts import Part, is_identity


def glb_parts(glb: Glb) -> Iterator[Part]:
    """Each primitive of the scene as often as the scene shows it. Raises `Refused` for damaged data."""
    gltf = glb.description
    waiting: list[tuple[int, list[Array]]] = [(index, []) for index in gltf.scenes[gltf.scene].nodes]
    while waiting:
        index, above = waiting.pop()
        node = gltf.nodes[index]
        transforms = [*above, _transform(node)]
        waiting += [(child, transforms) for child in node.children or []]
        if node.mesh is not None:
            file_T_node = _product(transforms)
            for primitive in reversed(gltf.meshes[node.mesh].primitives):
                if primitive.mode not in POINTS_LINES:
                    yield _part(glb, primitive, file_T_node)


def _part(glb: Glb, primitive: Primitive, file_T_part: Array) -> Part:
    vertices = _numbers(glb, positions_of(glb.description, primitive)).astype(np.float64)
    indices = indices_of(glb.description, primitive)
    corners = np.arange(len(vertices)) if indices is None else _numbers(glb, indices).astype(np.int64).ravel()
    return Part(vertices, _faces(corners, primitive.mode), file_T_part)


def _faces(corners: Indices, mode: int) -> Indices:
    """Triangles, shape (F, 3), from the corners of a list or a strip of them, shape (n,) (section 3.7.2.1)."""
    if mode == STRIP:
        faces = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
        faces[1::2] = faces[1::2, ::-1]
        return faces
    if len(corners) % 3:
        raise Refused(f"has triangles with {len(corners)} corners, which cannot be divided by three: is it damaged?")
    return corners.reshape(-1, 3)


def _numbers(glb: Glb, accessor: Accessor) -> NDArray[Any]:
    """The numbers of an accessor, shape (count, 3) or (count, 1) (section 3.6.2)."""
    view = view_of(glb.description, accessor)
    shape, kind = (accessor.count, 3 if accessor.type == "VEC3" else 1), np.dtype(COMPONENTS[accessor.component_type])
    data, start = _data(glb, view.buffer), view.byte_offset + accessor.byte_offset
    strides = (view.byte_stride or shape[1] * kind.itemsize, kind.itemsize)
    try:
        return np.ndarray(shape, kind, buffer=data, offset=start, strides=strides)
    except (TypeError, ValueError):  # the data in a URI may be shorter than the description says
        raise Refused(f"has only {len(data)} bytes of data in buffer {view.buffer}: is it damaged?") from None


def _data(glb: Glb, number: int) -> bytes:
    """The content of a buffer: text in its URI, or the binary chunk (section 3.6.1)."""
    uri = glb.description.buffers[number].uri
    if uri is None:
        return glb.binary
    _, found, text = uri.partition("base64,")
    try:
        content = base64.b64decode(text)
    except ValueError:
        content = b""
    if not (found and content):
        raise Refused(f"has data in buffer {number} that is not base64: is it damaged?")
    return content


def _transform(node: Node) -> Array:
    """From a node to the one above it, shape (4, 4): its matrix, or translation, rotation and scale (section 3.5.3)."""
    parent_T_node = np.eye(4) if node.matrix is None else np.array(node.matrix, dtype=np.float64).reshape(4, 4).T
    if node.translation is not None:
        moved = np.eye(4)
        moved[:3, 3] = node.translation
        parent_T_node = np.dot(parent_T_node, moved)
    if node.rotation is not None:
        parent_T_node = np.dot(parent_T_node, _rotation(np.array(node.rotation, dtype=np.float64)))
    if node.scale is not None:
        parent_T_node = np.dot(parent_T_node, np.diag([*node.scale, 1.0]))
    return parent_T_node


def _rotation(quaternion: Array) -> Array:
    """The rotation by a quaternion x, y, z, w of any length, shape (4,) to (4, 4); none by one of length zero."""
    wxyz = quaternion[[3, 0, 1, 2]]
    (squared,) = np.dot(wxyz[None] ** 2, np.ones(4))  # as trimesh sums, which decides the last bit
    turned = np.eye(4)
    if squared < 4 * np.finfo(float).eps:
        return turned
    scaled = wxyz * np.sqrt(2.0 / squared)
    (_, xw, yw, zw), (_, xx, xy, xz), (_, _, yy, yz), (_, _, _, zz) = scaled[:, None] * scaled
    turned[:3, :3] = [
        [1.0 - yy - zz, xy - zw, xz + yw],
        [xy + zw, 1.0 - xx - zz, yz - xw],
        [xz - yw, yz + xw, 1.0 - xx - yy],
    ]
    return turned


def _product(transforms: list[Array]) -> Array:
    """The transforms from the scene's root to a node in one, shape (4, 4)."""
    changes = [transform for transform in transforms if not is_identity(transform)]
    if len(changes) < 2:
        return changes[0] if changes else np.eye(4)
    product: Array = np.linalg.multi_dot(changes)
    return product
