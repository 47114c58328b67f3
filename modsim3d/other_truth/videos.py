"""The videos of a labelled set: each is one sequence of images, in order of time."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.errors import InputError
from modsim3d.formats.labelled import FileIds, Images, LabelledSet
from modsim3d.inputs.validation import shown

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
    """What keeps images, in order of time, from being a video."""
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
