"""One picture of one frame, layer by layer, at any size."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from PIL import Image, ImageDraw

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask
from modsim3d.render.id_pass import AnyIdRenderer, Ids, Region
from modsim3d.runs.counts import Outcome, frame_outcomes
from modsim3d.runs.frames import Frame, detected_rows
from modsim3d.scene.scene import Scene
from modsim3d.view import palette
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.palette import Colour, vessel_colour
from modsim3d.view.pictures.canvas import Box, Canvas, Label, Window, draw_labels
from modsim3d.view.pictures.layers import Layers, is_a
from modsim3d.view.pictures.plain import Solids, background, draw_horizon, fill_solids

STRIPE_PX = 4.0


def hatch_hidden(picture: Image.Image, window: Window, solids: Solids, ids: Ids, unit: float) -> None:
    """Hatch each vessel where something else is in front of it.
    `ids` is occluder + 1 at each of the picture's pixels, shape (h, w). `unit` is 1 in a picture of nominal width."""
    stripe = max(2, round(STRIPE_PX * unit))
    for row, occluder in enumerate(solids.occluders.tolist()):
        if occluder >= len(solids.extents_m):
            continue
        region, silhouette = silhouette_mask(solids, row, window)
        if not region.width or not region.height:
            continue
        seen = ids[region.y : region.y + region.height, region.x : region.x + region.width]
        hidden = silhouette & (seen != occluder + 1) & (seen > 0)
        if not hidden.any():
            continue
        diagonal = np.arange(region.y, region.y + region.height)[:, None] + np.arange(region.x, region.x + region.width)
        striped = hidden & (diagonal // stripe % 2 == 0)
        mask = Image.fromarray(np.where(striped, np.uint8(255), np.uint8(0)))
        picture.paste(vessel_colour(occluder, solids.own_ships), (region.x, region.y), mask)


def silhouette_mask(solids: Solids, row: int, window: Window) -> tuple[Region, Mask]:
    """A region of the window, and which of its pixels the whole silhouette of a row covers, shape (h, w)."""
    triangles = window.to_picture(solids.triangles.corners_px[solids.triangles.row == row])
    if not len(triangles):
        return Region(0, 0, 0, 0), np.zeros((0, 0), dtype=bool)
    box = np.concatenate([triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))])
    region = Region.around(box, window.size)
    mask = Image.new("1", (max(region.width, 1), max(region.height, 1)))
    draw = ImageDraw.Draw(mask)
    # Pillow counts from pixel centres, and fills the pixels on the edge too.
    for triangle in (triangles - (region.x + 0.5, region.y + 0.5)).reshape(-1, 6).tolist():
        draw.polygon(triangle, fill=1)
    return region, np.array(mask, dtype=bool)


LONG_DASH_PX, DASHES_A_SIDE = 10.0, 3
FLAG_PX, FLAG_SHARE = 16.0, 0.6  # legs of the filled corner of a wrong class, at most this share of the shorter side


def draw_detection(canvas: Canvas, box: Box, colour: Colour, outcome: Outcome, weight: float = 1.5) -> None:
    """Draw a detection's box, in pixels of the picture.
    Solid if it fits its vessel, in long dashes if it does not, with a filled corner for a wrong class; crossed out and
    in short dashes if it is a false positive."""
    if outcome & Outcome.FALSE_POSITIVE:
        canvas.crossed(box, colour)
        canvas.dashed_box(box, colour, weight)
    elif outcome & Outcome.BELOW_HALF_IOU:
        side = max(box[2] - box[0], box[3] - box[1])  # also a small box has dashes and gaps
        canvas.dashed_box(box, colour, weight, min(LONG_DASH_PX, side / (2 * DASHES_A_SIDE - 1) / canvas.unit))
    else:
        canvas.box(box, colour, weight)
    if outcome & Outcome.MISLABELLED:
        x0, y0, x1, y1 = box
        leg = max(5.0, min(FLAG_PX * canvas.unit, FLAG_SHARE * min(x1 - x0, y1 - y0)))
        canvas.draw.polygon([(x1 - leg, y0), (x1, y0), (x1, y0 + leg)], fill=palette.ALARM, outline=palette.INK)


def draw_tether(canvas: Canvas, box: Box, true_box: Box) -> None:
    """Draw a line from the centre of a detection's box to the box of its vessel, which it does not touch."""
    x, y = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
    end = (min(max(x, true_box[0]), true_box[2]), min(max(y, true_box[1]), true_box[3]))
    canvas.segments(np.array([[(x, y), end]]), palette.ALARM, 0.75)
    radius = max(2.0, 3.0 * canvas.unit)
    canvas.draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=palette.ALARM)


WEIGHT, WEIGHT_SHARE = 2.5, 0.12  # of a track's box, at most so much of its shorter side; a detection's has 1.5


