"""Settings and results of a run: `run.json` of a finished run, `settings.json` of an interrupted one."""

import hashlib
from collections.abc import Collection, Sequence
from dataclasses import asdict, fields
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import orjson
from pydantic import AfterValidator, Field, ValidationError, field_validator

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.errors import InputError, RunDirectoryError
from modsim3d.detector.draws import ErrorUnit
from modsim3d.io.input_files import file_sha256
from modsim3d.io.strict_text import load_json
from modsim3d.io.validation import Count, Number, Strict, describe, shown
from modsim3d.runs.counts import Counts
from modsim3d.runs.files.overwrite import MAX_NAME_LENGTH
from modsim3d.scene.scene import Scene
from modsim3d.truth.crosscheck.comparison import CheckCounts

Sha256 = Annotated[str, Field(strict=True, pattern="^[0-9a-f]{64}$")]
Text = Annotated[str, Field(strict=True)]
FileName = Annotated[str, Field(strict=True, pattern=r"^[^/\x00]+$", max_length=MAX_NAME_LENGTH)]
Estimate = Number | None  # a number, null where too few boxes tell it
Four = Annotated[list[Estimate], Field(min_length=4, max_length=4)]
MAX_PROBLEMS = 5


def _has_every_count(counts: dict[str, float]) -> dict[str, float]:
    """Refuse counts that are not those of a run; format 1 had no `off_vessel`."""
    names = {field.name for field in fields(Counts)}
    if missing := sorted(names - counts.keys() - {"off_vessel"}):
        raise ValueError(f"these counts are missing: {', '.join(missing)}")
    if unknown := sorted(counts.keys() - names):
        raise ValueError(f"these counts are unknown: {', '.join(unknown)}")
    if broken := [name for name in counts if name != "largest_curvature_px" and counts[name] % 1]:
        raise ValueError(f"these counts are no whole numbers: {', '.join(broken)}")
    return counts


def _is_a_check(entries: dict[str, float]) -> dict[str, float]:
    """Refuse what `CheckCounts` does not have."""
    if wrong := sorted(entries.keys() ^ {field.name for field in fields(CheckCounts)}):
        raise ValueError(f"these entries are missing or unknown: {', '.join(wrong)}")
    return entries


_Numbers = dict[Text, Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)]]
RunCounts = Annotated[_Numbers, AfterValidator(_has_every_count)]
Crosscheck = Annotated[_Numbers, AfterValidator(_is_a_check)]


class FileEntry(Strict):
    """Size and checksum of a file."""

    bytes: Count
    sha256: Sha256


class Truncation(Strict):
    """Shift of the box errors of a performance state by resampling, see `BoxSample.truncation`."""

    unit: ErrorUnit
    detections: Count
    boxes: Count
    redrawn: Estimate
    mean: Four
    mean_shift: Four
    mean_standard_error: Four
    covariance: Annotated[list[Four], Field(min_length=4, max_length=4)]


class RunSettings(Strict):
    """Everything that decides the content of the files, see `runs.run.settings_of`."""

    format: Literal[1, 2]
    scene: FileName
    scene_sha256: Sha256
    seed: Count
    detector_seed: Count
    traffic_seed: Count | None = None  # that the traffic was drawn from; None where every seed has this traffic
    traffic_sha256: Sha256 | None = None  # of the vessels and their poses where the vessels were drawn too
    steps: Count
    annotation: dict[Text, Any]
    cameras: list[Text]
    backend: Text
    plugins: dict[Text, Text]
    # of the files of each plug-in; None if there are none, or the run is older
    plugins_sha256: dict[Text, Sha256] | None = None
    versions: dict[Text, Text]
    truth_versions: dict[Text, Text] | None = None


class RunFile(RunSettings):
    """The settings, and what is known after the run."""

    counts: RunCounts  # of all frames, see `Counts`
    camera_counts: dict[Text, RunCounts] | None = None  # None in format 1
    truncation: dict[Text, Truncation]
    poses_sha256: Sha256 | None = None  # of the poses that a live scene received
    crosscheck: Crosscheck | None = None  # see `CheckCounts`; None in a run before there was one
    files: dict[Text, FileEntry] | None = None  # by path in the run directory; None in a run before this was kept

    @field_validator("files")
    @classmethod
    def _lie_in_the_folder(cls, files: dict[str, FileEntry] | None) -> dict[str, FileEntry] | None:
        for name in files or {}:
            path = PurePosixPath(name)
            if not name or len(name) > MAX_NAME_LENGTH or path.is_absolute() or ".." in path.parts or "\0" in name:
                raise ValueError(f"{shown(name)} is no path in a run directory")
        return files


