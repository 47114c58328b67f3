"""One PNG that shows at a glance what happened in a run."""

from __future__ import annotations

from functools import reduce
from operator import or_
from pathlib import Path

from PIL import Image, ImageDraw

from modsim3d.outputs.placing import put_in_place
from modsim3d.render.plain_ids import AnyIdRenderer
from modsim3d.runs.blocks import Frame
from modsim3d.runs.outcomes import NOTHING_WRONG, frame_outcomes
from modsim3d.runs.stored_run import StoredRun
from modsim3d.view import palette
from modsim3d.view.outcome_words import fate
from modsim3d.view.pictures.canvas import NOMINAL_PX, font
from modsim3d.view.pictures.frame_picture import CameraView, frame_picture
from modsim3d.view.pictures.highlights import Highlight, pick_highlights
from modsim3d.view.pictures.layers import DETECTIONS
from modsim3d.view.pictures.legend import detection_entries, legend
from modsim3d.view.pictures.plain import background
from modsim3d.view.pictures.solids import open_id_renderer
from modsim3d.view.pictures.window import Window

SHEET_FILE = "contact_sheet.png"
PANEL_PX = (720, 440)
COLUMNS = 2
GAP_PX, CAPTION_PX, FOOT_PX = 16, 44, 40
INSET_PX = 150


def draw_contact_sheet(run: StoredRun) -> Path:
    """Draw the contact sheet of a finished run into its folder: panels of frames that are worth a look."""
    path = run.folder / SHEET_FILE
    with open_id_renderer(run.scene) as id_renderer:
        sheet = _sheet(run, pick_highlights(run.finished_tables, run.scene), id_renderer)
    with put_in_place(path) as partial:
        sheet.save(partial, format="PNG")
    return path


def _sheet(run: StoredRun, highlights: list[Highlight], id_renderer: AnyIdRenderer) -> Image.Image:
    scene, annotation = run.scene, run.scene.annotation
    rows = max(1, -(-len(highlights) // COLUMNS))
    width = COLUMNS * (PANEL_PX[0] + GAP_PX) + GAP_PX
    height = rows * (PANEL_PX[1] + CAPTION_PX + GAP_PX) + GAP_PX + CAPTION_PX + FOOT_PX
    sheet = Image.new("RGB", (width, height), palette.PAPER)
    draw = ImageDraw.Draw(sheet)
    title = f"{scene.name}: annotation mode {annotation.mode}, {annotation.source} truth, seed {scene.seed}"
    draw.text((GAP_PX, GAP_PX), title, fill=palette.INK, font=font(24))
    if not highlights:
        draw.text((GAP_PX, 3 * GAP_PX + CAPTION_PX), "No vessel was in any image.", fill=palette.INK, font=font(18))
    mistakes = NOTHING_WRONG
    for i, highlight in enumerate(highlights):
        x = GAP_PX + (i % COLUMNS) * (PANEL_PX[0] + GAP_PX)
        y = GAP_PX + CAPTION_PX + (i // COLUMNS) * (PANEL_PX[1] + CAPTION_PX + GAP_PX)
        frame = run.frame(highlight.camera, highlight.step)
        place = f"{frame.camera}, {frame.timestamp} s, detector {frame.state}"
        draw.text((x, y), _caption(highlight, frame), fill=palette.INK, font=font(18))
        draw.text((x, y + 22), place, fill=palette.SOFT_INK, font=font(14))
        mistakes = reduce(or_, frame_outcomes(frame), mistakes)
        panel = _panel(highlight, CameraView.of(scene, frame), id_renderer)
        sheet.paste(panel, (x, y + CAPTION_PX))
    key = legend(detection_entries(DETECTIONS, annotation.mode, mistakes), width, 15)
    sheet.paste(key, (0, height - FOOT_PX))
    return sheet


def _caption(highlight: Highlight, frame: Frame) -> str:
    if highlight.vessel is None:
        return highlight.what
    annotated = frame.truth.annotated[frame.truth.vessels.index(highlight.vessel)]
    words = highlight.what, fate(frame, highlight.vessel) if annotated else ""
    return f"{highlight.vessel}: {', '.join(filter(None, words))}"


def _panel(highlight: Highlight, camera_view: CameraView, id_renderer: AnyIdRenderer) -> Image.Image:
    """A highlight, with its place in the whole image in a corner."""
    image_size = camera_view.image_size_px
    window = Window.around(highlight.focus_px, image_size, PANEL_PX)
    picture = frame_picture(camera_view, window, DETECTIONS, id_renderer, nominal_width_px=NOMINAL_PX)
    whole = Window.whole(image_size, INSET_PX)
    inset = background(whole, camera_view.solids.sea_half_plane, image_size)
    draw = ImageDraw.Draw(inset)
    x, y = window.x * whole.scale, window.y * whole.scale
    shown = whole.scale / window.scale
    draw.rectangle((x, y, x + PANEL_PX[0] * shown, y + PANEL_PX[1] * shown), outline=palette.PAPER, width=1)
    for box in camera_view.frame.truth.full_boxes_px:
        x, y = (box.reshape(2, 2).mean(axis=0) * whole.scale).tolist()
        draw.ellipse((x - 1.5, y - 1.5, x + 1.5, y + 1.5), fill=palette.VESSELS[3])
    draw.rectangle((0, 0, inset.width - 1, inset.height - 1), outline=palette.PAPER)
    picture.paste(inset, (PANEL_PX[0] - inset.width - 8, PANEL_PX[1] - inset.height - 8))
    return picture
