"""ID buffers as files, and the picture of a vessel on which two of them differ."""

from pathlib import Path

import numpy as np
from PIL import Image

from modsim3d.core.arrays import Mask
from modsim3d.core.errors import ModsimError
from modsim3d.io.atomic_write import encoded, written_whole
from modsim3d.render.id_pass import AnyIdRenderer, Ids
from modsim3d.scene.sight import IdImage
from modsim3d.view import palette
from modsim3d.view.palette import Colour
from modsim3d.view.pictures.canvas import Box, Canvas, Label, Window, draw_labels, font, text_size
from modsim3d.view.pictures.frame_picture import hatch_hidden
from modsim3d.view.pictures.legend import letters
from modsim3d.view.pictures.plain import Solids, background

MAX_IN_PNG = 2**16 - 1
GAP_PX, MIN_SIDE_PX = 4, 200


def write_id_buffer(image: IdImage, path: Path) -> None:
    """Write IDs as NumPy's `.npy`, or as a grey PNG of 16 bits, whose values they are.
    Raises ModsimError for an ID that is too large for a PNG."""
    if path.suffix.lower() == ".npy":
        with written_whole(path) as partial, partial.open("wb") as file:
            np.save(file, image.ids)
        return
    if int(image.ids.max(initial=0)) > MAX_IN_PNG:
        raise ModsimError(f"{path}: a PNG holds IDs up to {MAX_IN_PNG}; give --out a name that ends in .npy")
    with written_whole(path) as partial:
        partial.write_bytes(encoded(image.ids.astype(np.uint16)))


def write_difference(masks: tuple[Mask, Mask], path: Path) -> None:
    """Write the pixels of a vessel in the truth, as they were drawn, and where they differ, side by side as a PNG."""
    truth, drawn = masks
    gap = np.full((len(truth), GAP_PX, 3), palette.PAPER, dtype=np.uint8)
    panels = [np.where(mask[..., None], palette.VESSELS[2], (0, 0, 0)) for mask in (truth, drawn, truth ^ drawn)]
    picture = np.concatenate([panels[0], gap, panels[1], gap, panels[2]], axis=1).astype(np.uint8)
    scale = max(1, -(-MIN_SIDE_PX // max(len(truth), 1)))
    with written_whole(path) as partial:
        partial.write_bytes(encoded(np.kron(picture, np.ones((scale, scale, 1), dtype=np.uint8))))


# ---- ID maps ----

SEA: Colour = (24, 28, 32)
SKY: Colour = (48, 54, 60)


def ids_picture(
    solids: Solids, window: Window, id_renderer: AnyIdRenderer, nominal_width_px: int | None = None
) -> Image.Image:
    """The ID at the centre of each pixel of a window, with what is hidden hatched over what hides it.
    Lines and text are meant for a picture of the nominal width, or else of the window's."""
    picture = background(window, solids.sea_half_plane, solids.intrinsics.image_size_px, SEA, SKY)
    if not len(solids.occluders):
        return picture
    ids = solids.ids(window, id_renderer)
    rows, columns = np.flatnonzero(ids.any(axis=1)), np.flatnonzero(ids.any(axis=0))
    if not len(rows):
        return picture
    left, top, right, bottom = int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1
    shown = ids[top:bottom, left:right]
    vessels, names = len(solids.extents_m), [obstacle.name for obstacle in solids.sight.obstacles]
    colours = palette.owner_colours(vessels, names, solids.own_ships)
    table = np.zeros((int(shown.max()) + 1, 3), dtype=np.uint8)
    for occluder in np.unique(solids.occluders).tolist():
        if occluder + 1 < len(table):
            table[occluder + 1] = colours[occluder]
    patch = np.array(picture.crop((left, top, right, bottom)))
    patch[shown > 0] = table[shown[shown > 0]]
    picture.paste(Image.fromarray(patch), (left, top))
    canvas = Canvas(picture, nominal_width_px)
    hatch_hidden(picture, window, solids, ids, canvas.unit)
    _mark(canvas, shown, left, top, vessels, colours)
    return picture


def _mark(canvas: Canvas, ids: Ids, left: int, top: int, vessels: int, colours: list[Colour]) -> None:
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
            beside.append(Label(boxes[-1], text, colours[index]))
            continue
        x = left + int(columns[len(columns) // 2])
        middle = np.flatnonzero(here[:, x - left])
        y = top + int(middle[len(middle) // 2])
        at = (x - (x0 + x1) / 2, y - (y0 + y1) / 2)
        canvas.draw.text(at, text, fill=(255, 255, 255), font=font(size), stroke_width=2, stroke_fill=(0, 0, 0))
    draw_labels(canvas, beside, boxes)
