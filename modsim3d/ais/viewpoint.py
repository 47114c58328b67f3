"""A place for a camera from which the traffic can be seen, clear of all hulls.

AIS does not say where land is, so the user has to check the place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices

CELL_M = 1000.0
HEIGHT_M = 20.0
MIN_DISTANCE_M, MAX_DISTANCE_M = 300.0, 2500.0
CLEARANCE_M = 50.0
TRIES = 12
MAX_POSES = 200_000
"""Of more poses than this, evenly spaced ones are used to find the busiest water."""


@dataclass(frozen=True)
class Viewpoint:
    """A camera ashore, at w1, w2, w3, that looks at a place on the water, w1, w2; its pitch is positive down."""

    position_m: tuple[float, float, float]
    yaw_rad: float
    pitch_rad: float
    target_m: tuple[float, float]
    distance_m: float


def viewpoint(vessels: Indices, places_m: Array, half_lengths_m: Array) -> Viewpoint:
    """A camera that looks across the busiest patch of water.

    The patch is the square kilometre that most vessels visit. The camera looks at right angles to the main direction of
    motion there, from the distance at which half of that traffic fills its view. If a hull comes near that place, the
    camera is turned aside or moved further away.

    Args:
        vessels: The vessel of each pose, in the order of time, shape (n,).
        places_m: Centre of its hull, shape (n, 2).
        half_lengths_m: Half the length of each hull, shape (V,).
    """
    spacing = max(1, len(vessels) // MAX_POSES)
    target = _busiest(places_m[::spacing], vessels[::spacing])
    bearing, distance = _across(places_m, target)
    place = _clear_place(places_m, half_lengths_m[vessels] + CLEARANCE_M, target, bearing, distance)
    look = target - place
    distance = float(np.hypot(*look))
    return Viewpoint(
        (round(float(place[0]), 1), round(float(place[1]), 1), HEIGHT_M),
        round(float(np.arctan2(look[1], look[0])), 4),
        round(float(np.arctan2(HEIGHT_M, distance)), 4),
        (round(float(target[0]), 1), round(float(target[1]), 1)),
        distance,
    )


def _across(places_m: Array, target_m: Array) -> tuple[float, float]:
    """Direction from the target at right angles to the traffic around it, in radians from w1, and a distance in metres.

    The direction is to the south, so that the light comes from behind; the distance shows half of the traffic.
    """
    near = places_m[np.abs(places_m - target_m).max(axis=1) <= 1.5 * CELL_M]
    spread = near - near.mean(axis=0)
    _, directions = np.linalg.eigh(spread.T @ spread)
    along = directions[:, 1]
    across = float(np.arctan2(-along[0], along[1]))
    reach = float(np.median(np.abs(spread @ along)))
    distance = float(np.clip(1.5 * reach, MIN_DISTANCE_M, MAX_DISTANCE_M))
    return (across if np.sin(across) < 0 else across + np.pi), distance


def _clear_place(places_m: Array, clearance_m: Array, target_m: Array, bearing_rad: float, distance_m: float) -> Array:
    """The first place that is clear of all hulls: at the bearing and distance, turned aside, or further away.

    `clearance_m`, shape (n,), is the distance to keep from each of the places, shape (n, 2).
    """
    for attempt in range(TRIES):
        turned = bearing_rad + (0.0, np.pi, 0.5, -0.5)[attempt % 4]
        further = distance_m * 1.5 ** (attempt // 4)
        place = target_m + further * np.array([np.cos(turned), np.sin(turned)])
        if (np.linalg.norm(places_m - place, axis=1) > clearance_m).all():
            return place
    south_m = float((places_m[:, 1] - clearance_m).min()) - CLEARANCE_M  # beyond the southernmost hull
    return np.array([target_m[0], south_m])


def _busiest(places_m: Array, vessels: Indices) -> Array:
    """The mean place, shape (2,), in the cell that most vessels visit; of several, the one with most poses."""
    cells = np.floor(places_m / CELL_M).astype(np.int64)
    names, cell = np.unique(cells, axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    visits = np.unique(np.stack([cell, vessels], axis=1), axis=0)[:, 0]
    visited = np.bincount(visits, minlength=len(names))
    poses = np.bincount(cell, minlength=len(names))
    best = int(np.lexsort((poses, visited))[-1])
    return np.asarray(places_m[cell == best].mean(axis=0))
