"""The horizon in an image: a row, a line through two points, or the rows at the left and the right edge.

Half-planes (a, b, c) say on which side of it the sea is: a·x + b·y + c >= 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from modsim3d.arrays import Array
from modsim3d.errors import InputError
from modsim3d.formats.labelled import LabelledSet
from modsim3d.inputs.validation import shown

MOST_PX = 1e7
UNKNOWN = (math.nan, math.nan, math.nan)
"""The half-plane of an image whose horizon is not known."""
EVERYWHERE = np.array([0.0, 0.0, 1.0])
"""The half-plane of a sea that fills the image."""
_DECIMALS, _LEAST_PX = 3, 1e-3


def parse_horizon(text: str) -> tuple[float, ...]:
    """The numbers of a text such as `400` or `0,400,1920,380`.

    Raises:
        InputError: There is something else in it.
    """
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise InputError("--horizon", [_wanted(text)]) from None


def half_plane(horizon: float | Sequence[float], sizes_px: Iterable[tuple[int, int]]) -> Array:
    """The half-plane (a, b, c) of the sea below a horizon, a·x + b·y + c >= 0, shape (3,).

    Args:
        horizon: A row, or x and y of one point and of another.
        sizes_px: Width and height of the images.

    Raises:
        InputError: It is no such line, or it lies below an image.
    """
    numbers = np.atleast_1d(np.asarray(horizon, dtype=np.float64))
    if numbers.shape not in ((1,), (4,)) or not (np.abs(numbers) <= MOST_PX).all():
        text = ", ".join(f"{number:g}" for number in numbers.ravel().tolist())
        far = f"; no farther than {MOST_PX:,.0f}" if (np.abs(numbers) > MOST_PX).any() else ""
        raise InputError("--horizon", [_wanted(text) + far])
    x_1, y_1, x_2, y_2 = numbers.tolist() if len(numbers) == 4 else (0.0, numbers[0], 1.0, numbers[0])
    if x_1 == x_2:
        raise InputError("--horizon", ["is upright: give two points in different columns"])
    sea = np.array(_below(x_1, y_1, x_2, y_2))
    for width, height in sizes_px:
        corners = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1]], dtype=np.float64)
        if not (corners @ sea > 0).any():
            raise InputError("--horizon", [f"lies below images of {width} × {height} px: they would show no sea"])
    return sea


def with_horizon(labelled: LabelledSet, horizon: float | Sequence[float] | None) -> LabelledSet:
    """A labelled set in which images without a horizon have this one, as in `half_plane`; None for none.

    Raises:
        InputError: It is no such line, or it lies below an image.
    """
    if horizon is None:
        return labelled
    images = labelled.images
    unknown = np.isnan(images.half_planes[:, 0])
    sizes = np.unique(images.sizes_px[unknown & np.isfinite(images.sizes_px[:, 0])], axis=0).astype(np.int64)
    sea = half_plane(horizon, [(width, height) for width, height in sizes.tolist()])
    return replace(labelled, images=replace(images, half_planes=np.where(unknown[:, None], sea, images.half_planes)))


def written_horizon(half_plane: Sequence[float], width_px: float) -> list[float] | None:
    """Rows of the horizon at the left and the right edge of an image; None where the sea is not below such a line."""
    a, b, c = half_plane
    if not (b > 0 and math.isfinite(width_px)):  # NaN is not above 0
        return None
    rows = [round(-(a * x + c) / b, _DECIMALS) for x in (0.0, width_px)]
    return rows if max(map(abs, rows)) <= MOST_PX else None


def read_horizon(value: Any, width_px: float) -> tuple[float, float, float] | None:
    """The half-plane of an image whose horizon is a row, the rows at its edges, or two points; None if it is neither.

    That of an image for which none is given is unknown.
    """
    if value is None:
        return UNKNOWN
    numbers = value if isinstance(value, list) else [value]
    if not all(isinstance(each, int | float) and not isinstance(each, bool) for each in numbers):
        return None
    if len(numbers) not in (1, 2, 4) or not all(-MOST_PX <= each <= MOST_PX for each in numbers):
        return None
    if len(numbers) == 4:
        return None if abs(numbers[0] - numbers[2]) < _LEAST_PX else _below(*numbers)
    return _below(0.0, numbers[0], width_px, numbers[-1])


def _below(x_1: float, y_1: float, x_2: float, y_2: float) -> tuple[float, float, float]:
    """The half-plane below the line through two points in different columns."""
    slope = (y_2 - y_1) / (x_2 - x_1)
    return -slope, 1.0, slope * x_1 - y_1


def _wanted(got: str) -> str:
    return f"must be ROW, or X1,Y1,X2,Y2, in pixels, as 400 (got {shown(got)})"
