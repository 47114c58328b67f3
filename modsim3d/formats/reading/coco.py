"""COCO ground truth and COCO results, as most detection libraries write them. Beyond COCO's own keys these are read
where they are given: of an image `condition`, `sequence` (or `video_id`), `time_s` or `frame_id` (or `frame_index`),
and `horizon`; of an annotation `ignore`, `track_id` (or `instance_id`), `visible_fraction` and `distance_m`; of a
result `probabilities`, one for each category in their order. Boxes come from `bbox`; masks are ignored. `image_id`
names the image of a result, or a `file_name` beside it does. Programs that know no IDs, such as ultralytics, write the
name of the image's file without its ending as `image_id`, as a number if it is one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, TypeGuard

import orjson

from modsim3d.core.errors import InputError
from modsim3d.formats.labelled import FileIds, LabelledSet, read_horizon
from modsim3d.formats.reading import builder
from modsim3d.formats.reading.builder import ID, NO_OPTIONS, Confidences, LabelledRow, Problems, ReadOptions, is_number
from modsim3d.io.input_files import COCO_BYTES_PER_VALUE, read_text
from modsim3d.io.misreadings import LOST
from modsim3d.io.strict_text import check_values, composed_values, parse_json
from modsim3d.io.validation import nearest, shown

_MAX_NAMES = 1000  # the search for a similar name among more of them takes seconds


def read_coco(condition: str, truth: Path, detections: Path | None, options: ReadOptions = NO_OPTIONS) -> LabelledSet:
    """Read COCO's ground truth and results of one condition, or its ground truth alone. Raises InputError if the files
    are wrong; each problem names the index of its entry."""
    problems, frame_rate_hz = Problems(f"ground truth {truth}", options.skip_bad), options.frame_rate_hz
    content = _object(truth, "ground truth", problems.source)
    categories = categories_of(content, problems)
    if not categories:
        raise InputError(problems.source, ["categories: is empty, must name at least one"])
    rows_of, images, sequences = _images(content, frame_rate_hz, problems)
    annotations, results = builder.AnnotationRows(), builder.ResultRows()
    lookup = KnownNames(rows_of, {}, categories)
    for index, entry in enumerate(_list(content, "annotations", problems)):
        _annotation(entry, f"annotations[{index}]", lookup, annotations, problems)
    notes = problems.settle()
    if detections is not None:
        notes += _read_results(detections, lookup, images.names, options, results)
    numbered = any(isinstance(entry, dict) and _FRAME & entry.keys() for entry in content["images"])
    if numbered and frame_rate_hz is None and any(map(math.isnan, images.time_s)):
        notes.append("images have a frame_id, and no time: --frame-rate HZ would make one of it")
    labels = [name for name, _ in categories.values()]
    ids = FileIds(tuple(rows_of), tuple(categories), sequences, annotations.identities, files=tuple(images.names))
    return builder.labelled_set(condition, labels, images, annotations, results, notes, ids)


@dataclass(frozen=True)
class KnownNames:
    """Names that an entry may use: rows of images by `image_id` and by file name, and categories by their ID."""

    images: Mapping[Any, int]
    files: Mapping[Any, int]
    categories: Mapping[Any, tuple[str, int]]

    @classmethod
    def of_results(
        cls,
        entries: Sequence[Any],
        images: builder.ImageNames,
        categories: Mapping[Any, tuple[str, int]],
        offset: int,
        problems: Problems,
    ) -> KnownNames:
        """Names that results may use, whose category IDs may start at another number."""
        categories = {number - offset: category for number, category in categories.items()}
        rows = (entry for entry in entries if isinstance(entry, dict))
        classes = {number for entry in rows if isinstance(number := entry.get("category_id"), int)}
        if classes - categories.keys():
            for step in (1, -1):
                if {number + step for number in classes} <= categories.keys():
                    whole = offset + step
                    by = f"add {whole} to those of the detections, with `modsim3d learn` by --category-offset {whole}"
                    problems.hint = f"category IDs are off by one: {by}"
        return cls(images.by_image_id, images.by_file_name, categories)

    def place(self, entry: Any, where: str, problems: Problems) -> LabelledRow | None:
        """Image, label and box of an entry; None with a problem if it has none."""
        if not isinstance(entry, dict):
            problems.add(f"{where}: must be a mapping (got {shown(entry)})")
            return None
        file = entry.get("file_name")
        row = self.files.get(file) if isinstance(file, str) else None
        row = _named(entry, "image_id", self.images, where, problems) if row is None else row
        category = None if row is None else _named(entry, "category_id", self.categories, where, problems)
        if row is None or category is None or not builder.valid_box(entry.get("bbox"), where, problems):
            return None
        return LabelledRow(row, category[1], entry["bbox"])


def _read_results(
    detections: Path, lookup: KnownNames, names: Sequence[str], options: ReadOptions, rows: builder.ResultRows
) -> list[str]:
    """Append the results of a file; remarks on them."""
    problems, entries = Problems(f"detections {detections}", options.skip_bad), _results(detections)
    images = builder.image_names(entries, lookup.images, names)
    lookup = KnownNames.of_results(entries, images, lookup.categories, options.category_offset, problems)
    scores = ((f"[{index}]", entry.get("score")) for index, entry in enumerate(entries) if isinstance(entry, dict))
    confidences = Confidences.of(scores, options.confidence_scale, problems, "score")
    for index, entry in enumerate(entries):
        _result(entry, f"[{index}]", lookup, rows, confidences, problems)
    return [*filter(None, [images.doubt]), *problems.settle(), *confidences.notes]


def _parse(path: Path, what: str) -> Any:
    """Read JSON; if it is broken, read it again with a slower reader that names the place."""
    text = read_text(path, what)
    if not text.strip():
        raise InputError(f"{what} {path}", ["the file is empty"])
    check_values(text, f"{what} {path}", COCO_BYTES_PER_VALUE)
    try:
        return composed_values(orjson.loads(text), text)
    except orjson.JSONDecodeError:
        return parse_json(text, f"{what} {path}")


def _object(path: Path, what: str, source: str) -> Mapping[str, Any]:
    content = _parse(path, what)
    if not isinstance(content, dict):
        kind = "a list: is it the results file?" if isinstance(content, list) else shown(content)
        raise InputError(source, [f"must be a mapping with images, annotations and categories (got {kind})"])
    missing = [key for key in ("images", "annotations", "categories") if key not in content]
    if missing:
        named = {"categories": ': give the names of the IDs, as [{"id": 1, "name": "boat"}]'}
        raise InputError(source, [f"{key}: missing{named.get(key, '')}" for key in missing])
    return content


def _results(path: Path) -> list[Any]:
    content = _parse(path, "detections")
    if isinstance(content, list):
        return content
    got = f"a mapping with {', '.join(map(shown, list(content)[:5]))}" if isinstance(content, dict) else shown(content)
    wanted = "a list of results with image_id, category_id, bbox and score"
    raise InputError(f"detections {path}", [f"must be {wanted} (got {got})"])


def _list(content: Mapping[str, Any], key: str, problems: Problems) -> list[Any]:
    if isinstance(entries := content[key], list):
        return entries
    raise InputError(problems.source, [f"{key}: must be a list"])


def categories_of(content: Mapping[str, Any], problems: Problems) -> dict[Any, tuple[str, int]]:
    """Name and label of each category's ID, in the order of the file. Raises InputError if they are none."""
    categories: dict[Any, tuple[str, int]] = {}
    names = set[str]()
    for index, entry in enumerate(_list(content, "categories", problems)):
        where = f"categories[{index}]"
        identity, name = (entry.get("id"), entry.get("name")) if isinstance(entry, dict) else (None, None)
        if not _is_id(identity) or isinstance(identity, str) or not isinstance(name, str) or not name:
            raise InputError(problems.source, [f"{where}: must have an id, a whole number, and a name"])
        if identity in categories or name in names:
            raise InputError(problems.source, [f"{where}: id {identity} or name {shown(name)} appears twice"])
        names.add(name)
        categories[identity] = (name, len(categories))
    return categories


