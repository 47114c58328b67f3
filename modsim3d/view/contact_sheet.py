"""One PNG that shows at a glance what happened in a run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from PIL import Image, ImageDraw

from modsim3d.render.plain_ids import IdDrawer
from modsim3d.view import palette
from modsim3d.view.layers import DETECTIONS
from modsim3d.view.legend import detection_entries, legend
from modsim3d.view.moments import Moment, pick_moments
from modsim3d.view.painter import Subject, paint
from modsim3d.view.pen import NOMINAL_PX, font
from modsim3d.view.plain import background
from modsim3d.view.window import Window

PANEL_PX = (720, 440)
COLUMNS = 2
GAP_PX, CAPTION_PX, FOOT_PX = 16, 44, 40
INSET_PX = 150


def contact_sheet(
    folder: Path, title: str, mode: int, subject_of: Callable[[Moment], Subject], drawer: IdDrawer
) -> Image.Image:
    """Panels of the moments that are worth a look, each with its place in the whole image.

    Args:
        folder: A finished run directory.
        title: Line at the top.
        mode: Annotation mode of the run.
        subject_of: Gives the frame of a moment.
        drawer: Draws ID buffers.
    """
    moments = pick_moments(folder)
    rows = max(1, -(-len(moments) // COLUMNS))
    width = COLUMNS * (PANEL_PX[0] + GAP_PX) + GAP_PX
    height = rows * (PANEL_PX[1] + CAPTION_PX + GAP_PX) + GAP_PX + CAPTION_PX + FOOT_PX
    sheet = Image.new("RGB", (width, height), palette.PAPER)
    draw = ImageDraw.Draw(sheet)
    draw.text((GAP_PX, GAP_PX), title, fill=palette.INK, font=font(24))
    if not moments:
        draw.text((GAP_PX, 3 * GAP_PX + CAPTION_PX), "No vessel was in any image.", fill=palette.INK, font=font(18))
    for i, moment in enumerate(moments):
        x = GAP_PX + (i % COLUMNS) * (PANEL_PX[0] + GAP_PX)
        y = GAP_PX + CAPTION_PX + (i // COLUMNS) * (PANEL_PX[1] + CAPTION_PX + GAP_PX)
        subject = subject_of(moment)
        frame = subject.frame
        place = f"{frame.camera}, {frame.timestamp} s, detector {frame.state}"
        draw.text((x, y), moment.caption, fill=palette.INK, font=font(18))
        draw.text((x, y + 22), place, fill=palette.SOFT_INK, font=font(14))
        sheet.paste(_panel(moment, subject, drawer), (x, y + CAPTION_PX))
    sheet.paste(legend(detection_entries(DETECTIONS, mode), width, 15), (0, height - FOOT_PX))
    return sheet


def _panel(moment: Moment, subject: Subject, drawer: IdDrawer) -> Image.Image:
    image_size = subject.image_size_px
    window = Window.around(moment.focus_px, image_size, PANEL_PX)
    picture = paint(subject, window, DETECTIONS, drawer, nominal_width_px=NOMINAL_PX)
    whole = Window.whole(image_size, INSET_PX)
    inset = background(whole, subject.solids.sea_half_plane, image_size)
    draw = ImageDraw.Draw(inset)
    x, y = window.x * whole.scale, window.y * whole.scale
    shown = whole.scale / window.scale
    draw.rectangle((x, y, x + PANEL_PX[0] * shown, y + PANEL_PX[1] * shown), outline=palette.PAPER, width=1)
    for box in subject.frame.truth.full_boxes_px:
        x, y = (box.reshape(2, 2).mean(axis=0) * whole.scale).tolist()
        draw.ellipse((x - 1.5, y - 1.5, x + 1.5, y + 1.5), fill=palette.VESSELS[3])
    draw.rectangle((0, 0, inset.width - 1, inset.height - 1), outline=palette.PAPER)
    picture.paste(inset, (PANEL_PX[0] - inset.width - 8, PANEL_PX[1] - inset.height - 8))
    return picture
