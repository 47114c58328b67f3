"""A run directory while it is written: made, filled block by block, finished, resumed after an interruption."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import orjson

from modsim3d.errors import RunDirectoryError
from modsim3d.outputs.locks import LOCK_FILE, locked_folder
from modsim3d.runs.files import tables, thesis_json
from modsim3d.runs.files.block_files import JSON_LINES, OWN_SHIP, BlockFiles, schemas_of
from modsim3d.runs.files.file_list import file_list
from modsim3d.runs.files.own_ships_table import own_ship_table
from modsim3d.runs.files.thesis_json import pose_lines
from modsim3d.scene.scene import Scene

UNFINISHED = "unfinished"
"""The folder inside a run directory with the files of a run that goes on."""
RUN_FILE, LOG_FILE, SETTINGS_FILE = "run.json", "run.log", "settings.json"
SCENE_FOLDER = "scene"
"""The folder with a copy of the scene and of every file that it names."""
POSES_FILE = "poses.jsonl"
"""The poses that a live scene received, as a pose file for another run."""


@contextmanager
def locked_run(folder: Path) -> Iterator[None]:
    """Hold the lock of a run directory, which is made if it is not there; hold it before workers start to write.

    Raises:
        OutputError: Another process writes to the folder.
        RunDirectoryError: The folder cannot be written to, or is a file.
    """
    with ExitStack() as locks:
        try:
            if folder.exists() and not folder.is_dir():
                raise _not_ours(folder)
            locks.enter_context(locked_folder(folder))
        except OSError as error:
            raise RunDirectoryError(f"{folder} cannot be written to: {error.strerror}") from error
        yield


class RunDirectory:
    """The folder of one run, while it is written; `locked_run` holds its lock.

    The truth of finished blocks is kept, so that an interrupted run can be resumed. A resumed run writes the files of
    the detector from the start, because the detector is cheap.
    """

    def __init__(
        self, folder: Path, scene: Scene, settings: dict[str, Any], *, overwrite: bool = False, resume: bool = False
    ) -> None:
        """Make the folder, or resume an interrupted run; a run that is replaced stays until the new one is finished.

        Args:
            folder: The run directory.
            scene: The scene that is run.
            settings: See `settings_of`; an interrupted run must have had the same.
            overwrite: Replace a run that is there.
            resume: Continue an interrupted run that is there.

        Raises:
            RunDirectoryError: The folder is taken, is no run directory, or cannot be written to.
        """
        self.folder = folder
        self.work = folder / UNFINISHED
        self._scene = scene
        self._settings = orjson.dumps(settings, option=orjson.OPT_SORT_KEYS)
        try:
            self._prepare(overwrite, resume)
            self._open_files()
        except OSError as error:
            raise RunDirectoryError(f"{folder} cannot be written to: {error.strerror}") from error

    def _open_files(self) -> None:
        """Copy the scene, and open the files of the run for writing."""
        self._scene.copy.write(self.work / SCENE_FOLDER)
        self._writers = {
            name: tables.TableWriter(self.work / f"{name}.parquet", schema)
            for name, schema in schemas_of(self._scene).items()
        }
        self._lines: dict[tuple[str, int], IO[bytes]] = {
            (kind, index): self._lines_path(kind, index).open("wb")
            for kind in JSON_LINES
            for index in range(len(self._scene.cameras))
        }
        self._poses = (self.work / POSES_FILE).open("wb") if self._scene.live else None
        self._poses_sha256 = hashlib.sha256()

    def __enter__(self) -> RunDirectory:
        """Return the folder, which is ready."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close all files; what was written stays.

        Raises:
            RunDirectoryError: The disk is full, or the files cannot be written for another reason.
        """
        try:
            self._close_files()
        except OSError as failure:
            raise self._unwritable(failure) from failure
        if isinstance(error, OSError):
            raise self._unwritable(error) from error

    def _close_files(self) -> None:
        for stream in self._lines.values():
            stream.close()
        for writer in self._writers.values():
            writer.close()
        if self._poses is not None:
            self._poses.close()

    def _unwritable(self, error: OSError) -> RunDirectoryError:
        problem = f"{self.folder} cannot be written to: {error.strerror or error}"
        return RunDirectoryError(f"{problem}; what was finished is kept: go on with --resume")

    def _prepare(self, overwrite: bool, resume: bool) -> None:
        interrupted, finished = _is_ours(self.work / SETTINGS_FILE), _is_ours(self.folder / RUN_FILE)
        taken = any(path.name != LOCK_FILE for path in self.folder.iterdir())
        if resume and interrupted:
            if (self.work / SETTINGS_FILE).read_bytes() == self._settings:
                return
            if not overwrite:
                raise RunDirectoryError(
                    f"{self.folder} holds an interrupted run with another scene, seed, settings or version: "
                    "resume it with the same, or use --overwrite"
                )
        if taken and not (interrupted or finished or self._hardly_begun()):
            raise _not_ours(self.folder)
        if not overwrite and (interrupted or finished):
            state = "an interrupted run: use --resume or --overwrite" if interrupted else "a run: use --overwrite"
            raise RunDirectoryError(f"{self.folder} holds {state}, or choose another folder")
        if self.work.is_dir():
            shutil.rmtree(self.work)
        self.work.mkdir(parents=True)
        partial = self.work / f"{SETTINGS_FILE}.partial"
        partial.write_bytes(self._settings)
        partial.replace(self.work / SETTINGS_FILE)

    def _hardly_begun(self) -> bool:
        """Whether a run was killed before it had written its settings."""
        names = {path.name for path in self.work.iterdir()} if self.work.is_dir() else {"none"}
        beside = {path.name for path in self.folder.iterdir()} - {LOCK_FILE}
        return names <= {f"{SETTINGS_FILE}.partial"} and beside == {UNFINISHED}

    def _remove_replaced(self) -> None:
        """Remove the run that this one replaces; `run.json` first, as it means that all other files are complete."""
        replaced = self.work / "replaced.json"
        if (self.folder / RUN_FILE).exists():
            (self.folder / RUN_FILE).replace(replaced)
        if not replaced.exists():
            return
        for path in self.folder.iterdir():
            if path.name in (UNFINISHED, LOCK_FILE):
                continue
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink()

    def _lines_path(self, kind: str, camera: int) -> Path:
        return self.work / f"{kind}_{self._scene.cameras[camera].name}.jsonl"

    def write(self, block: BlockFiles) -> None:
        """Add a block's rows and lines."""
        for name, rows in block.tables.items():
            self._writers[name].write(rows)
        for key, lines in block.lines.items():
            self._lines[key].write(lines)
            self._lines[key].flush()

    def write_poses(self, first: int, stop: int) -> None:
        """Add the poses of steps first to stop − 1, if a live scene has received them."""
        if self._poses is not None:
            lines = pose_lines(self._scene, first, stop)
            self._poses.write(lines)
            self._poses.flush()
            self._poses_sha256.update(lines)

    def write_live_own_ships(self, steps: int) -> None:
        """Add the motion of a live scene's own ships, once all steps have come."""
        if self._poses is not None and self._scene.own_ships and steps:
            self._writers[OWN_SHIP].write(own_ship_table(self._scene, 0, steps))

    def live_settings(self, steps: int) -> dict[str, Any]:
        """The settings of a live scene that are known only after the run."""
        return {"steps": steps, "poses_sha256": self._poses_sha256.hexdigest()} if self._poses is not None else {}

    def finish(self, run: dict[str, Any], log: str) -> None:
        """Put every file in its place; `run.json` comes last: `run` and the list of all files, which are complete."""
        self._close_files()
        for kind, camera in self._lines:
            lines = self._lines_path(kind, camera)
            with lines.with_suffix(".json").open("wb") as out:
                thesis_json.join_lines(lines, out)
        content = {**run, "files": file_list(self.work, self._file_names())}
        self._remove_replaced()
        if (self.folder / SCENE_FOLDER).is_dir():  # put there by a run that was killed just then
            shutil.rmtree(self.folder / SCENE_FOLDER)
        (self.work / SCENE_FOLDER).replace(self.folder / SCENE_FOLDER)
        for name in content["files"]:
            if not name.startswith(f"{SCENE_FOLDER}/"):
                place(self.work / name, self.folder / name)
        (self.folder / LOG_FILE).write_text(log)
        partial = self.work / RUN_FILE
        partial.write_bytes(orjson.dumps(content, option=orjson.OPT_INDENT_2) + b"\n")
        place(partial, self.folder / RUN_FILE)
        shutil.rmtree(self.work)

    def _file_names(self) -> list[str]:
        """Paths of the finished run's files inside the run directory, without `run.json` and `run.log`."""
        names = [f"{name}.parquet" for name in self._writers]
        names += [self._lines_path(*key).with_suffix(".json").name for key in self._lines]
        names += [f"{SCENE_FOLDER}/{name}" for name in self._scene.copy.names]
        return [*names, POSES_FILE] if self._poses is not None else names


def _not_ours(folder: Path) -> RunDirectoryError:
    return RunDirectoryError(f"{folder} exists and is not a run directory: choose another folder")


def _is_ours(path: Path) -> bool:
    """Whether a file is the `run.json` or `settings.json` of a run, and not of another program."""
    try:
        content = orjson.loads(path.read_bytes())
    except (OSError, ValueError):
        return False
    return isinstance(content, dict) and "scene_sha256" in content and "format" in content


def place(partial: Path, final: Path) -> None:
    """Move a complete file to its place in one step, once it is on the disk."""
    with partial.open("rb+") as written:
        os.fsync(written.fileno())
    partial.replace(final)
