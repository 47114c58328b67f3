"""Vessels: dimensions, label and shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import permutations
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from pydantic import BeforeValidator, ValidationError, field_validator

from modsim3d.core.arrays import Array, Indices, read_only
from modsim3d.core.errors import InputError
from modsim3d.io.plugins import SHAPES, Plugin, failed, load_plugin
from modsim3d.io.strict_text import load_json
from modsim3d.io.validation import MAX_PROBLEMS, Limits, Strict, describe, join_path, kind_of, shown
from modsim3d.world.mesh_limits import MAX_COORDINATE, Refusal, check_faces, check_vertices

if TYPE_CHECKING:
    import trimesh

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Solid:
    """The shape of something, without place or size: a triangle mesh. A vessel's solid fills the unit box of VCF, in
    units of its length, beam and air draft, so that vessels of all sizes share one; `Bodies` place it."""

    vertices: Array  # v1, v2 in [−1/2, 1/2] and v3 in [0, 1]: (K, 3)
    faces: Indices  # vertex indices, counter-clockwise seen from outside: (F, 3)
    convex: bool = True  # whether the mesh is its own convex hull
    closed: bool = True  # whether the faces enclose a volume and all point outward, so that back faces are hidden
    file_box: FileBox | None = None  # its bounding box in the mesh file, where it comes from one

    def __reduce__(self) -> tuple[Any, ...]:
        """Make copies in other processes of this; there too, the shoebox is one object, which `has_mesh` asks for."""
        if self is shoebox():
            return shoebox, ()
        return Solid, (self.vertices, self.faces, self.convex, self.closed, self.file_box)


def once_a_solid(work_out: Callable[[Solid], T]) -> Callable[[Solid], T]:
    """A function whose result for a solid is kept for as long as the solid is there. `functools.cache` would keep the
    solids of all scenes that a process has had: of a campaign, those of each run."""
    kept: WeakKeyDictionary[Solid, T] = WeakKeyDictionary()

    def result_for(solid: Solid) -> T:
        if solid not in kept:
            kept[solid] = work_out(solid)
        return kept[solid]

    return result_for


@cache
def shoebox() -> Solid:
    """The unit shoebox: `trimesh.creation.box`, moved so that its origin is the centre of its bottom. Its vertices and
    faces are constants here, since importing trimesh adds 0.3 s to the 1.2 s of processor time of a cold start (medians
    of 7 runs of `simulation_1 --steps 10` each way, in turn). `trimesh.creation` alone takes no less, because trimesh's
    own `__init__` imports all of it."""
    vertices = read_only([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
    # Counter-clockwise seen from outside; corner 4 i + 2 j + k is at the i-th x, j-th y, k-th z.
    corners = [(1, 3, 0), (4, 1, 0), (0, 3, 2), (2, 4, 0), (1, 7, 3), (5, 1, 4)]
    corners += [(5, 7, 1), (3, 7, 2), (6, 4, 2), (2, 7, 6), (6, 5, 4), (7, 5, 6)]
    faces = np.array(corners, dtype=np.int64)
    faces.setflags(write=False)
    return Solid(vertices, faces)


@dataclass(frozen=True)
class Vessel:
    """A vessel as the scene describes it: its ID, its true class, its extents along v1, v2 and v3, and its shape.
    `shape` is the name of its mesh, empty if it has none."""

    name: str
    label: str
    length_m: float
    beam_m: float
    air_draft_m: float
    solid: Solid = field(default_factory=shoebox)
    shape: str = ""

    @cached_property
    def extents_m(self) -> Array:
        """Length, beam and air draft in metres, read-only, shape (3,)."""
        return read_only([self.length_m, self.beam_m, self.air_draft_m])

    @cached_property
    def reach_m(self) -> float:
        """Greatest distance from the origin of VCF to a point of the vessel, or more."""
        return float(np.linalg.norm(self.extents_m))

    @cached_property
    def triangles_m(self) -> Array:
        """Corners of the triangles of `to_trimesh`, read-only, shape (F, 3, 3)."""
        return read_only((self.solid.vertices * self.extents_m)[self.solid.faces])

    def to_trimesh(self) -> trimesh.Trimesh:
        """The very solid that is drawn, in VCF, scaled to length × beam × air draft, in metres."""
        import trimesh  # takes 0.3 s

        return trimesh.Trimesh(self.solid.vertices * self.extents_m, self.solid.faces.copy(), process=False)

    @property
    def has_mesh(self) -> bool:
        """Whether its shape is not the shoebox."""
        return self.solid is not shoebox()


MAPPING_NEEDED = "a mapping of vessel ID to vessel is needed"
MIN_EXTENT_M, MAX_EXTENT_M = 1e-3, 1e5
Extent = Annotated[float, Limits(allow_inf_nan=False, ge=MIN_EXTENT_M, le=MAX_EXTENT_M)]


def _mesh_entry(entry: object) -> object:
    texts = entry.values() if isinstance(entry, dict) else [entry]
    if all(isinstance(text, str) for text in texts):
        return entry
    needed = "the name of a shipped mesh, a file, or a mapping of file, forward and up is needed"
    raise ValueError(f"{needed} (got {shown(entry)})")


MeshName = Annotated[str | dict[str, str], BeforeValidator(_mesh_entry)]


class VesselEntry(Strict):
    """One vessel of a vessels file (Jessen & Mohr (2023), Figure 7.2). `mesh` is ours; `SceneMeshes` reads it."""

    length_m: Extent
    beam_m: Extent
    air_draft_m: Extent
    label: str
    mesh: MeshName | None = None

    @field_validator("label")
    @classmethod
    def _printable(cls, label: str) -> str:
        if not label.isprintable():
            raise ValueError(f"a label must be printable text (got {label!r})")
        return label


def name_problem(name: str) -> str | None:
    """Reason why a text cannot be a vessel's ID; None if it can."""
    if not name:
        return "a vessel's ID must not be empty"
    if not name.isprintable():
        return f"a vessel's ID must be printable text (got {name!r})"
    if "#" in name:
        return "a vessel's ID must not hold '#', which marks a second box of a vessel"
    for prefix, marked in (("false_positive_", "false positives"), ("obstacle:", "obstacles")):
        if name.startswith(prefix):
            return f"a vessel's ID must not begin with '{prefix}', which marks {marked}"
    return None


