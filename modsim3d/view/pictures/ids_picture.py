"""ID maps: who is front-most at each pixel, vessels in their colours with numbers, obstacles in greys with letters."""

from __future__ import annotations

import numpy as np
from PIL import Image

from modsim3d.render.id_pass import Ids
from modsim3d.render.plain_ids import AnyIdRenderer
from modsim3d.view.palette import Colour, obstacle_colour, vessel_colour
from modsim3d.view.pictures.canvas import Canvas, font, text_size
from modsim3d.view.pictures.hatching import hatch_hidden
from modsim3d.view.pictures.labels import Label, draw_labels
from modsim3d.view.pictures.legend import letters
from modsim3d.view.pictures.plain import background
from modsim3d.view.pictures.solids import Solids
from modsim3d.view.pictures.window import Box, Window

SEA: Colour = (24, 28, 32)
SKY: Colour = (48, 54, 60)


def ids_picture(
    solids: Solids, window: Window, id_renderer: AnyIdRenderer, nominal_width_px: int | None = None
) -> Image.Image:
    """The ID at the centre of each pixel of a window, with what is hidden hatched over what hides it.

    Lines and text are meant for a picture of the nominal width, or else of the window's.
    """
    picture = background(window, solids.sea_half_plane, solids.intrinsics.image_size_px, SEA, SKY)
    if not len(solids.occluders):
        return picture
    ids = solids.ids(window, id_renderer)
    rows, columns = np.flatnonzero(ids.any(axis=1)), np.flatnonzero(ids.any(axis=0))
    if not len(rows):
        return picture
    left, top, right, bottom = int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1
    shown = ids[top:bottom, left:right]
    vessels = len(solids.extents_m)
    table = np.zeros((int(shown.max()) + 1, 3), dtype=np.uint8)
    for occluder in np.unique(solids.occluders).tolist():
        if occluder + 1 < len(table):
            table[occluder + 1] = _colour(occluder, vessels)
    patch = np.array(picture.crop((left, top, right, bottom)))
    patch[shown > 0] = table[shown[shown > 0]]
    picture.paste(Image.fromarray(patch), (left, top))
    canvas = Canvas(picture, nominal_width_px)
    hatch_hidden(picture, window, solids, ids, canvas.unit)
    _mark(canvas, shown, left, top, vessels)
    return picture


def _mark(canvas: Canvas, ids: Ids, left: int, top: int, vessels: int) -> None:
    """Write each vessel's number and each obstacle's letter on what is seen of it, or beside it."""
    size = max(9, round(canvas.text_px * 0.9))
    boxes: list[Box] = []
    beside: list[Label] = []
    for value in np.unique(ids[ids > 0]).tolist():
        index = value - 1
        text = str(value) if index < vessels else letters(index - vessels)
        here = ids == value
        by_row, by_column = here.sum(axis=1), here.sum(axis=0)
        rows, every_column = np.flatnonzero(by_row), np.flatnonzero(by_column)
        boxes.append((left + every_column[0], top + rows[0], left + every_column[-1] + 1.0, top + rows[-1] + 1.0))
        columns = np.flatnonzero(here[int(np.argmax(by_row))])
        x0, y0, x1, y1 = text_size(text, size)
        if len(columns) < x1 - x0 + 4 or by_column.max() < y1 - y0 + 4:
            beside.append(Label(boxes[-1], text, _colour(index, vessels)))
            continue
        x = left + int(columns[len(columns) // 2])
        middle = np.flatnonzero(here[:, x - left])
        y = top + int(middle[len(middle) // 2])
        at = (x - (x0 + x1) / 2, y - (y0 + y1) / 2)
        canvas.draw.text(at, text, fill=(255, 255, 255), font=font(size), stroke_width=2, stroke_fill=(0, 0, 0))
    draw_labels(canvas, beside, boxes)


def _colour(occluder: int, vessels: int) -> Colour:
    return vessel_colour(occluder) if occluder < vessels else obstacle_colour(occluder - vessels)
