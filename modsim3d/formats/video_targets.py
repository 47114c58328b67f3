"""The videos and labels of a labelled set, and the boxes that a detector is to find in them."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from modsim3d.core.arrays import Array, Columns, Indices, Mask
from modsim3d.core.boxes import areas, clip, intersections, sizes
from modsim3d.core.errors import InputError
from modsim3d.core.text import counted
from modsim3d.formats.labelled import FileIds, Images, LabelledSet
from modsim3d.io.validation import nearest, shown
from modsim3d.truth.analytic import NOTHING_PX2, Hiders
from modsim3d.truth.occlusion_order import overlapping_pairs


def visible_fractions(image: Indices, boxes_px: Array, feet_px: Array) -> Array:
    """Share of each box that no nearer box of its image covers: (n,). `image` of each box is non-decreasing: (n,),
    `boxes_px` are cut at the edge of the image: (n, 4), `feet_px` are the lower edges before that: (n,)."""
    first, second = overlapping_pairs(image, boxes_px)
    below, above = feet_px[first] > feet_px[second], feet_px[first] < feet_px[second]
    hiding = Hiders.of(np.concatenate([second[below], first[above]]), np.concatenate([first[below], second[above]]))
    hidden_px = np.zeros(len(boxes_px))
    common_px = intersections(boxes_px[hiding.hidden], boxes_px[hiding.hiders])
    rows, starts, counts = np.unique(hiding.hidden, return_index=True, return_counts=True)
    hidden_px[rows] = common_px[starts]
    for row, start, count in zip(*(column[counts > 1].tolist() for column in (rows, starts, counts)), strict=True):
        nearer = boxes_px[hiding.hiders[start : start + count]]
        low, high = np.maximum(nearer[:, :2], boxes_px[row, :2]), np.minimum(nearer[:, 2:], boxes_px[row, 2:])
        hidden_px[row] = shapely.area(shapely.union_all(shapely.box(*low.T, *high.T)))
    whole_px = np.maximum(areas(boxes_px), 0)
    left_px = np.where(whole_px - hidden_px > NOTHING_PX2, whole_px - hidden_px, 0.0)
    return np.where(hidden_px > 0, left_px / np.where(whole_px > 0, whole_px, 1.0), 1.0)


MAX_BOXES = 2000  # of an image: pairs of them are compared
_HALF = 0.5


@dataclass(frozen=True, eq=False)
class TargetBoxes(Columns):
    """The boxes that are to be found, n rows in order of image and track."""

    image: Indices  # row of the images, non-decreasing: (n,)
    track: Indices  # index into the identities of the file: (n,)
    label: Indices  # index into the detector's labels: (n,)
    boxes_px: Array  # cut at the edge of the image: (n, 4)
    visible_fraction: Array
    depth_m: Array  # NaN where unknown: (n,)
    in_frame_fraction: Array  # NaN where unknown: (n,)
    rows: Indices  # of each among the annotations: (n,)
    from_overlap: int  # visible fractions that come from the overlap of boxes, not from the file
    notes: tuple[str, ...]  # what was left out, and where visible fractions come from


def sought_in(labelled: LabelledSet, to_label: Indices, tracks: tuple[int | str, ...], source: str) -> TargetBoxes:
    """Targets of a detector in a labelled set. `to_label` has the detector's label of each of its labels, −1 for what
    is no target: (k,), `tracks` its identities, by whose names the rows of an image are ordered, `source` what messages
    call the file. Raises InputError if a box that is to be found has no track, or an image has too many boxes."""
    rows = labelled.annotations
    counts = np.bincount(rows.image, minlength=1)
    if (most := int(counts.max())) > MAX_BOXES:
        image = shown(labelled.images.names[int(counts.argmax())])
        raise InputError(source, [f"image {image} has {most:,} boxes, and at most {MAX_BOXES:,} can be compared"])
    boxes_px = clip(rows.boxes_px, labelled.images.sizes_px[rows.image])
    inside = (sizes(boxes_px) > 0).all(axis=1)
    of_label = to_label[rows.label] >= 0
    wanted = ~rows.ignored & of_label
    solid = np.flatnonzero(inside & ~rows.crowd)
    targets = np.flatnonzero(wanted & inside)
    if len(without := targets[rows.identity[targets] < 0]):
        image = shown(labelled.images.names[rows.image[without[0]]])
        what = f"{len(without)} of {len(targets)} boxes have no track, the first is in image {image}"
        raise InputError(source, [f"{what}: each needs a track_id in COCO, or a track of 0 or more in a text file"])
    feet_px = rows.boxes_px[:, 3]
    fractions, from_overlap, notes = _visible(rows.visible_fraction, rows.image, boxes_px, feet_px, solid, targets)
    left_out = {
        "not to be considered": rows.ignored,
        "of classes that are not to be detected": ~rows.ignored & ~of_label,
        "outside their image": wanted & ~inside,
    }
    counted = ((why, int(mask.sum())) for why, mask in left_out.items())
    remarks = [f"{count} of {len(rows)} boxes are left out: {why}" for why, count in counted if count]
    names = np.argsort(np.argsort(np.array([str(track) for track in tracks], dtype=object), kind="stable"))
    order = targets[np.lexsort((names[rows.identity[targets]] if len(names) else targets, rows.image[targets]))]
    places = rows.image[order], rows.identity[order], to_label[rows.label[order]], boxes_px[order]
    by_overlap = int(from_overlap[order].sum())
    in_frame = np.full(len(order), np.nan) if rows.in_frame_fraction is None else rows.in_frame_fraction[order]
    return TargetBoxes(*places, fractions[order], rows.depth_m[order], in_frame, order, by_overlap, (*remarks, *notes))


def _visible(
    given: Array, image: Indices, boxes_px: Array, feet_px: Array, solid: Indices, targets: Indices
) -> tuple[Array, Mask, list[str]]:
    """Visible fractions of all boxes, which of them come from overlap, shapes (n,), and remarks."""
    unknown = np.isnan(given)
    missing, constant = int(unknown[targets].sum()), len(targets) > 0 and bool((given[targets] == 1).all())
    fractions = given.copy()
    if not missing and not constant:
        return fractions, unknown, []
    of_overlap = np.ones(len(given))
    of_overlap[solid] = visible_fractions(image[solid], boxes_px[solid], feet_px[solid])
    if missing:
        fractions[unknown] = of_overlap[unknown]
        nearer = "of overlapping boxes the one with the lower foot is nearer"
        return fractions, unknown, [f"visibility of {missing} of {len(targets)} boxes comes from overlap: {nearer}"]
    hidden = int((of_overlap[targets] < _HALF).sum())
    doubt = f"the file's visibility is 1 everywhere, but other boxes cover more than half of {hidden} boxes"
    remedy = "if it is not known, leave it out, and it comes from overlap"
    return fractions, unknown, [f"{doubt}: {remedy}"] if hidden else []


NO_NAME = "sequence"  # the name of a sequence to which the file gives none
_UNSAFE = re.compile(r"[^A-Za-z0-9_.-]")
_MAX_NAME = 100
_MAX_SIDE_PX = 100_000


@dataclass(frozen=True, eq=False)
class Video:
    """One sequence, which is one camera of the detector."""

    name: str  # as the file has it; random numbers are keyed by it
    images: Indices  # row of each of S frames in the labelled set's images, in order of time: (S,)
    times_s: Array  # of each frame as the file has it, ascending: (S,)
    size_px: tuple[int, int]  # width and height of its images

    @property
    def file_name(self) -> str:
        """The name with no character that a file's name should not have: that of its camera."""
        name = _UNSAFE.sub("_", self.name)
        return (name if name[:1].isalnum() else f"v{name}")[:_MAX_NAME]


