"""The curved sea: distant things lie lower than on a flat one.
A point of the sea at a horizontal distance d lies d² / (2 R) below the plane that touches the sea under the camera.
This is the first term of R − √(R² − d²); the next, d⁴ / (8 R³), is below a millimetre at 30 km. Light travels straight
here; refraction would lift distant things by about a seventh of the drop."""

import numpy as np

from modsim3d.core.arrays import Array
from modsim3d.geometry.camera import Intrinsics
from modsim3d.geometry.camera_poses import CameraPoses, heading_of

RADIUS_M = 6_371_000.0  # mean radius of the Earth (Moritz, 2000, "Geodetic Reference System 1980": R1 = 6 371 008.77 m)


def drop_m(places_m: Array, camera_m: Array) -> Array:
    """Drop of the sea at places (..., 2) or (..., 3) below the plane that touches it under a camera, in metres, shape
    (...). Camera centres, in WCF, have a shape that broadcasts against the places."""
    away = places_m[..., :2] - camera_m[..., :2]
    drop: Array = (away * away).sum(axis=-1) / (2 * RADIUS_M)
    return drop


def lowered(places_m: Array, camera_m: Array) -> Array:
    """Places in WCF, in metres, as cameras at `camera_m` see them over a curved sea; all shapes are (..., 3)."""
    places: Array = np.array(places_m, dtype=np.float64)
    places[..., 2] -= drop_m(places_m, camera_m)
    return places


def shift_px(depth_m: Array, focal_px: tuple[float, float]) -> Array:
    """Pixels, shape (n,), by which the drop f d / (2 R) shifts things at depths d, shape (n,), down the image. The
    larger focal length counts, as the camera may be rolled."""
    return max(focal_px) * depth_m / (2 * RADIUS_M)


# ---- Where the ray through a pixel meets the sea ----


def look(intrinsics: Intrinsics, poses: CameraPoses, pixels: Array) -> Array:
    """Bearing and flat inverse range of n pixels, column and row (n, 2), each from a pose of its own; shape (n, 2).
    Bearings are in (−π, π], counter-clockwise from w1, and flat inverse ranges in 1/m, negative above the horizontal.
    Distortion is undone. NaN where the lens shows nothing at a pixel; the inverse range also where the camera is not
    above the sea, and where the ray is vertical."""
    rays = intrinsics.unproject(pixels, np.ones(len(pixels)))
    world = (np.swapaxes(poses.camera_R_world, -1, -2) @ rays[..., None])[..., 0]
    across, height = np.hypot(world[:, 0], world[:, 1]), poses.positions_m[:, 2]
    product = across * height
    flat = np.where(product > 0, -world[:, 2] / np.where(product > 0, product, 1.0), np.nan)
    return np.stack([heading_of(world), flat], axis=-1)


def horizon_inverse_range(heights_m: Array, *, curved: bool) -> Array:
    """The inverse range of the horizon, 1 / √(2 R H) on a curved sea and 0 on a flat one, in 1/m; same shape. Heights
    are those of cameras above the sea; NaN where one is not."""
    above = np.where(heights_m > 0, heights_m, np.nan)
    return 1 / np.sqrt(2 * RADIUS_M * above) if curved else 0 * above


def inverse_range(flat_per_m: Array, horizon_per_m: Array) -> Array:
    """Inverse range 1/r from the flat one and that of the horizon, all in 1/m and of the same shape. Below the horizon
    it is the point where the ray meets the sea. Above it goes on with slope one: continuous and monotone, so that an
    error there is still an error; a value at or below that of the horizon means "at the horizon or beyond"."""
    dip = 2 * horizon_per_m
    root = np.sqrt(np.maximum(flat_per_m**2 - dip**2, 0))
    return np.where(flat_per_m > dip, (flat_per_m + root) / 2, flat_per_m - horizon_per_m)
