"""Solids from mesh files. A mesh file may come from anywhere, so it is not trusted: its size is checked from its header
before it is parsed, it is parsed from memory without access to folders or the network, and the result is checked
again."""

import io
import logging
import stat
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np
from pydantic import ValidationError

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.errors import InputError
from modsim3d.io.input_files import data_folder
from modsim3d.io.validation import Strict, describe, join_path, nearest, shown
from modsim3d.world.mesh_glb import MeshPart, glb_parts, joined, read_glb
from modsim3d.world.mesh_limits import Refusal, leads_outside, read_obj, read_ply, read_stl
from modsim3d.world.vessels import Solid, to_solid

Axis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
Reader = Callable[[BinaryIO, int], bytes]
GLB = ".glb"
READERS: dict[str, Reader] = {".obj": read_obj, ".stl": read_stl, ".ply": read_ply}
GLTF_AXES: tuple[Axis, Axis] = ("+z", "+y")  # forward and up in every glTF file (glTF 2.0, section 3.4)
PLAIN_AXES: tuple[Axis, Axis] = ("+x", "+z")  # forward and up for formats without a rule; our choice


class MeshEntry(Strict):
    """A mesh file with its axes; None for those of the format."""

    file: str
    forward: Axis | None = None
    up: Axis | None = None


@cache
def shipped_meshes() -> dict[str, Path]:
    """Files of the shipped meshes, by name."""
    return {path.stem: path for path in sorted(data_folder("meshes").glob("*.glb"))}


def load_mesh(entry: object, folder: Path, source: str = "mesh", *prefix: object) -> Solid:
    """The solid of a mesh entry of a scene; its faces have two sides if it is open (`closed` is False). The entry is a
    shipped mesh's name, a file relative to the folder, outside which none is read, or a mapping of `file`, `forward`
    and `up`. Raises InputError if the entry or the file is wrong; it names `source`, the file with the entry, and the
    keys that lead to it."""
    where = prefix or ("mesh",)
    shipped = shipped_meshes()
    if isinstance(entry, str) and entry in shipped:
        return to_solid(*_triangles(shipped[entry]), *GLTF_AXES)
    if not isinstance(entry, str | dict):
        needed = "the name of a shipped mesh, a file, or a mapping of file, forward and up is needed"
        raise InputError(source, [f"{join_path(*where)}: {needed} (got {shown(entry)})"])
    try:
        parsed = MeshEntry.model_validate({"file": entry} if isinstance(entry, str) else entry)
    except ValidationError as error:
        raise InputError(source, describe(error, MeshEntry, *where)) from None
    try:
        path = _find(parsed.file, folder)
        axes = GLTF_AXES if path.suffix.lower() == GLB else PLAIN_AXES
        forward, up = parsed.forward or axes[0], parsed.up or axes[1]
        if forward[1] == up[1]:
            raise Refusal(f"has forward {forward} and up {up}; two different axes are needed")
        return to_solid(*_triangles(path), forward, up)
    except Refusal as problem:
        raise InputError(source, [f"{join_path(*where)}: {shown(parsed.file)} {problem}"]) from None


def _find(file: str, folder: Path) -> Path:
    """The path of a mesh file, which must lie in the folder and have a known ending."""
    if not file or not file.isprintable():
        raise Refusal("cannot be a file's name")
    if leads_outside(file):
        raise Refusal("is remote or outside the scene's folder: put the mesh into that folder, and name it from there")
    suffix = Path(file).suffix.lower()
    if suffix not in (GLB, *READERS):
        hint = nearest(file, shipped_meshes())
        raise Refusal(f"is no shipped mesh ({hint}), and no file that ends in one of {', '.join((GLB, *READERS))}")
    path = folder / file
    try:
        if not path.resolve().is_relative_to(folder.resolve()):
            raise Refusal("is a link that leads out of the scene's folder: put the mesh itself there")
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise Refusal("does not exist") from None
    except (OSError, RuntimeError) as error:  # a loop of links is a RuntimeError before Python 3.13
        raise Refusal(f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if not stat.S_ISREG(mode):
        raise Refusal(f"is {'a folder' if stat.S_ISDIR(mode) else 'no ordinary file'}; a mesh file was expected")
    return path


def _triangles(path: Path) -> tuple[Array, Indices]:
    """Vertices and faces of a mesh file in its own axes, shapes (K, 3) and (F, 3)."""
    suffix = path.suffix.lower()
    try:
        with path.open("rb") as file:
            size = path.stat().st_size
            if size == 0:
                raise Refusal("is empty")
            if suffix != GLB:
                return joined(_parts(file, size, suffix))
            with np.errstate(all="ignore"):  # vertices that are not finite are refused later
                return joined(glb_parts(read_glb(file, size)))
    except OSError as error:
        raise Refusal(f"cannot be read: {error.strerror}") from None


def _parts(file: BinaryIO, size: int, suffix: str) -> Iterator[MeshPart]:
    import trimesh  # takes 0.3 s, and most meshes are in GLB

    content, kind = READERS[suffix](file, size), suffix[1:]
    try:
        with _strictly():
            scene = trimesh.load_scene(io.BytesIO(content), file_type=kind, skip_materials=True, process=False)
    except Exception as error:  # a parser may raise anything on a damaged file
        raise Refusal(f"cannot be read as {kind.upper()}: {_brief(error)}") from None
    for name in scene.graph.nodes_geometry:
        transform, geometry = scene.graph[name]
        part = scene.geometry[geometry]
        if isinstance(part, trimesh.Trimesh):
            yield MeshPart(part.vertices.view(np.ndarray), np.asarray(part.faces, dtype=np.int64), transform)


@contextmanager
def _strictly() -> Iterator[None]:
    """Make warnings errors, since NumPy only warns of invalid numbers in text; keep trimesh from logging."""
    log = logging.getLogger("trimesh")
    level = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            yield
    finally:
        log.setLevel(level)


def _brief(error: Exception) -> str:
    text = " ".join(str(error).split()) + (" is missing" if isinstance(error, KeyError) else "")
    return (text[:100] + "...") if len(text) > 100 else text or type(error).__name__
