"""A small finished run and an interrupted one, as the files in their folders."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

from modsim3d.runs.run import run_scene
from modsim3d.scene.reading import load_scene
from tests.fuzz.corpora import Files, scenes


class _Stop(Exception):
    """Interrupts a run once a block is kept."""


def _stop(steps: int) -> None:
    raise _Stop


@cache
def stored_runs(interrupted: bool) -> tuple[Files, ...]:
    """Runs of the small scenes with one camera and with everything."""
    return tuple(_files_of(scenes()[number], _stop if interrupted else lambda steps: None) for number in (0, 3))


def _files_of(inputs: Files, progress: Callable[[int], None]) -> Files:
    with tempfile.TemporaryDirectory(prefix="modsim3d_fuzz_") as name:
        folder = Path(name)
        write_files(inputs, folder / "in")
        scene = load_scene(folder / "in" / "scene.yaml", source="analytic")
        with contextlib.suppress(_Stop):
            run_scene(scene, folder / "run", progress=progress)
        paths = sorted((folder / "run").rglob("*"))
        return {f"run/{path.relative_to(folder / 'run')}": path.read_bytes() for path in paths if path.is_file()}


def write_files(files: Files, folder: Path) -> None:
    """Write files below a folder, which is made if it does not exist."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if content is None:
            path.mkdir()
        else:
            path.write_bytes(content)
