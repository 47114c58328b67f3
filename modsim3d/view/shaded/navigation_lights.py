"""The lights of vessels by night: white at the top, red to port, green to starboard (COLREG 1972, Rule 21)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array
from modsim3d.scene.sight import Sight
from modsim3d.vessels.vessel import Vessel

SIDELIGHT_RAD = math.radians(112.5)
"""Sidelights shine from right ahead to this far abaft, each to its own side."""
WHITE, RED, GREEN = (1.0, 0.96, 0.85), (1.0, 0.12, 0.08), (0.1, 1.0, 0.45)
BESIDE = 0.02
"""How far outside the hull a sidelight is, as a share of the beam, so that the hull does not hide it."""


def lights(sight: Sight, vessels: tuple[Vessel, ...]) -> tuple[Array, Array]:
    """Places in the world and colours, shape (n, 3) each, of the lights that a camera sees at its first step."""
    camera = sight.camera_poses.positions_m[0]
    places, colours = [np.empty((0, 3))], [np.empty((0, 3))]
    for index in np.flatnonzero(sight.others[0]).tolist():
        vessel, rotation = vessels[index], sight.world_R_vessel[0, index]
        origin = sight.poses.positions_m[0, index]
        ahead, port, _ = rotation.T @ (camera - origin)
        bearing = math.atan2(port, ahead)
        top = vessel.solid.vertices[vessel.solid.vertices[:, 2].argmax()]
        body, shown = [top * (1.0, 1.0, 1.01)], [WHITE]
        if abs(bearing) <= SIDELIGHT_RAD:
            side = 1.0 if bearing > 0 else -1.0
            body.append(np.array([0.2, side * (0.5 + BESIDE), 0.35]))
            shown.append(RED if side > 0 else GREEN)
        places.append(np.array(body) * vessel.extents_m @ rotation.T + origin)
        colours.append(np.array(shown))
    return np.concatenate(places), np.concatenate(colours)


def glow(rgb: NDArray[np.float32], place_px: Array, colour: Array, radius_px: float) -> None:
    """Add a light to a picture in place: a bright point in a halo that fades with distance.

    Args:
        rgb: sRGB from 0 to 1, shape (h, w, 3).
        place_px: Column and row, shape (2,).
        colour: Of the point, from 0 to 1, shape (3,).
        radius_px: Radius of the point.
    """
    reach = math.ceil(8 * radius_px)
    height, width = rgb.shape[:2]
    column, row = (math.floor(value) for value in place_px)
    rows = np.arange(max(row - reach, 0), min(row + reach + 1, height))
    columns = np.arange(max(column - reach, 0), min(column + reach + 1, width))
    if not len(rows) or not len(columns):
        return
    squared = ((rows + 0.5 - place_px[1])[:, None] ** 2 + (columns + 0.5 - place_px[0]) ** 2) / radius_px**2
    strength = (1.2 * np.exp(-squared) + 0.25 * np.exp(-squared / 12))[..., None]
    here = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    rgb[here] += (strength * colour).astype(np.float32)
