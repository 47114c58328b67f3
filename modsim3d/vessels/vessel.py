"""Vessels: dimensions, label and shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from pydantic import BeforeValidator, ValidationError, field_validator

from modsim3d.arrays import Array, Indices, read_only
from modsim3d.errors import InputError
from modsim3d.inputs.strict_json import load_json
from modsim3d.inputs.validation import MOST_PROBLEMS, Limits, Strict, describe, join_path, kind_of, shown

if TYPE_CHECKING:
    import trimesh

    from modsim3d.vessels.meshes.fit import FileBox


T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Solid:
    """The shape of something, without place or size: a triangle mesh.

    A vessel's solid fills the unit box of VCF, in units of its length, beam and air draft, so that vessels of all sizes
    share one. `Bodies` give solids their size and place in the world.

    Attributes:
        vertices: v1, v2 in [−1/2, 1/2] and v3 in [0, 1], shape (K, 3).
        faces: Vertex indices, counter-clockwise seen from outside, shape (F, 3).
        convex: Whether the mesh is its own convex hull.
        closed: Whether the faces enclose a volume and all point outward, so that back faces are hidden.
        file_box: Its bounding box in the mesh file, where it comes from one.
    """

    vertices: Array
    faces: Indices
    convex: bool = True
    closed: bool = True
    file_box: FileBox | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        """Make copies in other processes of this; there too, the shoebox is one object, which `has_mesh` asks for."""
        if self is shoebox():
            return shoebox, ()
        return Solid, (self.vertices, self.faces, self.convex, self.closed, self.file_box)


def once_a_solid(work_out: Callable[[Solid], T]) -> Callable[[Solid], T]:
    """A function whose result for a solid is kept for as long as the solid is there.

    `functools.cache` would keep the solids of all scenes that a process has had: of a campaign, those of each run.
    """
    kept: WeakKeyDictionary[Solid, T] = WeakKeyDictionary()

    def result_for(solid: Solid) -> T:
        if solid not in kept:
            kept[solid] = work_out(solid)
        return kept[solid]

    return result_for


@cache
def shoebox() -> Solid:
    """The unit shoebox: `trimesh.creation.box`, moved so that its origin is the centre of its bottom.

    Its vertices and faces are constants here, since importing trimesh adds 0.3 s to the 1.2 s of processor time of a
    cold start (medians of 7 runs of `simulation_1 --steps 10` each way, in turn). `trimesh.creation` alone takes no
    less, because trimesh's own `__init__` imports all of it.
    """
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

    `shape` is the name of its mesh, empty if it has none.
    """

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
    """Vessels from the mapping of Figure 7.2: ID → length, beam, air draft, label.

    `source` is the name of the file in errors, and `prefix` the keys that lead to the mapping in it.

    Raises:
        InputError: With every problem found.
    """
    where = join_path(*prefix) or "top level"
    if not isinstance(data, dict):
        raise InputError(source, [f"{where}: {MAPPING_NEEDED} (got {kind_of(data)})"])
    problems = [] if data else [f"{where}: no vessels; a scene needs at least one"]
    vessels = []
    for name, raw in data.items():
        if len(problems) >= MOST_PROBLEMS:
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
    """The mapping in a vessels file; its vessels are not checked.

    Raises:
        InputError: The file cannot be read or holds no mapping.
    """
    data = load_json(path, "vessels file")
    if not isinstance(data, dict):
        raise InputError(f"vessels file {path}", [f"top level: {MAPPING_NEEDED} (got {kind_of(data)})"])
    return data
