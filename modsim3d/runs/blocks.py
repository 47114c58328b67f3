"""Truth and detections of consecutive steps: as columns for each camera (blocks), and frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.detector.records import KINDS, Detections
from modsim3d.errors import ModsimError
from modsim3d.runs.frame_views import (
    detections_html,
    detections_in_words,
    frame_html,
    frame_in_words,
    frame_png,
    supervision_detections,
    supervision_truth,
    truth_html,
    truth_in_words,
)
from modsim3d.scene.scene import Scene
from modsim3d.scene.snapshot import IdImage, Snapshot
from modsim3d.truth.modes import annotation_boxes
from modsim3d.truth.truth_record import Truth

if TYPE_CHECKING:
    import pyarrow as pa
    import supervision
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class CameraBlock:
    """One camera's part of a block.

    Attributes:
        camera: Index into the scene's cameras.
        steps: Steps at which it took a frame, ascending, shape (S,).
        sea_half_planes: (a, b, c) of each frame, with a·x + b·y + c >= 0 on the sea's side of the horizon, (S, 3).
        truth: What it saw, in order of step and vessel.
        target_rows: Rows of `truth` that were annotated and given to the detector, shape (n,).
        detections: What the detector made of it. `frame` indexes `steps`; `target` indexes `target_rows`.
    """

    camera: int
    steps: Indices
    sea_half_planes: Array
    truth: Truth
    target_rows: Indices
    detections: Detections

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
        found = np.zeros(len(self.truth), dtype=bool)
        detections = self.detections
        own, shared = detections.target[~detections.false()], detections.partner[detections.partner >= 0]
        found[self.target_rows[np.concatenate([own, shared])]] = True
        return found


@dataclass(frozen=True, eq=False)
class Block:
    """Truth and detections of steps first to stop − 1 of a scene.

    Attributes:
        timestamps: The text of each step's time.
        cameras: One part for each camera, in the order of the scene's cameras.
    """

    first: int
    timestamps: tuple[str, ...]
    cameras: tuple[CameraBlock, ...]

    @property
    def stop(self) -> int:
        """The step after the last."""
        return self.first + len(self.timestamps)


@dataclass(frozen=True, eq=False, repr=False)
class FrameTruth:
    """What one camera sees at one step: n vessels as arrays. Boxes are x_min, y_min, x_max, y_max in pixels.

    Attributes:
        vessels: IDs of the vessels.
        labels: True classes of the vessels.
        class_id: Their indices in the detector's labels, `scene.detector.labels`, shape (n,).
        full_boxes_px: Boxes of the whole silhouettes, cut at the image edge, shape (n, 4).
        visible_boxes_px: Boxes of the visible pixels; NaN if there are none, shape (n, 4).
        boxes_px: The boxes that the annotation mode takes: the full or the visible ones, shape (n, 4).
        silhouette_px: Pixels of the silhouette in the image, shape (n,).
        visible_px: Pixels of the silhouette that are seen, shape (n,).
        visible_fraction: visible_px / silhouette_px; NaN if there is no silhouette pixel, shape (n,).
        in_frame_fraction: Area in the image over area of the silhouette; NaN across the near plane, shape (n,).
        depth_m: Mean distance along the camera's axis, shape (n,).
        occluded_by: For each vessel, the names of its occluders and the number of pixels that each hides.
        annotated: Whether each vessel was given to the detector, shape (n,).
        detected: Whether each vessel was detected, under whatever label, shape (n,).
    """

    vessels: tuple[str, ...]
    labels: tuple[str, ...]
    class_id: Indices
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

    def __repr__(self) -> str:
        """The vessels, and how many are annotated and detected."""
        return f"<FrameTruth: {truth_in_words(self)}>"

    def _repr_html_(self) -> str:
        """A notebook's table."""
        return truth_html(self)


@dataclass(frozen=True, eq=False, repr=False)
class FrameDetections:
    """The detector's output for one frame: m detections as arrays, in shuffled order.

    Attributes:
        labels: Detected classes.
        class_id: Their indices in the detector's labels, `scene.detector.labels`, shape (m,).
        confidence: In [0, 1], shape (m,).
        boxes_px: x_min, y_min, x_max, y_max, shape (m, 4).
        kinds: Origin of each detection: one of `modsim3d.detector.KINDS`.
        vessels: ID of the vessel that each detection came from, None for a false positive. A tracker must not read it.
        errors_px: e_x, e_y, e_w, e_h before clipping, NaN for false positives, shape (m, 4).
    """

    labels: tuple[str, ...]
    class_id: Indices
    confidence: Array
    boxes_px: Array
    kinds: tuple[str, ...]
    vessels: tuple[str | None, ...]
    errors_px: Array

    def __len__(self) -> int:
        """Number of detections."""
        return len(self.labels)

    def __repr__(self) -> str:
        """How many there are, and of what kinds."""
        return f"<FrameDetections: {detections_in_words(self)}>"

    def _repr_html_(self) -> str:
        """A notebook's table."""
        return detections_html(self)


