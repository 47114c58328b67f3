"""Folders of runs that tests make: what is in them, and runs that are interrupted."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from modsim3d.runs.run import run_scene
from modsim3d.runs.stored_run import StoredRun, open_run
from modsim3d.scene.scene import Scene


def wait_for(state: Callable[[], object]) -> None:
    """Wait until there is something; the bound is only there so that a broken program fails and does not hang."""
    deadline = time.monotonic() + 240
    while not state():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.005)


def finished(scene: Scene, folder: Path) -> StoredRun:
    """The run of a scene in a new folder."""
    return open_run(run_scene(scene, folder).folder)


def run_files(folder: Path, *without: str) -> dict[str, bytes]:
    """Content by path of all files below a folder, but for logs and files of the names that are left out."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name not in ("run.log", *without))
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def edited_run(source: Path, folder: Path, **changes: Any) -> Path:
    """A copy of a run with other entries in its `run.json`; None removes one. Its other files are links."""
    folder.mkdir()
    for path in source.iterdir():
        if path.name != "run.json":
            (folder / path.name).symlink_to(path)
    content = json.loads((source / "run.json").read_text()) | changes
    (folder / "run.json").write_text(json.dumps({key: value for key, value in content.items() if value is not None}))
    return folder


def interrupt(scene: Scene, folder: Path, blocks: int = 1, **options: Any) -> Path:
    """Run a scene until some blocks of steps are kept; gives the folder back."""
    kept: list[int] = []

    def stop(steps: int) -> None:
        kept.append(steps)
        if len(kept) == blocks:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_scene(scene, folder, progress=stop, **options)
    return folder
