"""The background of a shaded picture: a sea with waves and a sky, by the direction in which each pixel looks.
For illustration: truth and detections know no weather, and the waves hide nothing."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.interpolate import RectBivariateSpline

from modsim3d.core.arrays import Array, Mask
from modsim3d.core.errors import ModsimError
from modsim3d.geometry.camera import Intrinsics
from modsim3d.io.strict_text import load_yaml
from modsim3d.scene.scene import Scene
from modsim3d.view.pictures.canvas import Window
from modsim3d.view.pictures.layers import WEATHER
from modsim3d.world.floating_vessels import Sea, jonswap_sea

# ---- How a scene is to look ----

CONTRAST = 0.02  # the visibility is the distance at which a black thing keeps this contrast against the sky
FOG_BELOW_M = 1000.0  # a visibility that the WMO calls fog, above it haze
DRAWN_TO_RAD = 2.6  # direction of waves that only a look has
PERIOD_OF_METRE_S = 4.4  # peak period of drawn waves of 1 m whose period nobody gives: that of a steepness of 1/30


@dataclass(frozen=True)
class RenderStyle:
    """Style in which a scene is drawn; weather only where it is shaded."""

    shaded: bool = False  # in light and shade, by pyrender
    visibility_m: float | None = None  # meteorological; clear air if None
    overcast: bool = False
    rain: bool = False
    dusk: bool = False
    night: bool = False
    significant_height_m: float | None = None  # of the waves that are drawn; the scene's own if None
    by_state: bool = False  # whether the weather is that of the detector's state in each frame
    caption: str = ""  # a line for the picture, that says what weather is drawn
    enlarged: float = 1.0  # size of the caption, as a multiple of the usual one

    def __post_init__(self) -> None:
        """Check what the user gave."""
        if self.visibility_m is not None and not (0 < self.visibility_m < math.inf):
            given = f"--look fog:{self.visibility_m:g}"
            raise ModsimError(f"{given}: give a positive distance in metres, such as fog:800")

    def in_state(self, scene: Scene, state: str) -> RenderStyle:
        """This style in the weather of a performance state, if it asks for that."""
        if not (self.shaded and self.by_state):
            return self
        look = scene.look_of(state)
        if look is None:
            return replace(self, by_state=False, caption=WEATHER)
        style = replace(self, by_state=False, **look.model_dump())
        sea = style.sea(scene.waves.sea if scene.waves else None)
        waves = f", waves {4 * math.sqrt((sea.amplitudes_m**2).sum() / 2):.2g} m" if sea else ""
        return replace(style, caption=f"drawn as: {style.words}{waves}")

    def sea(self, own: Sea | None) -> Sea | None:
        """The waves that are drawn: of this style, else those of the scene; None for ripples alone."""
        height_m = self.significant_height_m
        return own if height_m is None else _waves_of(height_m) if height_m else None

    @property
    def dark(self) -> bool:
        """Whether vessels show their lights."""
        return self.dusk or self.night

    @property
    def sunny(self) -> bool:
        """Whether the sun is seen."""
        return not (self.night or self.overcast or self.rain)

    @property
    def extinction_per_m(self) -> float:
        """Share of the light that a metre of air takes: −ln 0.02 / V = 3.912 / V (Koschmieder, 1924)."""
        return 0.0 if self.visibility_m is None else -math.log(CONTRAST) / self.visibility_m

    @property
    def words(self) -> str:
        """The weather in words, such as `night, fog, 800 m`."""
        sight = self.visibility_m or 0.0
        air = f"{'fog' if sight < FOG_BELOW_M else 'haze'}, {sight:,.0f} m" if sight else ""
        if self.rain and air:
            air = f"visibility {sight:,.0f} m"
        time = "night" if self.night else "dusk" if self.dusk else ""
        sky = "rain" if self.rain else "overcast" if self.overcast else "" if air else "clear"
        return ", ".join(filter(None, (time, sky, air)))


PLAIN_STYLE = RenderStyle()


@cache
def _waves_of(height_m: float) -> Sea:
    """A sea of some significant height, as steep as a young sea is."""
    return jonswap_sea(height_m, PERIOD_OF_METRE_S * math.sqrt(height_m), DRAWN_TO_RAD, seed=0)


Floats = NDArray[np.float32]

GRID_PX = 16  # directions through a lens are found at every such pixel, and between them by cubic interpolation
TILE, TILE_SEED = 512, 7
TABLE = 8192
SKIES = Path(__file__).with_name("skies.yaml")
RIPPLE_PX, RIPPLE_M = 5.0, 0.4  # least size of ripples: roughly in the picture, at any distance, and in the world
FADE_M = 1000.0  # at this distance ripples are half as strong
FOG_DEPTH_M = 150.0  # height of the layer of fog, through which the sky is seen
WATER_REFLECTS = 0.02  # share of the light that water reflects when one looks straight down (n = 1.33)
ROUGHNESS = 0.12  # ripples turn a part of the sea towards the camera, so that it never is a perfect mirror
CREST_M = 0.8  # how far ripples shift crests, so that they are no straight lines
COARSE_PX = 4  # clouds and the sun's glow are found at every such pixel
CLOUD_FOOT = 0.12  # sine of the height at which clouds begin to crowd towards the horizon
SUN_SINE = {False: 0.76, True: 0.09}  # height of the sun by day, and at dusk
SUN_WAY = np.array([-0.537, 0.844])  # direction to the sun on the sea, as in plain pictures


Rgb = tuple[float, float, float]


class Palette(NamedTuple):
    """Colours of a sky and its sea, sRGB from 0 to 1."""

    zenith: Rgb
    horizon: Rgb
    water: Rgb
    fog: Rgb
    cloud: Rgb
    sun: Rgb = (0.0, 0.0, 0.0)


@cache
def palette_of(style: RenderStyle) -> Palette:
    """The colours of a style's weather."""
    time = "night" if style.night else "dusk" if style.dusk else "day"
    colours = load_yaml(SKIES, "skies")[f"grey {time}" if style.overcast or style.rain else time]
    return Palette(**{name: tuple(colour) for name, colour in colours.items()})


