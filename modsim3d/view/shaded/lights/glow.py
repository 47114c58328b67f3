"""Draws the lights of vessels into a picture."""

from __future__ import annotations

import math

import numpy as np

from modsim3d.arrays import Array
from modsim3d.view.pictures.solids import Solids
from modsim3d.view.pictures.window import Window
from modsim3d.view.shaded.lights.seen import SeenLight, is_hidden, lights_towards
from modsim3d.view.shaded.sea_and_sky import Floats

FAINTEST, BRIGHTEST = 0.35, 1.2
"""Brightness of the middle of the faintest light that an eye sees, and of a strong light."""
MOST_PX = 4.0
"""Radius of the strongest light at a width of 1280."""


def draw_lights(rgb: Floats, solids: Solids, window: Window, speeds_m_s: Array, extinction_per_m: float) -> None:
    """Draw the lights before a camera that nothing hides into a picture, sRGB from 0 to 1, shape (h, w, 3).

    For `speeds_m_s` and `extinction_per_m` see `lights_towards`.
    """
    camera = solids.sight.camera_poses
    for light in lights_towards(solids.sight, speeds_m_s, extinction_per_m):
        seen_m = camera.to_camera(light.place_m[None, None])[0, 0]
        if seen_m[2] <= solids.intrinsics.near_clip_m:
            continue
        place_px = solids.intrinsics.project(seen_m[None])[0]
        x, y = window.to_picture(place_px).tolist()
        if not (0 <= x < window.size[0] and 0 <= y < window.size[1]):
            continue
        if not is_hidden(solids, light.vessel, place_px, solids.intrinsics.near_clip_m / seen_m[2]):
            _glow(rgb, np.array([x, y]), light, window.size[0] / 1280)


def _glow(rgb: Floats, place_px: Array, light: SeenLight, unit_px: float) -> None:
    """A bright point in a halo. Its radius and its brightness grow with the logarithm of the light, as eyes see it."""
    radius_px = max(1.0, unit_px * min(0.7 + 0.75 * light.decades, MOST_PX))
    peak = min(FAINTEST + 0.4 * light.decades, BRIGHTEST)
    reach = math.ceil(8 * radius_px)
    height, width = rgb.shape[:2]
    column, row = (math.floor(value) for value in place_px)
    rows = np.arange(max(row - reach, 0), min(row + reach + 1, height))
    columns = np.arange(max(column - reach, 0), min(column + reach + 1, width))
    squared = ((rows + 0.5 - place_px[1])[:, None] ** 2 + (columns + 0.5 - place_px[0]) ** 2) / radius_px**2
    strength = peak * (np.exp(-squared) + 0.2 * np.exp(-squared / 12))[..., None]
    rgb[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += (strength * light.lantern.colour.value).astype(
        np.float32
    )
