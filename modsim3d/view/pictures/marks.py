"""Boxes of detections, with marks of what is wrong with them."""

from __future__ import annotations

import numpy as np

from modsim3d.runs.outcomes import Outcome
from modsim3d.view import palette
from modsim3d.view.palette import Colour
from modsim3d.view.pictures.canvas import Canvas
from modsim3d.view.pictures.window import Box

LONG_DASH_PX, DASHES_A_SIDE = 10.0, 3
FLAG_PX, FLAG_SHARE = 16.0, 0.6
"""The legs of the filled corner of a wrong class, and their most share of the box's shorter side."""


def draw_detection(canvas: Canvas, box: Box, colour: Colour, outcome: Outcome, weight: float = 1.5) -> None:
    """Draw a detection's box, in pixels of the picture.

    Solid if it fits its vessel, in long dashes if it does not, with a filled corner for a wrong class; crossed out and
    in short dashes if it is a false positive.
    """
    if outcome & Outcome.FALSE_POSITIVE:
        canvas.crossed(box, colour)
        canvas.dashed_box(box, colour, weight)
    elif outcome & Outcome.BELOW_HALF_IOU:
        side = max(box[2] - box[0], box[3] - box[1])  # also a small box has dashes and gaps
        canvas.dashed_box(box, colour, weight, min(LONG_DASH_PX, side / (2 * DASHES_A_SIDE - 1) / canvas.unit))
    else:
        canvas.box(box, colour, weight)
    if outcome & Outcome.MISLABELLED:
        _draw_flag(canvas, box)


def _draw_flag(canvas: Canvas, box: Box) -> None:
    """Fill the upper right corner of a box."""
    x0, y0, x1, y1 = box
    leg = max(5.0, min(FLAG_PX * canvas.unit, FLAG_SHARE * min(x1 - x0, y1 - y0)))
    canvas.draw.polygon([(x1 - leg, y0), (x1, y0), (x1, y0 + leg)], fill=palette.ALARM, outline=palette.INK)


def draw_tether(canvas: Canvas, box: Box, true_box: Box) -> None:
    """Draw a line from the centre of a detection's box to the box of its vessel, which it does not touch."""
    x, y = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
    end = (min(max(x, true_box[0]), true_box[2]), min(max(y, true_box[1]), true_box[3]))
    canvas.segments(np.array([[(x, y), end]]), palette.ALARM, 0.75)
    radius = max(2.0, 3.0 * canvas.unit)
    canvas.draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=palette.ALARM)
