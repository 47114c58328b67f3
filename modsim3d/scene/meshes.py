"""Meshes of the vessels and obstacles of a scene: each is read once and copied with the scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from modsim3d.errors import InputError
from modsim3d.inputs.plugins import Plugin
from modsim3d.inputs.validation import join_path
from modsim3d.scene.keys import ObstacleKeys
from modsim3d.vessels.meshes import load_mesh, shipped_meshes
from modsim3d.vessels.meshes.shape import is_closed
from modsim3d.vessels.obstacles import Obstacle, extruded, placed
from modsim3d.vessels.shapes import find_shape
from modsim3d.vessels.vessel import Solid


class SceneMeshes:
    """The meshes that a scene names. Equal entries of one folder share a solid, so that they are handled together."""

    def __init__(self) -> None:
        """Start without meshes."""
        self._solids: dict[bytes, Solid] = {}
        self.files: dict[str, Path] = {}
        """Path in a copy of the scene → original mesh file."""
        self.plugins: list[Plugin] = []
        """Plug-ins that gave shapes."""

    def solid(self, entry: object, folder: Path, source: str, *path: object) -> Solid:
        """The solid of an entry; see `load_mesh`.

        Raises:
            InputError: The entry or the file is wrong.
        """
        key = orjson.dumps([str(folder), entry], default=str)
        if key not in self._solids:
            self._solids[key] = self._load(entry, folder, source, *path)
        return self._solids[key]

    def _load(self, entry: object, folder: Path, source: str, *path: object) -> Solid:
        if not isinstance(entry, str) or entry in shipped_meshes() or Path(entry).suffix:
            return load_mesh(entry, folder, source, *path)
        try:
            solid, plugin = find_shape(entry, join_path(*path), tuple(shipped_meshes()))
        except InputError as error:
            raise InputError(source, [f"{error.source}: {problem}" for problem in error.problems]) from error
        self.plugins.append(plugin)
        return replace(solid, convex=False, closed=is_closed(solid.faces))

    def copied(self, entry: object, folder: Path) -> object:
        """The entry as a copy of the scene has it, where meshes lie in a folder of their own."""
        file = entry.get("file") if isinstance(entry, dict) else entry
        if not isinstance(file, str):
            return entry
        if isinstance(entry, str) and entry in shipped_meshes():
            return self._name_of(shipped_meshes()[entry])
        if not Path(file).suffix:
            return entry  # a shape from a plug-in
        name = self._name_of(folder / file)
        return {**entry, "file": name} if isinstance(entry, dict) else name

    def copied_all(self, entries: Mapping[Any, Any], folder: Path) -> dict[Any, Any]:
        """Vessels or obstacles with the mesh names of a copy of the scene."""
        return {
            name: {**entry, "mesh": self.copied(entry["mesh"], folder)} if entry.get("mesh") else entry
            for name, entry in entries.items()
        }

    def _name_of(self, source: Path) -> str:
        """Name of a mesh file in the copy: its own unless that is taken, so that a copy of the copy has the same."""
        name, number = f"meshes/{source.name}", 0
        while self.files.setdefault(name, source) != source:
            number += 1
            name = f"meshes/{number}_{source.name}"
        return name


def mesh_name(entry: object) -> str:
    """The name of the mesh of an entry, without folder and ending: the same in a scene and in its copy."""
    return Path(str(entry.get("file", "") if isinstance(entry, dict) else entry)).stem


def read_obstacle(name: str, keys: ObstacleKeys, meshes: SceneMeshes, folder: Path, scene: str) -> Obstacle:
    """An obstacle of a scene file in a folder, whose mesh is added to those of the scene.

    Raises:
        InputError: The name is not printable, or the mesh cannot be read.
    """
    where = join_path("obstacles", name)
    if not name or not name.isprintable():
        raise InputError(scene, [f"{where}: an obstacle's name must be printable text (got {name!r})"])
    if keys.polygon_m is not None:
        return Obstacle(name, extruded(np.array(keys.polygon_m), keys.base_m, keys.height_m or 0.0))
    solid = meshes.solid(keys.mesh, folder, scene, "obstacles", name, "mesh")
    return Obstacle(name, (placed(solid, np.array(keys.size_m), np.array(keys.position_m), keys.heading_rad),))