def _images(
    content: Mapping[str, Any], frame_rate_hz: float | None, problems: Problems
) -> tuple[dict[Any, int], builder.ImageRows, tuple[ID | None, ...]]:
    """Rows of the images by ID, in ascending order of the IDs as COCO's own tools have them, numbers before text; the
    images; and the names of the sequences."""
    entries: dict[Any, tuple[str, dict[str, Any]]] = {}
    for index, entry in enumerate(_list(content, "images", problems)):
        where = f"images[{index}]"
        if not isinstance(entry, dict) or not _is_id(entry.get("id")):
            problems.add(f"{where}: must have an id, a whole number or text")
        elif entry["id"] in entries:
            problems.add(f"{where}: id {shown(entry['id'])} appears twice")
        else:
            entries[entry["id"]] = where, entry
    rows_of: dict[Any, int] = {}
    images, sequences = builder.ImageRows(), dict[Any, int]()
    for identity in sorted(entries, key=lambda identity: (isinstance(identity, str), identity)):
        if _image(*entries[identity], frame_rate_hz, images, sequences, problems):
            rows_of[identity] = len(rows_of)
    return rows_of, images, tuple(sequences)


def _image(
    where: str,
    entry: Mapping[str, Any],
    frame_rate_hz: float | None,
    images: builder.ImageRows,
    sequences: dict[Any, int],
    problems: Problems,
) -> bool:
    """Append an image, whose sequence is numbered; False with a problem if it cannot be used."""
    count, given = problems.count, [entry.get("width"), entry.get("height")]
    size_px = [float(side) for side in given if is_number(side, _MIN_PX, builder.MAX_PX)]
    if len(size_px) < 2:
        got = f"{shown(given[0])} and {shown(given[1])}"
        problems.add(f"{where}: width and height must be pixels, above 0 (got {got})")
    sequence, condition = entry.get("sequence", entry.get("video_id")), entry.get("condition")
    if sequence is not None and not _is_id(sequence):
        problems.add(f"{where}: sequence must be a whole number or text (got {shown(sequence)})")
    name = entry["id"] if (file := entry.get("file_name")) in (None, "") else file
    for key, value in (("file_name", name), ("condition", condition)):
        if value is not None and not (_is_id(value) or is_number(value)):
            problems.add(f"{where}: {key} must be text (got {shown(value)})")
    time_s = _time_s(entry, frame_rate_hz)
    if time_s is None:
        got = shown(entry.get("time_s", entry.get("frame_id", entry.get("frame_index"))))
        problems.add(f"{where}: time_s and frame_id must be numbers (got {got})")
    sea = read_horizon(entry.get("horizon"), size_px[0] if size_px else math.nan)
    if sea is None:
        wanted = "a row, [left, right], its rows at both edges, or [x1, y1, x2, y2], in pixels"
        problems.add(f"{where}: horizon must be {wanted} (got {shown(entry['horizon'])})")
    if time_s is None or sea is None or problems.count > count:
        return False
    number = sequences.setdefault(sequence, len(sequences))
    images.add(str(name), size_px, number, time_s, None if condition is None else str(condition), sea)
    return True


