"""Whether a camera is inside a vessel, where no picture makes sense."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from modsim3d.frames import Array
from modsim3d.poses import Poses
from modsim3d.vessels import Vessel


def check_cameras_outside(
    positions_m: Array, vessels: Sequence[Vessel], looked_at: NDArray[np.bool_], poses: Poses, world_R_vessel: Array
) -> tuple[int, int] | None:
    """The first frame and vessel in whose shoebox a camera is.

    Args:
        positions_m: Of the camera in WCF, shape (S, 3).
        vessels: V of them.
        looked_at: Those that are there and do not carry the camera, shape (S, V).
        poses: Of the vessels.
        world_R_vessel: Rotations VCF to WCF, shape (S, V, 3, 3).

    Returns:
        Frame and vessel index, or None.
    """
    offsets = positions_m[:, None, None, :] - poses.positions_m[:, :, None, :]
    body = (offsets @ world_R_vessel)[:, :, 0, :]
    extents = np.array([vessel.extents_m for vessel in vessels])
    within = (np.abs(body[..., :2]) < extents[:, :2] / 2).all(axis=-1)
    within &= (body[..., 2] > 0) & (body[..., 2] < extents[:, 2]) & looked_at
    found = np.argwhere(within)
    return (int(found[0][0]), int(found[0][1])) if len(found) else None
