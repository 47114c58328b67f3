"""Base of all readers of labelled sets: they collect rows and problems, and make columns of the rows."""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any, TypeGuard

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Indices
from modsim3d.core.boxes import from_top_left
from modsim3d.core.errors import InputError
from modsim3d.formats.labelled import UNKNOWN, Annotations, FileIds, Images, LabelledSet, Results
from modsim3d.io.input_files import MAX_BAD_ENTRIES
from modsim3d.io.misreadings import ROUNDED, are_rounded
from modsim3d.io.validation import shown

MAX_PROBLEMS = 20
MAX_PX = 1e7  # a larger coordinate is no place in an image, and its square would leave no digits
MAX_NUMBER = 1e15  # a larger number is no identity, distance or time, and neighbours of it cannot be told apart
_HALF_CHARACTER = re.compile("[\ud800-\udfff]")


@dataclass(frozen=True)
class ReadOptions:
    """Facts that files do not state themselves."""

    labels: tuple[str, ...] = ()  # names of the classes from number 1 in MOT and 0 in YOLO
    image_size_px: tuple[float, float] | None = None  # for MOT without `seqinfo.ini` and for YOLO without its images
    skip_bad: bool = False  # leave out wrong entries and count them
    frame_rate_hz: float | None = None  # for MOT, and for COCO whose images have a `frame_id` alone
    category_offset: int = 0  # to be added to the category IDs of COCO results
    confidence_scale: tuple[float, float] | None = None  # what stands for 0 and for 1 in the files; None: 0 and 1
    horizon: tuple[float, ...] | None = None  # of images without one: its row, or x and y of two of its points
    first_frame: int | None = None  # number of the first frame and of the first pixel in MOT, 0 or 1; None: see `mot`

    def __post_init__(self) -> None:
        """Raise InputError if a value is out of range."""
        scale, size_px = self.confidence_scale, self.image_size_px
        if scale is not None and not scale[0] < scale[1]:
            raise InputError("--confidence-scale", [f"must be two numbers that rise, as 0,100 (got {scale})"])
        if size_px is not None and not min(size_px) > 0:
            raise InputError("--image-size", [f"must be a width and a height above 0 (got {size_px})"])


NO_OPTIONS = ReadOptions()


@dataclass
class Problems:
    """Problems of the entries of a file: a line for each, and a hint that may help with many of them at once. With
    `skip`, wrong entries are left out and counted; without it, they are an error. Only the first lines are kept."""

    source: str
    skip: bool = False
    lines: list[str] = field(default_factory=list)
    count: int = 0
    hint: str = ""

    def add(self, line: str) -> None:
        """Record an entry that cannot be used. Raises InputError for too many of them that are not to be skipped."""
        self.count += 1
        if self.count <= MAX_PROBLEMS:
            self.lines.append(line)
        if self.count >= MAX_BAD_ENTRIES and not self.skip:
            self.settle()

    def settle(self) -> list[str]:
        """A remark on how many entries were left out, if any. Raises InputError if they are not to be skipped."""
        if not self.lines:
            return []
        if self.skip:
            return [f"{self.source}: {self.count} entries left out, the first because {self.lines[0]}"]
        lines = list(self.lines)
        if self.count >= MAX_BAD_ENTRIES:
            lines.append(f"... {self.count:,} in all so far; the rest was not read. --skip-bad leaves such entries out")
        elif self.count > MAX_PROBLEMS:
            lines.append(f"... and {self.count - MAX_PROBLEMS} more; --skip-bad leaves all such entries out")
        lines += [self.hint] if self.hint else []
        raise InputError(self.source, lines)


def is_number(value: Any, least: float = -MAX_NUMBER, most: float = MAX_NUMBER) -> TypeGuard[float]:
    """Whether a value of JSON is a number in a range: not true or false, NaN, or a number of 400 digits."""
    return isinstance(value, int | float) and not isinstance(value, bool) and least <= value <= most


_FLAGS = {"0": False, "1": True, "false": False, "true": True}


def read_flag(value: Any, name: str, where: str, problems: Problems) -> bool:
    """A flag, as number, truth value or text; false where it is not given, and with a problem where it is none."""
    flag = False if value is None else _FLAGS.get(str(value).strip().lower().removesuffix(".0"))
    if flag is None:
        got = f"{value:g}" if is_number(value) else shown(value)
        problems.add(f"{where}: {name} must be 0 or 1, false or true (got {got})")
    return bool(flag)


