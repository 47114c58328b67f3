"""One picture of one frame, layer by layer, at any size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image

from modsim3d.arrays import Array, Indices
from modsim3d.render.plain_ids import AnyIdRenderer
from modsim3d.runs.frames import Frame
from modsim3d.runs.outcomes import Outcome, detected_rows, frame_outcomes
from modsim3d.scene.scene import Scene
from modsim3d.view import palette
from modsim3d.view.outcome_words import is_a
from modsim3d.view.palette import Colour
from modsim3d.view.pictures.canvas import Canvas
from modsim3d.view.pictures.hatching import hatch_hidden
from modsim3d.view.pictures.labels import Label, draw_labels
from modsim3d.view.pictures.layers import Layers
from modsim3d.view.pictures.marks import draw_detection, draw_tether
from modsim3d.view.pictures.plain import background, draw_horizon, fill_solids
from modsim3d.view.pictures.solids import Solids
from modsim3d.view.pictures.track_marks import NO_TRACKS, FrameTracks, draw_tracks
from modsim3d.view.pictures.window import Box, Window

DIM = 0.25
"""How much darker vessels are filled under boxes of their colour."""
SHORT_BELOW_PX = 480
"""A picture narrower than this has room for the confidence only."""


@dataclass(frozen=True, eq=False)
class CameraView:
    """A frame, the solids before its camera, the names of the scene's vessels in order of their colours, and tracks."""

    frame: Frame
    solids: Solids
    vessels: tuple[str, ...]
    tracks: FrameTracks = NO_TRACKS

    @classmethod
    def of(cls, scene: Scene, frame: Frame, tracks: FrameTracks = NO_TRACKS) -> CameraView:
        """Add to a frame of a scene what stood before its camera, and the tracks in it."""
        (camera,) = (camera for camera in scene.cameras if camera.name == frame.camera)
        return cls(frame, Solids.at(scene, camera, frame.step), scene.vessel_names, tracks)

    @property
    def image_size_px(self) -> tuple[int, int]:
        """Width and height of the camera's image."""
        return self.solids.intrinsics.image_size_px

    def colour(self, vessel: str) -> Colour:
        """The colour of a vessel by its name."""
        return palette.vessel_colour(self.vessels.index(vessel))


def frame_picture(
    camera_view: CameraView,
    window: Window,
    layers: Layers,
    id_renderer: AnyIdRenderer,
    *,
    ground: Image.Image | None = None,
    nominal_width_px: int | None = None,
    wanted: Callable[[Label], bool] = lambda label: True,
    keep_clear: Sequence[Box] = (),
) -> Image.Image:
    """Draw layers of a frame.

    Args:
        camera_view: The frame, and what stood before its camera.
        window: The part of the image to show, and how large.
        layers: The layers to draw.
        id_renderer: Renders ID buffers, for filled and hatched silhouettes.
        ground: A picture to draw on, in place of plain sea and sky.
        nominal_width_px: Width of the picture for which lines and text are meant; the window's if None.
        wanted: Which labels to write.
        keep_clear: What labels should not cover, beside vessels and detections, in pixels of the picture.
    """
    solids = camera_view.solids
    half_plane = solids.sea_half_plane
    picture = ground or background(window, half_plane, camera_view.image_size_px)
    canvas = Canvas(picture, nominal_width_px)
    if layers.horizon:
        draw_horizon(canvas, window, half_plane, camera_view.image_size_px)
    if layers.silhouettes and (layers.truth or layers.detections):
        # Beneath boxes a step in an edge is not noticed; see benchmarks/DRAWING.md.
        fill_solids(picture, window, solids, id_renderer, dim=DIM, samples=1)
    elif layers.silhouettes:
        fill_solids(picture, window, solids, id_renderer)
    if layers.hatching and any(camera_view.frame.truth.occluded_by):
        hatch_hidden(picture, window, solids, solids.ids(window, id_renderer), canvas.unit)
    if layers.wires or layers.points:
        _draw_shoeboxes(canvas, window, solids, layers)
    labels = _draw_truth(canvas, window, camera_view, layers) + _draw_detections(canvas, window, camera_view, layers)
    if layers.tracks:
        labels = draw_tracks(canvas, window, camera_view.tracks) + labels
    frame = camera_view.frame
    seen = frame.truth.visible_boxes_px[~np.isnan(frame.truth.visible_boxes_px).any(axis=1)]
    boxes = [window.corners(box) for box in (*seen, *frame.detections.boxes_px)] + [*keep_clear]
    draw_labels(canvas, sorted(filter(wanted, labels), key=lambda label: label.colour != palette.ALARM), boxes)
    return picture


