"""Tracks in a run, from a folder that `modsim3d track` has written or from somebody's own files."""

import hashlib
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import Field, ValidationError

from modsim3d.core.arrays import NOBODY, Array, Indices, positions
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.io import input_files
from modsim3d.io.atomic_write import json_text, write_files
from modsim3d.io.input_files import open_input
from modsim3d.io.overwrite_guard import claimed
from modsim3d.io.strict_text import load_json
from modsim3d.io.text_table import RowProblems
from modsim3d.io.validation import Count, Strict, describe, nearest, shown
from modsim3d.runs.files.overwrite import read_of_run
from modsim3d.runs.files.run_file import FileEntry, Sha256, Text
from modsim3d.runs.files.table_columns import BOX_SIDES
from modsim3d.runs.files.tables import ROW_GROUP_ROWS, indices, integer_column, number_column
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.tracks.diagnosis import CORNERS, BoxRows, KnownBoxes, misreading
from modsim3d.tracks.text_tracks import FileRows, frames_at, read_csv_tracks, read_mot_tracks, tracks_of
from modsim3d.tracks.tracks import COVARIANCES, SCHEMA, Origin, TrackSet, name_of, source_of, track_table

TABLE: Literal["tracks.parquet"] = "tracks.parquet"
WORLD_TABLE: Literal["world_tracks.csv"] = "world_tracks.csv"  # in its place, of a tracker in the world
FACTS = "tracks.json"
TRACK_FILES = (TABLE, FACTS)
FORMAT = 1


class TrackedRun(Strict):
    """Identity of the run that was tracked."""

    scene: Text
    scene_sha256: Sha256  # of the scene's copy in the run, as in `run.json`
    seed: Count
    detector_seed: Count
    traffic_seed: Count | None  # that the traffic was drawn from; None where every seed has this traffic
    steps: Count
    detections_sha256: Sha256 | None  # of the run's `detections.parquet`; None of a run without a list of its files


class TrackFacts(Strict):
    """The content of `tracks.json`."""

    format: Literal[1]
    name: Text
    tracker: Text
    settings: dict[Text, Any]
    chosen: Text
    package: Text
    versions: dict[Text, Text]
    run: TrackedRun
    counts: Annotated[dict[Literal["rows", "tracks"], Count], Field(min_length=2)]
    files: Annotated[dict[Literal["tracks.parquet", "world_tracks.csv"], FileEntry], Field(min_length=1, max_length=1)]

    @property
    def origin(self) -> Origin:
        """Origin of the tracks."""
        return Origin(self.tracker, self.settings, self.chosen, self.package, self.versions)


def track_paths(folder: Path) -> list[Path]:
    """The files that tracks may have in a folder: those in the images, or those in the world."""
    return [folder / name for name in (TABLE, WORLD_TABLE, FACTS)]


def write_tracks(folder: Path, run: StoredRun, track_set: TrackSet, overwrite: bool) -> None:
    """Write tracks into a folder; the same tracks give the same bytes. Raises OutputError if the files are there and
    are not to be overwritten, or cannot be written, and ModsimError if it is not known how the tracks were made."""
    with claimed(track_paths(folder), overwrite=overwrite, inputs=read_of_run(run.folder)):
        write_claimed_tracks(folder, run, track_set)


def write_claimed_tracks(folder: Path, run: StoredRun, track_set: TrackSet) -> None:
    """Write tracks where the caller has claimed the files, before the work; for errors see `write_tracks`."""
    if track_set.origin is None:
        problem = "have no origin: only those that modsim3d has made are written"
        raise ModsimError(f"the tracks '{track_set.name}' {problem}")
    buffer = io.BytesIO()
    table = track_table(track_set.tracks, run.scene)
    pq.write_table(table, buffer, compression="zstd", row_group_size=ROW_GROUP_ROWS)
    content = buffer.getvalue()
    counts = {"rows": len(track_set.tracks), "tracks": int(track_set.tracks.identity.max(initial=-1)) + 1}
    facts = facts_text(track_set.name, track_set.origin, run, counts, {TABLE: content})
    write_files({folder / TABLE: content, folder / FACTS: facts})


def facts_text(name: str, origin: Origin, run: StoredRun, counts: dict[str, int], files: dict[str, bytes]) -> bytes:
    """The content of `tracks.json`: where tracks come from, of which run they are, and the checksum of their file."""
    listed = {
        file: {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()} for file, content in files.items()
    }
    run_facts = _tracked_run(run).model_dump()
    facts = {"format": FORMAT, "name": name, **vars(origin), "run": run_facts, "counts": counts, "files": listed}
    return json_text(facts)