Model = TypeVar("Model", bound=RunSettings)


def read_settings(path: Path, model: type[Model]) -> tuple[dict[str, Any], Model]:
    """The content of `run.json` or `settings.json`, as it is and validated, or RunDirectoryError."""
    try:
        content = load_json(path, "run")
        return content, model.model_validate(content)
    except InputError as error:
        problems = list(error.problems)
    except ValidationError as error:
        problems = describe(error, model)
    more = [f"and {len(problems) - MAX_PROBLEMS} more"] if len(problems) > MAX_PROBLEMS else []
    raise RunDirectoryError(f"{path} is not what a run has written: {'; '.join([*problems[:MAX_PROBLEMS], *more])}")


def check_scene_copy(folder: Path, settings: RunSettings, source: Path, listed: Collection[str] | None) -> None:
    """Check that the copy of the scene in `folder` is the one that the run has made, by the content of its `source`,
    `run.json` or `settings.json`. `listed` are the paths inside the run directory of the run's files; other files in
    the folder are the user's. It is None if the run has no such list: then all files in the folder are the copy. Raises
    RunDirectoryError if the copy is missing or was changed; see `SceneCopy.sha256`."""
    scene_file = folder / f"{settings.scene}.json"
    if not _is_file(scene_file):
        raise RunDirectoryError(f"{scene_file} is missing: {source} names it as the copy of the run's scene")
    try:
        digest = hashlib.sha256(bytes.fromhex(file_sha256(scene_file)))
        paths = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
        if listed:
            paths = {name: path for name, path in paths.items() if f"{folder.name}/{name}" in listed}
        for name, path in sorted(paths.items()):
            if path != scene_file:
                digest.update(hashlib.sha256(name.encode("utf-8", "surrogateescape")).digest())
                digest.update(bytes.fromhex(file_sha256(path)))
    except OSError as error:
        raise RunDirectoryError(f"{error.filename or folder} cannot be read: {error.strerror or error}") from None
    if digest.hexdigest() != settings.scene_sha256:
        raise RunDirectoryError(
            f"{folder} is not the scene that the run was made of: its files have the checksum {digest.hexdigest()}, "
            f"{source.name} has scene_sha256 {settings.scene_sha256}; was a file in it changed, added or lost?"
        )


def _is_file(path: Path) -> bool:
    """Whether a path is a file; one that is too long to be a path is none."""
    try:
        return path.is_file()
    except OSError:
        return False


def check_same_scene(settings: RunSettings, scene: Scene, source: Path) -> None:
    """Raise RunDirectoryError if one of the settings is not that of the scene in its copy."""
    expected = {
        "seed": scene.seed,
        "detector_seed": scene.detector_seed,
        "steps": scene.steps,
        "cameras": [camera.name for camera in scene.cameras],
        **{f"annotation.{key}": value for key, value in asdict(scene.annotation).items() if key != "check"},
    }
    entries = settings.model_dump() | {f"annotation.{key}": value for key, value in settings.annotation.items()}
    for name, value in expected.items():
        if name not in entries:
            raise RunDirectoryError(f"{source}: {name} is missing, and {shown(value)} in the run's copy of its scene")
        if entries[name] != value:
            raise RunDirectoryError(
                f"{source}: {name} is {shown(entries[name])}, but {shown(value)} in the run's copy of its scene "
                f"({scene.path})"
            )
    if settings.traffic_sha256 not in (None, scene.traffic_sha256()):
        versions = " and ".join(f"{name} {settings.versions.get(name)}" for name in ("modsim3d", "shapely"))
        raise RunDirectoryError(
            f"{source}: seed {scene.seed} draws another traffic here than when the run was made, with {versions}: open "
            "the run with those"
        )


