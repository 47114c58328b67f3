"""A picture of what sources disagree on: all their boxes, and the pixels that differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import shapely
from numpy.typing import NDArray
from PIL import Image

from modsim3d.arrays import Array, Mask
from modsim3d.render.plain_ids import AnyIdRenderer
from modsim3d.view import palette
from modsim3d.view.palette import Colour
from modsim3d.view.pictures.canvas import Canvas, font
from modsim3d.view.pictures.plain import background, occluder_colour
from modsim3d.view.pictures.solids import Solids
from modsim3d.view.pictures.window import Window

SIZE_PX = (960, 540)
KEY_PX, LINE_PX = 60, 26
STYLES = {  # box: colour, dashed, weight
    "rendered full": (palette.TRUTH, False, 0.5),
    "analytic full": (palette.VESSELS[1], True, 1.0),
    "rendered visible": (palette.VESSELS[3], False, 1.5),
    "analytic visible": (palette.VESSELS[0], True, 1.5),
    "rectangles visible": (palette.ALARM, True, 1.5),
}
BOTH: Colour = (150, 158, 164)
PIXELS = (
    ("pixels of both", BOTH),
    ("of the rendered source only", palette.ALARM),
    ("of the {region} only", palette.VESSELS[2]),
)


def comparison_picture(
    boxes_px: Mapping[str, Sequence[float]],
    vessel: int,
    solids: Solids,
    exact: shapely.Geometry,
    id_renderer: AnyIdRenderer,
    region: str = "exact region",
) -> Image.Image:
    """The boxes of a case and what each source sees of its vessel, with a key.

    Args:
        boxes_px: Name of a box → x_min, y_min, x_max, y_max; NaN where there is none.
        vessel: Index into the scene's vessels.
        solids: What stands before the camera.
        exact: What is seen of the vessel, as a region of the image.
        id_renderer: Renders ID buffers.
        region: What to call it in the key.
    """
    x0, y0, x1, y1 = boxes_px["rendered full"]
    width = 1.6 * max(x1 - x0, (y1 - y0) * SIZE_PX[0] / SIZE_PX[1], 24.0)
    left, top = (x0 + x1 - width) / 2, (y0 + y1 - width * SIZE_PX[1] / SIZE_PX[0]) / 2
    window = Window(left, top, SIZE_PX[0] / width, SIZE_PX)
    image_size = solids.intrinsics.image_size_px
    ids = solids.ids(Window(0.0, 0.0, 1.0, image_size), id_renderer)
    differing = differing_pixels(ids == vessel + 1, exact)
    shown = background(window, solids.sea_half_plane, image_size)
    _paint_pixels(shown, window, ids, differing, len(solids.extents_m))
    canvas = Canvas(shown, 1280)
    for ring in _rings(exact):
        corners = window.to_picture(ring)
        canvas.segments(np.stack([corners[:-1], corners[1:]], axis=1), palette.WHITE, 0.5)
    for name, (colour, dashed, weight) in STYLES.items():
        box = np.array(boxes_px[name], dtype=np.float64)
        if not np.isnan(box).any():
            (canvas.dashed_box if dashed else canvas.box)(window.corners(box), colour, weight)
    picture = Image.new("RGB", (SIZE_PX[0], SIZE_PX[1] + KEY_PX), palette.PAPER)
    picture.paste(shown, (0, KEY_PX))
    _key(Canvas(picture, 1280), [int((differing == i + 1).sum()) for i in range(len(PIXELS))], region)
    return picture


def differing_pixels(seen: Mask, exact: shapely.Geometry) -> NDArray[np.uint8]:
    """Which source each pixel of an image belongs to: 0 neither, 1 both, 2 the first only, 3 the second only.

    Args:
        seen: Pixels that the rendered source saw, shape (h, w).
        exact: The exact region; a pixel belongs to it if its centre does.
    """
    height, width = seen.shape
    inside = np.zeros(seen.shape, dtype=bool)
    if not exact.is_empty:
        x0, y0, x1, y1 = exact.bounds
        columns = np.arange(max(int(x0) - 1, 0), min(int(x1) + 2, width))
        rows = np.arange(max(int(y0) - 1, 0), min(int(y1) + 2, height))
        shapely.prepare(exact)
        inside[np.ix_(rows, columns)] = shapely.contains_xy(exact, columns[None, :] + 0.5, rows[:, None] + 0.5)
    return np.where(seen & inside, 1, np.where(seen, 2, np.where(inside, 3, 0))).astype(np.uint8)


def _paint_pixels(
    picture: Image.Image, window: Window, ids: NDArray[np.uint32], differing: NDArray[np.uint8], vessels: int
) -> None:
    """The other vessels darkened, the case's pixels by their source."""
    width, height = window.size
    columns = np.floor(window.x + (np.arange(width) + 0.5) / window.scale).astype(int)
    rows = np.floor(window.y + (np.arange(height) + 0.5) / window.scale).astype(int)
    i = np.flatnonzero((rows >= 0) & (rows < ids.shape[0]))
    j = np.flatnonzero((columns >= 0) & (columns < ids.shape[1]))
    here = np.ix_(rows[i], columns[j])
    who, what = ids[here], differing[here]
    pixels = np.array(picture)
    part = pixels[np.ix_(i, j)]
    for value in np.unique(who[who > 0]).tolist():
        part[who == value] = palette.darker(occluder_colour(value - 1, vessels))
    for index, (_, colour) in enumerate(PIXELS):
        part[what == index + 1] = colour
    pixels[np.ix_(i, j)] = part
    picture.paste(Image.fromarray(pixels))


def _rings(region: shapely.Geometry) -> list[Array]:
    """The boundary of a region as closed lines, each of shape (k, 2)."""
    lines = shapely.get_parts(shapely.boundary(region))
    return [shapely.get_coordinates(line) for line in lines]


def _key(canvas: Canvas, counts: Sequence[int], region: str) -> None:
    x = 8
    for name, (colour, dashed, weight) in STYLES.items():
        canvas.draw.rectangle((x, 6, x + 24, 24), fill=palette.SEA)
        (canvas.dashed_box if dashed else canvas.box)((x + 3, 9, x + 22, 22), colour, weight)
        x = _text(canvas, x, 6, name)
    x = 8
    for (name, colour), count in zip(PIXELS, counts, strict=True):
        canvas.draw.rectangle((x, 6 + LINE_PX, x + 24, 24 + LINE_PX), fill=colour)
        x = _text(canvas, x, 6 + LINE_PX, f"{count} {name.format(region=region)}")


def _text(canvas: Canvas, x: int, y: int, text: str) -> int:
    """Write beside a sample; where the next one goes."""
    canvas.draw.text((x + 30, y + 1), text, fill=palette.INK, font=font(14))
    return x + 46 + int(canvas.draw.textlength(text, font=font(14)))
