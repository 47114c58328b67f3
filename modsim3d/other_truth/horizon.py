"""The horizon that a user gives: a row of the image, or a line through two points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from modsim3d.arrays import Array
from modsim3d.errors import InputError
from modsim3d.inputs.validation import shown

MOST_PX = 1e7


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
        raise InputError("--horizon", [_wanted(", ".join(f"{number:g}" for number in numbers.ravel().tolist()))])
    x_1, y_1, x_2, y_2 = numbers if len(numbers) == 4 else (0.0, numbers[0], 1.0, numbers[0])
    if x_1 == x_2:
        raise InputError("--horizon", ["is upright: give two points in different columns"])
    slope = (y_2 - y_1) / (x_2 - x_1)
    sea = np.array([-slope, 1.0, slope * x_1 - y_1])
    for width, height in sizes_px:
        corners = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1]], dtype=np.float64)
        if not (corners @ sea > 0).any():
            raise InputError("--horizon", [f"lies below images of {width} × {height} px: they would show no sea"])
    return sea


def _wanted(got: str) -> str:
    return f"must be ROW, or X1,Y1,X2,Y2, in pixels, as 400 (got {shown(got)})"
