"""One PNG that shows at a glance what happened in a run."""

from __future__ import annotations

from functools import reduce
from operator import or_
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from modsim3d.arrays import Array
from modsim3d.boxes import areas, intersections
from modsim3d.outputs.pictures import encoded
from modsim3d.outputs.placing import put_in_place
from modsim3d.render.plain_ids import AnyIdRenderer
from modsim3d.runs.frames import Frame
from modsim3d.runs.outcomes import NOTHING_WRONG, frame_outcomes
from modsim3d.runs.stored_run import StoredRun
from modsim3d.view import palette
from modsim3d.view.outcome_words import WEATHER, fate
from modsim3d.view.pictures.canvas import ARROW_HEAD, Canvas, font, text_size
from modsim3d.view.pictures.frame_picture import CameraView, frame_picture
from modsim3d.view.pictures.highlights import Highlight, pick_highlights
from modsim3d.view.pictures.labels import Label
from modsim3d.view.pictures.layers import DETECTIONS
from modsim3d.view.pictures.legend import detection_entries, legend
from modsim3d.view.pictures.plain import background
from modsim3d.view.pictures.solids import open_id_renderer
from modsim3d.view.pictures.window import Box, Window

SHEET_FILE = "contact_sheet.png"
PANEL_PX = (720, 440)
COLUMNS = 2
GAP_PX, CAPTION_PX = 16, 68
TITLE_PX, CAPTION_TEXT_PX, TEXT_PX = 30, 26, 20
"""Sizes of text, which a page shows at about 60 %."""
LEAST_TEXT_PX = 17
"""Of a long caption; one that is longer still is cut."""
NOMINAL_WIDTH_PX = 1700
"""Width of a picture for which the lines and the text of a panel are meant."""
INSET_PX = (124, 62)
ARROW_PX = 56


def draw_contact_sheet(run: StoredRun) -> Path:
    """Draw the contact sheet of a finished run into its folder: panels of frames that are worth a look."""
    path = run.folder / SHEET_FILE
    with open_id_renderer(run.scene) as id_renderer:
        sheet = _sheet(run, pick_highlights(run.finished_tables, run.scene), id_renderer)
    with put_in_place(path) as partial:
        partial.write_bytes(encoded(sheet))
    return path


