"""Choice of a reader for a pair of files or of folders with a file of each sequence, or for truth alone."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Indices
from modsim3d.core.errors import InputError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.core.text import number_in
from modsim3d.formats.labelled import FileIds, Images, LabelledSet, joined, with_horizon
from modsim3d.formats.reading.builder import NO_OPTIONS, ReadOptions
from modsim3d.formats.reading.coco import read_coco
from modsim3d.formats.reading.kitti import chosen_types, is_kitti, read_kitti
from modsim3d.formats.reading.mot import read_mot
from modsim3d.formats.reading.yolo import read_yolo
from modsim3d.io.input_files import read_text
from modsim3d.io.validation import shown
from modsim3d.tracks import diagnosis
from modsim3d.tracks.diagnosis import BoxForm, BoxRows, KnownBoxes, agree, implausible, misreading

_FORMS = {"COCO": diagnosis.TOP_LEFT, "KITTI": diagnosis.CORNERS, "MOT": diagnosis.MOT, "YOLO": diagnosis.CENTRE}
_UNUSED = {
    "COCO": {"--labels": "labels", "--image-size": "image_size_px", "--first-frame": "first_frame"},
    "KITTI": {"--category-offset": "category_offset", "--first-frame": "first_frame"},
    "MOT": {"--category-offset": "category_offset"},
    "YOLO": {"--category-offset": "category_offset", "--first-frame": "first_frame"},
}


def read_pair(condition: str, truth: StrPath, detections: StrPath, options: ReadOptions = NO_OPTIONS) -> LabelledSet:
    """Read one condition from files of one kind, see `file_kind`. Raises InputError if they are wrong, or of two."""
    truth, detections = as_path(truth, "truth"), as_path(detections, "detections")
    missing = [(what, path) for what, path in (("truth", truth), ("detections", detections)) if not path.exists()]
    if missing:
        raise InputError(f"condition {condition}", [f"{what} {path}: no such file or folder" for what, path in missing])
    kinds = [file_kind(path) for path in (truth, detections)]
    if kinds[0] != kinds[1] and not (kinds[0] == "KITTI" and not _first_line(detections)):
        mixed = f"{truth} looks like {kinds[0]} and {detections} like {kinds[1]}: give one kind"
        raise InputError(f"condition {condition}", [mixed])
    labelled = _read(kinds[0], condition, truth, detections, options)
    form = _form(kinds[0], labelled)
    labelled = _plausible(labelled, form, truth, detections)
    boxes, annotated = compared(labelled, form)
    problem, files = misreading(*boxes), [f"detections {detections}", f"ground truth {truth}"]
    if problem is None:
        problem, files = misreading(*annotated, only_forms=True), files[::-1]
    if problem:
        if not problem.slight:
            raise InputError(files[0], [f"{problem.sentence}, or {files[1]} is wrong, the other way round"])
        note = f"{condition}: {problem.sentence}, or the detector has such a bias, which is learned"
        labelled = replace(labelled, notes=(*labelled.notes, note))
    unused = [
        f"{option} is not used: {kinds[0]} does not need it"
        for option, name in _UNUSED[kinds[0]].items()
        if getattr(options, name) != getattr(NO_OPTIONS, name)
    ]
    labelled = replace(labelled, notes=(*labelled.notes, *unused, *_left_out(labelled, condition, kinds[0])))
    return with_horizon(labelled, options.horizon)


def _read(kind: str, condition: str, truth: Path, detections: Path | None, options: ReadOptions) -> LabelledSet:
    if kind == "KITTI":
        paths = sequence_files(detections) if detections else []
        options = replace(options, labels=chosen_types(options.labels, sequence_files(truth), paths))
    read = {"COCO": read_coco, "KITTI": read_kitti, "MOT": read_mot, "YOLO": read_yolo}[kind]
    if truth.is_dir() and kind != "YOLO":
        return read_sequences(read, condition, truth, detections, options)
    return read(condition, truth, detections, options)


def _form(kind: str, labelled: LabelledSet) -> BoxForm:
    """The form of boxes in files of a kind; MOT's count pixels from 0 where they count frames so."""
    from_0 = kind == "MOT" and labelled.ids is not None and labelled.ids.first_frame == 0
    return diagnosis.TOP_LEFT if from_0 else _FORMS[kind]


