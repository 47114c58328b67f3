"""Labels of videos in place of poses: who is seen where in which image, while nobody's place in the world is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import orjson
from pydantic import InstanceOf, model_validator

from modsim3d.core.arrays import NOBODY, Array, Columns, Indices, Mask
from modsim3d.core.errors import InputError
from modsim3d.geometry.camera import Camera, Intrinsics
from modsim3d.geometry.camera_poses import Mount
from modsim3d.io.strict_text import load_json
from modsim3d.io.validation import Strict, shown
from modsim3d.world.poses.base import PoseRequest, Poses, SourceKeys
from modsim3d.world.poses.replay import time_problems
from modsim3d.world.vessels import Vessel, name_problem

LABELS = "labels"  # the name of this source in a scene file
REAL = "real"  # the one performance state of a detector whose detections are given, and which is never asked
FORMAT = 1
EVERYWHERE = (0.0, 0.0, 1.0)  # the half-plane of a sea that fills the image
_UNKNOWN = float("nan")


@dataclass(frozen=True, eq=False)
class ImageSequence:
    """Images of one camera, one after another."""

    name: str  # of the camera
    image_size_px: tuple[int, int]  # width and height
    steps: Indices  # step of each image, ascending, shape (S,)
    images: tuple[str, ...]  # file of each where the labels name it, else what they call it
    sea: tuple[float, float, float] | None = None  # a·x + b·y + c >= 0 on it, in pixels; None if unknown
    first_frame: int = 1  # number of the first frame, and of the first pixel, in files of its tracks

    @property
    def camera(self) -> Camera:
        """The camera, of which nothing but the size of its images is known."""
        unknown = Intrinsics((_UNKNOWN, _UNKNOWN), (_UNKNOWN, _UNKNOWN), self.image_size_px)
        return Camera(self.name, unknown, Mount((_UNKNOWN, _UNKNOWN, _UNKNOWN)))


@dataclass(frozen=True, eq=False)
class LabelledBoxes(Columns):
    """Boxes of vessels, n rows in order of step, camera and vessel."""

    step: Indices  # (n,)
    camera: Indices  # index of the sequence, (n,)
    vessel: Indices  # (n,)
    boxes_px: Array  # x_min, y_min, x_max, y_max, cut at the edge of the image, (n, 4)
    visible_fraction: Array  # (n,)
    depth_m: Array  # NaN where unknown, (n,)
    in_frame_fraction: Array  # share inside the image, NaN where unknown, (n,)


@dataclass(frozen=True, eq=False)
class IgnoredRegions(Columns):
    """Boxes in which a detection counts neither for nor against anybody, k rows in order of step and camera."""

    step: Indices  # (k,)
    camera: Indices  # index of the sequence, (k,)
    boxes_px: Array  # (k, 4)
    crowd: Mask  # whether half of a detection inside is enough; else its IoU must be a half, (k,)


@dataclass(frozen=True, eq=False)
class GivenDetections(Columns):
    """Detections of a real detector, m rows in order of step and camera."""

    step: Indices  # (m,)
    camera: Indices  # index of the sequence, (m,)
    label: Indices  # index into the detector's labels, (m,)
    boxes_px: Array  # (m, 4)
    confidence: Array  # (m,)
    row: Indices  # row of the labelled boxes that it detects, `NOBODY` for none, (m,)


_PARTS = {"boxes": LabelledBoxes, "regions": IgnoredRegions, "detections": GivenDetections}


@dataclass(frozen=True, eq=False)
class LabelledPoses:
    """Labels of one or several videos, as a source of poses that knows no place of anybody."""

    timestamps: tuple[str, ...]  # texts of the times of all images, in order; each is a step
    sequences: tuple[ImageSequence, ...]  # one for each camera
    vessels: Mapping[str, str]  # ID → label of each vessel, in the order of `LabelledBoxes.vessel`
    boxes: LabelledBoxes  # what is to be detected
    regions: IgnoredRegions  # what is to be ignored
    detections: GivenDetections | None = None  # those of a real detector; None for a simulated one on the labels
    notes: tuple[str, ...] = ()  # what was left out and what was taken for what, each a sentence
    videos: int = 1  # number of videos of which this is one, where the seed chooses

    def poses(self, first: int, stop: int) -> Poses:
        """Nobody, at steps first to stop − 1."""
        return Poses.absent(stop - first, len(self.vessels))

    @property
    def as_vessels(self) -> tuple[Vessel, ...]:
        """The vessels, whose sizes are not known."""
        return tuple(Vessel(name, label, _UNKNOWN, _UNKNOWN, _UNKNOWN) for name, label in self.vessels.items())

    def frame_steps(self, camera: str, first: int, stop: int) -> Indices:
        """Steps first to stop − 1 at which a camera has an image, ascending, shape (n,)."""
        steps = self.sequence(camera).steps
        return steps[slice(*np.searchsorted(steps, (first, stop)))]

    def sequence(self, camera: str) -> ImageSequence:
        """The images of a camera, by its name."""
        return next(sequence for sequence in self.sequences if sequence.name == camera)

    def alone(self, number: int) -> LabelledPoses:
        """One of the sequences with its own steps and vessels, by its place."""
        own = self.sequences[number]

        def own_part(rows: Any) -> Any:
            chosen = rows.take(rows.camera == number)
            return replace(chosen, step=np.searchsorted(own.steps, chosen.step), camera=np.zeros_like(chosen.camera))

        boxes, results = own_part(self.boxes), self.detections
        used, vessel = np.unique(boxes.vessel, return_inverse=True)
        if results is not None:
            before = np.cumsum(self.boxes.camera == number) - 1
            results = own_part(results)
            results = replace(results, row=np.where(results.row >= 0, np.append(before, NOBODY)[results.row], NOBODY))
        names = list(self.vessels)
        return replace(
            self,
            timestamps=tuple(self.timestamps[step] for step in own.steps.tolist()),
            sequences=(replace(own, steps=np.arange(len(own.steps))),),
            vessels={names[index]: self.vessels[names[index]] for index in used.tolist()},
            boxes=replace(boxes, vessel=vessel),
            regions=own_part(self.regions),
            detections=results,
            videos=len(self.sequences),
        )

    def written(self) -> bytes:
        """The file that `read_labels` reads."""
        content = {
            "format": FORMAT,
            "timestamps": self.timestamps,
            "sequences": [asdict(sequence) for sequence in self.sequences],
            "vessels": dict(self.vessels),
            **{part: None if (rows := getattr(self, part)) is None else vars(rows) for part in _PARTS},
            "notes": self.notes,
        }
        return orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY) + b"\n"


def read_labels(path: Path) -> LabelledPoses:
    """The labels in a file that modsim3d has written. Raises InputError if it is something else."""
    source = f"labels {path}"
    content = load_json(path, "labels", bytes_per_value=2)
    try:
        if content["format"] != FORMAT:
            raise InputError(source, [f"format: must be {FORMAT} (got {shown(content['format'])})"])
        sequences = tuple(_sequence(entry) for entry in content["sequences"])
        parts = {name: _columns(kind, content[name]) for name, kind in _PARTS.items()}
        labels = LabelledPoses(
            tuple(map(str, content["timestamps"])),
            sequences,
            {str(name): str(label) for name, label in content["vessels"].items()},
            notes=tuple(map(str, content["notes"])),
            **parts,
        )
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise InputError(source, [f"is not what modsim3d writes: {type(error).__name__}: {error}"]) from None
    return _checked(labels, source)


def _sequence(content: Mapping[str, Any]) -> ImageSequence:
    width, height = map(int, content["image_size_px"])
    sea = content["sea"] if content["sea"] is None else tuple(map(float, content["sea"]))
    steps = np.array(content["steps"], dtype=np.int64)
    images, first_frame = tuple(map(str, content["images"])), int(content["first_frame"])
    return ImageSequence(str(content["name"]), (width, height), steps, images, sea, first_frame)  # type: ignore[arg-type]


def _columns(kind: type[Any], content: Mapping[str, Any] | None) -> Any:
    """Rows of a part of the file; whole numbers, truth values and numbers, of which null is NaN."""
    if content is None:
        return None
    columns = {}
    if kind is LabelledBoxes:  # runs from before this column
        content = {"in_frame_fraction": [None] * len(content["step"]), **content}
    for field in fields(kind):
        form = {"Indices": np.int64, "Mask": np.bool_}.get(str(field.type), np.float64)
        values: np.ndarray[Any, Any] = np.array(content[field.name], dtype=form)
        columns[field.name] = values.reshape(-1, 4) if field.name == "boxes_px" else values
    if len({len(column) for column in columns.values()}) > 1:
        raise ValueError(f"columns of different lengths: {', '.join(columns)}")
    return kind(**columns)


def _checked(labels: LabelledPoses, source: str) -> LabelledPoses:
    """The labels. Raises InputError if they cannot be those of a scene."""
    problems = time_problems(list(labels.timestamps))
    problems += [f"track {shown(name)}: {problem}" for name in labels.vessels if (problem := name_problem(name))]
    problems += [
        f"sequence '{sequence.name}': steps must ascend within the timestamps, one for each of its images"
        for sequence in labels.sequences
        if len(sequence.steps) != len(sequence.images)
        or (np.diff(sequence.steps, prepend=-1, append=len(labels.timestamps)) <= 0).any()
    ]
    if not labels.sequences:
        raise InputError(source, ["sequences: there are none"])
    places = np.concatenate([sequence.steps * len(labels.sequences) + k for k, sequence in enumerate(labels.sequences)])
    sizes_px = np.array([sequence.image_size_px * 2 for sequence in labels.sequences])
    for name in _PARTS:
        if (rows := getattr(labels, name)) is None:
            continue
        if not np.isin(rows.step * len(labels.sequences) + rows.camera, places).all():
            problems.append(f"{name}: a row where a camera has no image")
        elif not ((rows.boxes_px >= 0) & (rows.boxes_px <= sizes_px[rows.camera])).all():
            problems.append(f"{name}: a box outside its image")
    boxes = labels.boxes
    if not ((boxes.vessel >= 0) & (boxes.vessel < len(labels.vessels))).all():
        problems.append("boxes: a vessel that the file does not have")
    key = (boxes.step * len(labels.sequences) + boxes.camera) * max(len(labels.vessels), 1) + boxes.vessel
    if (np.diff(key) <= 0).any():
        problems.append("boxes: rows must be in order of step, camera and vessel, one for each vessel in an image")
    detections = labels.detections
    if detections is not None and not ((detections.row >= NOBODY) & (detections.row < len(boxes))).all():
        problems.append("detections: a row of a box that the file does not have")
    if problems:
        raise InputError(source, problems)
    return labels


class LabelsKeys(SourceKeys, Strict):
    """The file of labels, which modsim3d has written. With `by_seed` a seed shows one of its videos. With `simulated`
    the detections of a real detector are left out, so that the scene's own works on the labels."""

    generated: ClassVar[bool] = False

    file: str
    by_seed: bool = False
    simulated: bool = False

    @model_validator(mode="before")
    @classmethod
    def _file_alone(cls, keys: Any) -> Any:
        return {"file": keys} if isinstance(keys, str) else keys

    @property
    def drawn(self) -> bool:  # type: ignore[override]
        """Whether the seed chooses the video."""
        return self.by_seed

    @property
    def files(self) -> tuple[str, ...]:
        """The file."""
        return (self.file,)

    def build(self, request: PoseRequest) -> LabelledPoses:
        """The labels in the file, or those of the seed's video."""
        return self._chosen(read_labels(request.folder / self.file), request.seed)

    def _chosen(self, labels: LabelledPoses, seed: int) -> LabelledPoses:
        labels = replace(labels, detections=None) if self.simulated else labels
        return labels.alone(seed % len(labels.sequences)) if self.by_seed else labels


class GivenLabels(LabelsKeys):
    """Labels that are in memory; `file` is what a copy of the scene calls them, `source` what errors call them."""

    labels: InstanceOf[LabelledPoses]
    source: str

    def build(self, request: PoseRequest) -> LabelledPoses:
        """The labels."""
        return self._chosen(_checked(self.labels, self.source), request.seed)
