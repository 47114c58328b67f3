"""What is behind everything in a shaded picture: a sea with ripples and a sky, both by the direction that a pixel looks.

For illustration: the ripples are not the waves that move the vessels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from modsim3d.camera import Intrinsics
from modsim3d.frames import Array
from modsim3d.view.look import Look
from modsim3d.view.window import Window

Floats = NDArray[np.float32]

GRID_PX = 16
"""Directions through a lens are found at every such pixel, and between them by cubic interpolation."""
TILE, TILE_SEED = 512, 7
RIPPLE_PX = 5.0
"""Ripples are drawn at least about as large, whatever their distance."""
RIPPLE_M = 0.4
"""And no smaller than this."""
FOG_DEPTH_M = 150.0
"""Height of the layer of fog, through which the sky is seen."""
WATER_REFLECTS = 0.02
"""Share of the light that water reflects when one looks straight down (n = 1.33)."""
ROUGHNESS = 0.12
"""Waves turn a part of the sea towards who looks along it, so that it never is a perfect mirror."""


@dataclass(frozen=True)
class Palette:
    """Colours of a time of day, sRGB from 0 to 1."""

    zenith: tuple[float, float, float]
    horizon: tuple[float, float, float]
    water: tuple[float, float, float]
    fog: tuple[float, float, float]


DAY = Palette((0.30, 0.50, 0.75), (0.80, 0.88, 0.93), (0.03, 0.15, 0.22), (0.80, 0.83, 0.85))
NIGHT = Palette((0.015, 0.025, 0.06), (0.10, 0.13, 0.20), (0.008, 0.015, 0.03), (0.13, 0.14, 0.17))


@dataclass(frozen=True, eq=False)
class Rays:
    """Where the pixels of a window look.

    Attributes:
        camera: Unit vectors in CCF, shape (h, w, 3).
        inside: Whether a pixel is in the camera's image, shape (h, w).
    """

    camera: Floats
    inside: NDArray[np.bool_]

    @classmethod
    def of(cls, intrinsics: Intrinsics, window: Window) -> Rays:
        """The directions of a camera's pixels; the same for all of its pictures."""
        width, height = window.size
        columns = (np.arange(width) + 0.5) / window.scale + window.x
        rows = (np.arange(height) + 0.5) / window.scale + window.y
        size = intrinsics.image_size_px
        inside = np.logical_and.outer((rows > 0) & (rows < size[1]), (columns > 0) & (columns < size[0]))
        if intrinsics.distortion is None:
            pixels = np.stack(np.meshgrid(columns, rows), axis=-1)
            directions = intrinsics.unproject(pixels, np.ones((height, width)))
        else:
            directions = _through_lens(intrinsics, np.clip(columns, 0, size[0]), np.clip(rows, 0, size[1]))
        unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
        return cls(unit.astype(np.float32), inside)


