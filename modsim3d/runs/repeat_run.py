"""Repeats a finished run from the copy of its scene, and compares every file with the stored one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson

from modsim3d.processes import WorkerCount
from modsim3d.runs.files.block_files import THESIS_LINES
from modsim3d.runs.files.differences import difference, settings_difference
from modsim3d.runs.files.file_list import FileList, file_list
from modsim3d.runs.files.replacing import POSES_FILE, RUN_FILE, SCENE_FOLDER
from modsim3d.runs.run import run_scene
from modsim3d.runs.stored_run import FinishedRun
from modsim3d.scene.scene import Scene

VERSION_KEYS = ("versions", "truth_versions", "plugins", "plugins_sha256", "backend")
"""What `run.json` says of the programs that made a run."""
_NOT_REPEATED = frozenset({*VERSION_KEYS, "files"})
_OF_LIVE_RUNS = frozenset({"scene_sha256", "poses_sha256"})  # the copy of a live scene reads its poses from a file


@dataclass(frozen=True)
class RepeatedFile:
    """A file of the stored run.

    Attributes:
        name: Path inside the run directory.
        stored: What is wrong with the stored file against the list in `run.json`; empty if nothing is.
        repeated: How the repeated run's file differs from the one that was written; empty if it has the same bytes.
        is_input: Whether the run is repeated from this file, so that there is nothing to compare.
    """

    name: str
    stored: str = ""
    repeated: str = ""
    is_input: bool = False

    @property
    def same(self) -> bool:
        """Whether the file is what was written, and was made again."""
        return not (self.stored or self.repeated)


@dataclass(frozen=True)
class VersionDifference:
    """A program that was another when the run was made, such as `numpy`; None where there was or is none."""

    name: str
    then: str | None
    now: str | None


@dataclass(frozen=True)
class Repetition:
    """What came of repeating a run; `listed` is whether its `run.json` lists its files, as older ones do not."""

    files: tuple[RepeatedFile, ...]
    versions: tuple[VersionDifference, ...]
    listed: bool

    @property
    def same(self) -> bool:
        """Whether every file is the same bytes."""
        return all(file.same for file in self.files)


def repeat_run(
    run: FinishedRun, again: Path, *, workers: WorkerCount = 1, progress: Callable[[int], None] = lambda steps: None
) -> Repetition:
    """Run the scene of a finished run, from `read_finished`, into a new folder, and compare.

    Raises:
        ModsimError: The scene cannot be run here.
    """
    folder, content, _, scene = run
    listed: FileList = content.get("files") or {}
    run_scene(scene, again, thesis_json=_has_thesis_json(listed), workers=workers, progress=progress)
    made = orjson.loads((again / RUN_FILE).read_bytes())
    names = sorted({name for name in {**listed, **made["files"]} if not _is_input(name)})
    files = [_compared(folder, again, name, listed, made["files"]) for name in names]
    files += [
        RepeatedFile(name, _damage(folder, name, listed), is_input=True) for name in _inputs(folder, scene, listed)
    ]
    settings = settings_difference((folder / RUN_FILE).read_bytes(), (again / RUN_FILE).read_bytes(), _ours(content))
    return Repetition(
        (*files, RepeatedFile(RUN_FILE, repeated=settings)), tuple(_versions(content, made)), bool(listed)
    )


def _has_thesis_json(listed: FileList) -> bool:
    """Whether a run wrote the thesis's JSON; one without a list of its files did."""
    return not listed or any(name.startswith(tuple(THESIS_LINES)) and name.endswith(".json") for name in listed)


def _is_input(name: str) -> bool:
    return name == POSES_FILE or name.startswith(f"{SCENE_FOLDER}/")


def _inputs(folder: Path, scene: Scene, listed: FileList) -> list[str]:
    """Files that the run is repeated from."""
    if listed:
        return sorted(filter(_is_input, listed))
    poses = [POSES_FILE] if (folder / POSES_FILE).is_file() else []
    return sorted([*(f"{SCENE_FOLDER}/{name}" for name in scene.copy.names), *poses])


def _ours(settings: dict[str, Any]) -> frozenset[str]:
    """Entries of `run.json` that need not be the same."""
    later = frozenset(
        {"traffic_seed", "traffic_sha256", "crosscheck"} - settings.keys()
    )  # older runs do not say where their traffic came from
    return _NOT_REPEATED | later | (_OF_LIVE_RUNS if "poses_sha256" in settings else frozenset())


def _compared(stored: Path, again: Path, name: str, listed: FileList, made: FileList) -> RepeatedFile:
    """A file of the stored run against the list and against the repeated run."""
    damage = _damage(stored, name, listed)
    if name not in made:
        return RepeatedFile(name, damage, "was not made again")
    written = listed.get(name) if listed else _found(stored, name)
    if written == made[name]:
        return RepeatedFile(name, damage)
    if written is None:
        return RepeatedFile(name, damage, "was made now, and is not in the run")
    readable = (stored / name).is_file() and not damage
    return RepeatedFile(name, damage, difference(stored / name, again / name) if readable else "differs")


def _damage(folder: Path, name: str, listed: FileList) -> str:
    """What is wrong with a stored file; empty if nothing is, or if nothing is known of it."""
    found = _found(folder, name)
    if found is None:
        return "is missing" if name in listed or not listed else ""
    if name not in listed or found == listed[name]:
        return ""
    if found["bytes"] != listed[name]["bytes"]:
        return f"has {found['bytes']} bytes, and was written with {listed[name]['bytes']}"
    return "is not what was written: its SHA-256 is another"


def _found(folder: Path, name: str) -> Any:
    return file_list(folder, [name])[name] if (folder / name).is_file() else None


def _versions(then: dict[str, Any], now: dict[str, Any]) -> list[VersionDifference]:
    """Programs that are not the same."""
    before, today = _programs(then), _programs(now)
    truth = {f"{name} (truth)": version for name, version in then.get("truth_versions", {}).items()}
    today |= {name: today.get(name.removesuffix(" (truth)")) for name in truth}
    before |= truth
    names = [name for name in {**before, **today} if before.get(name) != today.get(name)]
    return [VersionDifference(name, before.get(name), today.get(name)) for name in names]


def _programs(settings: dict[str, Any]) -> dict[str, str | None]:
    files = {f"{name} (files)": sha256 for name, sha256 in settings.get("plugins_sha256", {}).items()}
    versions = {**settings.get("versions", {}), **settings.get("plugins", {}), **files}
    versions["renderer"] = settings.get("backend")
    return {name: None if version is None else str(version) for name, version in versions.items()}