def _sheet(run: StoredRun, highlights: list[Highlight], id_renderer: AnyIdRenderer) -> Image.Image:
    scene, annotation = run.scene, run.scene.annotation
    rows = max(1, -(-len(highlights) // COLUMNS))
    width = COLUMNS * (PANEL_PX[0] + GAP_PX) + GAP_PX
    frames = [run.frame(highlight.camera, highlight.step) for highlight in highlights]
    mistakes = reduce(or_, (outcome for frame in frames for outcome in frame_outcomes(frame)), NOTHING_WRONG)
    key = legend(detection_entries(DETECTIONS, annotation.mode, mistakes), width, TEXT_PX)
    foot = rows * (PANEL_PX[1] + CAPTION_PX + GAP_PX) + 2 * GAP_PX + TITLE_PX
    sheet = Image.new("RGB", (width, foot + key.height), palette.PAPER)
    draw = ImageDraw.Draw(sheet)
    title = f"{scene.name}: annotation mode {annotation.mode}, {annotation.source} truth, seed {scene.seed} ({WEATHER})"
    draw.text((GAP_PX, GAP_PX // 2), title, fill=palette.INK, font=font(TITLE_PX))
    if not highlights:
        draw.text((GAP_PX, 3 * GAP_PX + TITLE_PX), "No vessel was in any image.", fill=palette.INK, font=font(TEXT_PX))
    for i, (highlight, frame) in enumerate(zip(highlights, frames, strict=True)):
        x = GAP_PX + (i % COLUMNS) * (PANEL_PX[0] + GAP_PX)
        y = 2 * GAP_PX + TITLE_PX + (i // COLUMNS) * (PANEL_PX[1] + CAPTION_PX + GAP_PX)
        sheet.paste(_tile(highlight, CameraView.of(scene, frame), id_renderer), (x, y))
    sheet.paste(key, (0, foot))
    return sheet


def _caption(highlight: Highlight, frame: Frame) -> str:
    if highlight.vessel is None:
        return highlight.what
    annotated = frame.truth.annotated[frame.truth.vessels.index(highlight.vessel)]
    words = highlight.what, fate(frame, highlight.vessel) if annotated else ""
    return f"{highlight.vessel}: {', '.join(filter(None, words))}"


def _tile(highlight: Highlight, camera_view: CameraView, id_renderer: AnyIdRenderer) -> Image.Image:
    """A highlight under its caption; its place in the whole image is beside the caption, where it covers nothing."""
    frame, image_size = camera_view.frame, camera_view.image_size_px
    window = Window.around(highlight.focus_px, image_size, PANEL_PX)
    tile = Image.new("RGB", (PANEL_PX[0], PANEL_PX[1] + CAPTION_PX), palette.PAPER)
    draw = ImageDraw.Draw(tile)
    inset = _inset(camera_view, window)
    caption, room = _caption(highlight, frame), PANEL_PX[0] - inset.width - GAP_PX
    fitting = (size for size in range(CAPTION_TEXT_PX, LEAST_TEXT_PX, -1) if text_size(caption, size)[2] <= room)
    size = next(fitting, LEAST_TEXT_PX)
    draw.text((0, 2), _shortened(caption, size, room), fill=palette.INK, font=font(size))
    place = f"{frame.camera}, {frame.timestamp} s, detector {frame.state}"
    draw.text((0, CAPTION_PX - TEXT_PX - 10), place, fill=palette.SOFT_INK, font=font(TEXT_PX))
    draw.rectangle((room, 0, PANEL_PX[0], CAPTION_PX), fill=palette.PAPER)
    tile.paste(inset, (PANEL_PX[0] - inset.width, (CAPTION_PX - inset.height) // 2))
    tile.paste(_panel(highlight, camera_view, window, id_renderer), (0, CAPTION_PX))
    return tile


def _shortened(text: str, size: int, room: int) -> str:
    """A text that is cut, with an ellipsis, where it is wider than there is room."""
    if text_size(text, size)[2] <= room:
        return text
    return next(cut for end in range(len(text), -1, -1) if text_size(cut := f"{text[:end]}…", size)[2] <= room)


def _panel(highlight: Highlight, camera_view: CameraView, window: Window, id_renderer: AnyIdRenderer) -> Image.Image:
    """The part of the image around a highlight, with an arrow at it; only what it is about has labels."""
    focus = window.corners(np.array(highlight.focus_px))

    def wanted(label: Label) -> bool:
        return label.vessel == highlight.vessel and (label.vessel is not None or np.allclose(label.box, focus))

    arrow = _arrow(focus, [window.corners(box) for box in _boxes_px(camera_view.frame)])
    picture = frame_picture(
        camera_view,
        window,
        DETECTIONS,
        id_renderer,
        nominal_width_px=NOMINAL_WIDTH_PX,
        wanted=wanted,
        keep_clear=[_place(*arrow)],
    )
    Canvas(picture, NOMINAL_WIDTH_PX).arrow(*arrow, ARROW_PX)
    return picture


def _boxes_px(frame: Frame) -> Array:
    seen = frame.truth.visible_boxes_px
    return np.concatenate([seen[~np.isnan(seen).any(axis=1)], frame.detections.boxes_px])


Arrow = tuple[tuple[float, float], tuple[int, int]]
"""Tip and direction."""


def _arrow(focus: Box, boxes: list[Box]) -> Arrow:
    """An arrow at a box, from the side on which it covers least of what else is there, inside the panel."""
    width, height = PANEL_PX
    x0, y0, x1, y1 = max(focus[0], 0.0), max(focus[1], 0.0), min(focus[2], width), min(focus[3], height)
    x, y, gap = (x0 + x1) / 2, (y0 + y1) / 2, GAP_PX / 2
    arrows: list[Arrow] = [
        ((x, y0 - gap), (0, 1)),
        ((x, y1 + gap), (0, -1)),
        ((x0 - gap, y), (1, 0)),
        ((x1 + gap, y), (-1, 0)),
    ]
    places = np.array([_place(*arrow) for arrow in arrows])
    outside = areas(places) - intersections(places, np.array([0.0, 0.0, width, height]))
    covered = intersections(places[:, None], np.array(boxes).reshape(-1, 4)).sum(axis=1)
    return arrows[int(np.argmin(covered + 100 * outside))]


def _place(tip: tuple[float, float], direction: tuple[int, int]) -> Box:
    """The box that an arrow fills."""
    (x, y), (right, down), half = tip, direction, 0.8 * ARROW_HEAD * ARROW_PX
    ends = np.array([[x, y], [x - right * ARROW_PX, y - down * ARROW_PX]])
    (x0, y0), (x1, y1) = ends.min(axis=0).tolist(), ends.max(axis=0).tolist()
    return (x0, y0 - half, x1, y1 + half) if right else (x0 - half, y0, x1 + half, y1)


def _inset(camera_view: CameraView, window: Window) -> Image.Image:
    """The whole image, small, with the vessels as dots and a frame around the window."""
    image_size = camera_view.image_size_px
    whole = Window.whole(image_size, round(min(INSET_PX[0], INSET_PX[1] * image_size[0] / image_size[1])))
    inset = background(whole, camera_view.solids.sea_half_plane, image_size)
    draw = ImageDraw.Draw(inset)
    for box in camera_view.frame.truth.full_boxes_px:
        x, y = (box.reshape(2, 2).mean(axis=0) * whole.scale).tolist()
        draw.ellipse((x - 1.5, y - 1.5, x + 1.5, y + 1.5), fill=palette.VESSELS[3])
    x, y = window.x * whole.scale, window.y * whole.scale
    shown = whole.scale / window.scale
    draw.rectangle((x, y, x + PANEL_PX[0] * shown, y + PANEL_PX[1] * shown), outline=palette.PAPER, width=2)
    return inset
