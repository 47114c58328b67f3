"""Forms in which files give boxes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array
from modsim3d.boxes import centre_form, corner_form, from_top_left, sizes
from modsim3d.runs.files.table_columns import BOX_SIDES, CENTRE_FORM


@dataclass(frozen=True)
class BoxForm:
    """A form.

    Attributes:
        meaning: What the four numbers are, in words.
        names: Their names.
        first_px: Number of the first pixel.
        to_corners: Makes x_min, y_min, x_max, y_max of the four, shapes (k, 4).
    """

    meaning: str
    names: tuple[str, ...]
    first_px: int
    to_corners: Callable[[Array], Array]

    def boxes_px(self, numbers: Array) -> Array:
        """Boxes as x_min, y_min, x_max, y_max with pixels from 0, of those of a file, shapes (k, 4)."""
        boxes: Array = self.to_corners(numbers) - self.first_px
        return boxes

    def numbers_of(self, boxes_px: Array) -> Array:
        """The four numbers that a file has of boxes, shapes (k, 4)."""
        if self.to_corners is corner_form:
            return centre_form(boxes_px)
        if self.to_corners is from_top_left:
            return np.hstack([boxes_px[:, :2] + self.first_px, sizes(boxes_px)])
        return boxes_px


CORNERS = BoxForm("the corners x_min, y_min, x_max, y_max", BOX_SIDES, 0, lambda numbers: numbers)
CENTRE = BoxForm("centre x, centre y, width, height", CENTRE_FORM, 0, corner_form)
TOP_LEFT = BoxForm("the corner x, y and width, height", ("x", "y", "width", "height"), 0, from_top_left)
MOT = BoxForm("x, y, width, height with pixels from 1", TOP_LEFT.names, 1, from_top_left)
