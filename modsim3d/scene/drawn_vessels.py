"""Vessels that a pose source draws: their entries are read and checked like those of a vessels file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from modsim3d.errors import InputError
from modsim3d.inputs.validation import MOST_PROBLEMS, nearest
from modsim3d.motion.poses import NamedSource, PoseRequest
from modsim3d.scene.meshes import SceneMeshes, mesh_name
from modsim3d.vessels.vessel import Vessel, parse_vessels

MOST_NAMES = 3


def drawn_vessels(
    source: NamedSource, request: PoseRequest, labels: Sequence[str] | None, meshes: SceneMeshes
) -> tuple[Vessel, ...]:
    """The vessels that a pose source draws for a scene, in its order; most sources draw none.

    Args:
        source: The source.
        request: The scene as its file describes it.
        labels: The detector's labels; None if they are not known.
        meshes: The scene's meshes; those of the vessels are added.

    Raises:
        InputError: With every problem found; each begins with the source's section of the scene file.
    """
    entries = source.vessels(request)
    if not entries:
        return ()
    section = f"poses.{source.name}"
    vessels = parse_vessels(entries, section)
    # A source of our own and any plug-in may have a key that renames labels.
    key = f": set {section}.labels" if "labels" in getattr(type(source.keys), "model_fields", {}) else ""
    problems = [*_name_problems(vessels, request), *(each + key for each in _label_problems(vessels, labels))]
    problems += _file_problems(entries, source.keys.files)
    if problems:
        raise InputError(section, problems[:MOST_PROBLEMS])
    return tuple(_with_mesh(vessel, entries[vessel.name].get("mesh"), request, meshes, section) for vessel in vessels)


def _with_mesh(vessel: Vessel, mesh: object, request: PoseRequest, meshes: SceneMeshes, section: str) -> Vessel:
    if mesh is None:
        return vessel
    solid = meshes.solid(mesh, request.folder, section, vessel.name, "mesh")
    return replace(vessel, solid=solid, shape=mesh_name(mesh))


def _name_problems(vessels: Sequence[Vessel], request: PoseRequest) -> Iterator[str]:
    taken = set(request.names or ())
    for vessel in vessels:
        if vessel.name in taken:
            yield f"draws a vessel '{vessel.name}', and the scene's vessels have one of this name: rename one of them"


def _label_problems(vessels: Sequence[Vessel], labels: Sequence[str] | None) -> Iterator[str]:
    """One problem for each label that the detector does not have."""
    if labels is None:
        return
    for label in dict.fromkeys(vessel.label for vessel in vessels if vessel.label not in labels):
        names = [vessel.name for vessel in vessels if vessel.label == label]
        more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
        yield (
            f"draws vessels with the label '{label}' ({', '.join(names[:MOST_NAMES])}{more}), which is not one of the "
            f"detector's labels ({nearest(label, labels)})"
        )


def _file_problems(entries: Mapping[str, Mapping[str, object]], files: Sequence[str]) -> Iterator[str]:
    """A copy of the scene has the files that the source names, and no others."""
    for name, entry in entries.items():
        mesh = entry.get("mesh")
        file = mesh.get("file") if isinstance(mesh, dict) else mesh
        if isinstance(file, str) and Path(file).suffix and file not in files:
            yield f"draws '{name}' with the mesh {file}, which is none of the files of the source: {list(files)}"
