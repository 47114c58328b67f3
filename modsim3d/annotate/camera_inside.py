"""Whether a camera is inside a body, where no picture makes sense."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modsim3d.arrays import Array
from modsim3d.bodies import Bodies

INSIDE = 2 * np.pi
"""A closed mesh fills the whole sphere of 4π seen from inside it, and nothing from outside."""


def first_body_around(cameras_m: Array, bodies: Sequence[Bodies]) -> tuple[int, int] | None:
    """The first frame and occluder that a camera is inside of.

    Args:
        cameras_m: Places of a camera in WCF, shape (S, 3).
        bodies: At the same steps.

    Returns:
        Frame and index into the scene's occluder names, or None.
    """
    found = []
    for some in bodies:
        offsets = cameras_m[:, None, None, :] - some.positions_m[:, :, None, :]
        places = (offsets @ some.world_R_body)[:, :, 0, :]  # in the frame of each body
        low, high = some.vertices_m.min(axis=1), some.vertices_m.max(axis=1)
        within = np.all((places > low) & (places < high), axis=-1) & some.present
        for frame, body in np.argwhere(within).tolist():
            triangles = some.vertices_m[body][some.solid.faces]
            if abs(solid_angle(places[frame, body], triangles)) > INSIDE:
                found.append((frame, int(some.occluder[body])))
                break
    return min(found, default=None)


def solid_angle(point: Array, triangles: Array) -> float:
    """The solid angle that oriented triangles subtend at a point (van Oosterom & Strackee, 1983).

    Args:
        point: Shape (3,).
        triangles: Corners, shape (T, 3, 3).

    Returns:
        Steradians; ±4π inside a closed mesh, 0 outside.
    """
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    la, lb, lc = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
    volume = np.einsum("ti,ti->t", a, np.cross(b, c))
    dots = [np.einsum("ti,ti->t", p, q) for p, q in ((a, b), (b, c), (c, a))]
    return float(2 * np.arctan2(volume, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb).sum())
