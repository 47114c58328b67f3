"""What a scene was read from, kept beside what came out of it: a run can be looked at and repeated from its folder."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson
from pydantic import BaseModel

from modsim3d.scene_file import AnnotationKeys, SceneKeys


@dataclass(frozen=True, eq=False)
class SceneCopy:
    """A scene's file and the files that it names.

    Attributes:
        name: Of the scene.
        document: The scene file's content, with what the caller set in its place, and with paths as in `files`.
        files: Path in the copy → where the file is.
    """

    name: str
    document: Mapping[str, Any]
    files: Mapping[str, Path]

    def write(self, folder: Path) -> Path:
        """Write the copy into a folder, which is made.

        Returns:
            The scene file, which `load_scene` reads.
        """
        folder.mkdir(parents=True, exist_ok=True)
        for name, source in self.files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, folder / name)
        path = folder / f"{self.name}.json"
        path.write_bytes(self._scene_file())
        return path

    def sha256(self) -> str:
        """Of the scene and of every file in the copy: the same for a scene and for the copy that a run holds of it."""
        digest = hashlib.sha256(hashlib.sha256(self._scene_file()).digest())
        for name, source in sorted(self.files.items()):
            digest.update(hashlib.sha256(name.encode()).digest())
            digest.update(hashlib.sha256(source.read_bytes()).digest())
        return digest.hexdigest()

    def _scene_file(self) -> bytes:
        return orjson.dumps(self.document, option=orjson.OPT_INDENT_2 | orjson.OPT_NON_STR_KEYS) + b"\n"


def copy_scene(
    path: Path,
    data: Mapping[str, Any],
    keys: SceneKeys,
    *,
    vessels: Mapping[Any, Any],
    obstacles: Mapping[Any, Any],
    mesh_files: Mapping[str, Path],
    pose_files: Sequence[str] | None,
) -> SceneCopy:
    """The scene with every file that it names under a plain name beside it; the copy of a copy is the same.

    Args:
        path: The scene file.
        data: Its content, with what the caller set in its place.
        keys: The same, validated.
        vessels: Entries with meshes as in `mesh_files`.
        obstacles: The same for obstacles.
        mesh_files: Path in the copy → where the file is.
        pose_files: Those that the pose source reads, as the scene file names them; None if its poses come in live.
    """
    folder = path.resolve().parent
    detector = f"detector{Path(keys.detector).suffix}"
    files = {detector: folder / keys.detector, **mesh_files}
    document = {**data, "vessels": vessels, "detector": detector}
    if "obstacles" in data:
        document["obstacles"] = obstacles
    if pose_files is None:
        document["poses"] = {"file": "../poses.jsonl"}  # where a run keeps what came in
        document.pop("steps", None)
    else:
        names = {file: _pose_file(number, file) for number, file in enumerate(dict.fromkeys(pose_files))}
        files |= {name: folder / file for file, name in names.items()}
        document["poses"] = _renamed(document["poses"], names)
    if document.get("detector_seed") == keys.seed:
        del document["detector_seed"]  # says nothing
    # In one order, whether the caller or the file set a key; vessels and cameras keep theirs, which has a meaning.
    if isinstance(document.get("annotation"), dict):
        document["annotation"] = _ordered(document["annotation"], AnnotationKeys)
    return SceneCopy(path.stem, _ordered(document, SceneKeys), files)


def _pose_file(number: int, file: str) -> str:
    return f"poses{f'_{number}' if number else ''}" + "".join(Path(file).suffixes[-2:])


def _renamed(value: Any, names: Mapping[str, str]) -> Any:
    """A pose source's section, with the files in it under other names."""
    if isinstance(value, dict):
        return {key: _renamed(inner, names) for key, inner in value.items()}
    if isinstance(value, list):
        return [_renamed(inner, names) for inner in value]
    return names.get(value, value) if isinstance(value, str) else value


def _ordered(keys: dict[str, Any], model: type[BaseModel]) -> dict[str, Any]:
    """A section with its keys in the order of its model."""
    return {name: keys[name] for name in model.model_fields if name in keys}
