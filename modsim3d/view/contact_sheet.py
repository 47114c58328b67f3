"""One PNG that shows at a glance what happened in a run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from modsim3d.block import Frame
from modsim3d.frames import Array
from modsim3d.view import palette
from modsim3d.view.moments import Moment, pick_moments
from modsim3d.view.panel import Window, background, draw_frame, font

PANEL_PX = (720, 440)
COLUMNS = 2
GAP_PX, CAPTION_PX, FOOT_PX = 16, 44, 40
INSET_PX = 150

Look = Callable[[Moment], tuple[Frame, "NDArray[np.uint32] | None", Array, tuple[int, int]]]
"""For a moment: its frame, the ID image (or None), the horizon's half plane, the image's width and height."""


def contact_sheet(folder: Path, title: str, vessels: tuple[str, ...], look: Look) -> Image.Image:
    """Panels of the moments that are worth a look, each with its place in the whole image.

    Args:
        folder: A finished run directory.
        title: Line at the top.
        vessels: IDs of the scene's vessels, for their colours.
        look: Gives what a moment's picture needs.
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
        frame, ids, half_plane, image_size = look(moment)
        place = f"{frame.camera}, {frame.timestamp} s, detector {frame.state}"
        draw.text((x, y), moment.caption, fill=palette.INK, font=font(18))
        draw.text((x, y + 22), place, fill=(110, 110, 110), font=font(14))
        sheet.paste(_panel(moment, frame, ids, half_plane, image_size, vessels), (x, y + CAPTION_PX))
    _legend(draw, GAP_PX, height - FOOT_PX)
    return sheet


def _panel(
    moment: Moment,
    frame: Frame,
    ids: NDArray[np.uint32] | None,
    half_plane: Array,
    image_size: tuple[int, int],
    vessels: tuple[str, ...],
) -> Image.Image:
    window = Window.around(moment.focus_px, image_size, PANEL_PX)
    picture = background(window, half_plane, ids)
    draw_frame(picture, window, frame, vessels)
    inset_size = INSET_PX, round(INSET_PX * image_size[1] / image_size[0])
    whole = Window(0.0, 0.0, INSET_PX / image_size[0], inset_size)
    inset = background(whole, half_plane, None)
    draw = ImageDraw.Draw(inset)
    shown = np.array([window.x, window.y, *(window.to_picture(np.zeros(2)) * 0)])
    shown[2:] = shown[:2] + np.array(PANEL_PX) / window.scale
    draw.rectangle(tuple((shown * whole.scale).tolist()), outline=palette.ALARM, width=1)
    for i in range(len(frame.truth)):
        x, y = (frame.truth.full_boxes_px[i].reshape(2, 2).mean(axis=0) * whole.scale).tolist()
        draw.ellipse((x - 1.5, y - 1.5, x + 1.5, y + 1.5), fill=palette.VESSELS[3])
    draw.rectangle((0, 0, inset_size[0] - 1, inset_size[1] - 1), outline=palette.PAPER)
    picture.paste(inset, (PANEL_PX[0] - inset_size[0] - 8, PANEL_PX[1] - inset_size[1] - 8))
    return picture


def _legend(draw: ImageDraw.ImageDraw, x: int, y: int) -> None:
    entries = (
        (palette.TRUTH, "truth (dashed: whole silhouette)"),
        (palette.VESSELS[0], "detection, in its vessel's colour"),
        (palette.ALARM, "missed (solid) or false positive (dashed)"),
    )
    for colour, text in entries:
        draw.rectangle((x, y + 6, x + 26, y + 20), fill=palette.SEA, outline=colour, width=3)
        draw.text((x + 34, y + 4), text, fill=palette.INK, font=font(15))
        x += 54 + int(draw.textlength(text, font=font(15)))
