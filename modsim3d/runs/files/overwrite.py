"""Files of a run directory that a new run replaces: the old run's files, and what was made of them."""

import hashlib
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any, TypedDict

import orjson

from modsim3d.io.overwrite_guard import LOCK_FILE

RUN_FILE, LOG_FILE = "run.json", "run.log"
DETECT_FILE = "detect.json"  # what is said of a labelled video beside its run, with the files that were written besides
UNFINISHED = "unfinished"  # the folder inside a run directory with the files of a run that goes on
SCENE_FOLDER = "scene"  # the folder with a copy of the scene and of every file that it names
POSES_FILE = "poses.jsonl"  # the poses that a live scene received, as a pose file for another run
MADE_OF_A_RUN = frozenset(
    {
        *("contact_sheet.png", "report.html", "side_by_side.html", "run.rrd", "verify.html", "verify.json"),
        *("compare.html", "compare.json", "rectangle_rule.png"),
        *("score.html", "score.json"),
    }
)
"""What other commands write into a run directory; of a run that is replaced, nothing of it may stay."""
_FILMS = "detections|scene|ids|corners|map|all"
_PICTURE = re.compile(rf"(?:{_FILMS})(?:_\d+\.(?:png|svg|pdf)|\.(?:mp4|gif))")
_FRAME = re.compile(r"frame_\d+\.png")
_PART = re.compile(r"[AB]-\d+\.js")
_FOLDERS = {  # folders that other commands make in a run directory, and the names of the files in them
    **dict.fromkeys(_FILMS.split("|"), _FRAME),
    **dict.fromkeys(("report_parts", "side_by_side_parts"), _PART),
    "report_images": re.compile(r"\d{6}\.jpg"),
}
MAX_NAME_LENGTH = 255  # bytes that a file system allows
_OLDER = ("frames.parquet", "truth.parquet", "detections.parquet", "ownship.parquet", POSES_FILE)


def files_of_run(folder: Path) -> set[str]:
    """Paths inside a run directory of all files of the finished run in it; none if there is none. A run of an older
    version has no list of its files: then they are the names that such a version wrote."""
    run = read_json(folder / RUN_FILE)
    if not is_of_a_run(run):
        return set()
    listed = run.get("files")
    names = set(listed) if isinstance(listed, dict) else set(_names_without_list(folder, run))
    return {RUN_FILE, LOG_FILE, *safe_names(names)}


def _names_without_list(folder: Path, run: dict[str, Any]) -> Iterator[str]:
    yield from _OLDER
    cameras = run.get("cameras")
    for camera in cameras if isinstance(cameras, list) else ():
        yield from (f"annotations_{camera}.json", f"detections_{camera}.json")
    yield f"{SCENE_FOLDER}/{run.get('scene')}.json"
    for pattern in ("detector", "detector.*", "poses*", "meshes/*"):
        yield from (path.relative_to(folder).as_posix() for path in (folder / SCENE_FOLDER).glob(pattern))


def made_of_run(folder: Path) -> set[str]:
    """Paths inside a run directory of what other commands have written there under the names that are their default."""
    made = {name for name in MADE_OF_A_RUN if (folder / name).is_file()}
    labelled = read_json(folder / DETECT_FILE)
    if isinstance(labelled, dict) and isinstance(labelled.get("files"), dict):
        made |= {DETECT_FILE, *(name for name in safe_names(labelled["files"]) if (folder / name).is_file())}
    for path in folder.iterdir():
        if path.is_file() and _PICTURE.fullmatch(path.name):
            made.add(path.name)
        elif path.is_dir() and (pattern := _FOLDERS.get(path.name)):
            made |= {f"{path.name}/{file.name}" for file in path.iterdir() if pattern.fullmatch(file.name)}
    return made


def read_of_run(folder: Path) -> list[Path]:
    """Files that are read of a run directory: those of a finished run, and the folder of an interrupted one."""
    return [folder / name for name in sorted(files_of_run(folder))] + [folder / UNFINISHED]


def remove_files(folder: Path, names: Iterable[str]) -> None:
    """Remove files of a folder, and the folders in it that are empty then; what is not there is passed over."""
    inside, parents = os.path.realpath(folder), set()
    for name in safe_names(names):
        path = folder / name
        # Never through a link out of the folder.
        if Path(os.path.realpath(path.parent)).is_relative_to(inside) and (path.is_file() or path.is_symlink()):
            path.unlink()
            parents |= {parent for parent in path.parents if parent.is_relative_to(folder) and parent != folder}
    for parent in sorted(parents, key=lambda path: len(path.parts), reverse=True):
        with suppress(OSError):  # it holds what is not the run's
            parent.rmdir()


def foreign(folder: Path, names: Iterable[str], own: set[str]) -> str | None:
    """The first of some paths in a folder where there is something that is not a run's; None if there is none."""
    for name in sorted(names):
        if name not in own and ((folder / name).exists() or (folder / name).is_symlink()):
            return name
        for parent in PurePosixPath(name).parents[:-1]:
            if (folder / parent).exists() and not (folder / parent).is_dir():
                return str(parent)
    return None


def safe_names(names: Iterable[Any]) -> set[str]:
    """Names, of some read from a file, that are paths inside a run directory and can be of a finished run."""
    return {name for name in names if isinstance(name, str) and _is_safe(name)}


def _is_safe(name: str) -> bool:
    path = PurePosixPath(name)
    if path.is_absolute() or not path.parts or path.parts[0] in (UNFINISHED, LOCK_FILE):
        return False
    return not any(part == ".." or "\0" in part or len(part.encode()) > MAX_NAME_LENGTH for part in path.parts)


def is_of_a_run(content: Any) -> bool:
    """Whether it is the content of the `run.json` or `settings.json` of a run, and not of another program's file."""
    return isinstance(content, dict) and "scene_sha256" in content and "format" in content


def read_json(path: Path) -> Any:
    """The content of a JSON file; None if it cannot be read."""
    try:
        return orjson.loads(path.read_bytes()) if path.is_file() else None  # a pipe would be waited for
    except (OSError, ValueError):
        return None


class ListedFile(TypedDict):
    """Size of a file in bytes, and its SHA-256 as 64 hexadecimal digits."""

    bytes: int
    sha256: str


FileList = dict[str, ListedFile]  # by path inside the run directory, with `/` between folders, in alphabetical order


def file_list(folder: Path, names: Iterable[str]) -> FileList:
    """The list of some files of a folder; `names` are their paths inside it."""
    return {name: listed_file(folder / name) for name in sorted(names)}


def listed_file(path: Path) -> ListedFile:
    """Entry of a file in the list: its size and checksum."""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256")
        return {"bytes": file.tell(), "sha256": digest.hexdigest()}