def sun_of(style: RenderStyle) -> Array:
    """The unit vector to the sun in the world, shape (3,)."""
    sine = SUN_SINE[style.dusk]
    return np.array([*(SUN_WAY * math.sqrt(1 - sine**2)), sine])


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
    coords = [RectBivariateSpline(y, x, grid[..., axis])(rows, columns) for axis in (0, 1)]
    return np.stack([*coords, np.ones_like(coords[0])], axis=-1)


class Backdrop:
    """Sea and sky of pictures of h × w pixels from one pose of a camera, with waves that move.

    Attributes:
        colour: sRGB from 0 to 1, shape (h, w, 3).
        sea: Which pixels show the sea, shape (h, w).
        ripple: Strength of the ripples, about −1 to 1, shape (h, w).
        wet: The rows in which there is sea; below they are r.
        from_camera_m: Places on the sea along w1 and w2 from the camera, each of shape (r, w).
        footprint_m: How much of the sea a pixel covers across its ray, shape (r, w).
        kept: Share of the sea's light that the air lets through, shape (r, w); None if all.
    """

    def __init__(
        self, rays: Rays, camera_R_world: Array, position_m: Array, focal_px: float, style: RenderStyle, sea: Sea | None
    ) -> None:
        """Look with a rotation from WCF to CCF, shape (3, 3), from a position in WCF, shape (3,); `focal_px` pixels of
        the picture stand for a radian, near its middle."""
        self.style, self._position_m, self.waves = style, position_m, sea
        above, turn = max(float(position_m[2]), 0.1), camera_R_world.astype(np.float32)
        self.colour, glow = _sky(rays.camera, turn, above, style)
        shape = rays.inside.shape
        self.sea, self.ripple = np.zeros(shape, bool), np.zeros(shape, np.float32)
        below = np.flatnonzero((rays.camera @ turn[:, 2] <= 0).any(axis=1))
        self.wet = wet = slice(max(below[0] - 1, 0), below[-1] + 2) if len(below) else slice(0, 0)
        world = rays.camera[wet] @ turn
        up = world[..., 2]
        self.sea[wet] = up <= 0
        down = np.maximum(-up, np.float32(1e-6))
        distance = above / down
        x, y = (world[..., axis] * distance for axis in (0, 1))
        self.from_camera_m, self.footprint_m = (x, y), distance / np.float32(focal_px)
        ripple = _ripple(x + np.float32(position_m[0]), y + np.float32(position_m[1]), distance, focal_px)
        self.ripple[wet] = ripple
        # Seen along the surface, what counts is how waves are turned; their slopes make up for the angle.
        self._sine = down + ROUGHNESS * (1 + 0.45 * ripple)
        if sea is not None:
            way = math.cos(sea.direction_rad), math.sin(sea.direction_rad)
            self._gain = world[..., 0] * np.float32(way[0]) + world[..., 1] * np.float32(way[1])
            # A pixel is long along its ray, and then covers many waves.
            footprint = self.footprint_m * (1 + np.abs(self._gain) / down)
            along = x * np.float32(way[0]) + y * np.float32(way[1])
            self._index = _index(along + CREST_M * ripple, footprint)
        glint = glow[wet] * (0.2 + np.maximum(1.6 * ripple, 0) ** 2)
        self._glinting = (glint > 1 / 255).nonzero()
        self._glint = glint[self._glinting]
        self.kept = np.exp(-style.extinction_per_m * distance) if style.extinction_per_m else None
        # A pixel on the horizon is part sea, part sky, so that the line has no steps.
        share = np.clip(0.5 + up * np.float32(focal_px), 0, 1)
        self._sky_at = share.nonzero()
        self._sky_share = share[self._sky_at][:, None]
        self._sky = self.colour[wet][self._sky_at]
        if sea is None:
            self.draw_sea(self.colour, 0.0)

    def draw_sea(self, rgb: Floats, time_s: float) -> None:
        """Draw the sea at a time into a picture, shape (h, w, 3)."""
        sine, palette, at = self._sine, palette_of(self.style), self._sky_at
        if self.waves is not None:
            slopes = wave_slopes(self.waves, time_s, self._position_m)
            sine = np.maximum(sine + self._gain * slopes.take(self._index), np.float32(0.02))
        colour = _tables(palette)[0].take(_place(sine), axis=0)
        colour[self._glinting] += self._glint[:, None] * np.array(palette.sun, np.float32)
        if self.kept is not None:
            air = np.array(palette.fog, np.float32)
            colour -= air
            colour *= self.kept[..., None]
            colour += air
        colour[at] += self._sky_share * (self._sky - colour[at])
        rgb[self.wet], self._shown = colour, sine

    def mirror(self, rows: NDArray[np.integer], columns: NDArray[np.integer]) -> Floats:
        """Share of the light that the sea reflects at some pixels in wet rows, shape (n,)."""
        return _tables(palette_of(self.style))[1].take(_place(self._shown[rows - self.wet.start, columns]))


