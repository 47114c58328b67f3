"""Whether a camera is inside a body, where no picture makes sense."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modsim3d.arrays import Array
from modsim3d.vessels.bodies import Bodies

INSIDE = 2 * np.pi
"""A closed mesh subtends the whole sphere of 4π at a point inside, and 0 at a point outside."""


def first_body_around(cameras_m: Array, bodies: Sequence[Bodies]) -> tuple[int, int] | None:
    """The first frame in which a camera is inside a body, and that body.

    Args:
        cameras_m: Positions of the camera in WCF at S steps, shape (S, 3).
        bodies: At the same steps.

    Returns:
        Frame and index into the scene's occluder names; None if the camera is always outside.
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
    """Steradians that oriented triangles, shape (T, 3, 3), subtend at a point, shape (3,).

    They are ±4π inside a closed mesh and 0 outside. A. van Oosterom and J. Strackee, "The solid angle of a plane
    triangle", IEEE Transactions on Biomedical Engineering 30 (1983).
    """
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    la, lb, lc = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
    volume = np.einsum("ti,ti->t", a, np.cross(b, c))
    dots = [np.einsum("ti,ti->t", p, q) for p, q in ((a, b), (b, c), (c, a))]
    return float(2 * np.arctan2(volume, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb).sum())
