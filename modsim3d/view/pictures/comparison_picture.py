"""A picture of a vessel on which sources of truth differ: all their boxes, and the pixels that differ."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from PIL import Image

from modsim3d.core.arrays import Mask
from modsim3d.render.id_pass import AnyIdRenderer
from modsim3d.view import palette
from modsim3d.view.palette import Colour
from modsim3d.view.pictures.canvas import Box, Canvas, Window, font
from modsim3d.view.pictures.plain import Solids, background, occluder_colour

SIZE_PX = (960, 540)
KEY_PX, LINE_PX, TEXT_PX = 66, 30, 18


@dataclass(frozen=True)
class SourceBoxes:
    """A vessel's boxes by each source of truth: x_min, y_min, x_max, y_max in pixels, NaN where there is none."""

    rendered_full: Box
    rendered_visible: Box
    analytic_full: Box
    analytic_visible: Box
    rectangles_visible: Box


@dataclass(frozen=True)
class BoxStyle:
    """Style of one of the boxes, and its name in the key."""

    name: str
    box: Callable[[SourceBoxes], Box]
    colour: Colour
    weight: float
    dashed: bool = True

    def draw(self, canvas: Canvas, box: Box) -> None:
        """Draw the box, in pixels of the picture."""
        (canvas.dashed_box if self.dashed else canvas.box)(box, self.colour, self.weight)


Styles = tuple[BoxStyle, ...]  # of the boxes that a picture of a vessel shows
FULL: Styles = (
    BoxStyle("whole silhouette: rendered", lambda boxes: boxes.rendered_full, palette.WHITE, 1.5, dashed=False),
    BoxStyle("analytic", lambda boxes: boxes.analytic_full, palette.VESSELS[5], 1.5),
)
VISIBLE: Styles = (
    BoxStyle("visible part: rendered", lambda boxes: boxes.rendered_visible, palette.WHITE, 1.5, dashed=False),
    BoxStyle("analytic", lambda boxes: boxes.analytic_visible, palette.VESSELS[5], 1.5),
)
RULE: Styles = (*VISIBLE, BoxStyle("rectangle rule", lambda boxes: boxes.rectangles_visible, palette.ALARM, 2.0))
BOTH: Colour = (150, 158, 164)
PIXELS = (
    ("pixels rendered and in the {region}", BOTH),
    ("rendered only", palette.ALARM),
    ("in that region only", palette.VESSELS[2]),
)


def comparison_picture(
    boxes: SourceBoxes,
    vessel: int,
    solids: Solids,
    exact: shapely.Geometry,
    id_renderer: AnyIdRenderer,
    region: str = "exact region",
    styles: Styles = VISIBLE,
) -> Image.Image:
    """Boxes of a vessel, by its index in the scene, and the pixels that each source sees of it, with a key. `exact` is
    what is seen of the vessel, as a region of the image, `region` its name in the key."""
    drawn = [(style, box) for style in styles if not np.isnan(box := np.array(style.box(boxes))).any()]
    shown_px = np.array([box for _, box in drawn] or [np.array(boxes.rendered_full)])
    (x0, y0), (x1, y1) = shown_px[:, :2].min(axis=0).tolist(), shown_px[:, 2:].max(axis=0).tolist()
    width = 1.8 * max(x1 - x0, (y1 - y0) * SIZE_PX[0] / SIZE_PX[1], 24.0)
    left, top = (x0 + x1 - width) / 2, (y0 + y1 - width * SIZE_PX[1] / SIZE_PX[0]) / 2
    window = Window(left, top, SIZE_PX[0] / width, SIZE_PX)
    image_size = solids.intrinsics.image_size_px
    ids = solids.ids(Window(0.0, 0.0, 1.0, image_size), id_renderer)
    differing = differing_pixels(ids == vessel + 1, exact)
    shown = background(window, solids.sea_half_plane, image_size)
    _paint_pixels(shown, window, ids, differing, solids)
    canvas = Canvas(shown, 1280)
    for ring in shapely.get_parts(shapely.boundary(exact)):
        corners = window.to_picture(shapely.get_coordinates(ring))
        canvas.segments(np.stack([corners[:-1], corners[1:]], axis=1), palette.WHITE, 0.5)
    for style, box in drawn:
        style.draw(canvas, window.corners(box))
    picture = Image.new("RGB", (SIZE_PX[0], SIZE_PX[1] + KEY_PX), palette.PAPER)
    picture.paste(shown, (0, KEY_PX))
    _key(Canvas(picture, 1280), styles, [int((differing == i + 1).sum()) for i in range(len(PIXELS))], region)
    return picture


def boxes_that_differ(boxes: SourceBoxes) -> Styles:
    """The boxes in which the rendered and the analytic source differ most, the full or the visible ones."""
    full = np.abs(np.subtract(boxes.rendered_full, boxes.analytic_full))
    visible = np.abs(np.subtract(boxes.rendered_visible, boxes.analytic_visible))
    return FULL if np.nan_to_num(full).max() > np.nan_to_num(visible).max() else VISIBLE


def differing_pixels(seen: Mask, exact: shapely.Geometry) -> NDArray[np.uint8]:
    """For each pixel 0 if neither source has it, 1 if both, 2 if the rendered one only, 3 if the region only.
    A pixel belongs to the exact region if its centre does. `seen` and the result have the shape (h, w)."""
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
    picture: Image.Image, window: Window, ids: NDArray[np.uint32], differing: NDArray[np.uint8], solids: Solids
) -> None:
    """Paint the other vessels darker, and each pixel of the case by the sources that have it."""
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
        part[who == value] = palette.darker(occluder_colour(value - 1, solids))
    for index, (_, colour) in enumerate(PIXELS):
        part[what == index + 1] = colour
    pixels[np.ix_(i, j)] = part
    picture.paste(Image.fromarray(pixels))


def _key(canvas: Canvas, styles: Styles, counts: Sequence[int], region: str) -> None:
    """Explain the boxes, and in a second line the pixels that there are."""
    x = 8
    for style in styles:
        canvas.draw.rectangle((x, 6, x + 32, 28), fill=palette.SEA)
        style.draw(canvas, (x + 4, 10, x + 29, 25))
        x = _text(canvas, x, 6, style.name)
    x = 8
    for (name, colour), count in zip(PIXELS, counts, strict=True):
        if count:
            canvas.draw.rectangle((x, 6 + LINE_PX, x + 32, 28 + LINE_PX), fill=colour)
            x = _text(canvas, x, 6 + LINE_PX, f"{count:,} {name.format(region=region)}")


def _text(canvas: Canvas, x: int, y: int, text: str) -> int:
    """Write beside a sample of the key; return the column of the next sample."""
    canvas.draw.text((x + 40, y), text, fill=palette.INK, font=font(TEXT_PX))
    return x + 64 + int(canvas.draw.textlength(text, font=font(TEXT_PX)))
