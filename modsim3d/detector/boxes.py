"""Boxes as x_min, y_min, x_max, y_max in pixels, along the last axis; none of it writes to its arguments."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modsim3d.detector.records import Array

Mask = NDArray[np.bool_]


def sizes(boxes_px: Array) -> Array:
    """Width and height, shape (..., 2); not positive where a box is turned inside out or clipped away."""
    return boxes_px[..., 2:] - boxes_px[..., :2]


def clip(boxes_px: Array, image_size_px: tuple[int, int]) -> Array:
    """Boxes cut at the image's edge."""
    return np.clip(boxes_px, 0, [*image_size_px, *image_size_px])


def move(boxes_px: Array, errors_px: Array) -> Array:
    """Boxes with (e_x, e_y, e_w, e_h) added to centre, width and height; without error exactly the same."""
    shift, half_growth = errors_px[..., :2], errors_px[..., 2:] / 2
    return np.concatenate([boxes_px[..., :2] + (shift - half_growth), boxes_px[..., 2:] + (shift + half_growth)], -1)


def at_least_a_pixel(boxes_px: Array, image_size_px: tuple[int, int]) -> Array:
    """Boxes whose sides below one pixel are replaced by the whole pixel that their middle is in."""
    low, high = boxes_px[..., :2], boxes_px[..., 2:]
    pixel = np.clip(np.floor((low + high) / 2), 0, np.array(image_size_px) - 1)
    thin = high - low < 1
    return np.concatenate([np.where(thin, pixel, low), np.where(thin, pixel + 1, high)], -1)
