"""MOTChallenge: ground truth, detections and sequence files, for trackers and for the programs that score them. There
are two sets. `modsim3d-all` has a sequence for each camera, of all classes as one. `modsim3d-class` has one for each
camera and class that is in its truth or among its detections. What is scored is class 1 in both, since evaluators score
no other class. The corner of a box is x_min + 1, y_min + 1, as the format counts pixels from 1; width and height are
those of the box. A vessel that is in the image and not annotated (hidden, or left out by a filter) has flag 0, which
means that it is not scored. Its class is 8, a distractor: a track that is kept on it costs nothing."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import iou, sizes
from modsim3d.core.errors import OutputError
from modsim3d.formats.writing.export_formats import ExportRequest
from modsim3d.io.atomic_write import write_files
from modsim3d.runs.camera_sequences import CameraSequence, SequenceTruth
from modsim3d.runs.tracker_view import TrackerDetections
from modsim3d.tracks.tracks import SEQUENCE_HEADING, free_name

ALL_SET, CLASS_SET = "modsim3d-all", "modsim3d-class"
SCORED, DISTRACTOR = 1, 8  # the only class that evaluators score, and one whose matches they leave out
UNKNOWN = -1
_MIN_IOU = 0.5  # from here on evaluators match a track to a distractor


def files(request: ExportRequest) -> tuple[str, ...]:
    """The paths of the files."""
    sequences = [f"{entry.folder}/{file}" for entry in _sequences(request) for file in _SEQUENCE_FILES]
    return (*sequences, *(f"seqmaps/{set_}.txt" for set_ in (ALL_SET, CLASS_SET)), "frames.csv", "vessels.csv")


def write(request: ExportRequest, folder: Path) -> None:
    """Write a run. Raises OutputError if the folder holds sequences of an earlier export that it would not replace."""
    sequences = _sequences(request)
    _check_no_others(sequences, folder)
    contents = {f"{entry.folder}/{file}": text(entry) for entry in sequences for file, text in _SEQUENCE_FILES.items()}
    for set_ in (ALL_SET, CLASS_SET):
        names = [entry.name for entry in sequences if entry.set == set_]
        contents[f"seqmaps/{set_}.txt"] = "".join(f"{name}\n" for name in (SEQUENCE_HEADING, *names))
    contents["frames.csv"] = _frame_table(request.sequences)
    vessels = ((k, vessel.name, vessel.label) for k, vessel in enumerate(request.run.scene.vessels, start=1))
    contents["vessels.csv"] = _table(("identity", "vessel", "label"), vessels)
    write_files({folder / path: text for path, text in contents.items()})


def _check_no_others(sequences: Sequence[_Sequence], folder: Path) -> None:
    """Refuse a folder with other sequences: programs read all that are in a set, whatever the sequence map lists."""
    folders = {entry.folder for entry in sequences}
    for set_ in (ALL_SET, CLASS_SET):
        names = sorted(path.name for path in (folder / set_).glob("*/") if path.is_dir())
        if others := [name for name in names if f"{set_}/{name}" not in folders]:
            raise OutputError(f"{folder / set_} holds another sequence ({others[0]}): choose another folder")


@dataclass(frozen=True, eq=False)
class _Sequence:
    """A sequence of one of the two sets, with the truth and the detections that belong to it."""

    set: str
    name: str
    frames: CameraSequence
    truth: SequenceTruth
    detections: TrackerDetections

    @property
    def folder(self) -> str:
        return f"{self.set}/{self.name}"


def _sequences(request: ExportRequest) -> list[_Sequence]:
    labels, entries = request.run.scene.detector.labels, list[_Sequence]()

    def free(wanted: str, set_: str) -> str:
        return free_name(wanted, [entry.name for entry in entries if entry.set == set_])

    for video in request.sequences:
        entries.append(_Sequence(ALL_SET, free(video.camera.name, ALL_SET), video, video.truth, video.detections))
    for video in request.sequences:
        for number, label in enumerate(labels):
            truth = video.truth.take(video.truth.label == number)
            detections = video.detections.take(video.detections.label == number)
            if truth.annotated.any() or len(detections):
                name = free(f"{video.camera.name}-{label}", CLASS_SET)
                entries.append(_Sequence(CLASS_SET, name, video, truth, detections))
    return entries


def sequence_text(name: str, size_px: tuple[int, int], rate_hz: float, frames: int) -> str:
    """A `seqinfo.ini`, from the size of the images, the frame rate and the number of frames."""
    width, height = size_px
    entries = {
        "name": name,
        "imDir": "img1",
        "frameRate": _number(round(rate_hz, 6)),
        "seqLength": frames,
        "imWidth": width,
        "imHeight": height,
        "imExt": ".png",
    }
    return "[Sequence]\n" + "".join(f"{key}={value}\n" for key, value in entries.items())


def _truth(sequence: _Sequence) -> str:
    """Lines of frame, identity, x, y, width, height, flag, class and visibility."""
    truth = sequence.truth
    classes = np.where(truth.annotated | _near_scored(truth), SCORED, DISTRACTOR)
    columns = (truth.frame + 1, truth.vessel + 1, *_places(truth.boxes_px), truth.annotated, classes)
    return _lines([*columns, np.where(np.isnan(truth.visible_fraction), UNKNOWN, truth.visible_fraction.round(6))])


def detection_text(rows: TrackerDetections, classes: Indices | None = None) -> str:
    """Lines of frame, −1, x, y, width, height, confidence, and −1 for the place in the world, which is not known. With
    classes, shape (m,), they stand in place of the first number of that place, as in truth."""
    unknown = np.full(len(rows), UNKNOWN)
    last = [unknown if classes is None else classes, unknown, unknown]
    return _lines([rows.frame + 1, unknown, *_places(rows.boxes_px), rows.confidence, *last])


def _info(sequence: _Sequence) -> str:
    frames = sequence.frames
    return sequence_text(sequence.name, frames.size_px, frames.rate_hz, len(frames.steps))


_SEQUENCE_FILES: dict[str, Callable[[_Sequence], str]] = {
    "seqinfo.ini": _info,
    "gt/gt.txt": _truth,
    "det/det.txt": lambda sequence: detection_text(sequence.detections),
}


def _near_scored(truth: SequenceTruth) -> Mask:
    """Mask of the boxes that overlap an annotated box so much that its track could be matched to them, shape (n,)."""
    near = np.zeros(len(truth), dtype=bool)
    scored = np.flatnonzero(truth.annotated)
    for row in np.flatnonzero(~truth.annotated).tolist():
        first, stop = np.searchsorted(truth.frame[scored], (truth.frame[row], truth.frame[row] + 1))
        others = truth.boxes_px[scored[first:stop]]
        near[row] = (iou(others, truth.boxes_px[[row]]) >= _MIN_IOU).any()
    return near


def _places(boxes_px: Array) -> list[Array]:
    """Columns of the corner, counted from 1, and of width and height."""
    return [*(boxes_px[:, :2] + 1).T, *sizes(boxes_px).T]


def _lines(columns: Sequence[np.ndarray]) -> str:
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return "".join(",".join(map(_number, row)) + "\n" for row in rows)


def _number(value: float) -> str:
    """A number with so many digits that it comes back within a millionth of a pixel, and no more."""
    return f"{value:.12g}"


def _frame_table(sequences: Sequence[CameraSequence]) -> str:
    rows = (
        (video.camera.name, frame, step, _number(time_s))
        for video in sequences
        for frame, (step, time_s) in enumerate(zip(video.steps.tolist(), video.times_s.tolist(), strict=True), start=1)
    )
    return _table(("camera", "frame", "step", "time_s"), rows)


def _table(heading: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([heading, *rows])
    return text.getvalue()
