"""A small finished run and an interrupted one, as the files in their folders."""

import contextlib
import hashlib
import io
import json
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from modsim3d.runs.files.block_files import DIGEST_BYTES
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


def reseal(files: Files) -> None:
    """Put the sizes, checksums and numbers of rows of changed files into a run's lists, as if the run had made them."""
    for name, content in files.items():
        if name.endswith(".npz") and content is not None:
            files[name] = content[:-DIGEST_BYTES] + hashlib.sha256(content[:-DIGEST_BYTES]).digest()
    for name in ("run/run.json", "run/unfinished/settings.json"):
        try:
            content = json.loads(files.get(name) or b"")
            folder = name.rpartition("/")[0]
            content["scene_sha256"] = _scene_sha256(files, f"{folder}/scene/", f"{content['scene']}.json")
            if name.endswith("run.json"):
                _list_again(files, content)
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError, OSError, pa.ArrowException):
            continue  # the lists themselves are spoiled
        files[name] = json.dumps(content).encode()


def _scene_sha256(files: Files, folder: str, scene: str) -> str:
    """As `SceneCopy.sha256`."""
    inside = {name.removeprefix(folder): content or b"" for name, content in files.items() if name.startswith(folder)}
    digest = hashlib.sha256(hashlib.sha256(inside.pop(scene)).digest())
    for name, content in sorted(inside.items()):
        digest.update(hashlib.sha256(name.encode()).digest() + hashlib.sha256(content).digest())
    return digest.hexdigest()


def _list_again(files: Files, content: dict[str, Any]) -> None:
    for name, entry in content.get("files", {}).items():
        found = files.get(f"run/{name}") or b""
        entry.update(bytes=len(found), sha256=hashlib.sha256(found).hexdigest())
    tables = ("frames", "truth", "detections")
    rows = {name: pq.read_metadata(io.BytesIO(files[f"run/{name}.parquet"] or b"")).num_rows for name in tables}
    counts = content["counts"]
    counts.update(frames=rows["frames"], vessel_frames=rows["truth"])
    counts["false_positives"] = rows["detections"] - counts["detected"] + counts["merged"]


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