def videos_of(labelled: LabelledSet, ids: FileIds, source: str) -> list[Video]:
    """The sequences in order of their names. Raises InputError if there are no images, or images of a sequence have no
    times, equal times or different sizes."""
    images = labelled.images
    if not len(images):
        raise InputError(source, ["there are no images, nor does a seqLength in seqinfo.ini say how many"])
    problems, videos = list[str](), list[Video]()
    order = np.lexsort((images.time_s, images.sequence))
    numbers, starts = np.unique(images.sequence[order], return_index=True)
    for number, rows in zip(numbers.tolist(), np.split(order, starts[1:]), strict=True):
        given = ids.sequences[number]
        name = NO_NAME if given is None else str(given)
        faults = list(_problems(name, images, rows))
        problems += faults
        if not faults:
            width, height = images.sizes_px[rows[0]].astype(np.int64).tolist()
            videos.append(Video(name, rows, images.time_s[rows], (width, height)))
    problems += _alike(videos)
    if problems:
        raise InputError(source, problems)
    return sorted(videos, key=lambda video: video.name)


def _problems(name: str, images: Images, rows: Indices) -> Iterator[str]:
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
    elif ((sizes_px != np.rint(sizes_px)) | (sizes_px > _MAX_SIDE_PX)).any():
        width, height = sizes_px[0].tolist()
        yield (
            f"sequence {shown(name)}: width and height of its images must be whole pixels, at most {_MAX_SIDE_PX:,} "
            f"(got {width:g} × {height:g})"
        )


