"""YOLO text folders: a file of labels and one of predictions for each frame, and `data.yaml` with the classes.
A line is class, x, y, width, height, in shares of the image, and for a prediction the confidence. Programs take the
list of images and their sizes from pictures, and a run has none: each frame has an empty one."""

from collections.abc import Iterator
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path

import numpy as np
import yaml
from PIL import Image

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.boxes import centre_form
from modsim3d.formats.writing.export_formats import ExportRequest
from modsim3d.io.atomic_write import encoded, make_folder, put_folder_in_place, write_files
from modsim3d.runs.camera_sequences import CameraSequence

DATA_FILE = "data.yaml"
FOLDERS = {"images": "*.png", "labels": "*.txt", "predictions": "*.txt"}  # wholly written: pattern of their files


def files(request: ExportRequest) -> tuple[str, ...]:
    """The paths of the files beside `FOLDERS`."""
    return (DATA_FILE,)


def write(request: ExportRequest, folder: Path) -> None:
    """Write a run."""
    make_folder(folder)
    contents = {"images": _pictures, "labels": _labels, "predictions": _predictions}
    labels = dict(enumerate(request.run.scene.detector.labels))
    data = {"train": "images", "val": "images", "nc": len(labels), "names": labels}
    with ExitStack() as places:  # none gets its place before all are complete
        for name, pattern in FOLDERS.items():
            partial = places.enter_context(put_folder_in_place(folder / name, pattern))
            for sequence in request.sequences:
                for step, content in zip(sequence.steps.tolist(), contents[name](sequence), strict=True):
                    (partial / f"{sequence.camera.name}_{step:06d}{Path(pattern).suffix}").write_bytes(content)
        write_files({folder / DATA_FILE: yaml.safe_dump(data, sort_keys=False, allow_unicode=True)})


def _pictures(sequence: CameraSequence) -> Iterator[bytes]:
    picture = encoded(Image.new("1", sequence.size_px), optimize=True)
    yield from [picture] * len(sequence.steps)


def _labels(sequence: CameraSequence) -> Iterator[bytes]:
    truth = sequence.truth.take(sequence.truth.annotated)
    return _lines(sequence, truth.frame, truth.label, truth.boxes_px)


def _predictions(sequence: CameraSequence) -> Iterator[bytes]:
    detections = sequence.detections
    return _lines(sequence, detections.frame, detections.label, detections.boxes_px, detections.confidence[:, None])


def _lines(sequence: CameraSequence, frame: Indices, label: Indices, boxes_px: Array, *more: Array) -> Iterator[bytes]:
    """The lines of each frame, from columns of n rows in order of the frames; `more` has shapes (n, k)."""
    shares = centre_form(boxes_px) / np.tile(sequence.size_px, 2)
    numbers = np.concatenate([shares, *more], axis=1).tolist()
    lines = [
        " ".join([str(number), *(f"{value:.12g}" for value in row)]) + "\n"
        for number, row in zip(label.tolist(), numbers, strict=True)
    ]
    starts = np.searchsorted(frame, np.arange(len(sequence.steps) + 1)).tolist()
    for first, stop in pairwise(starts):
        yield "".join(lines[first:stop]).encode()
