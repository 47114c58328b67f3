"""Binary glTF 2.0: its description, checked against itself and its data. Section numbers are those of the glTF 2.0
specification (The Khronos Group, 2021). Materials, textures, cameras, skins and animations are not in the description
that is read here, so that nothing can be read through them."""

import base64
import json
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, BinaryIO, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.alias_generators import to_camel

from modsim3d.core.arrays import Array, Indices
from modsim3d.io.validation import Count, Number, describe
from modsim3d.world.mesh_limits import MAX_GLB_BYTES, Refusal, check_faces, check_reference, check_size, check_vertices

MAX_DESCRIPTION_BYTES = 2**23
MAX_NODES = 2000
# NumPy's name of each type of number (section 3.6.2.2).
COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
POINTS_LINES = (0, 1, 2, 3)
TRIANGLES, STRIP, FAN = 4, 5, 6
DRAWN_ONLY = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_")  # change how a mesh looks, not its shape
Item = TypeVar("Item")


class _Part(BaseModel):
    """The keys of an object of the description that are read; others are ignored."""

    model_config = ConfigDict(
        extra="ignore", frozen=True, alias_generator=to_camel, populate_by_name=True, defer_build=True
    )


class Accessor(_Part):
    """Numbers in a view (section 3.6.2)."""

    buffer_view: Count | None = None
    byte_offset: Count = 0
    component_type: Literal[5120, 5121, 5122, 5123, 5125, 5126]
    count: Annotated[int, Field(strict=True, ge=1)]
    type: Literal["SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"]
    sparse: object = None


class BufferView(_Part):
    """Bytes of a buffer (section 3.6.1)."""

    buffer: Count
    byte_offset: Count = 0
    byte_length: Count
    byte_stride: Annotated[int, Field(strict=True, ge=4, le=252)] | None = None


class _Buffer(_Part):
    byte_length: Count
    uri: str | None = None


class _Attributes(_Part):
    position: Count | None = Field(default=None, alias="POSITION")


class Primitive(_Part):
    """Triangles, lines or points (section 3.7.2)."""

    attributes: _Attributes
    indices: Count | None = None
    mode: Annotated[int, Field(strict=True, ge=0, le=6)] = TRIANGLES


class _Mesh(_Part):
    primitives: list[Primitive]


class Node(_Part):
    """A place in the scene, in that of the node above it (section 3.5)."""

    children: list[Count] | None = None
    mesh: Count | None = None
    matrix: Annotated[list[Number], Field(min_length=16, max_length=16)] | None = None
    translation: Annotated[list[Number], Field(min_length=3, max_length=3)] | None = None
    rotation: Annotated[list[Number], Field(min_length=4, max_length=4)] | None = None
    scale: Annotated[list[Number], Field(min_length=3, max_length=3)] | None = None


class _Scene(_Part):
    nodes: list[Count] = []


class _Image(_Part):
    uri: str | None = None


class Gltf(_Part):
    """Content of a file."""

    asset: dict[str, object] = {}
    scene: Count = 0
    scenes: list[_Scene] = []
    nodes: Annotated[list[Node], Field(max_length=MAX_NODES)] = []
    meshes: list[_Mesh] = []
    accessors: list[Accessor] = []
    buffer_views: list[BufferView] = []
    buffers: list[_Buffer] = []
    images: list[_Image] = []
    extensions_required: list[str] = []


@dataclass(frozen=True, eq=False)
class Glb:
    """The description of a GLB file, and its binary chunk."""

    description: Gltf
    binary: bytes


def read_glb(file: BinaryIO, size: int) -> Glb:
    """The content of a GLB file. Raises `Refusal` if it is wrong, too large, or refers to other files."""
    header = file.read(20)
    if len(header) < 20 or header[:4] != b"glTF" or header[16:20] != b"JSON":
        raise Refusal("is not a GLB file: it does not begin as binary glTF does")
    version, length, description_bytes = struct.unpack("<4xIII", header[:16])
    if version != 2:
        raise Refusal(f"is glTF version {version}; version 2 is needed")
    if length != size:
        raise Refusal(f"has {size} bytes where its header announces {length}: is it cut off?")
    if description_bytes > MAX_DESCRIPTION_BYTES:
        most = f"at most {MAX_DESCRIPTION_BYTES} are read: simplify it"
        raise Refusal(f"has a description of {description_bytes} bytes; {most}")
    gltf = _parse(file.read(description_bytes))
    _check_references(gltf)
    _check_counts(gltf)
    check_size(size, MAX_GLB_BYTES)
    rest = file.read(size)
    announced = struct.unpack("<I", rest[:4])[0] if rest[4:8] == b"BIN\0" else 0
    binary = rest[8 : 8 + announced]
    if len(binary) < announced:
        raise Refusal(f"has {len(binary)} bytes of data where it announces {announced}: is it cut off?")
    _check_ranges(gltf, len(binary))
    return Glb(gltf, binary)


