"""The background of a shaded picture: a sea with ripples and a sky, by the direction in which each pixel looks.
For illustration: the ripples are not the waves that move the vessels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from modsim3d.core.arrays import Array, Mask
from modsim3d.core.errors import ModsimError
from modsim3d.geometry.camera import Intrinsics
from modsim3d.view.pictures.canvas import Window

# ---- How a scene is to look ----

CONTRAST = 0.02  # the visibility is the distance at which a black thing keeps this contrast against the sky


@dataclass(frozen=True)
class RenderStyle:
    """Style in which a scene is drawn; weather only where it is shaded."""

    shaded: bool = False  # in light and shade, by pyrender
    visibility_m: float | None = None  # meteorological; clear air if None
    night: bool = False

    def __post_init__(self) -> None:
        """Check what the user gave."""
        if self.visibility_m is not None and not (0 < self.visibility_m < math.inf):
            given = f"--look fog:{self.visibility_m:g}"
            raise ModsimError(f"{given}: give a positive distance in metres, such as fog:800")
        if not self.shaded and (self.visibility_m is not None or self.night):
            weather = "night" if self.night else "fog"
            raise ModsimError(f"--look {weather} works in shaded pictures only: leave out plain")

    @property
    def extinction_per_m(self) -> float:
        """Share of the light that a metre of air takes: −ln 0.02 / V = 3.912 / V (Koschmieder, 1924)."""
        return 0.0 if self.visibility_m is None else -math.log(CONTRAST) / self.visibility_m

    @property
    def caption(self) -> str:
        """A line for the picture, so that nobody takes weather for a part of the simulation."""
        fog = [] if self.visibility_m is None else [f"visibility {self.visibility_m:,.0f} m"]
        weather = fog + (["night"] if self.night else [])
        return f"illustration: {', '.join(weather)}; not part of truth or detections" if weather else ""


PLAIN_STYLE = RenderStyle()

Floats = NDArray[np.float32]

GRID_PX = 16  # directions through a lens are found at every such pixel, and between them by cubic interpolation
TILE, TILE_SEED = 512, 7
TABLE = 8192
RIPPLE_PX, RIPPLE_M = 5.0, 0.4  # least size of ripples: roughly in the picture, at any distance, and in the world
FADE_M = 1000.0  # at this distance ripples are half as strong
FOG_DEPTH_M = 150.0  # height of the layer of fog, through which the sky is seen
WATER_REFLECTS = 0.02  # share of the light that water reflects when one looks straight down (n = 1.33)
ROUGHNESS = 0.12  # waves turn a part of the sea towards the camera, so that it never is a perfect mirror


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
    """Unit vectors in CCF of a window's pixels, shape (h, w, 3), and which are in the camera's image, shape (h, w)."""

    camera: Floats
    inside: Mask

    @classmethod
    def of(cls, intrinsics: Intrinsics, window: Window) -> Rays:
        """The directions of a camera's pixels, which are the same for all of its pictures."""
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
    found = [RectBivariateSpline(y, x, grid[..., axis])(rows, columns) for axis in (0, 1)]
    return np.stack([*found, np.ones_like(found[0])], axis=-1)


@dataclass(frozen=True, eq=False)
class Backdrop:
    """Sea and sky of one picture of h × w pixels."""

    colour: Floats  # sRGB from 0 to 1, shape (h, w, 3)
    sea: Mask  # which pixels show the sea, shape (h, w)
    mirror: Floats  # share of the light that the sea reflects there, shape (h, w)
    ripple: Floats  # strength of the ripples, about −1 to 1, shape (h, w)


