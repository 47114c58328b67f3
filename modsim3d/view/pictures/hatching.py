"""Hidden parts of vessels, hatched in their colours over what hides them."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw

from modsim3d.arrays import Mask
from modsim3d.render.id_pass import Ids, Region
from modsim3d.view.palette import vessel_colour
from modsim3d.view.pictures.solids import Solids
from modsim3d.view.pictures.window import Window

STRIPE_PX = 4.0


def hatch_hidden(picture: Image.Image, window: Window, solids: Solids, ids: Ids, unit: float) -> None:
    """Hatch each vessel where something else is in front of it.

    `ids` is occluder + 1 at each of the picture's pixels, shape (h, w). `unit` is 1 in a picture of nominal width.
    """
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
        picture.paste(vessel_colour(occluder), (region.x, region.y), mask)


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