def _draw_shoeboxes(canvas: Canvas, window: Window, solids: Solids, layers: Layers) -> None:
    for vessel, edges, corners in solids.shoeboxes():
        colour = palette.vessel_colour(vessel)
        if layers.wires:
            canvas.segments(window.to_picture(edges), colour, 0.75)
        if layers.points:
            radius = max(1.5, 2.5 * canvas.unit)
            for x, y in window.to_picture(corners[np.isfinite(corners).all(axis=1)]).tolist():
                canvas.draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour, outline=palette.INK)


def _draw_truth(canvas: Canvas, window: Window, camera_view: CameraView, layers: Layers) -> list[Label]:
    truth, narrow = camera_view.frame.truth, canvas.picture.width < SHORT_BELOW_PX
    labels = []
    for i in range(len(truth)):
        full = window.corners(truth.full_boxes_px[i])
        annotated = bool(truth.annotated[i])
        for shown, boxes in ((layers.full, truth.full_boxes_px), (layers.visible, truth.visible_boxes_px)):
            if shown and _is_another(boxes[i], truth.boxes_px[i] if annotated else None):
                canvas.dashed_box(window.corners(boxes[i]), palette.TRUTH, 0.75)
        if layers.truth and annotated:
            canvas.box(window.corners(truth.boxes_px[i]), palette.TRUTH, 0.75, halo=True)
        share = _percent(float(truth.visible_fraction[i])) if layers.fractions and truth.visible_fraction[i] < 1 else ""
        if layers.missed and annotated and not truth.detected[i]:
            canvas.brackets(window.corners(truth.boxes_px[i]), palette.ALARM, 1.5)
            if layers.labels:
                text = ", ".join(filter(None, (f"missed {truth.vessels[i]}", share and f"{share} seen")))
                labels.append(_worded(full, text, "missed", palette.ALARM, narrow, truth.vessels[i], below=True))
                continue
        if share:
            text = f"{truth.vessels[i]}, {share} seen"
            label = _worded(full, text, share, palette.TRUTH, narrow, truth.vessels[i], below=True)
            labels.append(replace(label, short="", optional=True) if share == "0 %" else label)
    return labels


def _is_another(box: Array, annotated: Array | None) -> bool:
    """Whether there is a box, and it is not the annotated one."""
    return not np.isnan(box).any() and (annotated is None or not np.array_equal(box, annotated))


def _percent(fraction: float) -> str:
    """The visible fraction of a vessel that is hidden in part; it says 0 % only if nothing is seen."""
    return f"{min(max(round(100 * fraction), 1), 99) if fraction else 0} %"


def _worded(
    box: Box, text: str, short: str, colour: Colour, narrow: bool, vessel: str | None, *, below: bool = False
) -> Label:
    """A label that may be shortened, and is in a narrow picture."""
    return Label(box, short if narrow else text, colour, below, "" if narrow else short, vessel=vessel)


def _draw_detections(canvas: Canvas, window: Window, camera_view: CameraView, layers: Layers) -> list[Label]:
    frame, detections = camera_view.frame, camera_view.frame.detections
    outcomes, rows, narrow = frame_outcomes(frame), detected_rows(frame), canvas.picture.width < SHORT_BELOW_PX
    labels = []
    order: Indices = np.argsort(detections.confidence, kind="stable")  # the most confident one is drawn last, on top
    for i in order.tolist():
        row = rows[i]
        if not (layers.false_positives if row is None else layers.detections):
            continue
        outcome = outcomes[i] if layers.mistakes else outcomes[i] & Outcome.FALSE_POSITIVE
        box = window.corners(detections.boxes_px[i])
        if row is not None and outcome & Outcome.OFF_VESSEL:
            draw_tether(canvas, box, window.corners(frame.truth.boxes_px[row]))
        colour = palette.ALARM if row is None else camera_view.colour(frame.truth.vessels[row])
        draw_detection(canvas, box, colour, outcome)
        if layers.labels:
            mislabelled = row is not None and bool(outcome & Outcome.MISLABELLED)
            confidence = f"{detections.confidence[i]:.2f}"
            text = f"{_remark(detections.kinds[i])}{detections.labels[i]} {confidence}"
            text += f", {is_a(frame.truth.labels[row])}" if row is not None and mislabelled else ""
            vessel = None if row is None else frame.truth.vessels[row]
            labels.append(_worded(box, text, confidence, palette.ALARM if mislabelled else colour, narrow, vessel))
    return labels[::-1]


def _remark(kind: str) -> str:
    """The words before the label of a detection that is not simply a vessel's."""
    if kind == "true":
        return ""
    return "false: " if kind.endswith("false_positive") else f"{kind}: "