def parse_vessels(data: object, source: str, *prefix: object) -> tuple[Vessel, ...]:
    """Vessels from the mapping of Figure 7.2: ID → length, beam, air draft, label. `source` is the name of the file in
    errors, and `prefix` the keys that lead to the mapping in it. Raises InputError with every problem found."""
    where = join_path(*prefix) or "top level"
    if not isinstance(data, dict):
        raise InputError(source, [f"{where}: {MAPPING_NEEDED} (got {kind_of(data)})"])
    problems = [] if data else [f"{where}: no vessels; a scene needs at least one"]
    vessels = []
    for name, raw in data.items():
        if len(problems) >= MAX_PROBLEMS:
            problems.append("… (the rest was not checked)")
            break
        if problem := name_problem(str(name)):
            problems.append(f"{join_path(*prefix, str(name))}: {problem}")
        try:
            entry = VesselEntry.model_validate(raw)
        except ValidationError as error:
            problems += describe(error, VesselEntry, *prefix, str(name))
        else:
            vessels.append(Vessel(str(name), entry.label, entry.length_m, entry.beam_m, entry.air_draft_m))
    if problems:
        raise InputError(source, problems)
    return tuple(vessels)


def load_mapping(path: Path) -> dict[str, Any]:
    """The mapping in a vessels file, its vessels unchecked. Raises InputError if it cannot be read or holds none."""
    data = load_json(path, "vessels file")
    if not isinstance(data, dict):
        raise InputError(f"vessels file {path}", [f"top level: {MAPPING_NEEDED} (got {kind_of(data)})"])
    return data