@dataclass(frozen=True, eq=False, repr=False)
class Frame:
    """One camera at one step, from `simulate_frames` or `StoredRun.frames`.

        frame.time_s, frame.truth.boxes_px, frame.detections.confidence

    Attributes:
        camera: Name of the camera.
        step: Step, counted from zero.
        timestamp: The text of the step's time, as files have it.
        time_s: Time since the scene's first step, in seconds.
        state: Name of the detector's performance state.
        truth: What the camera sees.
        detections: What the detector makes of it.
        image_size_px: Width and height.
        sea_half_plane: (a, b, c) with a·x + b·y + c >= 0 on the sea's side of the horizon, shape (3,).
        scene_vessels: IDs of all vessels of the scene, seen or not; their order gives the colours of pictures.
        scene: The scene, for the picture; None in a frame that was made without one.
    """

    camera: str
    step: int
    timestamp: str
    time_s: float
    state: str
    truth: FrameTruth
    detections: FrameDetections
    image_size_px: tuple[int, int]
    sea_half_plane: Array
    scene_vessels: tuple[str, ...]
    scene: Scene | None = None

    def __repr__(self) -> str:
        """Camera, step, time and how much is in it."""
        return f"<Frame: {frame_in_words(self)}>"

    def _repr_html_(self) -> str | None:
        """A notebook's tables, where it cannot draw the picture."""
        return frame_html(self)

    def _repr_png_(self) -> bytes | None:
        """A notebook's picture; None without matplotlib."""
        return frame_png(self)

    def id_image(self) -> IdImage:
        """What is in front at each pixel: `ids` of shape (height, width), 0 for nothing, and the `names` of IDs.

        Raises:
            ModsimError: The frame was made without a scene.
            RendererError: There is no OpenGL library.
        """
        return self._snapshot().render_ids(self.camera)

    def silhouette(self, vessel: str) -> Mask:
        """The pixels of a vessel drawn alone, parts that others hide included, of the shape of `id_image().ids`.

        Raises:
            ModsimError: There is no such vessel, or the frame was made without a scene.
            RendererError: There is no OpenGL library.
        """
        return self._snapshot().render_silhouette(self.camera, vessel)

    def _snapshot(self) -> Snapshot:
        if self.scene is None:
            raise ModsimError("this frame has no scene that could be drawn: take one from simulate_frames or open_run")
        return self.scene.at(self.step)

    def table(self, name: str) -> pa.Table:
        """Its rows of a run's table: `frames`, `truth` or `detections`, with the columns of `StoredRun.table`.

        Raises:
            ModsimError: There is no such table.
        """
        from modsim3d.runs.files.frame_rows import rows_of_frame  # no pyarrow where none is needed

        return rows_of_frame(self, name)

    def to_supervision(self) -> supervision.Detections:
        """The detections as `supervision.Detections`: `xyxy`, `confidence`, `class_id` and `data["class_name"]`.

        Raises:
            ModsimError: supervision is not installed.
        """
        return supervision_detections(self)

    def truth_to_supervision(self) -> supervision.Detections:
        """The annotated vessels as `supervision.Detections`, with the boxes that the annotation mode takes.

        `tracker_id` is the place of each vessel in `scene_vessels`; `data["vessel"]` is its ID. There is no confidence.

        Raises:
            ModsimError: supervision is not installed.
        """
        return supervision_truth(self)

    def plot(self, axes: Axes | None = None, *, zoom: bool = False, labels: bool = True) -> Figure:
        """Draw the picture of the films, with axes in pixels; a notebook shows the matplotlib figure that is returned.

        Args:
            axes: Axes to draw into; a new figure if None.
            zoom: Show only the part of the image with vessels.
            labels: Write names, classes and confidences.

        Raises:
            ModsimError: matplotlib is not installed.
        """
        from modsim3d.view.frame_plot import plot_frame  # the one import of a room above, for notebooks

        return plot_frame(self, axes, zoom=zoom, labels=labels)


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
    """The frame that a camera took at its step `index`."""
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