def _through_lens(intrinsics: Intrinsics, columns: Array, rows: Array) -> Array:
    width, height = intrinsics.image_size_px
    x = np.linspace(0, width, max(4, width // GRID_PX))
    y = np.linspace(0, height, max(4, height // GRID_PX))
    grid = intrinsics.unproject(np.stack(np.meshgrid(x, y), axis=-1), np.ones((len(y), len(x))))
    place = np.meshgrid(rows / height * (len(y) - 1), columns / width * (len(x) - 1), indexing="ij")
    found = [map_coordinates(grid[..., axis], place, order=3, mode="nearest") for axis in (0, 1)]
    return np.stack([*found, np.ones_like(found[0])], axis=-1)


@dataclass(frozen=True, eq=False)
class Backdrop:
    """Sea and sky of one picture.

    Attributes:
        colour: sRGB from 0 to 1, shape (h, w, 3).
        sea: Which pixels show the sea, shape (h, w).
        mirror: Share of the light that the sea reflects there, shape (h, w).
        ripple: How ripples turn the sea, about −1 to 1, shape (h, w).
    """

    colour: Floats
    sea: NDArray[np.bool_]
    mirror: Floats
    ripple: Floats


def backdrop(rays: Rays, camera_R_world: Array, position_m: Array, focal_px: float, look: Look) -> Backdrop:
    """Sea and sky.

    Args:
        rays: Where the pixels look.
        camera_R_world: Rotation WCF to CCF, shape (3, 3).
        position_m: Of the camera in WCF, shape (3,).
        focal_px: Pixels of the picture for a radian, near its middle.
        look: Weather and time of day.
    """
    colours = NIGHT if look.night else DAY
    world = rays.camera @ camera_R_world.astype(np.float32)
    up = world[..., 2]
    above = max(float(position_m[2]), 0.1)
    sea = up <= 0
    down = np.maximum(-up, 1e-6)
    distance = above / down
    ripple = np.zeros(up.shape, np.float32)
    rows = sea.any(axis=1)
    if rows.any():
        ripple[rows] = _ripple(world[rows], distance[rows], position_m, focal_px)
    # Seen along the surface, what counts is how waves are turned; their slopes make up for the angle.
    turned = np.clip(down + ROUGHNESS * (1 + 0.45 * ripple), 0.02, 1.0)
    mirror = WATER_REFLECTS + (1 - WATER_REFLECTS) * (1 - turned) ** 5
    reflected = _sky(turned, colours)
    water = np.array(colours.water, np.float32) * (1 + 0.25 * ripple[..., None])
    colour = np.where(sea[..., None], water + mirror[..., None] * (reflected - water), _sky(up, colours))
    if look.extinction_per_m:
        # Through fog of some depth: along the sea all the way, upwards until it ends.
        through = np.where(sea, distance, (FOG_DEPTH_M - min(above, FOG_DEPTH_M - 1)) / np.maximum(np.abs(up), 1e-6))
        colour = fogged(colour, through, look)
    return Backdrop(colour.astype(np.float32), sea, mirror.astype(np.float32), ripple)


def fogged(colour: NDArray[np.floating], distance_m: NDArray[np.floating], look: Look) -> Floats:
    """Colours behind air: Koschmieder's law, C = C0 e^(−σ d) + A (1 − e^(−σ d)) with A the colour of fog.

    Args:
        colour: Shape (..., 3).
        distance_m: Shape (...).
        look: Has the visibility.
    """
    if not look.extinction_per_m:
        return colour.astype(np.float32)
    kept = np.exp(-look.extinction_per_m * distance_m)[..., None]
    air = np.array((NIGHT if look.night else DAY).fog, np.float32)
    out: Floats = (air + kept * (colour - air)).astype(np.float32)
    return out


def _sky(up: Floats, colours: Palette) -> Floats:
    """The sky at the sine of an elevation, shape (..., 3)."""
    share = (1 - np.exp(-3.5 * np.maximum(up, 0)))[..., None]
    low, high = np.array(colours.horizon, np.float32), np.array(colours.zenith, np.float32)
    sky: Floats = low + share * (high - low)
    return sky


def _ripple(world: Floats, distance: Floats, position_m: Array, focal_px: float) -> Floats:
    """A pattern that lies on the sea, as coarse as its distance asks for."""
    x = world[..., 0] * distance + np.float32(position_m[0])
    y = world[..., 1] * distance + np.float32(position_m[1])
    finest = np.log2(np.maximum(distance * (RIPPLE_PX / focal_px), RIPPLE_M))
    level = np.floor(finest)
    share = finest - level
    tile = _tile()
    out = np.zeros(distance.shape, np.float32)
    for step, weight in ((0, 1 - share), (1, share)):
        cells = np.exp2(-(level + step)) * 4  # a tile's longest waves are some cells long
        i, j = (np.floor(axis * cells).astype(np.int64) % TILE for axis in (x, y))
        out += weight * tile[i, j]
    return out


@cache
def _tile() -> Floats:
    """Smooth noise that repeats without a seam, its crests across w1 and w2 alike; standard deviation 0.5."""
    rng = np.random.default_rng(TILE_SEED)
    frequency = np.hypot(np.fft.fftfreq(TILE)[:, None], np.fft.fftfreq(TILE))
    band = np.exp(-(((frequency - 0.09) / 0.06) ** 2))
    noise = np.fft.ifft2(np.fft.fft2(rng.standard_normal((TILE, TILE))) * band).real
    tile: Floats = (0.5 * noise / noise.std()).astype(np.float32)
    return tile