_NO_ROWS = np.empty(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class FrameTracks:
    """The tracks in one frame, m of them."""

    number: Indices  # that the tracker gave each, shape (m,)
    boxes_px: Array  # x_min, y_min, x_max, y_max, shape (m, 4)
    vessel: Indices  # index of the vessel that each follows, `NOBODY` for none, shape (m,)
    unscored: Mask  # which follow a vessel that is hidden or not annotated, shape (m,)
    trails_px: tuple[Array, ...]  # where the centre of each has been, the newest first, each of shape (n, 2)

    @classmethod
    def of(cls, followed: FollowedTracks | None, scene: Scene, frame: Frame, only: Set[int] | None = None) -> Self:
        """The tracks in a frame of a scene, or those with some numbers only; none if there are no tracks."""
        if followed is None:
            return cls(_NO_ROWS, np.empty((0, 4)), _NO_ROWS, _NO_ROWS.astype(bool), ())
        camera, tracks = [scene_camera.name for scene_camera in scene.cameras].index(frame.camera), followed.tracks
        rows = np.arange(len(tracks))[followed.rows_of(frame.step * len(scene.cameras) + camera)]
        if only is not None:
            rows = rows[np.isin(tracks.track[rows], list(only))]
        columns = tracks.track[rows], tracks.boxes_px[rows], followed.vessel[rows], followed.unscored[rows]
        return cls(*columns, tuple(followed.trail_px(row) for row in rows.tolist()))


def draw_tracks(canvas: Canvas, window: Window, tracks: FrameTracks, own_ships: Sequence[int] = ()) -> list[Label]:
    """Draw the tracks of a frame, and return their numbers as labels.
    A box is solid where its track follows a vessel that is to be followed, and dashed elsewhere."""
    labels = []
    for i, (number, vessel) in enumerate(zip(tracks.number.tolist(), tracks.vessel.tolist(), strict=True)):
        colour = palette.ALARM if vessel == NOBODY else vessel_colour(vessel, own_ships)
        box = window.corners(tracks.boxes_px[i])
        weight = min(WEIGHT, WEIGHT_SHARE * min(box[2] - box[0], box[3] - box[1]) / canvas.line_px())
        trail = window.to_picture(tracks.trails_px[i])
        canvas.segments(np.stack([trail[:-1], trail[1:]], axis=1), colour, 1.0)
        if vessel == NOBODY or tracks.unscored[i]:
            canvas.dashed_box(box, colour, weight)
        else:
            canvas.box(box, colour, weight, halo=True)
        labels.append(Label(box, f"#{number}", colour, below=True))
    return labels


DIM = 0.25  # how much darker vessels are filled under boxes of their colour
SHORT_BELOW_PX = 480  # a picture narrower than this has room for the confidence only


@dataclass(frozen=True, eq=False)
class CameraView:
    """A frame, the solids before its camera, the names of the scene's vessels in order of their colours, and tracks."""

    frame: Frame
    solids: Solids
    vessels: tuple[str, ...]
    tracks: FrameTracks

    @classmethod
    def of(cls, scene: Scene, frame: Frame, tracks: FrameTracks | None = None) -> CameraView:
        """Add to a frame of a scene what stood before its camera, and the tracks in it."""
        (camera,) = (camera for camera in scene.cameras if camera.name == frame.camera)
        solids = Solids.at(scene, camera, frame.step)
        return cls(frame, solids, scene.vessel_names, tracks or FrameTracks.of(None, scene, frame))

    @property
    def image_size_px(self) -> tuple[int, int]:
        """Width and height of the camera's image."""
        return self.solids.intrinsics.image_size_px

    def colour(self, vessel: str) -> Colour:
        """The colour of a vessel by its name."""
        return vessel_colour(self.vessels.index(vessel), self.solids.own_ships)


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
    if layers.numbers:
        for name, box in zip(camera_view.frame.truth.vessels, camera_view.frame.truth.visible_boxes_px, strict=True):
            if not np.isnan(box).any():
                number = f"{camera_view.vessels.index(name) + 1}"
                labels.append(Label(window.corners(box), number, camera_view.colour(name), vessel=name))
    if layers.tracks:
        labels = draw_tracks(canvas, window, camera_view.tracks, solids.own_ships) + labels
    frame = camera_view.frame
    seen = frame.truth.visible_boxes_px[~np.isnan(frame.truth.visible_boxes_px).any(axis=1)]
    draw_labels(canvas, [*filter(wanted, labels)], [*map(window.corners, seen), *keep_clear])
    return picture


def _draw_shoeboxes(canvas: Canvas, window: Window, solids: Solids, layers: Layers) -> None:
    for vessel, edges, corners in solids.shoeboxes():
        colour = vessel_colour(vessel, solids.own_ships)
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
        full, annotated = window.corners(truth.full_boxes_px[i]), bool(truth.annotated[i])
        for shown, boxes in ((layers.full, truth.full_boxes_px), (layers.visible, truth.visible_boxes_px)):
            is_annotated = annotated and np.array_equal(boxes[i], truth.boxes_px[i])
            if shown and not np.isnan(boxes[i]).any() and not is_annotated:
                canvas.dashed_box(window.corners(boxes[i]), palette.TRUTH, 0.75)
        if layers.truth and annotated:
            canvas.box(window.corners(truth.boxes_px[i]), palette.TRUTH, 0.75, halo=True)
        share = _percent(float(truth.visible_fraction[i])) if layers.fractions and truth.visible_fraction[i] < 1 else ""
        if layers.missed and annotated and not truth.detected[i]:
            canvas.brackets(window.corners(truth.boxes_px[i]), palette.ALARM, 1.5)
            if layers.labels:
                text = ", ".join(filter(None, (f"missed {truth.vessels[i]}", share and f"{share} seen")))
                labels.append(_worded(full, text, "missed", palette.ALARM, narrow, truth.vessels[i]))
                continue
        if share:
            text = f"{truth.vessels[i]}, {share} seen"
            label = _worded(full, text, share, palette.TRUTH, narrow, truth.vessels[i], below=True)
            labels.append(replace(label, short="", optional=True) if share == "0 %" else label)
    return labels


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
            # At the vessel and not at the box, whose errors would make it jump from frame to frame.
            place = box if row is None else window.corners(frame.truth.full_boxes_px[row])
            labels.append(_worded(place, text, confidence, palette.ALARM if mislabelled else colour, narrow, vessel))
    return labels[::-1]


def _remark(kind: str) -> str:
    """The words before the label of a detection that is not simply a vessel's."""
    if kind == "true":
        return ""
    return "false: " if kind.endswith("false_positive") else f"{kind}: "
