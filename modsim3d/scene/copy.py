"""Copies of a scene and its files in a run, so that the run can be looked at and repeated from its folder."""

import hashlib
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from modsim3d.core.paths import StrPath, as_path
from modsim3d.detector.file.reading import detector_text
from modsim3d.io.atomic_write import json_text
from modsim3d.scene.keys import AnnotationKeys, SceneKeys
from modsim3d.scene.parts import SceneParts
from modsim3d.world.poses.replay import LivePoses

_NOT_OF_TRUTH = ("seed", "looks", "detector", "detector_seed")


@dataclass(frozen=True, eq=False)
class SceneCopy:
    """A scene file and the files that it names."""

    name: str
    document: Mapping[str, Any]  # content of the scene file with what the caller set, and with the paths of the copy
    files: Mapping[str, Path]  # path in the copy → original file
    changed: Mapping[str, bytes] = field(default_factory=dict)
    """Path in the copy → content, of the files that are not as the original, or have none."""
    read: tuple[Path, ...] = ()
    """Every file that the scene is read from; also those that are not copied but written into the document."""

    @property
    def names(self) -> tuple[str, ...]:
        """Paths of all files in the copy, the scene file first."""
        return (f"{self.name}.json", *self.files)

    def write(self, folder: StrPath) -> Path:
        """Write the copy into a folder, and return its scene file, which `load_scene` reads."""
        folder = as_path(folder, "folder")
        folder.mkdir(parents=True, exist_ok=True)
        for name, source in self.files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            if name in self.changed:
                (folder / name).write_bytes(self.changed[name])
            else:
                shutil.copyfile(source, folder / name)
        path = folder / self.names[0]
        path.write_bytes(self._scene_file())
        return path

    def sha256(self) -> str:
        """Checksum of the scene and every file in the copy, equal for a scene and for its copy in a run."""
        return self._checksum(self._scene_file(), self.files)

    def truth_sha256(self) -> str:
        """Checksum without the seeds and the detector: what decides the truth beside the seed."""
        content = {key: value for key, value in self.document.items() if key not in _NOT_OF_TRUTH}
        return self._checksum(json_text(content), [name for name in self.files if name != self.document["detector"]])

    def _checksum(self, scene_file: bytes, names: Iterable[str]) -> str:
        digest = hashlib.sha256(hashlib.sha256(scene_file).digest())
        for name in sorted(names):
            digest.update(hashlib.sha256(name.encode()).digest())
            content = self.changed[name] if name in self.changed else self.files[name].read_bytes()
            digest.update(hashlib.sha256(content).digest())
        return digest.hexdigest()

    def _scene_file(self) -> bytes:
        return json_text(self.document)


def copy_scene(parts: SceneParts, keys: SceneKeys) -> SceneCopy:
    """A copy in which each file that the scene names lies beside it under a plain name; a copy's copy is the same."""
    detector_file = parts.detector_file(keys.detector)
    changed, suffix = dict(parts.contents), detector_file.suffix
    if parts.changed_detector is not None:
        suffix = ".yaml"
        changed[f"detector{suffix}"] = detector_text(parts.changed_detector).encode()
    detector = f"detector{suffix}"
    vessels = parts.meshes.copied_all(parts.vessel_entries or {}, parts.vessels_at.folder)
    document = {**parts.data, "vessels": vessels, "detector": detector}
    if "obstacles" in document:
        document["obstacles"] = parts.meshes.copied_all(document["obstacles"] or {}, parts.folder)
    if "looks" in document:
        document["looks"] = {name: document["looks"][name] for name in parts.looks}
    files = {detector: detector_file, **parts.meshes.files}
    if parts.source is None or isinstance(parts.poses, LivePoses):
        document["poses"] = {"file": "../poses.jsonl"}  # where a run keeps the poses that came in
        document.pop("steps", None)
    else:
        pose_files = dict.fromkeys(parts.source.keys.files)
        names = {file: _pose_file(number, file) for number, file in enumerate(pose_files)}
        files |= {name: parts.folder / file for file, name in names.items()}
        document["poses"] = _renamed(document["poses"], names)
    if document.get("detector_seed") == keys.seed:
        del document["detector_seed"]  # the default
    # In the order of the model, whoever set a key. The order of vessels and cameras has a meaning and is kept.
    if isinstance(document.get("annotation"), dict):
        document["annotation"] = _ordered(document["annotation"], AnnotationKeys)
    read = (*parts.read, *(file for name, file in files.items() if name not in parts.contents))
    return SceneCopy(parts.scene_name, _ordered(document, SceneKeys), files, changed, read)


def _pose_file(number: int, file: str) -> str:
    return f"poses{f'_{number}' if number else ''}" + "".join(Path(file).suffixes[-2:])


def _renamed(value: Any, names: Mapping[str, str]) -> Any:
    if isinstance(value, dict):
        return {key: _renamed(inner, names) for key, inner in value.items()}
    if isinstance(value, list):
        return [_renamed(inner, names) for inner in value]
    return names.get(value, value) if isinstance(value, str) else value


def _ordered(keys: dict[str, Any], model: type[BaseModel]) -> dict[str, Any]:
    return {name: keys[name] for name in model.model_fields if name in keys}