def _parse(description: bytes) -> Gltf:
    try:
        return Gltf.model_validate(json.loads(description))
    except ValidationError as error:
        raise Refusal(f"has a faulty description: {describe(error, Gltf)[0]}") from None
    except (ValueError, RecursionError) as error:
        raise Refusal(f"has a description that is not JSON ({type(error).__name__}): is it damaged?") from None


def _check_references(gltf: Gltf) -> None:
    """Refuse geometry in other files, and references that are remote or lead out of the folder."""
    for image in gltf.images:
        if image.uri is not None and not image.uri.startswith("data:"):
            check_reference(image.uri, "image")
    for buffer in gltf.buffers:
        if buffer.uri is not None and not buffer.uri.startswith("data:"):
            check_reference(buffer.uri, "buffer")
            raise Refusal(f"keeps its geometry in another file, {buffer.uri[:80]!r}: export it as one GLB file")
    for name in gltf.extensions_required:
        if not name.startswith(DRAWN_ONLY):
            raise Refusal(f"needs the glTF extension {name[:80]!r}, which is not read: export it without")


def _one_of(items: Sequence[Item], index: int, what: str) -> Item:
    if index >= len(items):
        raise Refusal(f"has no {what} {index}, only {len(items)}: is it damaged?")
    return items[index]


def _check_counts(gltf: Gltf) -> None:
    """Check faces and vertices of the accessors, each mesh as often as the scene shows it (section 3.7.2)."""
    shown = _times_shown(gltf)
    faces = vertices = 0
    for mesh, times in zip(gltf.meshes, shown, strict=True):
        for primitive in mesh.primitives:
            faces += times * _faces(gltf, primitive)
            vertices += max(times, 1) * positions_of(gltf, primitive).count
    check_faces(faces)
    check_vertices(vertices)


def _times_shown(gltf: Gltf) -> list[int]:
    """Number of times that the scene shows each mesh; its nodes must form trees (section 3.5.2)."""
    if gltf.scene >= len(gltf.scenes):
        raise Refusal(f"has no scene {gltf.scene}, only {len(gltf.scenes)}: export it with a scene")
    shown = [0] * len(gltf.meshes)
    seen: set[int] = set()
    waiting = list(gltf.scenes[gltf.scene].nodes)
    while waiting:
        index = waiting.pop()
        node = _one_of(gltf.nodes, index, "node")
        if index in seen:
            raise Refusal(f"has node {index} in two places of its scene; its nodes must form trees")
        seen.add(index)
        waiting += node.children or []
        if node.mesh is not None:
            _one_of(gltf.meshes, node.mesh, "mesh")
            shown[node.mesh] += 1
    return shown


def _accessor(gltf: Gltf, index: int, kind: str) -> Accessor:
    accessor = _one_of(gltf.accessors, index, "accessor")
    if accessor.type != kind or (kind == "SCALAR" and accessor.component_type not in (5121, 5123, 5125)):
        raise Refusal(f"has accessor {index} of a type that positions or indices cannot be: is it damaged?")
    if accessor.sparse is not None:
        raise Refusal(f"has accessor {index} stored sparsely, which is not read: export it without")
    return accessor


def positions_of(gltf: Gltf, primitive: Primitive) -> Accessor:
    """The accessor of the positions of a primitive. Raises `Refusal` if it has none."""
    if primitive.attributes.position is None:
        raise Refusal("has a mesh without positions: is it damaged?")
    return _accessor(gltf, primitive.attributes.position, "VEC3")


def indices_of(gltf: Gltf, primitive: Primitive) -> Accessor | None:
    """The accessor of the indices of a primitive, None if its positions are in order. Raises `Refusal` for others."""
    return None if primitive.indices is None else _accessor(gltf, primitive.indices, "SCALAR")


def view_of(gltf: Gltf, accessor: Accessor) -> BufferView:
    """The bytes that an accessor is in. Raises `Refusal` if there are none."""
    if accessor.buffer_view is None or accessor.buffer_view >= len(gltf.buffer_views):
        raise Refusal("has an accessor without data: is it compressed or damaged?")
    return gltf.buffer_views[accessor.buffer_view]


