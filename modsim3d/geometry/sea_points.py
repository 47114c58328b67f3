"""Where the ray through a pixel meets the sea, as bearing and inverse range.

A ray that points below the horizontal by an angle of tangent t leaves a camera at the height H and meets a flat sea at
the horizontal distance r = H / t. The flat inverse range κ = t / H is therefore linear in t, and nearly so in pixels.

A sea of radius R lies r² / (2 R) lower there (see `curved_sea`), so that 1/r = ρ solves κ = ρ + 1 / (2 R H ρ). Of its
two solutions the greater is the nearer point. Rays above the horizon, κ < √(2 / (R H)), meet no sea.
"""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array
from modsim3d.geometry.camera import Intrinsics
from modsim3d.geometry.camera_poses import CameraPoses
from modsim3d.geometry.curved_sea import RADIUS_M
from modsim3d.geometry.rotations import heading_of


def look(intrinsics: Intrinsics, poses: CameraPoses, pixels: Array) -> Array:
    """Bearing and flat inverse range of n pixels, each from a pose of its own.

    Args:
        intrinsics: The camera; its distortion is undone.
        poses: One for each pixel.
        pixels: Column and row, shape (n, 2).

    Returns:
        Bearings in (−π, π], counter-clockwise from w1, and flat inverse ranges in 1/m, negative above the horizontal,
        shape (n, 2). NaN where the lens shows nothing at a pixel; the inverse range also where the camera is not above
        the sea, and where the ray is vertical.
    """
    rays = intrinsics.unproject(pixels, np.ones(len(pixels)))
    world = (np.swapaxes(poses.camera_R_world, -1, -2) @ rays[..., None])[..., 0]
    across, height = np.hypot(world[:, 0], world[:, 1]), poses.positions_m[:, 2]
    product = across * height
    flat = np.where(product > 0, -world[:, 2] / np.where(product > 0, product, 1.0), np.nan)
    return np.stack([heading_of(world), flat], axis=-1)


def horizon_inverse_range(heights_m: Array, *, curved: bool) -> Array:
    """The inverse range of the horizon, 1 / √(2 R H) on a curved sea and 0 on a flat one, in 1/m; same shape.

    Heights are those of cameras above the sea; NaN where one is not.
    """
    above = np.where(heights_m > 0, heights_m, np.nan)
    horizon: Array = 1 / np.sqrt(2 * RADIUS_M * above) if curved else 0 * above
    return horizon


def inverse_range(flat_per_m: Array, horizon_per_m: Array) -> Array:
    """Inverse range 1/r from the flat one and that of the horizon, all in 1/m and of the same shape.

    Below the horizon it is the point where the ray meets the sea. Above it goes on with slope one: continuous and
    monotone, so that an error there is still an error; a value at or below that of the horizon means "at the horizon
    or beyond".
    """
    dip = 2 * horizon_per_m
    root = np.sqrt(np.maximum(flat_per_m**2 - dip**2, 0))
    return np.where(flat_per_m > dip, (flat_per_m + root) / 2, flat_per_m - horizon_per_m)