def _alike(videos: list[Video]) -> Iterator[str]:
    """Sequences whose files would have one name, also where the case of names means nothing."""
    names: dict[str, str] = {}
    for video in videos:
        before = names.setdefault(video.file_name.casefold(), video.name)
        if before is not video.name:
            yield f"sequences {shown(before)} and {shown(video.name)} would have files of one name: rename one of them"


NO_TARGET = "-"  # in place of a label: things of this class are not to be detected


@dataclass(frozen=True)
class FileClasses:
    """The classes of a file."""

    kind: str  # of the file, as `file_kind` has it
    names: tuple[str, ...]  # MOT's have none of their own and are called `class_1`, `class_2` and so on
    numbers: tuple[int, ...]  # 0 in a MOT file without classes

    @property
    def places(self) -> list[int]:
        """Place of each class in the list of their names that a user gives: its number in MOT, which counts from 1."""
        return [max(number - 1, 0) for number in self.numbers] if self.kind == "MOT" else [*range(len(self.names))]

    def in_words(self, index: int) -> str:
        """Name of a class in messages."""
        if self.kind != "MOT":
            return f"category {shown(self.names[index])}"
        return f"class {self.numbers[index]}" if self.numbers[index] else "the one class of the file"


def to_labels(
    classes: FileClasses, used: Mask, given: Sequence[str] | None, labels: Sequence[str]
) -> tuple[Indices, list[str]]:
    """Index into the detector's labels of each of k classes, −1 for one that is no target: (k,); and remarks. `used`
    are the classes with boxes that are to be detected: (k,), `given` a label of the detector, or `-`, for each class in
    the order of the file or of the numbers, as `--labels` has them, None if there are none. Raises InputError if a
    class that is used has no label, or there are more names than classes; TypeError if they are no list of names."""
    whole = np.flatnonzero(used)
    if given is not None:
        if isinstance(given, str) or not all(isinstance(name, str) for name in given):
            raise TypeError(f"labels: a list of names is needed (got {shown(given)})")
        problems = list(_given_problems(classes, used, given, labels))
        if problems:
            raise InputError("--labels", problems)
        named = [given[place] if place < len(given) else NO_TARGET for place in classes.places]
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
        order = f"for each class from 1 to {max(classes.places) + 1}"
    return f"give --labels A,B,... with a label of the detector {order}; {NO_TARGET} for one that is not to be detected"


def _given_problems(classes: FileClasses, used: Mask, given: Sequence[str], labels: Sequence[str]) -> Iterator[str]:
    for name in dict.fromkeys(given):
        if name not in labels and name != NO_TARGET:
            yield f"'{name}' is not one of the detector's labels ({nearest(name, labels)})"
    if len(given) > (count := max(classes.places) + 1):
        yield f"has {len(given)} names, and the file {counted(count, 'class', 'classes')}"
    for index in np.flatnonzero(used).tolist():
        if classes.places[index] >= len(given):
            yield f"does not say what {classes.in_words(index)} is: {_how(classes)}"
