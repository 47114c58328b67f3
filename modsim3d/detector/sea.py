"""Random places on the part of the image where there is sea."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array, Mask
from modsim3d.detector.draws import choose, cumulative


def sea_polygons(half_planes: Array, image_size_px: tuple[int, int]) -> Array:
    """The image rectangle cut by each half-plane (Sutherland & Hodgman (1974)).

    Args:
        half_planes: (a, b, c) with a·x + b·y + c >= 0 on the sea side, shape (m, 3).
        image_size_px: Width and height.

    Returns:
        Convex polygons of eight corners in order, shape (m, 8, 2); a polygon that has fewer repeats some.
        Where no sea is in the image, the whole image.
    """
    width, height = image_size_px
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float64)
    a, b, c = half_planes[:, :1], half_planes[:, 1:2], half_planes[:, 2:]
    start_side = a * corners[:, 0] + b * corners[:, 1] + c  # (m, 4), at the start of each edge
    end_side = np.roll(start_side, -1, axis=1)
    crosses = (start_side >= 0) != (end_side >= 0)
    along = np.where(crosses, start_side, 0) / np.where(crosses, start_side - end_side, 1)
    crossing = corners + along[..., None] * (np.roll(corners, -1, axis=0) - corners)
    polygons = np.stack([np.broadcast_to(corners, crossing.shape), crossing], axis=2).reshape(-1, 8, 2)
    is_corner = np.stack([start_side >= 0, crosses], axis=2).reshape(-1, 8)
    nowhere = ~is_corner.any(axis=1)
    is_corner[nowhere] = np.tile([True, False], 4)
    return _repeat_missing(polygons, is_corner)


def _repeat_missing(polygons: Array, present: Mask) -> Array:
    """Each missing corner replaced by the last one before it that is there, around the polygon."""
    places = np.where(present, np.arange(8), -1)
    last = places.max(axis=1, keepdims=True)
    source = np.maximum.accumulate(places, axis=1)
    return np.take_along_axis(polygons, np.where(source < 0, last, source)[..., None], axis=1)


def uniform_places(half_planes: Array, image_size_px: tuple[int, int], uniforms: Array) -> Array:
    """Points spread evenly over the sea in the image, or over the image where it shows none.

    A triangle of the fan from the first corner is chosen by its area, then a point in it.

    Args:
        half_planes: Sea side of the horizon for each point, shape (m, 3).
        image_size_px: Width and height.
        uniforms: Shape (m, 3).

    Returns:
        x and y in pixels, inside the image, shape (m, 2).
    """
    polygons = sea_polygons(half_planes, image_size_px)
    spokes = polygons[:, 1:] - polygons[:, :1]
    first, second = spokes[:, :-1], spokes[:, 1:]
    areas = np.abs(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])
    areas[areas.sum(axis=1) == 0] = 1  # sea along one edge or at one corner only
    rows, chosen = np.arange(len(polygons)), choose(cumulative(areas), uniforms[:, 0])
    outward, across = np.sqrt(uniforms[:, 1:2]), uniforms[:, 2:3]
    offsets = (1 - across) * first[rows, chosen] + across * second[rows, chosen]
    return np.clip(polygons[:, 0] + outward * offsets, 0, image_size_px)