def backdrop(rays: Rays, camera_R_world: Array, position_m: Array, focal_px: float, style: RenderStyle) -> Backdrop:
    """Sea and sky as a camera sees them with a rotation from WCF to CCF, shape (3, 3), at a position in WCF, shape
    (3,); `focal_px` pixels of the picture stand for a radian, near its middle."""
    up: Floats = (rays.camera.reshape(-1, 3) @ camera_R_world[:, 2].astype(np.float32)).reshape(rays.inside.shape)
    above = max(float(position_m[2]), 0.1)
    sea = up <= 0
    rows = np.flatnonzero(sea.any(axis=1))
    wet = slice(max(rows[0] - 1, 0), rows[-1] + 2) if len(rows) else slice(0, 0)
    down: Floats = np.maximum(-up, np.float32(1e-6))
    ripple, mirror = (np.zeros(up.shape, np.float32) for _ in range(2))
    world = rays.camera[wet] @ camera_R_world[:, :2].astype(np.float32)
    ripple[wet] = _ripple(world, above / down[wet], position_m, focal_px)
    # Seen along the surface, what counts is how waves are turned; their slopes make up for the angle.
    turned = _place(down[wet] + ROUGHNESS * (1 + 0.45 * ripple[wet]))
    colours, mirrors = _tables(style.night)
    place = _place(up) + TABLE  # the sky's colours stand behind the sea's
    place[wet] = np.where(sea[wet], turned, place[wet])
    colour = colours.take(place, axis=0)
    mirror[wet] = mirrors.take(turned)
    # A pixel on the horizon is part sea, part sky, so that the line has no steps.
    i, j = np.nonzero(np.abs(up[wet]) < 0.5 / focal_px)
    at = up[wet][i, j]
    share = 0.5 - at[:, None] * np.float32(focal_px)
    colour[wet][i, j] = colours[TABLE + _place(at)] * (1 - share) + colours[turned[i, j]] * share
    if style.extinction_per_m:
        # Through fog of some depth: along the sea all the way, upwards until it ends.
        through = np.where(sea, above / down, max(FOG_DEPTH_M - above, 1.0) / np.maximum(up, 1e-6))
        colour = fogged(colour, through, style)
    return Backdrop(colour, sea, mirror, ripple)


def _place(sine: Floats) -> NDArray[np.int32]:
    """Indices into the tables of the sines of angles, from 0 to 1."""
    return np.clip(sine * (TABLE - 1), 0, TABLE - 1).astype(np.int32)


@cache
def _tables(night: bool) -> tuple[Floats, Floats]:
    """Colours of sea and sky, (2 TABLE, 3), and the share that the sea mirrors, (TABLE,), by the sine of the angle."""
    colours = NIGHT if night else DAY
    sine = np.linspace(0, 1, TABLE, dtype=np.float32)
    low, high = np.array(colours.horizon, np.float32), np.array(colours.zenith, np.float32)
    sky: Floats = low + (1 - np.exp(-3.5 * sine))[:, None] * (high - low)
    mirror = (WATER_REFLECTS + (1 - WATER_REFLECTS) * (1 - sine) ** 5).astype(np.float32)  # Schlick (1994)
    water = np.array(colours.water, np.float32)
    return np.concatenate([water + mirror[:, None] * (sky - water), sky]), mirror


def fogged(colour: NDArray[np.floating], distance_m: NDArray[np.floating], style: RenderStyle) -> Floats:
    """Colours, shape (..., 3), behind distances of air in metres, shape (...).
    Koschmieder's law: C = C0 e^(−σ d) + A (1 − e^(−σ d)), with A the colour of fog."""
    if not style.extinction_per_m:
        return colour.astype(np.float32)
    kept = np.exp(-style.extinction_per_m * distance_m)[..., None]
    air = np.array((NIGHT if style.night else DAY).fog, np.float32)
    out: Floats = (air + kept * (colour - air)).astype(np.float32)
    return out


def _ripple(world: Floats, distance: NDArray[np.floating], position_m: Array, focal_px: float) -> Floats:
    """A pattern that lies on the sea, as coarse as its distance asks for."""
    x = world[..., 0] * distance + np.float32(position_m[0])
    y = world[..., 1] * distance + np.float32(position_m[1])
    finest = np.log2(np.maximum(distance * (RIPPLE_PX / focal_px), RIPPLE_M))
    level = np.floor(finest)
    share = finest - level
    cells = np.exp2(-level) * 4  # a tile's longest waves are some cells long
    out = (1 - share) * _tile_at(x * cells, y * cells)
    out += share * _tile_at(x * (cells / 2), y * (cells / 2))
    faded: Floats = (out / (1 + distance / FADE_M)).astype(np.float32)
    return faded


def _tile_at(x: Floats, y: Floats) -> Floats:
    """The tile, which repeats, at columns and rows of any size."""
    i, j = (np.floor(axis).astype(np.int32) & (TILE - 1) for axis in (x, y))
    return _tile().take(i * TILE + j)


@cache
def _tile() -> Floats:
    """Smooth noise that repeats without a seam, its crests across w1 and w2 alike; standard deviation 0.5."""
    rng = np.random.default_rng(TILE_SEED)
    frequency = np.hypot(np.fft.fftfreq(TILE)[:, None], np.fft.fftfreq(TILE))
    band = np.exp(-(((frequency - 0.09) / 0.06) ** 2))
    noise = np.fft.ifft2(np.fft.fft2(rng.standard_normal((TILE, TILE))) * band).real
    tile: Floats = (0.5 * noise / noise.std()).astype(np.float32)
    return tile
