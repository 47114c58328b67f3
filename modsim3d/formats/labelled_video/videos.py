"""The videos of a labelled set: each is one sequence of images, in order of time."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.errors import InputError
from modsim3d.formats.labelled import FileIds, Images, LabelledSet
from modsim3d.io.validation import nearest, shown

NO_NAME = "sequence"
"""The name of a sequence to which the file gives none."""
_UNSAFE = re.compile(r"[^A-Za-z0-9_.-]")
_MOST_NAME = 100
_MOST_SIDE_PX = 100_000


@dataclass(frozen=True, eq=False)
class Video:
    """One sequence, which is one camera of the detector.

    Attributes:
        name: What the file calls it; random numbers are keyed by it.
        images: Row of each of S frames in the labelled set's images, in order of time, shape (S,).
        times_s: Time of each frame as the file has it, ascending, shape (S,).
        size_px: Width and height of its images.
    """

    name: str
    images: Indices
    times_s: Array
    size_px: tuple[int, int]

    @property
    def file_name(self) -> str:
        """The name with no character that a file's name should not have."""
        return _UNSAFE.sub("_", self.name)[:_MOST_NAME]


def videos_of(labelled: LabelledSet, ids: FileIds, source: str) -> list[Video]:
    """The sequences in order of their names.

    Raises:
        InputError: There are no images, or images of a sequence have no times, equal times or different sizes.
    """
    images = labelled.images
    if not len(images):
        raise InputError(source, ["there are no images, nor does a seqLength in seqinfo.ini say how many"])
    problems: list[str] = []
    videos = []
    order = np.lexsort((images.time_s, images.sequence))
    for number, rows in zip(*_split(images.sequence[order], order), strict=True):
        given = ids.sequences[number]
        name = NO_NAME if given is None else str(given)
        found = list(_problems(name, images, rows))
        problems += found
        if not found:
            width, height = images.sizes_px[rows[0]].astype(np.int64).tolist()
            videos.append(Video(name, rows, images.time_s[rows], (width, height)))
    problems += _alike(videos)
    if problems:
        raise InputError(source, problems)
    return sorted(videos, key=lambda video: video.name)


def _split(sequence: Indices, rows: Indices) -> tuple[list[int], list[Indices]]:
    """The number of each sequence, and its rows."""
    numbers, starts = np.unique(sequence, return_index=True)
    return numbers.tolist(), np.split(rows, starts[1:])


def _problems(name: str, images: Images, rows: Indices) -> Iterator[str]:
    """Reasons why images, in order of time, are no video."""
    times_s, sizes_px = images.time_s[rows], images.sizes_px[rows]
    if np.isnan(times_s).any():
        unknown = images.names[rows[np.isnan(times_s)][0]]
        yield (
            f"sequence {shown(name)}: {int(np.isnan(times_s).sum())} of {len(rows)} images have no time, the first is "
            f"{shown(unknown)}: give --frame-rate HZ, with COCO beside a frame_id of each image, or its time_s"
        )
    elif len(same := np.flatnonzero(np.diff(times_s) == 0)):
        pair = " and ".join(shown(images.names[row]) for row in rows[same[0] : same[0] + 2])
        yield (
            f"sequence {shown(name)}: images {pair} have the same time, {times_s[same[0]]:g} s: if they are of "
            "different videos, name these in sequence or video_id"
        )
    wrong = (sizes_px != sizes_px[:1]).any(axis=1)
    if wrong.any():
        first, other = ("{:g} × {:g}".format(*size) for size in sizes_px[[0, int(wrong.argmax())]].tolist())
        yield f"sequence {shown(name)}: images are {first} and {other} px: all of a sequence must have one size"
    elif ((sizes_px != np.rint(sizes_px)) | (sizes_px > _MOST_SIDE_PX)).any():
        width, height = sizes_px[0].tolist()
        yield (
            f"sequence {shown(name)}: width and height of its images must be whole pixels, at most {_MOST_SIDE_PX:,} "
            f"(got {width:g} × {height:g})"
        )


def _alike(videos: list[Video]) -> Iterator[str]:
    """Sequences whose files would have one name, also where the case of names means nothing."""
    known: dict[str, str] = {}
    for video in videos:
        before = known.setdefault(video.file_name.casefold(), video.name)
        if before is not video.name:
            yield f"sequences {shown(before)} and {shown(video.name)} would have files of one name: rename one of them"


# ---- Which of the detector's labels each class of a file is ----

NO_TARGET = "-"
"""In place of a label: things of this class are not to be detected."""


@dataclass(frozen=True)
class FileClasses:
    """The classes of a file.

    Attributes:
        kind: `MOT` or `COCO`.
        names: Their names; MOT's have none of their own and are called `class_1`, `class_2` and so on.
        numbers: Their numbers; 0 in a MOT file without classes.
    """

    kind: str
    names: tuple[str, ...]
    numbers: tuple[int, ...]

    def in_words(self, index: int) -> str:
        """Name of a class in messages."""
        if self.kind == "COCO":
            return f"category {shown(self.names[index])}"
        return f"class {self.numbers[index]}" if self.numbers[index] else "the one class of the file"


def to_labels(
    classes: FileClasses, used: Mask, given: Sequence[str] | None, labels: Sequence[str]
) -> tuple[Indices, list[str]]:
    """Index into the detector's labels of each of k classes, −1 for one that is no target, shape (k,); and remarks.

    Args:
        classes: The classes.
        used: Which of them have boxes that are to be detected, shape (k,).
        given: A label of the detector, or `-`, for each class in the order of the file or of the numbers, as `--labels`
            has them; None if there are none.
        labels: The detector's labels.

    Raises:
        InputError: A class that is used has no label.
    """
    whole = np.flatnonzero(used)
    if given is not None:
        problems = list(_given_problems(classes, used, given, labels))
        if problems:
            raise InputError("--labels", problems)
        named = [*given[: len(classes.names)], *[NO_TARGET] * (len(classes.names) - len(given))]
        return np.array([-1 if name == NO_TARGET else labels.index(name) for name in named], dtype=np.int64), []
    if classes.kind == "MOT" and len(whole) == len(labels) == 1:
        mapped = np.full(len(classes.names), -1)
        mapped[whole] = 0
        return mapped, [f"{classes.in_words(whole[0])} is taken for the detector's one label, {labels[0]}"]
    problems = [
        f"{classes.in_words(index)} is not one of the detector's labels ({nearest(classes.names[index], labels)})"
        for index in whole.tolist()
        if classes.names[index] not in labels
    ]
    if problems:
        raise InputError("labels", [*problems, _how(classes)])
    return np.array([labels.index(name) if name in labels else -1 for name in classes.names], dtype=np.int64), []


def _how(classes: FileClasses) -> str:
    order = f"in the order of the file ({', '.join(classes.names[:20])})"
    if classes.kind == "MOT":
        order = f"for each class from 1 to {len(classes.names)}"
    return f"give --labels A,B,... with a label of the detector {order}; {NO_TARGET} for one that is not to be detected"


def _given_problems(classes: FileClasses, used: Mask, given: Sequence[str], labels: Sequence[str]) -> Iterator[str]:
    for name in dict.fromkeys(given):
        if name not in labels and name != NO_TARGET:
            yield f"'{name}' is not one of the detector's labels ({nearest(name, labels)})"
    if classes.kind == "COCO" and len(given) > len(classes.names):
        yield f"names {len(given)} categories, and the file has {len(classes.names)}"
    for index in np.flatnonzero(used)[np.flatnonzero(used) >= len(given)].tolist():
        yield f"does not say what {classes.in_words(index)} is: {_how(classes)}"