def _faces(gltf: Gltf, primitive: Primitive) -> int:
    """Triangles of a primitive; points and lines are none (section 3.7.2.1)."""
    corners = (indices_of(gltf, primitive) or positions_of(gltf, primitive)).count
    if primitive.mode == FAN:
        raise Refusal("has triangle fans, which are not read: export it with triangles")
    if primitive.mode in POINTS_LINES:
        return 0
    return max(corners - 2, 0) if primitive.mode == STRIP else corners // 3


def _check_ranges(gltf: Gltf, binary_bytes: int) -> None:
    """Refuse accessors that reach beyond their view, and views beyond their buffer (section 3.6.2.4)."""
    for number, view in enumerate(gltf.buffer_views):
        buffer = gltf.buffers[view.buffer] if view.buffer < len(gltf.buffers) else None
        limit = 0 if buffer is None else buffer.byte_length if buffer.uri else min(buffer.byte_length, binary_bytes)
        if view.byte_offset + view.byte_length > limit:
            raise Refusal(f"has buffer view {number} reaching beyond its data of {limit} bytes: is it damaged?")
    primitives = [primitive for mesh in gltf.meshes for primitive in mesh.primitives]
    used = (index for part in primitives for index in (part.attributes.position, part.indices))
    for number in sorted({index for index in used if index is not None}):
        accessor = gltf.accessors[number]
        view = view_of(gltf, accessor)
        item = np.dtype(COMPONENTS[accessor.component_type]).itemsize * (3 if accessor.type == "VEC3" else 1)
        end = accessor.byte_offset + (accessor.count - 1) * (view.byte_stride or item) + item
        if end > view.byte_length:
            held = f"{accessor.count} items in {view.byte_length} bytes"
            raise Refusal(f"has accessor {number} with {held}: is it cut off?")


NO_CHANGE = 1e-8  # a transform that differs less than this from the identity is taken for it


@dataclass(frozen=True, eq=False)
class MeshPart:
    """A part of a file: its vertices (K, 3), their indices in its faces (F, 3), and its transform (4, 4)."""

    vertices: Array
    faces: Indices
    file_T_part: Array


def joined(parts: Iterable[MeshPart]) -> tuple[Array, Indices]:
    """Vertices and faces of all parts with their transforms applied, shapes (K, 3) and (F, 3). Raises `Refusal` if
    there are no faces or too many, or a part contradicts itself."""
    vertices: list[Array] = []
    faces: list[Indices] = []
    count = 0
    for part in parts:
        if len(part.faces):
            _check(part)
            mirrors = np.linalg.det(part.file_T_part[:3, :3]) < 0  # which turns a part inside out
            faces.append((part.faces[:, ::-1] if mirrors else part.faces) + count)
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


def _check(part: MeshPart) -> None:
    """Refuse vertices without three coordinates, and faces with vertices that do not exist."""
    vertices, faces = part.vertices, part.faces
    if vertices.shape[1] != 3 or faces.shape[1] != 3:
        raise Refusal(f"has vertices of {vertices.shape[1]} coordinates; three are needed, x, y and z")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise Refusal(f"has faces that use vertex {int(faces.max())} of {len(vertices)}: is it damaged?")


def glb_parts(glb: Glb) -> Iterator[MeshPart]:
    """Each primitive of the scene as often as the scene shows it. Raises `Refusal` for damaged data."""
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


def _part(glb: Glb, primitive: Primitive, file_T_part: Array) -> MeshPart:
    vertices = _numbers(glb, positions_of(glb.description, primitive)).astype(np.float64)
    indices = indices_of(glb.description, primitive)
    corners = np.arange(len(vertices)) if indices is None else _numbers(glb, indices).astype(np.int64).ravel()
    return MeshPart(vertices, _primitive_faces(corners, primitive.mode), file_T_part)


def _primitive_faces(corners: Indices, mode: int) -> Indices:
    """Triangles, shape (F, 3), from the corners of a list or a strip of them, shape (n,) (section 3.7.2.1)."""
    if mode == STRIP:
        faces = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
        faces[1::2] = faces[1::2, ::-1]
        return faces
    if len(corners) % 3:
        raise Refusal(f"has triangles with {len(corners)} corners, which cannot be divided by three: is it damaged?")
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
        raise Refusal(f"has only {len(data)} bytes of data in buffer {view.buffer}: is it damaged?") from None


def _data(glb: Glb, number: int) -> bytes:
    """The content of a buffer: text in its URI, or the binary chunk (section 3.6.1)."""
    uri = glb.description.buffers[number].uri
    if uri is None:
        return glb.binary
    _, marker, text = uri.partition("base64,")
    try:
        content = base64.b64decode(text)
    except ValueError:
        content = b""
    if not (marker and content):
        raise Refusal(f"has data in buffer {number} that is not base64: is it damaged?")
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
