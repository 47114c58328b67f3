"""Whether a camera is inside a body, where no picture makes sense."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modsim3d.arrays import Array
from modsim3d.vessels.bodies import Bodies

INSIDE = 2 * np.pi
"""A closed mesh subtends the whole sphere of 4π at a point inside, and 0 at a point outside."""
MOST_TRIANGLES = 100_000
"""Most triangles times points that are looked at together; it bounds the memory."""


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
        for body in np.flatnonzero(within.any(axis=0)).tolist():
            frames, triangles = np.flatnonzero(within[:, body]), some.vertices_m[body][some.solid.faces]
            for some_frames in np.array_split(frames, -(-len(frames) * len(triangles) // MOST_TRIANGLES)):
                inside = np.abs(solid_angle(places[some_frames, body], triangles)) > INSIDE
                found += [(frame, int(some.occluder[body])) for frame in some_frames[inside][:1].tolist()]
    return min(found, default=None)


def solid_angle(points: Array, triangles: Array) -> Array:
    """Steradians that oriented triangles, shape (T, 3, 3), subtend at points, shape (..., 3) to (...).

    They are ±4π inside a closed mesh and 0 outside. A. van Oosterom and J. Strackee, "The solid angle of a plane
    triangle", IEEE Transactions on Biomedical Engineering 30 (1983).
    """
    a, b, c = np.moveaxis(triangles - points[..., None, None, :], -2, 0)
    la, lb, lc = (np.linalg.norm(corner, axis=-1) for corner in (a, b, c))
    volume = np.einsum("...i,...i->...", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("...i,...i->...", p, q) for p, q in ((a, b), (b, c), (c, a)))
    angle: Array = 2 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb).sum(axis=-1)
    return angle
