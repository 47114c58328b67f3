"""Truth and detections of consecutive steps: as columns for each camera (blocks), and frame by frame."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.detector.records import KINDS, Detections
from modsim3d.runs.frames import Frame, FrameDetections, FrameTruth
from modsim3d.scene.scene import Scene
from modsim3d.truth.record import Truth, annotation_boxes


@dataclass(frozen=True, eq=False)
class CameraBlock:
    """One camera's part of a block."""

    camera: int  # index into the scene's cameras
    steps: Indices  # at which it took a frame, ascending, (S,)
    sea_half_planes: Array  # (a, b, c) of each frame, a·x + b·y + c >= 0 on the sea's side of the horizon, (S, 3)
    truth: Truth  # in order of step and vessel
    target_rows: Indices  # rows of `truth` that were annotated and given to the detector, (n,)
    detections: Detections  # `frame` indexes `steps`; `target` indexes `target_rows`

    @cached_property
    def truth_row(self) -> Indices:
        """Row of `truth` that each detection came from, −1 for a false positive, shape (m,)."""
        target = self.detections.target
        if not len(self.target_rows):
            return np.full(len(target), -1)
        return np.where(target >= 0, self.target_rows[target], -1)

    @cached_property
    def detected(self) -> Mask:
        """Whether each truth row was detected, under whatever label, alone or merged with another, shape (n,)."""
        hits = np.zeros(len(self.truth), dtype=bool)
        detections = self.detections
        own, shared = detections.target[~detections.false()], detections.partner[detections.partner >= 0]
        hits[self.target_rows[np.concatenate([own, shared])]] = True
        return hits


@dataclass(frozen=True, eq=False)
class Block:
    """Truth and detections of steps first to stop − 1 of a scene: a part for each camera, in the scene's order."""

    first: int
    timestamps: tuple[str, ...]  # the text of each step's time
    cameras: tuple[CameraBlock, ...]

    @property
    def stop(self) -> int:
        """The step after the last."""
        return self.first + len(self.timestamps)


def frames_of(block: Block, scene: Scene, steps: range | None = None) -> Iterator[Frame]:
    """The frames of a block of a scene, or of some of its steps, in order of step and camera."""
    wanted = range(block.first, block.stop) if steps is None else steps
    taken = sorted(
        (step, place, index)
        for place, part in enumerate(block.cameras)
        for index, step in enumerate(part.steps.tolist())
        if step in wanted
    )
    for _, place, index in taken:
        yield _frame(block, block.cameras[place], scene, index)


def _frame(block: Block, part: CameraBlock, scene: Scene, index: int) -> Frame:
    step, camera = int(part.steps[index]), scene.cameras[part.camera]
    return Frame(
        camera=camera.name,
        step=step,
        timestamp=block.timestamps[step - block.first],
        time_s=float(scene.times_s(step, step + 1)[0]),
        state=scene.detector.states[part.detections.states[index]].name,
        truth=_frame_truth(part, scene, step),
        detections=_frame_detections(part, scene, index),
        image_size_px=camera.intrinsics.image_size_px,
        sea_half_plane=part.sea_half_planes[index],
        scene_vessels=scene.vessel_names,
        scene=scene,
    )


def _frame_truth(part: CameraBlock, scene: Scene, step: int) -> FrameTruth:
    first, stop = np.searchsorted(part.truth.step, (step, step + 1)).tolist()
    rows, truth, names = slice(first, stop), part.truth, scene.occluder_names
    vessels = [scene.vessels[vessel] for vessel in truth.vessel[rows]]
    return FrameTruth(
        vessels=tuple(vessel.name for vessel in vessels),
        labels=tuple(vessel.label for vessel in vessels),
        class_id=np.array([scene.detector.labels.index(vessel.label) for vessel in vessels], dtype=np.int64),
        full_boxes_px=truth.full_boxes_px[rows],
        visible_boxes_px=truth.visible_boxes_px[rows],
        boxes_px=annotation_boxes(truth, scene.annotation.mode)[rows],
        silhouette_px=truth.silhouette_px[rows],
        visible_px=truth.visible_px[rows],
        visible_fraction=truth.visible_fraction[rows],
        in_frame_fraction=truth.in_frame_fraction[rows],
        depth_m=truth.depth_m[rows],
        occluded_by=tuple(
            {names[occluder]: pixels for occluder, pixels in truth.occluders_of(row)} for row in range(first, stop)
        ),
        annotated=truth.annotated[rows],
        detected=part.detected[rows],
    )


def _frame_detections(part: CameraBlock, scene: Scene, index: int) -> FrameDetections:
    detections, labels = part.detections, scene.detector.labels
    rows = slice(*np.searchsorted(detections.frame, (index, index + 1)))
    vessels = scene.vessel_names
    return FrameDetections(
        labels=tuple(labels[label] for label in detections.label[rows]),
        class_id=detections.label[rows],
        confidence=detections.confidence[rows],
        boxes_px=detections.boxes_px[rows],
        kinds=tuple(KINDS[kind] for kind in detections.kind[rows]),
        vessels=tuple(vessels[part.truth.vessel[row]] if row >= 0 else None for row in part.truth_row[rows]),
        errors_px=detections.errors_px[rows],
    )