def _plausible(labelled: LabelledSet, form: BoxForm, truth: Path, detections: Path | None = None) -> LabelledSet:
    """The set with remarks on boxes that are odd in their images, and on those that are hidden. Raises InputError if
    boxes are in another form, or of other images; not if they are the truth, and detections confirm it."""
    rows, notes = labelled.annotations, list(labelled.notes)
    parts = [_box_rows(labelled.images, part.image, part.boxes_px, form) for part in (rows, labelled.results)]
    problems = [implausible(part) for part in parts]
    confirmed = problems[1] is None and agree(parts[1], KnownBoxes("an annotation", rows.image, rows.boxes_px))
    for source, problem in zip((f"ground truth {truth}", f"detections {detections}"), problems, strict=True):
        if problem:
            if not problem.slight and not confirmed:
                raise InputError(source, [problem.sentence])
            notes.append(f"{source}: {problem.sentence}")
    if hidden := int(((rows.visible_fraction == 0) & ~rows.ignored).sum()):
        note = f"the visibility of {hidden:,} of {len(rows):,} boxes is 0: they count as fully hidden"
        notes.append(f"ground truth {truth}: {note}; some programs write 0 where it is not known")
    return replace(labelled, notes=tuple(notes))


_REGIONS = {"COCO": "are crowds (iscrowd)", "KITTI": "are regions (DontCare)", "MOT": "are regions (class 0)"}
_IGNORED = {"COCO": "ignore", "KITTI": "types to be ignored", "MOT": "flag 0"}


def _left_out(labelled: LabelledSet, condition: str, kind: str) -> Iterator[str]:
    rows = labelled.annotations
    edges_px, boxes_px = labelled.images.sizes_px[rows.image], rows.boxes_px
    outside = ((boxes_px[:, :2] >= edges_px) | (boxes_px[:, 2:] <= 0)).any(axis=1) & ~rows.ignored
    reasons = {
        f"{_REGIONS.get(kind)} and left out": rows.crowd,
        f"are left out ({_IGNORED.get(kind)})": rows.ignored & ~rows.crowd,
        "lie outside their image, and count as missed": outside,
    }
    for why, chosen in reasons.items():
        if chosen.any():
            left = np.bincount(rows.label[~rows.ignored], minlength=len(labelled.labels))
            all_of = [labelled.labels[k] for k in np.unique(rows.label[chosen]).tolist() if not left[k]]
            also = f", among them all of {', '.join(map(shown, all_of))}" if all_of else ""
            yield f"{condition}: {chosen.sum():,} of {len(rows):,} annotations {why}{also}"


def compared(labelled: LabelledSet, form: BoxForm) -> Iterator[tuple[BoxRows, KnownBoxes]]:
    """The most confident detections, as many as there are annotations, in the form of their file, with annotations;
    then the annotations that are nearest to these, with them. Images of unknown size reach as far as annotations."""
    images, results = labelled.images, labelled.results
    solid = ~labelled.annotations.crowd  # what is ignored is found, too
    image, annotated_px = labelled.annotations.image[solid], labelled.annotations.boxes_px[solid]
    rows = np.sort(np.argsort(-results.confidence, kind="stable")[: len(annotated_px)])
    image_found, found_px = results.image[rows], results.boxes_px[rows]
    reach_px = annotated_px[:, 2:].max(axis=0, initial=1.0)
    sized = replace(images, sizes_px=np.where(np.isnan(images.sizes_px), reach_px, images.sizes_px))
    truth, boxes = KnownBoxes("an annotation", image, annotated_px), _box_rows(sized, image_found, found_px, form)
    yield boxes, truth
    some = boxes.spread()
    near = np.unique(truth.nearest(some.frame, form.boxes_px(some.numbers))[1])
    yield _box_rows(sized, image[near], annotated_px[near], form), KnownBoxes("a detection", image_found, found_px)