def valid_box(values: Any, where: str, problems: Problems) -> bool:
    """Whether values are a position, width and height in pixels that can be a box; adds a problem if not."""
    if (
        not isinstance(values, list)
        or len(values) != 4
        or not all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    ):
        problems.add(f"{where}: bbox must be [x, y, width, height] in pixels (got {shown(values)})")
        return False
    _, _, width, height = values
    if not all(is_number(value, -MAX_PX, MAX_PX) for value in values):
        problems.add(f"{where}: bbox must be in pixels, at most {MAX_PX:g} (got {shown(values)})")
    elif width <= 0 or height <= 0:
        problems.add(f"{where}: bbox has no area: width {width:g}, height {height:g}")
    else:
        return True
    return False


@dataclass(frozen=True)
class LabelledRow:
    """Row of the image, index of the label and box, four numbers in the form of the file, of an entry."""

    image: int
    label: int
    box_px: list[float]


@dataclass
class _Rows:
    """Rows as they are read; `to_corners` makes boxes as x_min, y_min, x_max, y_max of the file's, shapes (n, 4)."""

    to_corners: Callable[[Array], Array] = from_top_left
    places: list[LabelledRow] = field(default_factory=list)

    def _columns(self) -> tuple[Indices, Indices, Array]:
        """Images (n,), labels (n,) and boxes as corners (n, 4)."""
        boxes = np.array([place.box_px for place in self.places], dtype=np.float64).reshape(-1, 4)
        image = np.array([place.image for place in self.places], dtype=np.int64)
        return image, np.array([place.label for place in self.places], dtype=np.int64), self.to_corners(boxes)


@dataclass
class AnnotationRows(_Rows):
    """Annotations as they are read; see the columns of `Annotations`."""

    attributes: list[tuple[bool, bool, Any, float, float, float]] = field(default_factory=list)
    _seen: set[tuple[int, Any]] = field(default_factory=set)

    def has(self, image: int, identity: Any) -> bool:
        """Whether a thing is in the image already, which it can be only once."""
        return identity is not None and (image, identity) in self._seen

    def add(
        self,
        place: LabelledRow,
        ignored: bool = False,
        crowd: bool = False,
        identity: Any = None,
        visible_fraction: float = math.nan,
        depth_m: float = math.nan,
        in_frame_fraction: float = math.nan,
    ) -> None:
        """Append a row; an unknown identity is None, other unknown values are NaN."""
        self._seen.add((place.image, identity))
        self.places.append(place)
        self.attributes.append((ignored, crowd, identity, visible_fraction, depth_m, in_frame_fraction))

    @property
    def identities(self) -> tuple[Any, ...]:
        """All identities, in the order in which they appear."""
        of_rows = (attributes[2] for attributes in self.attributes)
        return tuple(dict.fromkeys(identity for identity in of_rows if identity is not None))

    def annotations(self) -> Annotations:
        """The rows as columns, ordered by image; identities are numbered in the order in which they appear."""
        nothing = ((),) * 6
        numbers = {name: number for number, name in enumerate(self.identities)}
        ignored, crowd, identity, visible, depth_m, in_frame = tuple(zip(*self.attributes, strict=True)) or nothing
        return Annotations(
            *self._columns(),
            ignored=np.array(ignored, dtype=bool),
            crowd=np.array(crowd, dtype=bool),
            identity=np.array([NOBODY if name is None else numbers[name] for name in identity], dtype=np.int64),
            visible_fraction=np.array(visible, dtype=np.float64),
            depth_m=np.array(depth_m, dtype=np.float64),
            in_frame_fraction=np.array(in_frame, dtype=np.float64),
        ).by_image()


@dataclass
class ResultRows(_Rows):
    """Results as they are read; see the columns of `Results`."""

    confidence: list[float] = field(default_factory=list)
    probabilities: list[list[float] | None] = field(default_factory=list)

    def add(self, place: LabelledRow, confidence: float, probabilities: list[float] | None = None) -> None:
        """Append a row."""
        self.places.append(place)
        self.confidence.append(confidence)
        self.probabilities.append(probabilities)

    def results(self, labels: int) -> Results:
        """The rows as columns, ordered by image, with probabilities of so many labels."""
        probabilities = None
        if any(given is not None for given in self.probabilities):
            nothing = [math.nan] * labels
            probabilities = np.array([nothing if given is None else given for given in self.probabilities])
        confidence = np.array(self.confidence, dtype=np.float64)
        return Results(*self._columns(), confidence, probabilities).by_image()


