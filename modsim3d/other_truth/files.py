"""What a tracker and an evaluator read: detections in the form of the truth's file, and lines for a tracker."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import orjson

from modsim3d.boxes import sizes
from modsim3d.detector.model import DetectorModel
from modsim3d.formats.writing.mot import detection_text, sequence_text
from modsim3d.other_truth.detecting import Part
from modsim3d.other_truth.labels import FileClasses
from modsim3d.other_truth.videos import Video
from modsim3d.runs.files.tracker_input import TRACKER_INPUT, detection_lines
from modsim3d.runs.told import BOX_DECIMALS, Told

ONE_FRAME_HZ = 1.0
"""The frame rate that is written of a video of one frame."""


def class_numbers(classes: FileClasses, to_label: Sequence[int], labels: Sequence[str]) -> dict[str, int]:
    """The number of each of the detector's labels in the file: that of the first class that it stands for.

    A label that stands for no class has a number that the file does not use.
    """
    numbers, free = {}, max((0, *classes.numbers)) + 1
    for index, label in enumerate(labels):
        own = [number for number, to in zip(classes.numbers, to_label, strict=True) if to == index and number]
        numbers[label] = own[0] if own else free
        free += not own
    return numbers


def tracker_files(parts: Sequence[Part], model: DetectorModel) -> dict[str, bytes]:
    """`tracker_input_<sequence>.jsonl` of each sequence."""
    files: dict[str, bytes] = {}
    for part in parts:
        name = f"{TRACKER_INPUT}_{part.video.file_name}.jsonl"
        lines = detection_lines(part.detections, model.labels, part.steps, part.times_s)
        files[name] = files.get(name, b"") + lines
    return files


def mot_files(truth: bytes, video: Video, parts: Sequence[Part], numbers: Sequence[int]) -> dict[str, bytes]:
    """A MOT sequence: the truth as it was read, detections, and `seqinfo.ini`.

    Detections name their class where the detector has several labels, whose numbers are given.
    """
    count, duration_s = len(video.images), float(video.times_s[-1] - video.times_s[0])
    rate_hz = (count - 1) / duration_s if count > 1 else ONE_FRAME_HZ
    text = "".join(_mot_text(part, numbers) for part in parts)
    info = sequence_text(video.name, video.size_px, rate_hz, count)
    return {"gt/gt.txt": truth, "det/det.txt": text.encode(), "seqinfo.ini": info.encode()}


def _mot_text(part: Part, numbers: Sequence[int]) -> str:
    found = Told.of(part.detections)
    found = replace(found, frame=part.steps[found.frame])
    return detection_text(found, np.array(numbers)[found.label] if len(numbers) > 1 else None)


def coco_results(parts: Iterable[Part], images: Sequence[int | str], numbers: Sequence[int]) -> bytes:
    """COCO results, with the image IDs of the truth's file and the category of each label."""
    entries: list[dict[str, Any]] = []
    for part in parts:
        found = Told.of(part.detections)
        shapes = np.round(np.concatenate([found.boxes_px[:, :2], sizes(found.boxes_px)], axis=1), BOX_DECIMALS)
        rows = part.video.images[part.steps[found.frame]].tolist()
        columns = rows, found.label.tolist(), shapes.tolist(), found.confidence.tolist()
        entries += [
            {"image_id": images[row], "category_id": numbers[label], "bbox": box, "score": score}
            for row, label, box, score in zip(*columns, strict=True)
        ]
    return orjson.dumps(entries)