_MIN_PX, _FRAME = 1e-6, {"frame_id", "frame_index"}


def _is_id(value: Any) -> TypeGuard[ID]:
    return isinstance(value, str) or (isinstance(value, int) and is_number(value))


def _time_s(entry: Mapping[str, Any], frame_rate_hz: float | None) -> float | None:
    """Time of an image, NaN where it is not known, None where it is no number."""
    time = entry.get("time_s")
    if time is None and frame_rate_hz is not None:
        frame = entry.get("frame_id", entry.get("frame_index"))
        time = frame / frame_rate_hz if is_number(frame) else frame
    if time is None:
        return math.nan
    return float(time) if is_number(time) else None


def _named(entry: Mapping[str, Any], key: str, table: Mapping[Any, Any], where: str, problems: Problems) -> Any:
    """The value that an entry refers to by a key; None with a problem if there is no such value."""
    value = entry.get(key)
    if (isinstance(value, str) or is_number(value)) and value in table:
        return table[value]
    # The search for similar names takes long: not for problems that will not be shown, and not among very many.
    searched = map(shown, islice(table, _MAX_NAMES))
    hint = f" ({nearest(shown(value), searched)})" if problems.count < builder.MAX_PROBLEMS else ""
    problems.add(f"{where}: unknown {key} {shown(value)}{hint}" if key in entry else f"{where}: {key} is missing")
    return None