@dataclass
class ImageRows:
    """Images as they are read; see the columns of `Images`. An image that names no condition has None."""

    names: list[str] = field(default_factory=list)
    sizes_px: list[Sequence[float]] = field(default_factory=list)
    sequence: list[int] = field(default_factory=list)
    time_s: list[float] = field(default_factory=list)
    condition: list[str | None] = field(default_factory=list)
    half_planes: list[Sequence[float]] = field(default_factory=list)

    def add(
        self,
        name: str,
        size_px: Sequence[float],
        sequence: int = 0,
        time_s: float = math.nan,
        own: str | None = None,
        sea: Sequence[float] = UNKNOWN,
    ) -> None:
        """Append an image, which may name a condition of its own."""
        for column, value in zip(vars(self).values(), (name, size_px, sequence, time_s, own, sea), strict=True):
            column.append(value)


def check_whole(names: Iterable[str], source: str) -> None:
    """Raise InputError if a name holds half a character, and so cannot be written."""
    broken = [name for name in names if _HALF_CHARACTER.search(name)][:MAX_PROBLEMS]
    if broken:
        raise InputError(source, [f"{shown(name)} holds half a character, which no file can hold" for name in broken])


def labelled_set(
    condition: str,
    labels: Sequence[str],
    images: ImageRows,
    annotations: AnnotationRows,
    results: ResultRows,
    notes: Sequence[str],
    ids: FileIds | None = None,
) -> LabelledSet:
    """A labelled set of one source; images that name no condition of their own have the given one. Raises InputError if
    two labels have the same name, a name cannot be written, or identities have lost digits."""
    repeated = sorted(name for name, count in Counter(labels).items() if count > 1)[:MAX_PROBLEMS]
    if repeated:
        raise InputError(f"labels of {condition}", [f"{shown(name)} names more than one class" for name in repeated])
    of_image = [condition if name is None else name for name in images.condition]
    conditions = tuple(dict.fromkeys(of_image)) or (condition,)
    check_whole((*labels, *conditions), f"labels and conditions of {condition}")
    if are_rounded(annotations.identities):
        raise InputError(f"ground truth of {condition}", [f"its tracks {ROUNDED}"])
    number_of = {name: number for number, name in enumerate(conditions)}
    columns = Images(
        tuple(images.names),
        np.array(images.sizes_px, dtype=np.float64).reshape(-1, 2),
        np.array([number_of[name] for name in of_image], dtype=np.int64),
        np.zeros(len(of_image), dtype=np.int64),
        np.array(images.sequence, dtype=np.int64),
        np.array(images.time_s, dtype=np.float64),
        np.array(images.half_planes, dtype=np.float64).reshape(-1, 3),
    )
    return LabelledSet(
        tuple(labels), conditions, columns, annotations.annotations(), results.results(len(labels)), tuple(notes), ids
    )


# ---- Which images COCO results name ----

ID = int | str
_MAX_DIGITS = 18  # of a file's name that is a number


@dataclass(frozen=True)
class ImageNames:
    """Rows of images by what results may call them."""

    by_image_id: Mapping[Any, int]
    by_file_name: Mapping[ID, int]  # by the `file_name` that a result may have beside its `image_id`
    image_ids_are_files: bool  # whether each `image_id` is taken for the name of a file
    doubt: str  # a remark if every `image_id` can be read as an ID and as a file, and some differ; else empty


def image_names(entries: Sequence[Any], rows_of_ids: Mapping[Any, int], names: Sequence[str]) -> ImageNames:
    """Reading of the `image_id` of results by which more of them are images. `entries` are the results as they are in
    the file; rows of images are given by ID and, as `names`, by file name."""
    results = [entry for entry in entries if isinstance(entry, dict)]
    given: set[Any] = {
        image for entry in results if isinstance(image := entry.get("image_id"), str) or is_number(image)
    }
    files, stems = _by_file(names)
    if len(given & stems.keys()) > len(given & rows_of_ids.keys()):
        return ImageNames(stems, files, True, "")
    doubt = ""
    file_names_decide = any("file_name" in entry for entry in results)
    both = given <= stems.keys() & rows_of_ids.keys()
    if both and not file_names_decide and any(stems[image] != rows_of_ids[image] for image in given):
        doubt = "each image_id of the results is an image's id, and the name of another's file too: taken for the id"
    return ImageNames(rows_of_ids, files, False, doubt)