# ---- Whether a mesh goes with its vessel ----

MAX_STRETCH, CLEARLY_BETTER = 3.0, 2.0
"""Axes do not fit if their scales differ by more, and others fit if they lessen that by such a factor."""
MAX_SPECK = 1 / 3  # the vessel is a speck if it is less than this share of its file in some direction
UNIT_BOX = 1.01  # extents that differ less were made equal on purpose, as in shipped meshes: they do not tell axes


@dataclass(frozen=True, eq=False)
class FileBox:
    """Extents of a mesh to the bow, to port and up, shape (3,), in the unit of its file, and its axes to bow and up."""

    extents: Array
    forward: str
    up: str

    @property
    def letters(self) -> str:
        """The file's axes along the extents."""
        forward, up = self.forward[1], self.up[1]
        return forward + "xyz".replace(forward, "").replace(up, "") + up

    def in_words(self, extents: Array) -> str:
        """Extents in the order of the file's axes."""
        return " × ".join(f"{extents[self.letters.index(letter)]:.4g}" for letter in "xyz")


def misfit(solid: Solid, size_m: Array) -> str | None:
    """Misfit of a mesh with its length, beam and air draft (3,), as text after its name; None if it fits."""
    box = solid.file_box
    if box is None:
        return None
    extents, size = box.extents, " × ".join(f"{side:.4g}" for side in size_m)
    measures = f"measures {box.in_words(extents)} along x, y and z of its file; "
    stretches = _stretches(extents, size_m)
    stretch, order = stretches[0, 1, 2], min(stretches, key=stretches.__getitem__)
    if stretch > MAX_STRETCH:
        faces, rest = _without_farthest_part(solid, extents)
        if (rest < MAX_SPECK * extents).any() and min(_stretches(rest, size_m).values()) <= MAX_STRETCH:
            without = f"without one part of {faces} faces it would measure {box.in_words(rest)}"
            return f"{measures}{without}, which fits {size} m: take that part out of the file"
    fits = stretches[order] <= min(stretch / CLEARLY_BETTER, MAX_STRETCH)
    if extents.max() <= UNIT_BOX * extents.min() or (stretch <= MAX_STRETCH and not fits):
        return None
    forward, _, up = (box.letters[axis] for axis in order)
    better = f'forward: "+{forward}" or "-{forward}", up: "+{up}" would fit'
    return (
        f'{measures}with forward "{box.forward}" and up "{box.up}" it is stretched {stretch:.2g} times as much along '
        f"one axis as along another, to the length × beam × air draft of {size} m: "
        + (better if fits else "look at its axes (forward, up), at these sizes, and at what else is in the file")
    )


def _stretches(extents: Array, size_m: Array) -> dict[tuple[int, ...], float]:
    """Greatest scale of an axis over the least, from extents in the file to sizes, with each order of the axes."""
    scales = {order: size_m / np.maximum(extents[list(order)], 1e-9) for order in permutations(range(3))}
    return {order: float(scale.max() / scale.min()) for order, scale in scales.items()}


