"""Places labels so that none lies on another."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from modsim3d.arrays import Array
from modsim3d.boxes import areas, intersections
from modsim3d.view.palette import INK, Colour
from modsim3d.view.pictures.canvas import Canvas
from modsim3d.view.pictures.window import Box

FARTHEST_ROWS = 16
"""How many rows of text a label may move away from its box."""
NEAR_COST, ROW_COST, SHIFT_COST = 0.06, 0.05, 0.1
"""Of the next best place at a box, of a row away from it, of a shift by half a plate; 1 is to cover a boat."""
SHORTENED_FROM, LEFT_OUT_FROM = 0.3, 0.9
"""A text is shortened if that saves so much, and an optional one is left out if it costs so much."""


@dataclass(frozen=True)
class Label:
    """A text on a coloured plate for a box in pixels of the picture, best placed above the box or below it.

    `short` is written instead where the text would cover too much; a label without it is never shortened. An `optional`
    label is left out there.
    """

    box: Box
    text: str
    colour: Colour
    below: bool = False
    short: str = ""
    optional: bool = False


def draw_labels(canvas: Canvas, labels: list[Label], keep_clear: list[Box]) -> int:
    """Draw labels, the most important ones first, and return how many have found a free place.

    They cover the boxes in `keep_clear` as little as possible.
    """
    size = np.array(canvas.picture.size)
    plates = np.empty((0, 4))
    chosen: list[tuple[Label, str, Array]] = []
    content = np.array(keep_clear, dtype=np.float64).reshape(-1, 4)
    for label in labels:
        x0, y0, x1, y1 = label.box
        if x1 < 0 or y1 < 0 or x0 > size[0] or y0 > size[1]:
            continue
        text = label.text
        cost, place = _best(label, canvas.plate_size(text), size, content, plates)
        if label.short and cost > SHORTENED_FROM:
            less, other = _best(label, canvas.plate_size(label.short), size, content, plates)
            if cost - less > SHORTENED_FROM:
                text, cost, place = label.short, less, other
        if cost < (LEFT_OUT_FROM if label.optional else np.inf):
            chosen.append((label, text, place))
            plates = np.vstack([plates, place])
    for label, _, place in chosen:  # lines before plates: none crosses a text
        _lead(canvas, label, place)
    for label, text, place in chosen:
        canvas.plate(round(float(place[0])), round(float(place[1])), text, label.colour)
    return len(chosen)


def _best(label: Label, plate: tuple[int, int], size: Array, content: Array, plates: Array) -> tuple[float, Array]:
    """The cost of the best free place for a plate, infinite if there is none, and the place, shape (4,)."""
    places, cost = _places(label, np.array(plate), size)
    if not len(places):
        return np.inf, np.empty(4)
    areas_px = np.clip(areas(content), 1, areas(places[0]))
    cost = cost + (intersections(places[:, None], content) / areas_px).sum(axis=1)
    cost[(intersections(places[:, None], plates) > 0).any(axis=1)] = np.inf
    best = int(np.argmin(cost))
    return float(cost[best]), places[best]


def _places(label: Label, plate: Array, size: Array) -> tuple[Array, Array]:
    """Boxes where a label may stand, all inside the picture, shape (k, 4), and what each costs, shape (k,)."""
    x0, y0, x1, y1 = label.box
    w, h = plate.tolist()
    gap = 2
    if w > size[0] or h > size[1]:
        return np.empty((0, 4)), np.empty(0)
    over, under = y0 - h - gap, y1 + gap
    near = [(x0, over), (x1 - w, over), (x0, under), (x1 - w, under)]
    if label.below:
        near = near[2:] + near[:2]
    near += [(x1 + gap, y0), (x0 - w - gap, y0), (x1 + gap, y1 - h), (x0 - w - gap, y1 - h)]
    if w < (x1 - x0) / 2 and h < (y1 - y0) / 3:
        near.append((x0 + gap, y0 + gap))
    row, shift, side = _STEPS.T
    away_x = np.where(shift < 0, x0 + shift * w / 2, np.where(shift > 0, x1 - w + shift * w / 2, (x0 + x1 - w) / 2))
    away_y = np.where(side < 0, over - row * (h + gap), under + row * (h + gap))
    corners = np.concatenate([near, np.stack([away_x, away_y], axis=1)])
    near_cost = NEAR_COST * np.arange(len(near))
    cost = np.concatenate([near_cost, near_cost[-1] + ROW_COST * row + SHIFT_COST * np.abs(shift)])
    # Along an edge of the picture a label slides in, as long as it still touches its box.
    moved = np.rint(np.clip(corners, 0, size - plate))
    return np.concatenate([moved, moved + plate], axis=1), cost


_STEPS = np.array(list(product(range(1, FARTHEST_ROWS + 1), range(-2, 3), (-1, 1))))
"""Rows away from the box, shifts by half a plate, and the side: -1 above, 1 below."""


def _lead(canvas: Canvas, label: Label, place: Array) -> None:
    """A line from a label to its box, if it does not touch it."""
    x0, y0, x1, y1 = label.box
    left, top, right, bottom = place.tolist()
    start = np.array([min(max((left + right) / 2, x0), x1), min(max((top + bottom) / 2, y0), y1)])
    end = np.array([min(max(start[0], left), right), min(max(start[1], top), bottom)])
    if np.abs(end - start).max() > 4:
        line = np.array([[start, end]])
        canvas.segments(line, INK, 1.0)  # the line may cross a vessel of its own colour
        canvas.segments(line, label.colour, 0.5)
