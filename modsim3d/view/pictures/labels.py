"""Places labels so that none lies on another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array
from modsim3d.boxes import areas
from modsim3d.view.palette import INK, Colour
from modsim3d.view.pictures.canvas import Canvas
from modsim3d.view.pictures.window import Box

FARTHEST_ROWS = 16
"""How many rows of text a label may move away from its box."""
GAP_PX = 2
COLUMN_COST, OTHER_SIDE_COST, ROW_COST = 0.03, 0.1, 0.06
"""Of the next best column, of the other side of the box, and of a row away from it; to cover a boat costs 1."""
SHORTENED_FROM, LEFT_OUT_FROM = 0.3, 0.9
"""A text is shortened if that saves so much, and an optional one is left out if it costs so much."""


@dataclass(frozen=True)
class Label:
    """A text on a coloured plate for a box in pixels of the picture, best placed above the box or below it.

    `short` is written instead where the text would cover too much; a label without it is never shortened. An `optional`
    label is left out there. `vessel` is the vessel that it is about, None for a false alarm or a track.
    """

    box: Box
    text: str
    colour: Colour
    below: bool = False
    short: str = ""
    optional: bool = False
    vessel: str | None = None


def draw_labels(canvas: Canvas, labels: list[Label], keep_clear: list[Box]) -> int:
    """Draw labels, the most important ones first, and return how many have found a free place.

    Optional ones are placed last. Labels cover the boxes in `keep_clear` as little as possible.
    """
    size = np.array(canvas.picture.size)
    plates = np.empty((0, 4))
    chosen: list[tuple[Label, str, Array]] = []
    content = np.array(keep_clear, dtype=np.float64).reshape(-1, 4)
    for label in sorted(labels, key=lambda label: label.optional):
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
    w, h = plate
    if w > size[0] or h > size[1]:
        return np.inf, np.empty(4)
    # Along an edge of the picture a label slides in, as long as it still touches its box.
    x, x_cost = _columns(label, w)
    y, y_cost = _rows(label, h)
    x, y = np.rint(np.clip(x, 0, size[0] - w)), np.rint(np.clip(y, 0, size[1] - h))
    covered = _common(x, w, content, 0) / np.clip(areas(content), 1, w * h) @ _common(y, h, content, 1).T
    cost = x_cost[:, None] + y_cost + covered
    cost[_common(x, w, plates, 0) @ _common(y, h, plates, 1).T > 0] = np.inf
    i, j = np.unravel_index(np.argmin(cost), cost.shape)
    return float(cost[i, j]), np.array([x[i], y[j], x[i] + w, y[j] + h])


def _columns(label: Label, width: int) -> tuple[Array, Array]:
    """Left edges that a label may have, and what each costs, shapes (k,)."""
    x0, _, x1, _ = label.box
    left, right = x0 - width - GAP_PX, x1 + GAP_PX
    edges = [x0, x1 - width, right, left, (x0 + x1 - width) / 2, x0 - width / 2, x1 - width / 2]
    return np.array(edges), COLUMN_COST * np.arange(float(len(edges)))


def _rows(label: Label, height: int) -> tuple[Array, Array]:
    """Top edges that a label may have, and what each costs, shapes (k,)."""
    _, y0, _, y1 = label.box
    away = (height + GAP_PX) * np.arange(1 + FARTHEST_ROWS)
    above, below = y0 - height - GAP_PX - away, y1 + GAP_PX + away
    first, second = (below, above) if label.below else (above, below)
    distance: Array = ROW_COST * np.arange(1.0 + FARTHEST_ROWS)
    costs = [distance, OTHER_SIDE_COST + distance, np.full(2, OTHER_SIDE_COST)]
    return np.concatenate([first, second, [y0, y1 - height]]), np.concatenate(costs)


def _common(starts: Array, length: int, boxes: Array, axis: int) -> Array:
    """Length that stretches of one length, n of them, have in common with m boxes along an axis, shape (n, m)."""
    ends = np.minimum(starts[:, None] + length, boxes[:, axis + 2])
    common: Array = np.maximum(ends - np.maximum(starts[:, None], boxes[:, axis]), 0.0)
    return common


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
