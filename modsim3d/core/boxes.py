"""Boxes as x_min, y_min, x_max, y_max in pixels, along the last axis. No function writes to its arguments."""

from typing import NamedTuple, Self

import numpy as np

from modsim3d.core.arrays import Array, Mask


def sizes(boxes_px: Array) -> Array:
    """Width and height of boxes (..., 4), shape (..., 2); not positive where a box is inverted or clipped away."""
    return boxes_px[..., 2:] - boxes_px[..., :2]


def centres(boxes_px: Array) -> Array:
    """Centres of boxes (..., 4), shape (..., 2)."""
    return (boxes_px[..., :2] + boxes_px[..., 2:]) / 2


def centre_form(boxes_px: Array) -> Array:
    """Centre x, centre y, width and height of boxes (..., 4), as files have them, shape (..., 4)."""
    size = sizes(boxes_px)
    return np.concatenate([boxes_px[..., :2] + size / 2, size], axis=-1)


def corner_form(centre_form_px: Array) -> Array:
    """Boxes from centre x, centre y, width and height, shapes (..., 4)."""
    centre, half = centre_form_px[..., :2], centre_form_px[..., 2:] / 2
    return np.concatenate([centre - half, centre + half], axis=-1)


def clip(boxes_px: Array, image_size_px: tuple[int, int] | Array) -> Array:
    """Boxes (..., 4) cut at the edge of the image, or each of its own image of a size (..., 2), same shape."""
    size = np.asarray(image_size_px)
    return np.clip(boxes_px, 0, np.concatenate([size, size], axis=-1))


def from_top_left(top_left_form_px: Array) -> Array:
    """Boxes from the corner x_min, y_min, width and height, shapes (..., 4)."""
    corner = top_left_form_px[..., :2]
    return np.concatenate([corner, corner + top_left_form_px[..., 2:]], axis=-1)


def move(boxes_px: Array, errors_px: Array) -> Array:
    """Boxes (..., 4) with (e_x, e_y, e_w, e_h) added to centre, width and height; the same bits for an error of 0."""
    shift, half_growth = errors_px[..., :2], errors_px[..., 2:] / 2
    return np.concatenate([boxes_px[..., :2] + (shift - half_growth), boxes_px[..., 2:] + (shift + half_growth)], -1)


def errors_between(found_px: Array, truth_px: Array) -> Array:
    """(e_x, e_y, e_w, e_h): what `move` would have to add to the true boxes to give the found ones, shape (n, 4)."""
    change = found_px - truth_px
    low, high = change[:, :2], change[:, 2:]
    return np.concatenate([(low + high) / 2, high - low], axis=1)


def at_least_a_pixel(boxes_px: Array, image_size_px: tuple[int, int] | Array) -> Array:
    """Boxes (..., 4) with each side below one pixel replaced by the pixel that contains its middle, same shape. The
    image is that of all, or each box has its own of a size (..., 2)."""
    low, high = boxes_px[..., :2], boxes_px[..., 2:]
    thin = high - low < 1
    if not thin.any():
        return boxes_px
    pixel = np.clip(np.floor((low + high) / 2), 0, np.array(image_size_px) - 1)
    return np.concatenate([np.where(thin, pixel, low), np.where(thin, pixel + 1, high)], -1)


def areas(boxes_px: Array) -> Array:
    """Areas of boxes (..., 4) in square pixels, shape (...)."""
    width_height = sizes(boxes_px)
    return width_height[..., 0] * width_height[..., 1]


def intersections(a_px: Array, b_px: Array) -> Array:
    """Common area of boxes (..., 4), pair by pair, in square pixels, shape (...)."""
    low, high = np.maximum(a_px[..., :2], b_px[..., :2]), np.minimum(a_px[..., 2:], b_px[..., 2:])
    sides = np.maximum(high - low, 0)
    common: Array = sides[..., 0] * sides[..., 1]
    return common


def iou(a_px: Array, b_px: Array) -> Array:
    """Intersection over union of boxes (..., 4), pair by pair, shape (...) (Jessen & Mohr (2023), section 5.6.1)."""
    common = intersections(a_px, b_px)
    together = areas(a_px) + areas(b_px) - common
    return common / np.where(together > 0, together, 1.0)


class Overlaps(NamedTuple):
    """Summary of how well detected boxes lie on those of their vessels, in IoU; NaN of none."""

    mean: float
    median: float
    below_half: float  # share with less than 0.5, which an evaluation by IoU counts as missed, and as false

    @classmethod
    def of(cls, overlap: Array) -> Self:
        """The summary of some IoU, shape (n,)."""
        if not len(overlap):
            return cls(*[np.nan] * 3)
        return cls(float(overlap.mean()), float(np.median(overlap)), float((overlap < 0.5).mean()))

    def __str__(self) -> str:
        """The numbers in words."""
        return f"mean {self.mean:.3f}, median {self.median:.3f}, {100 * self.below_half:.1f} % below 0.5"


def unions(a_px: Array, b_px: Array) -> Array:
    """The smallest boxes that contain both of each pair, shape (k, 4)."""
    low, high = np.minimum(a_px, b_px), np.maximum(a_px, b_px)
    return np.concatenate([low[:, :2], high[:, 2:]], axis=1)


def inside_image(boxes_px: Array, image_size_px: tuple[int, int] | Array) -> Mask:
    """Mask of the boxes (..., 4) that, clipped to their image by `clip`, are at least a pixel wide and high, (...)."""
    large: Mask = sizes(clip(boxes_px, image_size_px)) >= 1 - 1e-9
    return large[..., 0] & large[..., 1]