def _by_file(names: Sequence[str]) -> tuple[dict[ID, int], dict[ID, int]]:
    """Rows of images by file name, and by name without folder and ending; names of several images are left out."""
    files, stems = defaultdict[ID, list[int]](list), defaultdict[ID, list[int]](list)
    for row, name in enumerate(names):
        path = PurePosixPath(name.replace("\\", "/"))
        names_of: set[ID] = {name, str(path), path.name}
        number: set[ID] = {int(path.stem)} if path.stem.isdecimal() and len(path.stem) <= _MAX_DIGITS else set()
        for key in names_of:
            files[key].append(row)
        for key in names_of | {path.stem} | number:
            stems[key].append(row)
    by_file, by_stem = ({key: rows[0] for key, rows in index.items() if len(rows) == 1} for index in (files, stems))
    return by_file, by_stem


NOT_GIVEN = -1  # stands for a confidence that is not given, as MOT has it
Scale = tuple[float, float]
_PERCENT, _MANY = 100, 8


@dataclass(frozen=True)
class Confidences:
    """Reading of the confidences of one file."""

    name: str  # what the file calls a confidence
    low: float  # becomes 0
    high: float  # becomes 1
    given: bool  # whether the file gives confidences
    example: str  # place and value of one that is given; of use where others are not
    odd: str = ""  # what they may be instead; empty if nothing speaks for it

    @classmethod
    def of(
        cls, values: Iterable[tuple[str, Any]], scale: Scale | None, problems: Problems, name: str = "confidence"
    ) -> Confidences:
        """Reading of these values, each with its place in the file; with a hint if they are on another scale. Raises
        InputError if none is given, and they are to be scaled."""
        low, high = scale or (0.0, 1.0)
        rows = [(where, float(value)) for where, value in values if is_number(value)]
        scores = [(where, value) for where, value in rows if value != NOT_GIVEN]
        if rows and not scores and scale:
            raise InputError(problems.source, [f"--confidence-scale: every {name} is -1, which means not given"])
        if scores and not all(low <= value <= high for _, value in scores):
            numbers = [value for _, value in rows]
            problems.hint = problems.hint or _hint(min(numbers), max(numbers), name)
            if all(value == int(value) for value in numbers):
                problems.hint = f"whole numbers may be tracks or classes, not {name}s; if not so, {problems.hint}"
        inside = next((f"{where} has {value:g}" for where, value in scores if low <= value <= high), "")
        whole = all(low <= value <= high for _, value in scores)
        odd, score_values = "", {value for _, value in scores}
        if len(rows) >= _MANY and scale is None:
            if score_values == {1}:
                odd = f"all {len(scores):,} {name}s are 1: if that is the number of a track, {name}s are missing"
            elif score_values == {0, 1}:
                odd = f"all {len(scores):,} {name}s are 0 or 1: if these are flags, {name}s are missing"
            elif not scores:
                odd = f"all {len(rows):,} {name}s are -1, which means not given"
        return cls(name, low, high, bool(scores) or not rows, inside if whole else "", odd)

    @property
    def notes(self) -> list[str]:
        """A remark if they are scaled, or may be something else."""
        if self.odd:
            return [self.odd]
        if (self.low, self.high) == (0, 1):
            return []
        return [f"{self.name}s from {self.low:g} to {self.high:g} were mapped onto 0 to 1 (--confidence-scale)"]

    def read(self, value: Any, where: str, problems: Problems) -> float | None:
        """A confidence from 0 to 1, NaN where the file gives none; None with a problem if it is wrong."""
        if value == NOT_GIVEN and not self.given:
            return math.nan
        if is_number(value, self.low, self.high):
            return (value - self.low) / (self.high - self.low)
        if value == NOT_GIVEN and self.example:
            problems.add(f"{where}: has no {self.name} (-1), but {self.example}: give one everywhere, or nowhere")
        else:
            got = f"{value:g}" if is_number(value) else shown(value)
            problems.add(f"{where}: {self.name} must be from {self.low:g} to {self.high:g} (got {got})")
        return None


def _hint(least: float, most: float, name: str) -> str:
    low, high = math.floor(least * 100) / 100, math.ceil(most * 100) / 100
    if least >= 0 and 10 < most <= _PERCENT:
        low, high = 0, _PERCENT
    return (
        f"{name}s are from {least:g} to {most:g} here: --confidence-scale LOW,HIGH maps LOW to 0 and HIGH to 1, as in "
        f"--confidence-scale {low:.10g},{high:.10g}"
    )