def check_camera_counts(run: RunFile, source: Path) -> None:
    """Raise RunDirectoryError if a run of format 2 has not every count of every camera."""
    of_cameras = run.camera_counts or {}
    complete = all("off_vessel" in counts for counts in (run.counts, *of_cameras.values()))
    if run.format > 1 and not (complete and list(of_cameras) == run.cameras):
        raise RunDirectoryError(f"{source} is not what a run has written: it must have every count of every camera")


def check_files(folder: Path, run: RunFile) -> None:
    """Raise RunDirectoryError if a file that a run has listed is missing, or has another size."""
    for name, entry in (run.files or {}).items():
        path = folder / name
        if not _is_file(path):
            raise RunDirectoryError(f"{path} is missing: run.json lists it")
        if (size := path.stat().st_size) != entry.bytes:
            raise RunDirectoryError(f"{path} has {size} bytes, and had {entry.bytes} when the run was finished")


def check_content(path: Path, sha256: str, source: str) -> None:
    """Check that a file has the checksum that the file `source` says it had when it was written. Raises
    RunDirectoryError if it has another, is missing, or cannot be read."""
    try:
        digest = file_sha256(path)
    except FileNotFoundError:
        raise RunDirectoryError(f"{path} is missing: {source} lists it") from None
    except OSError as error:
        raise RunDirectoryError(f"{path} cannot be read: {error.strerror or error}") from None
    if digest != sha256:
        raise RunDirectoryError(f"{path} was changed after the run: its checksum is {digest}, {source} has {sha256}")


Column = bytes | Sequence[bytes] | Array
"""A text that is the same in all n rows; one for each row; or numbers of shape (n,), or (n, k) with commas between."""
ROWS_AT_ONCE = 1024  # whose texts are made together: those of many more take fresh memory, which costs more time


def string_texts(strings: Sequence[str]) -> list[bytes]:
    """The JSON text of each string."""
    # One a line: JSON has no line breaks inside a string.
    return orjson.dumps(strings, option=orjson.OPT_INDENT_2)[4:-2].split(b",\n  ") if strings else []


def number_texts(numbers: Array | Indices) -> list[bytes]:
    """The JSON text of each number, `null` for NaN; the numbers have shape (n,)."""
    if not len(numbers):
        return []
    return orjson.dumps(np.ascontiguousarray(numbers), option=orjson.OPT_SERIALIZE_NUMPY)[1:-1].split(b",")


def list_texts(numbers: Array) -> list[bytes]:
    """The JSON text of each row of numbers of shape (n, k), with commas between them and without brackets."""
    if not len(numbers):
        return []
    return orjson.dumps(np.ascontiguousarray(numbers), option=orjson.OPT_SERIALIZE_NUMPY)[2:-2].split(b"],[")


def frame_lines(heads: Sequence[bytes], tail: bytes, frame: Indices, *columns: Column) -> bytes:
    """A line for each of F frames: its head, the texts of its rows with commas between them, and the tail that all
    have. `frame` is that of each of n rows, ascending, (n,); `columns` stand side by side in each row."""
    bounds = np.searchsorted(frame, np.arange(len(heads) + 1)).tolist()
    before, between = [b","] * len(frame), b""
    for head, start, stop in zip(heads, bounds[:-1], bounds[1:], strict=True):
        if start == stop:
            between += head + tail
        else:
            before[start], between = between + head, tail
    starts = range(0, len(frame), ROWS_AT_ONCE)
    parts = [_joined(slice(start, start + ROWS_AT_ONCE), before, *columns) for start in starts]
    return b"".join([*parts, between])


def _joined(rows: slice, before: Sequence[bytes], *columns: Column) -> bytes:
    texts = [column if isinstance(column, bytes) else _texts(column[rows]) for column in (before, *columns)]
    count = len(before[rows])
    pieces = [b""] * (count * len(texts))
    for place, text in enumerate(texts):
        pieces[place :: len(texts)] = [text] * count if isinstance(text, bytes) else text
    return b"".join(pieces)


def _texts(column: Sequence[bytes] | Array) -> Sequence[bytes]:
    if not isinstance(column, np.ndarray):
        return column
    return number_texts(column) if column.ndim == 1 else list_texts(column)