def _box_rows(images: Images, image: Indices, boxes_px: Array, form: BoxForm) -> BoxRows:
    beside = (np.clip(image + step, 0, len(images) - 1) for step in (-1, 1))
    near = (np.where((to != image) & (images.sequence[to] == images.sequence[image]), to, NOBODY) for to in beside)
    return BoxRows(form.numbers_of(boxes_px), form, images.sizes_px[image], image, *near)


def read_truth(truth: StrPath, options: ReadOptions = NO_OPTIONS) -> tuple[LabelledSet, str]:
    """The truth of labelled videos without detections, and its kind, see `file_kind`; InputError if it is wrong."""
    path = as_path(truth, "truth")
    if not path.exists():
        raise InputError(f"truth {path}", ["no such file or folder"])
    kind = file_kind(path)
    labelled = _read(kind, path.stem, path, None, options)
    return _plausible(labelled, _form(kind, labelled), path), kind


_MOT_NUMBERS = 6  # that a line has at least


def file_kind(path: Path) -> str:
    """`COCO`, `KITTI`, `MOT` or `YOLO`: text is KITTI's where its third word is a type, else MOT's; a folder is what
    its files are, and YOLO's if they are neither; anything else is COCO's. Raises InputError if it cannot be read."""
    if not path.is_dir() and path.suffix not in (".txt", ".csv"):
        return "COCO"
    line = _first_line(path)
    if is_kitti(line):
        return "KITTI"
    numbers = [number_in(cell) for cell in line.strip().rstrip(",").split(",")]
    return "MOT" if path.is_file() or (len(numbers) >= _MOT_NUMBERS and not np.isnan(numbers).any()) else "YOLO"


def _first_line(path: Path) -> str:
    """First line that is not empty of a text, or of the files of a folder; empty if there is none."""
    texts = (read_text(file, "labels") for file in sequence_files(path))
    return next((line for text in texts for line in text.splitlines() if line.strip()), "")


Reader = Callable[[str, Path, Path | None, ReadOptions], LabelledSet]


def sequence_files(folder: Path) -> list[Path]:
    """The text files of a folder, in order of their names; a file stands for itself."""
    return sorted(folder.glob("*.txt")) if folder.is_dir() else [folder]


def read_sequences(
    read: Reader, condition: str, truth: Path, detections: Path | None, options: ReadOptions
) -> LabelledSet:
    """Read the files of a folder, each a sequence that is called as its file. Detections are in files of the same
    names. Tracks of different files are different things: they are called `FILE/TRACK`. If one file counts frames from
    0, all do. Raises InputError if a file has no detections, or is wrong."""
    paths, files = sequence_files(truth), {path.name: path for path in sequence_files(detections)} if detections else {}
    if detections and (missing := [path.name for path in paths if path.name not in files]):
        problem = f"{', '.join(missing[:5])}: no such file, and {truth} has it: without any detections it must be empty"
        raise InputError(f"detections {detections}", [problem])
    parts = [read(path.stem, path, files.get(path.name), options) for path in paths]
    if len(firsts := {part.ids.first_frame for part in parts if part.ids}) > 1:
        options = replace(options, first_frame=0)
        parts = [read(path.stem, path, files.get(path.name), options) for path in paths]
    notes = [note for part in parts for note in part.notes]
    if extra := sorted(files.keys() - {path.name for path in paths}):
        notes.append(f"{len(extra)} files of detections have no truth and are left out, the first is {shown(extra[0])}")
    whole = joined(parts)
    named = [(path.stem, part.ids) for path, part in zip(paths, parts, strict=True) if part.ids is not None]
    numbers = {name: ids.labels[k] for part in parts if (ids := part.ids) for k, name in enumerate(part.labels)}
    ids = FileIds(
        tuple(f"{stem}/{image}" for stem, file_ids in named for image in file_ids.images),
        tuple(numbers[name] for name in whole.labels),
        tuple(stem for stem, _ in named),
        tuple(f"{stem}/{identity}" for stem, file_ids in named for identity in file_ids.identities),
        min(firsts),
    )
    images = replace(whole.images, condition=0 * whole.images.condition, source=0 * whole.images.source)
    return replace(whole, conditions=(condition,), images=images, notes=tuple(dict.fromkeys(notes)), ids=ids)
