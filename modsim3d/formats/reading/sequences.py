"""Folders with a file of each sequence, as KITTI's: one labelled set of all of them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from modsim3d.core.errors import InputError
from modsim3d.formats.labelled import FileIds, LabelledSet, joined
from modsim3d.formats.reading.builder import ReadOptions
from modsim3d.io.validation import shown

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
    paths, found = sequence_files(truth), {path.name: path for path in sequence_files(detections)} if detections else {}
    if detections and (missing := [path.name for path in paths if path.name not in found]):
        told = f"{', '.join(missing[:5])}: no such file, and {truth} has it: without any detections it must be empty"
        raise InputError(f"detections {detections}", [told])
    parts = [read(path.stem, path, found.get(path.name), options) for path in paths]
    if len(firsts := {part.ids.first_frame for part in parts if part.ids}) > 1:
        options = replace(options, first_frame=0)
        parts = [read(path.stem, path, found.get(path.name), options) for path in paths]
    notes = [note for part in parts for note in part.notes]
    if extra := sorted(found.keys() - {path.name for path in paths}):
        notes.append(f"{len(extra)} files of detections have no truth and are left out, the first is {shown(extra[0])}")
    whole = joined(parts)
    named = [(path.stem, part.ids) for path, part in zip(paths, parts, strict=True) if part.ids is not None]
    numbers = {name: ids.labels[k] for part in parts if (ids := part.ids) for k, name in enumerate(part.labels)}
    ids = FileIds(
        tuple(f"{stem}/{image}" for stem, each in named for image in each.images),
        tuple(numbers[name] for name in whole.labels),
        tuple(stem for stem, _ in named),
        tuple(f"{stem}/{identity}" for stem, each in named for identity in each.identities),
        min(firsts),
    )
    images = replace(whole.images, condition=0 * whole.images.condition, source=0 * whole.images.source)
    return replace(whole, conditions=(condition,), images=images, notes=tuple(dict.fromkeys(notes)), ids=ids)
