"""The plain style of Jessen & Mohr (2023), Figures 9.3 and 9.4: a dark sea, a light sky, a horizon between them."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw

from modsim3d.arrays import Array
from modsim3d.render.id_pass import Region
from modsim3d.render.plain_ids import AnyIdRenderer
from modsim3d.view import palette
from modsim3d.view.palette import Colour
from modsim3d.view.pictures.canvas import Canvas
from modsim3d.view.pictures.solids import Solids
from modsim3d.view.pictures.window import Window

SMOOTH_SAMPLES = 2
"""Vessels drawn this much larger and shrunk have edges without steps."""


def background(
    window: Window,
    sea_half_plane: Array,
    image_size_px: tuple[int, int],
    sea: Colour = palette.SEA,
    sky: Colour = palette.SKY,
) -> Image.Image:
    """Sea and sky in a window; paper outside the camera's image.

    The sea is where a x + b y + c ≥ 0 in pixels of the image, with (a, b, c) the sea half plane, shape (3,).
    """
    picture = Image.new("RGB", window.size, palette.PAPER)
    draw = ImageDraw.Draw(picture)
    width, height = window.size
    corners = window.to_picture(np.array([[0, 0], [image_size_px[0], image_size_px[1]]], dtype=np.float64))
    (left, top), (right, bottom) = np.clip(np.rint(corners), 0, (width, height)).tolist()
    if right <= left or bottom <= top:
        return picture
    draw.rectangle((left, top, right - 1, bottom - 1), fill=sky)
    # A pixel is of the sea if its centre is; whole pixels count from their own corner here.
    frame = np.array([(left, top), (right - 1, top), (right - 1, bottom - 1), (left, bottom - 1)])
    polygon = below_horizon(frame, (frame + 0.5) / window.scale + (window.x, window.y), sea_half_plane)
    if len(polygon):
        draw.polygon([tuple(point) for point in np.rint(polygon).tolist()], fill=sea)
    return picture


def below_horizon(polygon: Array, polygon_px: Array, sea_half_plane: Array) -> Array:
    """The part of a convex polygon on the sea's side of the horizon, shape (m, 2); empty if there is no sea in it.

    Args:
        polygon: Its corners in any affine coordinates of the image, shape (n, 2).
        polygon_px: The same corners in pixels of the image, shape (n, 2).
        sea_half_plane: (a, b, c), see `background`, shape (3,).
    """
    value = polygon_px @ sea_half_plane[:2] + sea_half_plane[2]
    points = []
    for i in range(len(polygon)):
        if (value[i - 1] >= 0) != (value[i] >= 0):
            share = value[i - 1] / (value[i - 1] - value[i])
            points.append(polygon[i - 1] + share * (polygon[i] - polygon[i - 1]))
        if value[i] >= 0:
            points.append(polygon[i])
    return np.array(points).reshape(-1, 2)


def draw_horizon(canvas: Canvas, window: Window, sea_half_plane: Array, image_size_px: tuple[int, int]) -> None:
    """Draw a line where the sea half plane, shape (3,), ends."""
    a, b, c = sea_half_plane
    if a == b == 0:
        return
    foot = -c * np.array([a, b])
    reach = 2.0 * sum(image_size_px) + float(np.abs(foot).max())
    along = np.array([-b, a]) * reach
    canvas.segments(window.to_picture(np.array([[foot - along, foot + along]])), palette.HORIZON, 0.5)


def fill_solids(
    picture: Image.Image,
    window: Window,
    solids: Solids,
    id_renderer: AnyIdRenderer,
    *,
    dim: float = 0.0,
    samples: int = SMOOTH_SAMPLES,
) -> None:
    """Fill the visible part of every vessel in a picture of a window, each side as bright as the light on it.

    Args:
        picture: The picture, which is changed.
        window: The part of the image that it shows.
        solids: The vessels and obstacles.
        id_renderer: Finds which side each pixel shows.
        dim: Share of black in all colours, so that boxes stand out.
        samples: Factor by which sides are drawn larger before they are shrunk.
    """
    triangles = solids.triangles
    if not len(triangles.row):
        return
    corners = window.to_picture(triangles.corners_px).reshape(-1, 2)
    region = Region.around(np.concatenate([corners.min(axis=0), corners.max(axis=0)]), window.size)
    if not region.width or not region.height:
        return
    faces = solids.faces(window, id_renderer, region, samples)
    vessels = len(solids.extents_m)
    colours = np.array([occluder_colour(occluder, vessels) for occluder in solids.occluders.tolist()])[triangles.row]
    table = np.zeros((len(colours) + 1, 4), dtype=np.uint8)
    table[1:, :3] = colours * (solids.light() * (1 - dim))[:, None]
    place = (region.x, region.y, region.x + region.width, region.y + region.height)
    patch = picture.crop(place).resize((region.width * samples, region.height * samples), Image.Resampling.NEAREST)
    # A pixel as one number is looked up four times as fast as three.
    under = np.frombuffer(patch.tobytes("raw", "RGBX"), dtype=np.uint32).reshape(faces.shape)
    pixels = np.where(faces > 0, table.view(np.uint32)[:, 0][faces], under)
    filled = Image.frombytes("RGB", patch.size, pixels.tobytes(), "raw", "RGBX")
    picture.paste(filled.reduce(samples), place)


def occluder_colour(occluder: int, vessels: int) -> Colour:
    """The colour of a vessel, or that of obstacles for an index beyond the vessels."""
    return palette.vessel_colour(occluder) if occluder < vessels else palette.OBSTACLE
