"""Places labels so that none lies on another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array
from modsim3d.boxes import areas, intersections
from modsim3d.view.palette import Colour
from modsim3d.view.pictures.canvas import Canvas
from modsim3d.view.pictures.window import Box

FARTHEST_ROWS = 4
"""How many rows of text a label may move away from its box."""


@dataclass(frozen=True)
class Label:
    """A text on a coloured plate for a box in pixels of the picture, best placed above the box or below it."""

    box: Box
    text: str
    colour: Colour
    below: bool = False


def draw_labels(canvas: Canvas, labels: list[Label], keep_clear: list[Box]) -> int:
    """Draw labels, the most important ones first, and return how many have found a free place.

    They cover the boxes in `keep_clear` as little as possible.
    """
    size = np.array(canvas.picture.size)
    plates = np.empty((0, 4))
    chosen: list[tuple[Label, Array]] = []
    content = np.array(keep_clear, dtype=np.float64).reshape(-1, 4)
    for label in labels:
        x0, y0, x1, y1 = label.box
        if x1 < 0 or y1 < 0 or x0 > size[0] or y0 > size[1]:
            continue
        places = _places(label, np.array(canvas.plate_size(label.text)), size)
        if not len(places):
            continue
        taken = (intersections(places[:, None], plates) > 0).any(axis=1)
        if taken.all():
            continue
        # A label next to its box is worth covering some of what else is there.
        plate = areas(places[0])
        covered = (intersections(places[:, None], content) / np.clip(areas(content), 1, plate)).sum(axis=1)
        cost = covered + 0.35 * np.arange(len(places)) / 6 + np.where(taken, np.inf, 0.0)
        best = places[int(np.argmin(cost))]
        chosen.append((label, best))
        plates = np.vstack([plates, best])
    for label, place in chosen:  # lines before plates: none crosses a text
        _lead(canvas, label, place)
    for label, place in chosen:
        canvas.plate(round(float(place[0])), round(float(place[1])), label.text, label.colour)
    return len(chosen)


def _places(label: Label, plate: Array, size: Array) -> Array:
    """Boxes where a label may stand, the best first, all inside the picture, shape (k, 4)."""
    x0, y0, x1, y1 = label.box
    w, h = plate.tolist()
    gap = 2
    if w > size[0] or h > size[1]:
        return np.empty((0, 4))
    over, under = y0 - h - gap, y1 + gap
    near = [(x0, over), (x1 - w, over), (x0, under), (x1 - w, under)]
    if label.below:
        near = near[2:] + near[:2]
    beside = [(x1 + gap, y0), (x0 - w - gap, y0), (x1 + gap, y1 - h), (x0 - w - gap, y1 - h)]
    away = [
        (x, y)
        for row in range(1, FARTHEST_ROWS + 1)
        for y in (over - row * (h + gap), under + row * (h + gap))
        for x in (x0, x1 - w)
    ]
    inside = [(x0 + gap, y0 + gap)] if w < (x1 - x0) / 2 and h < (y1 - y0) / 3 else []
    corners = np.array(near + beside + inside + away)
    # Along an edge of the picture a label slides in, as long as it still touches its box.
    moved = np.rint(np.clip(corners, 0, size - plate))
    return np.concatenate([moved, moved + plate], axis=1)


def _lead(canvas: Canvas, label: Label, place: Array) -> None:
    """A line from a label to its box, if it does not touch it."""
    x0, y0, x1, y1 = label.box
    left, top, right, bottom = place.tolist()
    start = np.array([min(max((left + right) / 2, x0), x1), min(max((top + bottom) / 2, y0), y1)])
    end = np.array([min(max(start[0], left), right), min(max(start[1], top), bottom)])
    if np.abs(end - start).max() > 4:
        canvas.segments(np.array([[start, end]]), label.colour, 0.5)
