"""A place for a camera from which the traffic can be seen, kept clear of every hull.

Nothing here knows where the land is: it is a place to begin with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask

CELL_M = 1000.0
HEIGHT_M = 20.0
MIN_DISTANCE_M, MAX_DISTANCE_M = 300.0, 2500.0
CLEARANCE_M = 50.0
TRIES = 12
LOOKED_AT = 200_000
"""Poses that are looked at; of more, every so many."""


@dataclass(frozen=True)
class Viewpoint:
    """A camera ashore.

    Attributes:
        position_m: w1, w2, w3.
        yaw_rad: Counter-clockwise from w1.
        pitch_rad: Positive down.
        target_m: What it looks at, w1 and w2.
        distance_m: How far that is.
    """

    position_m: tuple[float, float, float]
    yaw_rad: float
    pitch_rad: float
    target_m: tuple[float, float]
    distance_m: float


def viewpoint(present: Mask, places_m: Array, half_lengths_m: Array) -> Viewpoint:
    """A camera that looks across the busiest patch of water.

    The patch is the square kilometre that most vessels visit. The camera stands off it across the main direction of
    what moves there, at the distance at which half of that traffic fills its view, further away or turned aside as long
    as a hull comes near.

    Args:
        present: Which vessel is there when, shape (S, V).
        places_m: Centres of hulls, shape (S, V, 2).
        half_lengths_m: Shape (V,).
    """
    steps, vessels = np.nonzero(present)
    thin = max(1, len(steps) // LOOKED_AT)
    places = places_m[steps, vessels]
    target = _busiest(places[::thin], vessels[::thin])
    near = places[np.abs(places - target).max(axis=1) <= 1.5 * CELL_M]
    spread = near - near.mean(axis=0)
    _, directions = np.linalg.eigh(spread.T @ spread)
    along = directions[:, 1]
    across = float(np.arctan2(-along[0], along[1]))
    reach = float(np.median(np.abs(spread @ along)))
    distance = float(np.clip(1.5 * reach, MIN_DISTANCE_M, MAX_DISTANCE_M))
    # From the south, with the light behind, if either side will do.
    bearing = across if np.sin(across) < 0 else across + np.pi
    keep_off = half_lengths_m[vessels] + CLEARANCE_M
    for attempt in range(TRIES):
        turned = bearing + (0.0, np.pi, 0.5, -0.5)[attempt % 4]
        further = distance * 1.5 ** (attempt // 4)
        place = target + further * np.array([np.cos(turned), np.sin(turned)])
        if (np.linalg.norm(places - place, axis=1) > keep_off).all():
            break
    else:
        # Outside everything: beyond the southernmost hull.
        place = np.array([target[0], float((places[:, 1] - keep_off).min()) - CLEARANCE_M])
    look = target - place
    distance = float(np.hypot(*look))
    return Viewpoint(
        (round(float(place[0]), 1), round(float(place[1]), 1), HEIGHT_M),
        round(float(np.arctan2(look[1], look[0])), 4),
        round(float(np.arctan2(HEIGHT_M, distance)), 4),
        (round(float(target[0]), 1), round(float(target[1]), 1)),
        distance,
    )


def _busiest(places_m: Array, vessels: Indices) -> Array:
    """The middle of the places in the cell that most vessels visit, of equals the one with most poses."""
    cells = np.floor(places_m / CELL_M).astype(np.int64)
    names, cell = np.unique(cells, axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    visits = np.unique(np.stack([cell, vessels], axis=1), axis=0)[:, 0]
    visited = np.bincount(visits, minlength=len(names))
    poses = np.bincount(cell, minlength=len(names))
    best = int(np.lexsort((poses, visited))[-1])
    return np.asarray(places_m[cell == best].mean(axis=0))
