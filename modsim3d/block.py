"""A run of consecutive steps as every camera saw it: truth, and what the detector made of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from modsim3d.annotate.modes import annotation_boxes
from modsim3d.annotate.truth_record import Truth
from modsim3d.arrays import Array, Indices, Mask
from modsim3d.detector.records import KINDS, Detections
from modsim3d.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class CameraBlock:
    """One camera's part of a block.

    Attributes:
        camera: Index into the scene's cameras.
        steps: At which it took a frame, ascending, shape (S,).
        truth: Its rows, in order of step and vessel.
        target_rows: Rows of `truth` that were annotated and given to the detector, shape (n,).
        detections: Their `frame` indexes `steps`; `target` indexes `target_rows`.
    """

    camera: int
    steps: Indices
    truth: Truth
    target_rows: Indices
    detections: Detections

    def truth_row(self) -> Indices:
        """Row of `truth` that each detection came from, −1 for a false positive, shape (m,)."""
        target = self.detections.target
        if not len(self.target_rows):
            return np.full(len(target), -1)
        return np.where(target >= 0, self.target_rows[target], -1)

    def detected(self) -> Mask:
        """Whether each truth row was detected, whatever its label came out as, by itself or with another."""
        found = np.zeros(len(self.truth), dtype=bool)
        drawn = self.detections
        sources = np.concatenate([drawn.target[~drawn.false()], drawn.partner[drawn.partner >= 0]])
        found[self.target_rows[sources]] = True
        return found


@dataclass(frozen=True, eq=False)
class Block:
    """Steps first to stop − 1 of a scene.

    Attributes:
        first: First step.
        timestamps: Text of each step's time.
        cameras: In the order of the scene's cameras.
    """

    first: int
    timestamps: tuple[str, ...]
    cameras: tuple[CameraBlock, ...]

    @property
    def stop(self) -> int:
        """The step after the last."""
        return self.first + len(self.timestamps)


@dataclass(frozen=True, eq=False)
class FrameTruth:
    """What one camera sees at one time: n vessels as arrays. Boxes are x_min, y_min, x_max, y_max in pixels.

    Attributes:
        vessels: Their IDs.
        labels: Their true classes.
        full_boxes_px: Whole silhouettes, cut at the image edge, shape (n, 4).
        visible_boxes_px: What is seen; NaN if nothing is, shape (n, 4).
        boxes_px: What the annotation mode annotates, shape (n, 4).
        silhouette_px: Shape (n,).
        visible_px: Shape (n,).
        visible_fraction: Shape (n,).
        in_frame_fraction: Shape (n,).
        depth_m: Shape (n,).
        occluded_by: For each vessel, who hides how many of its pixels.
        annotated: Shape (n,).
        detected: Shape (n,).
    """

    vessels: tuple[str, ...]
    labels: tuple[str, ...]
    full_boxes_px: Array
    visible_boxes_px: Array
    boxes_px: Array
    silhouette_px: Array
    visible_px: Array
    visible_fraction: Array
    in_frame_fraction: Array
    depth_m: Array
    occluded_by: tuple[dict[str, float], ...]
    annotated: Mask
    detected: Mask

    def __len__(self) -> int:
        """Number of vessels."""
        return len(self.vessels)


@dataclass(frozen=True, eq=False)
class FrameDetections:
    """What the detector put out for one frame: m detections as arrays, in shuffled order.

    Attributes:
        labels: Classes.
        confidence: Shape (m,).
        boxes_px: x_min, y_min, x_max, y_max, shape (m, 4).
        kinds: Where each came from: one of `modsim3d.detector.KINDS`.
        vessels: ID of the vessel each came from, None for a false positive. A tracker must not read this.
        errors_px: e_x, e_y, e_w, e_h before clipping, NaN for false positives, shape (m, 4).
    """

    labels: tuple[str, ...]
    confidence: Array
    boxes_px: Array
    kinds: tuple[str, ...]
    vessels: tuple[str | None, ...]
    errors_px: Array

    def __len__(self) -> int:
        """Number of detections."""
        return len(self.labels)


@dataclass(frozen=True, eq=False)
class Frame:
    """One camera at one time.

    Attributes:
        camera: Its ID.
        step: Counted from zero.
        timestamp: The text of its time.
        state: Name of the detector's performance state.
        truth: What the camera sees.
        detections: What the detector put out.
        image_size_px: Width and height.
        sea_half_plane: (a, b, c) with a·x + b·y + c >= 0 on the sea's side of the horizon, shape (3,).
        scene_vessels: IDs of all vessels of the scene, seen or not; their order gives the colours of pictures.
    """

    camera: str
    step: int
    timestamp: str
    state: str
    truth: FrameTruth
    detections: FrameDetections
    image_size_px: tuple[int, int]
    sea_half_plane: Array
    scene_vessels: tuple[str, ...]

    def plot(self, axes: Axes | None = None, *, zoom: bool = False, labels: bool = True) -> Figure:
        """Draw sea, sky, truth and detections with matplotlib; a notebook shows what is returned.

        Args:
            axes: Where to draw; a figure of its own if None.
            zoom: Show only the part of the image in which there are vessels.
            labels: Write names, classes and confidences.

        Raises:
            ModsimError: matplotlib is not installed.
        """
        from modsim3d.view.frame_plot import plot_frame  # the one arrow up, for the sake of frame.plot() in notebooks

        return plot_frame(self, axes, zoom=zoom, labels=labels)


def frames_of(block: Block, scene: Scene, steps: Sequence[int] | None = None) -> Iterator[Frame]:
    """The frames of a block, in order of step and camera.

    Args:
        block: Truth and detections.
        scene: That the block belongs to.
        steps: Only these, ascending; all if None.
    """
    wanted = np.arange(block.first, block.stop) if steps is None else np.array(steps, dtype=np.int64)
    taken = [np.flatnonzero(np.isin(part.steps, wanted)) for part in block.cameras]
    horizons = [
        dict(zip(chosen.tolist(), scene.sea_half_planes(scene.cameras[part.camera], part.steps[chosen]), strict=True))
        for part, chosen in zip(block.cameras, taken, strict=True)
    ]
    order = sorted((int(part.steps[i]), place, i) for place, part in enumerate(block.cameras) for i in horizons[place])
    for _, place, within in order:
        yield _frame(block, block.cameras[place], scene, within, horizons[place][within])


def _frame(block: Block, part: CameraBlock, scene: Scene, within: int, sea_half_plane: Array) -> Frame:
    step = int(part.steps[within])
    rows = slice(*np.searchsorted(part.truth.step, (step, step + 1)))
    drawn = slice(*np.searchsorted(part.detections.frame, (within, within + 1)))
    truth, detections = part.truth, part.detections
    vessels = [scene.vessels[index] for index in truth.vessel[rows]]
    names = scene.occluder_names
    labels = scene.detector.labels
    sources = part.truth_row()[drawn]
    return Frame(
        camera=scene.cameras[part.camera].name,
        step=step,
        timestamp=block.timestamps[step - block.first],
        state=scene.detector.states[detections.states[within]].name,
        truth=FrameTruth(
            vessels=tuple(vessel.name for vessel in vessels),
            labels=tuple(vessel.label for vessel in vessels),
            full_boxes_px=truth.full_boxes_px[rows],
            visible_boxes_px=truth.visible_boxes_px[rows],
            boxes_px=annotation_boxes(truth, scene.annotation.mode)[rows],
            silhouette_px=truth.silhouette_px[rows],
            visible_px=truth.visible_px[rows],
            visible_fraction=truth.visible_fraction[rows],
            in_frame_fraction=truth.in_frame_fraction[rows],
            depth_m=truth.depth_m[rows],
            occluded_by=tuple(
                {names[index]: pixels for index, pixels in truth.occluders_of(row)}
                for row in range(rows.start, rows.stop)
            ),
            annotated=truth.annotated[rows],
            detected=part.detected()[rows],
        ),
        detections=FrameDetections(
            labels=tuple(labels[index] for index in detections.label[drawn]),
            confidence=detections.confidence[drawn],
            boxes_px=detections.boxes_px[drawn],
            kinds=tuple(KINDS[kind] for kind in detections.kind[drawn]),
            vessels=tuple(scene.vessels[truth.vessel[row]].name if row >= 0 else None for row in sources),
            errors_px=detections.errors_px[drawn],
        ),
        image_size_px=scene.cameras[part.camera].intrinsics.image_size_px,
        sea_half_plane=sea_half_plane,
        scene_vessels=scene.vessel_names,
    )
