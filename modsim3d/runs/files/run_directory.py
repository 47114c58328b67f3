"""A run directory while it is written: made, filled block by block, finished, resumed after an interruption."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path, PurePosixPath
from threading import Lock
from types import TracebackType
from typing import IO, Any

import orjson

from modsim3d.core.errors import RunDirectoryError
from modsim3d.io.atomic_write import json_text, sync_file, sync_folder, written_whole
from modsim3d.io.overwrite_guard import LOCK_FILE, identities, identity, is_inside, locked_folder
from modsim3d.runs.files import block_files, tables
from modsim3d.runs.files.block_files import OWN_SHIP, SETTINGS_FILE, THESIS_LINES, BlockFiles, line_kinds, schemas_of
from modsim3d.runs.files.overwrite import (
    LOG_FILE,
    POSES_FILE,
    RUN_FILE,
    SCENE_FOLDER,
    UNFINISHED,
    FileList,
    ListedFile,
    files_of_run,
    foreign,
    is_of_a_run,
    listed_file,
    made_of_run,
    read_json,
    remove_files,
    safe_names,
)
from modsim3d.runs.files.table_columns import own_ship_table
from modsim3d.scene.scene import Scene
from modsim3d.world.poses.arrays import pose_texts

FILES_AT_ONCE = 8  # most files that are put on the disk together: the disk takes hardly longer for several than for one
REPLACES_FILE = "replaces.json"  # in the folder of a run that goes on: the files of earlier runs that it replaces


@contextmanager
def locked_run(folder: Path) -> Iterator[None]:
    """Hold the lock of a run directory, which is made if it is not there; hold it before workers start to write. Raises
    OutputError if another process writes to the folder, RunDirectoryError if it cannot be written to or is a file."""
    with ExitStack() as locks:
        try:
            if folder.exists() and not folder.is_dir():
                raise _not_ours(folder)
            locks.enter_context(locked_folder(folder))
        except OSError as error:
            raise RunDirectoryError(f"{folder} cannot be written to: {error.strerror}") from error
        yield


class RunDirectory:
    """The folder of one run, while it is written; `locked_run` holds its lock. The truth of finished blocks is kept, so
    that an interrupted run can be resumed. A resumed run writes those of the cheap detector from the start."""

    def __init__(
        self,
        folder: Path,
        scene: Scene,
        settings: dict[str, Any],
        *,
        overwrite: bool = False,
        resume: bool = False,
        thesis_json: bool = True,
    ) -> None:
        """Make the folder, or resume an interrupted run, which must have had the same settings, see `settings_of`; a
        run that is replaced stays until the new one is finished. Raises RunDirectoryError if the folder is taken, is no
        run directory, or cannot be written to."""
        self.folder = folder
        self.work = folder / UNFINISHED
        self.line_kinds = line_kinds(thesis_json)
        self._scene = scene
        self._settings = orjson.dumps(settings, option=orjson.OPT_SORT_KEYS)
        try:
            self._prepare(overwrite, resume)
            self._open_files()
        except OSError as error:
            raise RunDirectoryError(f"{folder} cannot be written to: {error.strerror}") from error

    def _open_files(self) -> None:
        self._scene.copy.write(self.work / SCENE_FOLDER)
        self._writers = {
            name: tables.TableWriter(self.work / f"{name}.parquet", schema)
            for name, schema in schemas_of(self._scene).items()
        }
        self._lines: dict[tuple[str, int], IO[bytes]] = {
            (kind, index): self._lines_path(kind, index).open("wb")
            for kind in self.line_kinds
            for index in range(len(self._scene.cameras))
        }
        self._closing = Lock()
        self._poses = (self.work / POSES_FILE).open("wb") if self._scene.live else None
        self._poses_sha256 = hashlib.sha256()
        self._files: FileList = {}

    def __enter__(self) -> RunDirectory:
        """Return the folder, which is ready."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close all files; what was written stays. Raises RunDirectoryError if the files cannot be written."""
        try:
            with ExitStack() as closing:  # where one cannot be closed, the others are closed all the same
                closing.callback(self._close_lines)
                for writer in self._writers.values():
                    closing.callback(writer.close)
        except OSError as failure:
            raise self._unwritable(failure) from failure
        if isinstance(error, OSError):
            raise self._unwritable(error) from error

    def _close_lines(self) -> None:
        for stream in self._lines.values():
            stream.close()
        if self._poses is not None:
            self._poses.close()

    def _unwritable(self, error: OSError) -> RunDirectoryError:
        problem = f"{self.folder} cannot be written to: {error.strerror or error}"
        return RunDirectoryError(f"{problem}; what was finished is kept: go on with --resume")

    def _prepare(self, overwrite: bool, resume: bool) -> None:
        interrupted = is_of_a_run(read_json(self.work / SETTINGS_FILE))
        goes_on = resume and interrupted and (self.work / SETTINGS_FILE).read_bytes() == self._settings
        if not goes_on:
            self._check_taken(interrupted, overwrite, resume)
        self._replaced = self._known_files()
        self._check_in_the_way()
        if not goes_on:
            self._begin()

    def _check_taken(self, interrupted: bool, overwrite: bool, resume: bool) -> None:
        """Refuse a folder that holds a run that is not to be replaced, or no run."""
        finished = is_of_a_run(read_json(self.folder / RUN_FILE))
        if resume and interrupted and not overwrite:
            raise RunDirectoryError(
                f"{self.folder} holds an interrupted run with another scene, seed, settings or version: "
                "resume it with the same, or use --overwrite"
            )
        if not (interrupted or finished or self._hardly_begun()):
            if any(path.name != LOCK_FILE for path in self.folder.iterdir()):
                raise _not_ours(self.folder)
        elif not overwrite and (interrupted or finished):
            state = "an interrupted run: use --resume or --overwrite" if interrupted else "a run: use --overwrite"
            raise RunDirectoryError(f"{self.folder} holds {state}, or choose another folder")

    def _hardly_begun(self) -> bool:
        """Whether a run was killed before it had written its settings."""
        names = [path.name for path in self.work.iterdir()] if self.work.is_dir() else ["none"]
        beside = {path.name for path in self.folder.iterdir()} - {LOCK_FILE}
        return all(".partial" in name or name == REPLACES_FILE for name in names) and beside == {UNFINISHED}

    def _known_files(self) -> set[str]:
        """Paths of all files of runs in the folder, also of one that was killed while it put its files in place."""
        begun = read_json(self.work / REPLACES_FILE)
        replaced = begun.get("replaces") if isinstance(begun, dict) else None
        names = safe_names(replaced) if isinstance(replaced, list) else set()
        return names | files_of_run(self.folder) | files_of_run(self.work)

    def _check_in_the_way(self) -> None:
        """Refuse to replace what no run has written, and what this run reads."""
        written = {RUN_FILE, LOG_FILE, *self._file_names()}
        if name := foreign(self.folder, written, self._replaced | {RUN_FILE, LOG_FILE}):
            raise RunDirectoryError(
                f"{self.folder / name} is in the way, and no run has written it: move it, or choose another folder"
            )
        replaced = written | self._replaced | made_of_run(self.folder)
        places = identities((*(self.folder / name for name in replaced), *self.work.rglob("*")))
        for path in self._scene.copy.read:
            if identity(path) in places or is_inside(path, self.work):
                raise RunDirectoryError(
                    f"{path} belongs to the run in {self.folder}, which would be replaced, and this run reads it: "
                    "copy it to another folder first, or choose another folder for the run"
                )

    def _begin(self) -> None:
        """Empty the folder of the run that goes on; its settings are replaced last, so that it stays a run's."""
        self.work.mkdir(exist_ok=True)
        with written_whole(self.work / REPLACES_FILE) as partial:
            partial.write_bytes(orjson.dumps({"replaces": sorted(self._replaced)}))
        for path in self.work.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            elif path.name not in (REPLACES_FILE, SETTINGS_FILE):
                path.unlink()
        with written_whole(self.work / SETTINGS_FILE) as partial:
            partial.write_bytes(self._settings)
        sync_folder(self.folder)

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
            scene = self._scene
            texts = pose_texts(scene.poses.poses(first, stop), scene.timestamps(first, stop), scene.vessel_names)
            lines = b"".join(text + b"\n" for text in texts)
            self._poses.write(lines)
            self._poses.flush()
            os.fsync(self._poses.fileno())  # they cannot come again
            self._poses_sha256.update(lines)

    def write_live_own_ships(self, steps: int) -> None:
        """Add the motion of a live scene's own ships, once all steps have come."""
        if self._poses is not None and self._scene.own_ships and steps:
            self._writers[OWN_SHIP].write(own_ship_table(self._scene, 0, steps))

    def live_settings(self, steps: int) -> dict[str, Any]:
        """The settings of a live scene that are known only after the run."""
        return {"steps": steps, "poses_sha256": self._poses_sha256.hexdigest()} if self._poses is not None else {}

    @contextmanager
    def completing(self) -> Iterator[None]:
        """Complete all files and put them on the disk, several at once, while the caller goes on. May raise OSError."""
        self._close_lines()
        with ThreadPoolExecutor(FILES_AT_ONCE) as threads:
            files = {name: threads.submit(self._complete, name) for name in self._file_names()}
            yield
            self._files = {name: files[name].result() for name in sorted(files)}

    def finish(self, run: dict[str, Any], log: str) -> None:
        """Put every file in its place, after `completing`. `run.json` goes first and comes last, so that where it is
        all else is complete. `run` is its content, but for the list of the files; `log` is that of `run.log`."""
        names, content = self._file_names(), {**run, "files": self._files}
        (self.work / LOG_FILE).write_text(log)
        (self.work / RUN_FILE).write_bytes(json_text(content))
        for name in (LOG_FILE, RUN_FILE):
            sync_file(self.work / name)
        _sync_folders(self.work, names)
        (self.folder / RUN_FILE).unlink(missing_ok=True)
        sync_folder(self.folder)
        remove_files(self.folder, (self._replaced | made_of_run(self.folder)) - set(names))
        for name in (*names, LOG_FILE):
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            (self.work / name).replace(self.folder / name)
        _sync_folders(self.folder, names)
        (self.work / RUN_FILE).replace(self.folder / RUN_FILE)
        sync_folder(self.folder)
        shutil.rmtree(self.work)
        with suppress(OSError):  # the run is there already
            sync_folder(self.folder)

    def _complete(self, name: str) -> ListedFile:
        """Complete a file, put it on the disk, and say what the list has of it."""
        path = self.work / name
        lines = path.with_suffix(".jsonl")
        if path.suffix == ".parquet" and path.stem in self._writers:
            with self._closing:  # the last row group of one table takes memory enough
                self._writers[path.stem].close()
        elif lines in {self._lines_path(*key) for key in self._lines} and path != lines:
            with path.open("wb") as out:
                block_files.join_lines(lines, out)
        sync_file(path)
        return listed_file(path)

    def _file_names(self) -> list[str]:
        """Paths of the finished run's files inside the run directory, without `run.json` and `run.log`."""
        names = [f"{name}.parquet" for name in schemas_of(self._scene)]
        ending = {kind: "json" if kind in THESIS_LINES else "jsonl" for kind in self.line_kinds}
        names += [f"{kind}_{camera.name}.{ending[kind]}" for kind in self.line_kinds for camera in self._scene.cameras]
        names += [f"{SCENE_FOLDER}/{name}" for name in self._scene.copy.names]
        return [*names, POSES_FILE] if self._scene.live else names


def _not_ours(folder: Path) -> RunDirectoryError:
    return RunDirectoryError(f"{folder} exists and is not a run directory: choose another folder")


def _sync_folders(folder: Path, names: Iterable[str]) -> None:
    """Keep the names of some files in a folder, and in folders inside it, on the disk."""
    inside = {parent for name in names for parent in PurePosixPath(name).parents}
    for parent in sorted(inside, reverse=True):
        sync_folder(folder / parent)