def _without_farthest_part(solid: Solid, extents: Array) -> tuple[int, Array]:
    """Faces of the part, of those without common vertices, without which the rest is smallest, and its extents."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components  # takes 0.1 s

    starts, ends = solid.faces[:, [0, 1]].ravel(), solid.faces[:, [1, 2]].ravel()
    links = coo_array((np.ones(len(starts)), (starts, ends)), shape=(len(solid.vertices),) * 2)
    count, part = connected_components(links, directed=False)
    if count == 1:
        return 0, extents
    lows, highs = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(lows, part, solid.vertices)
    np.maximum.at(highs, part, solid.vertices)
    (low, next_low), (high, next_high) = np.sort(lows, axis=0)[:2], np.sort(highs, axis=0)[:-3:-1]
    rests = np.where(highs == high, next_high, high) - np.where(lows == low, next_low, low)
    left_out = int(np.argmin(rests.sum(axis=1)))
    return int((part[solid.faces[:, 0]] == left_out).sum()), rests[left_out] * extents


# ---- From triangles in a file's own axes and units to a solid in units of length ----

SAME_VERTEX = 1e-7  # closer vertices, in units of the box, are merged: STL repeats each, in single precision
MAX_FACES_OF_CONVEX = 64  # convex meshes with more count as not convex: sorting by their planes would take too long
EXTENTS = ("length", "beam", "height")


def axis(name: str) -> Array:
    """The unit vector that `+x` or `-z` names, shape (3,)."""
    direction: Array = np.eye(3)["xyz".index(name[1])]
    return direction if name[0] == "+" else -direction


def vehicle_R_file(forward: str, up: str) -> Array:
    """The rotation from a file's axes to VCF, shape (3, 3)."""
    return np.array([axis(forward), np.cross(axis(up), axis(forward)), axis(up)])


def to_solid(vertices: Array, faces: Indices, forward: str, up: str) -> Solid:
    """The solid of a mesh, its bounding box scaled to the unit box. The vertices (K, 3) are in any unit; faces are
    their indices (F, 3). `forward` and `up` are the axes of the file that point to the bow and up, such as `+x`. Raises
    `Refusal` if a vertex is not finite, there are no faces, or the mesh is flat along an axis."""
    check_faces(len(faces))
    check_vertices(len(vertices))
    bad = ~(np.abs(vertices) <= MAX_COORDINATE).all(axis=1)
    if bad.any():
        first = int(np.argmax(bad))
        value = [float(x) for x in vertices[first]]
        raise Refusal(
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
    convex = closed and len(faces) <= MAX_FACES_OF_CONVEX and _is_convex(vertices, abs(volume))
    return Solid(vertices, faces, convex=convex, closed=closed, file_box=FileBox(extents, forward, up))


def _unit_box(vertices: Array) -> tuple[Array, Array]:
    """Vertices, shape (K, 3), scaled and moved so that they fill the unit box exactly, and their extents before."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    extents = high - low
    # A flat mesh that was rotated or stored in single precision has some rounding.
    rounding = 1e-6 * float(extents.max())
    if (extents <= rounding).any():
        flat = [name for name, extent in zip(EXTENTS, extents, strict=True) if extent <= rounding]
        raise Refusal(f"has no {' and no '.join(flat)}: a solid is needed, or other axes (`forward` and `up`)")
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
    from scipy.spatial import ConvexHull, QhullError  # takes 0.1 s

    try:
        return bool(np.isclose(ConvexHull(vertices).volume, volume, rtol=1e-9, atol=0.0))
    except QhullError:
        return False


LOW, HIGH = np.array([-0.5, -0.5, 0.0]), np.array([0.5, 0.5, 1.0])
"""Corners of the box that a shape fills, in units of length, beam and air draft, each of shape (3,)."""
SLACK = 1e-6


def find_shape(name: str, path: str, built_in: tuple[str, ...] = ()) -> tuple[Solid, Plugin]:
    """A vessel shape of the group `modsim3d.shapes`. The plug-in is a function without arguments that returns vertices
    (K, 3) and faces (F, 3) of a closed triangle mesh: v1 forward and v2 to port from −1/2 to 1/2, v3 up from 0 to 1, in
    units of length, beam and air draft; faces are counter-clockwise seen from outside. Errors name the path of the key;
    `built_in` are names that need no plug-in, for the hint at an unknown name. Raises InputError if there is no such
    plug-in, it fails, or it returns something else."""
    function, plugin = load_plugin(SHAPES, name, path, built_in)
    if not callable(function):
        raise InputError(path, [f"{plugin} must be a function that returns vertices and faces, not {function!r}"])
    try:
        vertices, faces = function()
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
    """Reason why vertices (K, 3), in units of the extents, and faces (F, 3) are no vessel's shape, or None."""
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
