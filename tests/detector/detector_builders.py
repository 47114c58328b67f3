"""Small detectors, frames and targets for the tests."""

import itertools
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from modsim3d.detector.chain import Detector, target_statistics
from modsim3d.detector.draws import select
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.persistence import Clock
from modsim3d.detector.records import TRUE, CameraFrames, Detections, Targets
from modsim3d.detector.target_statistics import TargetStatistics

IMAGE_PX = (3600, 2400)
ALL_SEA = (0.0, 0.0, 1.0)
ALL_SEEN = [[1, 0], [0, 1], [0, 0]]
"""A confusion matrix without misses and mistakes."""
FOG = [[0.5, 0.2], [0.1, 0.4], [0.4, 0.4]]
MEAN_PX = [4.3, 6.8, -8.1, -0.9]
COVARIANCE_PX2 = [[2354, 206, 1157, -169], [206, 390, -227, -389], [1157, -227, 5404, 115], [-169, -389, 115, 1225]]
"""The thesis's `excellent` state, Jessen & Mohr (2023), Table 9.3."""


def clock(step_s: float = 0.1) -> Clock:
    return lambda first, stop: np.arange(first, stop) * step_s


def state_data(**changes: Any) -> dict[str, Any]:
    state: dict[str, Any] = {
        "confusion": [[0.7, 0.1], [0.1, 0.6], [0.2, 0.3]],
        "false_positive_labels": [0.25, 0.75],
        "false_discovery_rate": 0.2,
        "box_error": {"unit": "px", "mean": list(MEAN_PX), "covariance": [list(row) for row in COVARIANCE_PX2]},
        "confidence": {"mean": 0.67, "std": 0.1},
    }
    return state | changes


def detector_data(**changes: Any) -> dict[str, Any]:
    data: dict[str, Any] = {
        "labels": ["sail", "motor"],
        "confidence_threshold": 0.2,
        "initial_state": "clear",
        "transition_matrix": [[0.9, 0.2], [0.1, 0.8]],
        "false_positives": {"model": "calibrated"},
        "states": {
            "clear": state_data(),
            "fog": state_data(confusion=FOG, false_discovery_rate=0.4, confidence={"mean": 0.4, "std": 0.2}),
        },
    }
    return data | changes


def one_state_data(**changes: Any) -> dict[str, Any]:
    return detector_data(transition_matrix=[[1]], initial_state="only", states={"only": state_data(**changes)})


def box_error(mean: Sequence[float], covariance: Any) -> dict[str, Any]:
    return {"unit": "px", "mean": list(mean), "covariance": np.asarray(covariance, dtype=float).tolist()}


def no_error() -> dict[str, Any]:
    return box_error([0, 0, 0, 0], np.zeros((4, 4)))


def make_frames(count: int, camera="C0", first_step=0, image_px=IMAGE_PX, sea=ALL_SEA, time_step_s=0.1) -> CameraFrames:
    times_s = (first_step + np.arange(count)) * time_step_s
    previous_s = (first_step - 1) * time_step_s if first_step else -np.inf
    planes = np.tile(np.asarray(sea, dtype=float), (count, 1))
    return CameraFrames(camera, first_step + np.arange(count), times_s, image_px, planes, previous_s)


def make_targets(boxes_px: Any, label: Any = 0, vessel_ids: Sequence[str] | None = None) -> Targets:
    """Targets from boxes of shape (frames, vessels, 4); a row of NaN is a vessel that is not annotated."""
    boxes = np.asarray(boxes_px, dtype=float)
    frame, vessel = np.nonzero(~np.isnan(boxes[..., 0]))
    ids = tuple(vessel_ids or (f"vessel{i}" for i in range(boxes.shape[1])))
    labels = np.broadcast_to(label, boxes.shape[:2])[frame, vessel]
    size = len(frame)
    return Targets(frame, vessel, labels, boxes[frame, vessel], np.full(size, np.nan), np.full(size, 100.0), ids)


def same_boxes(frames: int, vessels: int, box_px: Sequence[float]) -> np.ndarray:
    return np.tile(np.asarray(box_px, dtype=float), (frames, vessels, 1))


def steady_targets(frames: int, vessels: int, box_px: Sequence[float], *more: Any, **options: Any) -> Targets:
    """The same box of each vessel in every frame; the rest is for `make_targets`."""
    return make_targets(same_boxes(frames, vessels, box_px), *more, **options)


def centred(width: float, height: float, image_px: tuple[int, int] = IMAGE_PX) -> list[float]:
    x, y = image_px[0] / 2, image_px[1] / 2
    return [x - width / 2, y - height / 2, x + width / 2, y + height / 2]


def chunk(frames: CameraFrames, targets: Targets, start: int, stop: int) -> tuple[CameraFrames, Targets, int]:
    """Some of the frames with their targets, and the row that the first of these targets has in the whole."""
    first, last = np.searchsorted(targets.frame, [start, stop])
    columns = {name: getattr(frames, name)[start:stop] for name in ("steps", "times_s", "sea_half_planes")}
    previous_s = float(frames.times_s[start - 1]) if start else frames.previous_s
    part = select(targets, np.arange(first, last))
    return replace(frames, **columns, previous_s=previous_s), replace(part, frame=part.frame - start), int(first)


def detect_in_chunks(detector: Detector, frames: CameraFrames, targets: Targets, borders: Sequence[int]) -> Detections:
    """One `Detections` from several calls, with `frame` and `target` counted over the whole."""
    columns: dict[str, list[np.ndarray]] = {field.name: [] for field in fields(Detections)}
    for start, stop in itertools.pairwise(borders):
        part, part_targets, first = chunk(frames, targets, start, stop)
        found = detector.detect(part, part_targets)
        for name, values in columns.items():
            values.append(getattr(found, name))
        columns["frame"][-1] = found.frame + start
        for name in ("target", "partner"):
            rows = getattr(found, name)
            columns[name][-1] = np.where(rows < 0, -1, rows + first)
    return Detections(**{name: np.concatenate(values) for name, values in columns.items()})


def by_frame(found: Detections, values: np.ndarray, frames: int, vessels: int, missed: float = np.nan) -> np.ndarray:
    """Values of the true detections, shape (frames, vessels, ...), of targets that are in every frame."""
    true = found.kind == TRUE
    result = np.full((frames * vessels, *values.shape[1:]), missed)
    result[found.target[true]] = values[true]
    return result.reshape(frames, vessels, *values.shape[1:])


def all_bytes(detections: Detections) -> dict[str, bytes]:
    return {field.name: getattr(detections, field.name).tobytes() for field in fields(Detections)}


Described = DetectorModel | dict[str, Any]
"""A model, or the content of its file."""


def model_of(described: Described) -> DetectorModel:
    return described if isinstance(described, DetectorModel) else parse_detector(described)


def detector(described: Described, seed: int = 1, step_s: float = 0.1) -> Detector:
    """A detector that needs no statistics of its targets."""
    return Detector(model_of(described), seed, TargetStatistics(), clock(step_s))


def run(described: Described, frames: CameraFrames, targets: Targets, seed: int = 1, step_s: float = 0.1) -> Detections:
    model = model_of(described)
    return Detector(model, seed, target_statistics(model, [(frames, targets)]), clock(step_s)).detect(frames, targets)
