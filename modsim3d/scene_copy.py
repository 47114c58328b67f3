"""What a scene was read from, kept beside what came out of it: a run can be looked at and repeated from its folder."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson


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