def stored_facts(folder: Path, run: StoredRun, table: Literal["tracks.parquet", "world_tracks.csv"]) -> TrackFacts:
    """Facts in `tracks.json` on the tracks of a run in a table. Raises InputError if a file is missing or damaged, or
    the tracks are of another run."""
    try:
        facts = TrackFacts.model_validate(load_json(folder / FACTS, "tracks"))
    except ValidationError as error:
        raise InputError(source_of(folder / FACTS), describe(error, TrackFacts)) from None
    _check_run(facts.run, _tracked_run(run), source_of(folder), of_files=bool(run.made_of))
    with open_input(folder / table, "tracks", input_files.MAX_TEXT_BYTES) as file:
        checksum = hashlib.file_digest(file, "sha256").hexdigest()
    if checksum != (listed := facts.files[table].sha256 if table in facts.files else "none"):
        problem = f"was changed or damaged: its checksum is {checksum}, {FACTS} has {listed}"
        raise InputError(source_of(folder / table), [problem])
    return facts


def read_stored_tracks(folder: Path, run: StoredRun, rows: RunRows) -> TrackSet:
    """Read the tracks that `write_tracks` has written for a run. Raises InputError if a file is missing or damaged, or
    the tracks are of another run."""
    facts, source = stored_facts(folder, run, TABLE), source_of(folder / TABLE)
    with open_input(folder / TABLE, "tracks", input_files.MAX_TEXT_BYTES) as file:
        content = file.read()
    with _damage_named(source):
        table = pq.read_table(pa.BufferReader(content)).combine_chunks()
        table.validate()
    _check_columns(table, source)
    file_rows = _rows(table, rows, source)
    file_rows.check(rows)
    return TrackSet(facts.name, tracks_of([file_rows], len(rows.scene.cameras)), facts.origin)


def _tracked_run(run: StoredRun) -> TrackedRun:
    settings = run.settings
    entry = (settings.get("files") or {}).get("detections.parquet")
    return TrackedRun(
        **{key: settings[key] for key in ("scene", "scene_sha256", "seed", "detector_seed")},
        traffic_seed=settings.get("traffic_seed"),
        steps=run.steps,
        detections_sha256=entry["sha256"] if entry else None,
    )


def _check_run(of: TrackedRun, run: TrackedRun, source: str, *, of_files: bool) -> None:
    """Refuse tracks of other detections; seeds are compared first, as a user knows them. A run `of_files` is made of
    labels and detections for one command."""
    remedy = "; --truth, --detections and --labels must be given as for `modsim3d track`" if of_files else ""
    for name in ("scene", "seed", "detector_seed", "traffic_seed", "steps", "scene_sha256"):
        track_fact, run_fact = getattr(of, name), getattr(run, name)
        if track_fact != run_fact:
            clash = f"{name} was {shown(track_fact)}, and is {shown(run_fact)} in this run"
            raise InputError(source, [f"these tracks are of another run: {clash}{remedy}"])
    if None not in (of.detections_sha256, run.detections_sha256) and of.detections_sha256 != run.detections_sha256:
        clash = f"checksums these were {of.detections_sha256}, and are {run.detections_sha256} in this run"
        raise InputError(source, [f"these tracks are of other detections of the same scene and seeds: {clash}{remedy}"])


def _check_columns(table: pa.Table, source: str) -> None:
    wanted = SCHEMA.names
    problems = [f"column '{name}' is missing" for name in wanted if name not in table.column_names]
    problems += [f"column '{name}' is unknown" for name in table.column_names if name not in wanted]
    problems += [
        f"column '{field.name}' has type {field.type}, must have {SCHEMA.field(field.name).type}"
        for field in table.schema
        if field.name in wanted and field.type != SCHEMA.field(field.name).type
    ]
    if table.column_names != wanted and not problems:
        problems = [f"its columns must be {', '.join(wanted)}"]
    if problems:
        raise InputError(source, problems)


def _rows(table: pa.Table, rows: RunRows, source: str) -> FileRows:
    problems, scene = RowProblems(source, np.arange(len(table)), "row"), rows.scene
    for name in ("camera", "step", "track"):
        nulls = np.asarray(table[name].is_null(), dtype=bool)
        problems.refuse(nulls, lambda row, name=name: f"{name} is null")  # type: ignore[misc]
    problems.settle()
    cameras = [camera.name for camera in scene.cameras]
    camera, label = indices(table, "camera", cameras), indices(table, "label", scene.detector.labels)
    problems.refuse(camera == NOBODY, lambda row: f"there is no camera {shown(table['camera'][row].as_py())}")

    def say(row: int) -> str:
        return f"there is no label '{table['label'][row]}' ({nearest(str(table['label'][row]), scene.detector.labels)})"

    problems.refuse((label == NOBODY) & ~np.asarray(table["label"].is_null(), dtype=bool), say)
    frame = frames_at(rows, camera, integer_column(table, "step"), problems)
    problems.settle()
    boxes = np.column_stack([number_column(table, name) for name in BOX_SIDES])
    x, xy, y = (number_column(table, name) for name in COVARIANCES)
    covariance = np.stack([x, xy, xy, y], axis=-1).reshape(-1, 2, 2)
    track, confidence = integer_column(table, "track"), number_column(table, "confidence")
    return FileRows(problems, frame, track, boxes, CORNERS, label, confidence, covariance)


