"""A picture of boxes that sources disagree on, over the ID image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from modsim3d.frames import Array
from modsim3d.view import palette
from modsim3d.view.panel import Window, background, font, outline_box

SIZE_PX = (960, 540)
KEY_PX = 34
STYLES = {  # box: colour, dashed, width
    "rendered full": (palette.TRUTH, False, 1),
    "analytic full": (palette.VESSELS[1], True, 2),
    "rendered visible": (palette.VESSELS[3], False, 3),
    "analytic visible": (palette.VESSELS[0], True, 3),
    "rectangles visible": (palette.ALARM, True, 3),
}


def comparison_picture(
    boxes_px: Mapping[str, Sequence[float]], sea_half_plane: Array, ids: NDArray[np.uint32]
) -> Image.Image:
    """The boxes of a case over the ID image, with a key.

    Args:
        boxes_px: Name of a box → x_min, y_min, x_max, y_max; NaN where there is none.
        sea_half_plane: (a, b, c) of the horizon.
        ids: Vessel index + 1 at each pixel of the whole image.
    """
    x0, y0, x1, y1 = boxes_px["rendered full"]
    margin = 0.6 * max(x1 - x0, (y1 - y0) * SIZE_PX[0] / SIZE_PX[1], 24.0)
    width = x1 - x0 + margin
    left, top = (x0 + x1 - width) / 2, (y0 + y1 - width * SIZE_PX[1] / SIZE_PX[0]) / 2
    window = Window(left, top, SIZE_PX[0] / width, SIZE_PX)
    picture = Image.new("RGB", (SIZE_PX[0], SIZE_PX[1] + KEY_PX), palette.PAPER)
    picture.paste(background(window, sea_half_plane, ids), (0, KEY_PX))
    shown = picture.crop((0, KEY_PX, *picture.size))
    draw = ImageDraw.Draw(shown)
    for name, (colour, dashed, line) in STYLES.items():
        box = np.array(boxes_px[name], dtype=float)
        if not np.isnan(box).any():
            outline_box(draw, window, box, colour, line, dashed=dashed)
    picture.paste(shown, (0, KEY_PX))
    _key(ImageDraw.Draw(picture))
    return picture


def _key(draw: ImageDraw.ImageDraw) -> None:
    x = 8
    for name, (colour, dashed, _) in STYLES.items():
        draw.rectangle((x, 9, x + 22, 24), fill=palette.SEA)
        draw.line((x + 3, 17, x + (9 if dashed else 19), 17), fill=colour, width=3)
        if dashed:
            draw.line((x + 13, 17, x + 19, 17), fill=colour, width=3)
        draw.text((x + 28, 8), name, fill=palette.INK, font=font(14))
        x += 42 + int(draw.textlength(name, font=font(14)))