def _sky(rays: Floats, turn: Floats, above_m: float, style: RenderStyle) -> tuple[Floats, Floats]:
    """The sky's colours with clouds, shape (h, w, 3), as if there were no sea; the sun's glow on the sea, (h, w)."""
    height, width = rays.shape[:2]
    world = rays[COARSE_PX // 2 :: COARSE_PX, COARSE_PX // 2 :: COARSE_PX] @ turn
    palette, up = palette_of(style), np.abs(world[..., 2])
    colour = _tables(palette)[0].take(_place(up) + TABLE, axis=0)
    far = 1 / (up + np.float32(CLOUD_FOOT))
    shape = _clouds()[tuple((world[..., axis] * far * 80).astype(np.int32) & (TILE - 1) for axis in (0, 1))]
    cover = np.clip(0.5 + 0.5 * shape, 0, 1) if style.overcast or style.rain else np.clip(0.6 * shape - 0.15, 0, 1)
    cover = 0.55 * cover * np.minimum(up / np.float32(0.1), 1)
    colour += cover[..., None] * (np.array(palette.cloud, np.float32) - colour)
    glow = np.zeros_like(up)
    if style.sunny:
        sun = sun_of(style).astype(np.float32)
        near = np.maximum(world @ sun, 0)
        around = near**8 * (0.55 if style.dusk else 0.2) + np.clip((near - 0.99993) * 30000, 0, 1)
        colour += around[..., None] * (np.array(palette.sun, np.float32) - colour)
        half = sun - world  # a wave that is turned so shows the sun: Cox & Munk (1954)
        slope = (half[..., 0] ** 2 + half[..., 1] ** 2) / np.maximum(half[..., 2], np.float32(0.01)) ** 2
        glow = np.exp(-slope / np.float32(0.06)) * np.float32(0.55)
    if style.extinction_per_m:
        colour = fogged(colour, max(FOG_DEPTH_M - above_m, 1.0) / np.maximum(up, 1e-6), style)
    small = Image.fromarray((np.clip(colour, 0, 1) * np.float32(255) + np.float32(0.5)).astype(np.uint8))
    whole = np.asarray(small.resize((width, height), Image.Resampling.BILINEAR), np.float32) / np.float32(255)
    return whole, np.asarray(Image.fromarray(glow).resize((width, height), Image.Resampling.BILINEAR))


def _place(sine: Floats) -> NDArray[np.int32]:
    """Indices into the tables of the sines of angles, from 0 to 1."""
    return np.clip(sine * (TABLE - 1), 0, TABLE - 1).astype(np.int32)


@cache
def _tables(colours: Palette) -> tuple[Floats, Floats]:
    """Colours of sea and sky, (2 TABLE, 3), and the share that the sea mirrors, (TABLE,), by the sine of the angle."""
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
    air = np.array(palette_of(style).fog, np.float32)
    out: Floats = (air + kept * (colour - air)).astype(np.float32)
    return out


# ---- Waves and ripples ----

WAVE_M, WAVE_SAMPLES, WAVE_LEVELS = 0.25, 1024, 8
"""Spacing along the waves' way in a table of their slopes, which each level doubles; samples and levels."""


def wave_slopes(sea: Sea, time_s: float, position_m: Array) -> Floats:
    """The slopes of a sea's surface at a time along the waves' way, shape (levels, samples). Level l has a sample
    every `WAVE_M` · 2^l metres around a position in WCF, shape (3,), which is in its middle; waves that are too short
    for it are smoothed away."""
    numbers, side = sea.wave_numbers_rad_m, math.isqrt(WAVE_SAMPLES)
    phases = sea.phases_at(np.array([time_s]), position_m[None])[0]
    out = np.empty((WAVE_LEVELS, WAVE_SAMPLES), np.float32)
    fine, coarse = (np.exp(1j * np.outer(np.arange(side) * WAVE_M * stride, numbers)) for stride in (1, side))
    first = coarse[side // 2].conj()  # from the middle to the first sample
    for level in range(WAVE_LEVELS):
        strength = numbers * sea.amplitudes_m * np.exp(-((numbers * WAVE_M * 2.0 ** (level - 1)) ** 2))
        blocks = coarse * (1j * strength * np.exp(1j * phases) * first)
        out[level] = (blocks.real @ fine.real.T - blocks.imag @ fine.imag.T).ravel()
        fine, coarse, first = fine**2, coarse**2, first**2  # as each step is twice as long
    return out


def _index(along_m: Floats, footprint_m: Floats) -> NDArray[np.int32]:
    """Places in the table of slopes, for distances from its middle and what a pixel covers there, in metres."""
    needed = np.maximum(footprint_m, np.abs(along_m) * np.float32(4.1 / WAVE_SAMPLES))  # so that it is in the table
    level = np.clip(np.log2(needed * np.float32(1 / WAVE_M)), 0, WAVE_LEVELS - 1).astype(np.int32)
    sample = (along_m * np.exp2(-level.astype(np.float32)) * np.float32(1 / WAVE_M)).astype(np.int32)
    place: NDArray[np.int32] = level * WAVE_SAMPLES + ((sample + WAVE_SAMPLES // 2) & (WAVE_SAMPLES - 1))
    return place


def _ripple(x: Floats, y: Floats, distance: Floats, focal_px: float) -> Floats:
    """A pattern that lies on the sea, as coarse as its distance asks for."""
    finest = np.log2(np.maximum(distance * np.float32(RIPPLE_PX / focal_px), np.float32(RIPPLE_M)))
    level = np.floor(finest)
    share = finest - level
    cells = np.exp2(-level) * 4  # a tile's longest waves are some cells long
    out = (1 - share) * _tile_at(x * cells, y * cells)
    out += share * _tile_at(x * (cells / 2), y * (cells / 2))
    faded: Floats = (out / (1 + distance / np.float32(FADE_M))).astype(np.float32)
    return faded


def _tile_at(x: Floats, y: Floats) -> Floats:
    """The tile, which repeats, at columns and rows of any size."""
    i, j = (np.floor(axis).astype(np.int32) & (TILE - 1) for axis in (x, y))
    return _tile().take(i * TILE + j)


@cache
def _tile() -> Floats:
    """Smooth noise that repeats without a seam, its crests across w1 and w2 alike; standard deviation 0.5."""
    return 0.5 * _noise(lambda frequency: np.exp(-(((frequency - 0.09) / 0.06) ** 2)))


@cache
def _clouds() -> Floats:
    """Noise of all sizes that repeats without a seam; standard deviation 1."""
    return _noise(lambda frequency: 1 / np.maximum(frequency, 2 / TILE) ** 1.7)


def _noise(band: Callable[[Array], Array]) -> Floats:
    rng = np.random.default_rng(TILE_SEED)
    frequency = np.hypot(np.fft.fftfreq(TILE)[:, None], np.fft.fftfreq(TILE))
    noise = np.fft.ifft2(np.fft.fft2(rng.standard_normal((TILE, TILE))) * band(frequency)).real
    tile: Floats = (noise / noise.std()).astype(np.float32)
    return tile