@contextmanager
def _damage_named(source: str) -> Iterator[None]:
    try:
        yield
    except (pa.ArrowException, OSError, KeyError, ValueError) as error:
        text = str(error).splitlines() or [type(error).__name__]
        raise InputError(source, [f"is no table of tracks: {text[0]}"]) from None


_FORMS = "a folder of `modsim3d track`, a .csv file, a MOT .txt file or a folder of such"


def read_tracks(path: StrPath, run: StoredRun, rows: RunRows, cameras: Sequence[int] = ()) -> TrackSet:
    """Read the tracks of a tracker in a run.

    Args:
        path: A folder that `modsim3d track` has written, a CSV file, a MOT file of the only camera, or a folder with a
            MOT file for each camera, in it or in its folder `data`.
        run: The run.
        rows: Its rows.
        cameras: Indices of the cameras whose tracks are wanted; all if there are none. No others need a MOT file.

    Raises:
        InputError: There are no such tracks, or they are wrong; each problem names its line.
        TypeError: The path is neither text nor a path.
    """
    path = as_path(path, "path")
    try:
        path.stat()
    except (OSError, ValueError) as error:  # a ValueError is a null character
        missing = isinstance(error, FileNotFoundError)
        problem = "no such file or folder" if missing else getattr(error, "strerror", None) or "is no valid name"
        raise InputError(source_of(path), [f"{problem}; tracks are {_FORMS}"]) from None
    if path.is_dir() and any((path / name).exists() for name in TRACK_FILES):
        return read_stored_tracks(path, run, rows)
    files = _files(path, rows, cameras)
    detections = _boxes_of("a detection", rows.detection_frame, rows.detection_boxes_px())
    true_px = np.concatenate([rows.boxes_px("visible"), rows.boxes_px("full")])
    truth = _boxes_of("a vessel", np.tile(rows.truth_frame, 2), true_px)
    for file, (index, camera) in product(files, enumerate(rows.scene.cameras)):
        if problem := misreading(_box_rows(file, rows, index), detections, truth):  # they are meant otherwise than read
            where = f"camera '{camera.name}': " if len(rows.scene.cameras) > 1 else ""
            raise InputError(file.problems.source, [where + problem.sentence])
    for file in files:
        file.check(rows)
    tracks = tracks_of(files, len(rows.scene.cameras))
    named = set(tracks.camera.tolist()) if len(files) == 1 and path.is_file() else set()
    unnamed = (camera.name for index, camera in enumerate(rows.scene.cameras) if named and index not in named)
    return TrackSet(_name(path), tracks, None, tuple(unnamed))


def _files(path: Path, rows: RunRows, cameras: Sequence[int]) -> list[FileRows]:
    suffix = Path(path.name.removesuffix(".gz")).suffix.lower()
    if path.is_dir() or suffix == ".txt":
        return read_mot_tracks(path, rows, cameras)
    if suffix == ".csv":
        return [read_csv_tracks(path, rows)]
    if path.name in TRACK_FILES:
        raise InputError(source_of(path), [f"this is one of the files {' and '.join(TRACK_FILES)}: give their folder"])
    raise InputError(source_of(path), [f"is none of what tracks may be: {_FORMS}"])


def _boxes_of(word: str, frame: Indices, boxes_px: Array) -> KnownBoxes:
    order = np.argsort(frame, kind="stable")
    order = order[np.isfinite(boxes_px[order]).all(axis=1)]
    return KnownBoxes(word, frame[order], boxes_px[order])


def _box_rows(file: FileRows, rows: RunRows, camera: int) -> BoxRows:
    count = len(rows.scene.cameras)
    taken, here = rows.frames[rows.frames % count == camera], file.frame % count == camera
    frame = file.frame[here]
    place = positions(taken, frame)
    before, after = np.append(NOBODY, taken)[place], np.append(taken, NOBODY)[place + 1]
    image_px = np.tile(rows.scene.cameras[camera].intrinsics.image_size_px, (len(frame), 1))
    return BoxRows(file.numbers[here], file.form, image_px, frame, before, after)


def _name(path: Path) -> str:
    whole = path.resolve()
    if whole.name == "data" and whole.is_dir():
        return whole.parent.name
    return whole.name if whole.is_dir() else name_of(whole)