_MIN_LOST, _MANY_LOST = 1e7, 1e4  # so large a number with so many zeros stands for other identities too
_MAX_VALUES = {"visible_fraction": 1 + 1e-6, "distance_m": builder.MAX_NUMBER}


def _number(entry: Mapping[str, Any], key: str, where: str, problems: Problems) -> float:
    """A number within the range of its key, NaN where it is not given; adds a problem if it is out of range."""
    value = entry.get(key)
    if value is None:
        return math.nan
    if is_number(value, 0, _MAX_VALUES[key]):
        return float(value)
    if not isinstance(value, int | float) or isinstance(value, bool):
        problems.add(f"{where}: {key} must be a number (got {shown(value)})")
    else:
        wanted = "from 0 to 1" if key == "visible_fraction" else "0 or more"
        problems.add(f"{where}: {key} must be {wanted} (got {shown(value)})")
    return math.nan


def _identity(entry: Mapping[str, Any], where: str, problems: Problems) -> ID | None:
    """Identity of an annotation; None where it is not given or -1, as in MOT. Other programs write whole numbers as 4.0
    too. Adds a problem if it is neither a whole number nor a text."""
    key = "track_id" if "track_id" in entry else "instance_id"
    identity = entry.get(key)
    if isinstance(identity, float) and identity.is_integer():
        if identity >= _MIN_LOST and identity % _MANY_LOST == 0:
            problems.add(f"{where}: {key} {LOST} (got {identity:g})")
        identity = int(identity)
    if identity is None or isinstance(identity, str):
        return identity
    if isinstance(identity, bool) or not isinstance(identity, int):
        problems.add(f"{where}: {key} must be a whole number or a text (got {shown(identity)})")
        return None
    if identity < -1:
        problems.add(f"{where}: {key} must be 0 or more, or -1 where it is not known (got {identity})")
    return identity if identity >= 0 else None


def _annotation(entry: Any, where: str, lookup: KnownNames, rows: builder.AnnotationRows, problems: Problems) -> None:
    place = lookup.place(entry, where, problems)
    if place is None:
        return
    before = problems.count
    visible_fraction, depth_m = (_number(entry, key, where, problems) for key in ("visible_fraction", "distance_m"))
    identity = _identity(entry, where, problems)
    if rows.has(place.image, identity):
        problems.add(f"{where}: identity {shown(identity)} is in the image {shown(entry.get('image_id'))} already")
    crowd, ignored = (builder.read_flag(entry.get(key), key, where, problems) for key in ("iscrowd", "ignore"))
    if problems.count == before:
        rows.add(place, crowd or ignored, crowd, identity, visible_fraction, depth_m)


def _result(
    entry: Any, where: str, lookup: KnownNames, rows: builder.ResultRows, confidences: Confidences, problems: Problems
) -> None:
    place = lookup.place(entry, where, problems)
    if place is None:
        return
    score, given = confidences.read(entry.get("score"), where, problems), entry.get("probabilities")
    if score is None:
        return
    count = len(lookup.categories)
    if given is not None and not (
        isinstance(given, list) and len(given) == count and all(is_number(value, 0, 1) for value in given)
    ):
        problems.add(f"{where}: probabilities must be {count} numbers from 0 to 1 (got {shown(given)})")
    else:
        rows.add(place, score, given)
