"""Lines, boxes and text on a picture, scaled to its width."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from modsim3d.core.arrays import Array
from modsim3d.core.boxes import areas
from modsim3d.view.palette import INK, WHITE, Colour, ink_on

Box = tuple[float, float, float, float]  # x_min, y_min, x_max, y_max in pixels
SURROUNDINGS = 4.0  # how many times as wide and high as a box a window around it is


@dataclass(frozen=True)
class Window:
    """A part of the image by its top-left corner, picture pixels for one image pixel, and the picture's size."""

    x: float
    y: float
    scale: float
    size: tuple[int, int]

    @classmethod
    def whole(cls, image_size_px: tuple[int, int], width: int) -> Window:
        """The whole image at a width; drawn at that size, never shrunk."""
        scale = width / image_size_px[0]
        return cls(0.0, 0.0, scale, (width, max(1, round(image_size_px[1] * scale))))

    @classmethod
    def around(
        cls, focus_px: Box, image_size_px: tuple[int, int], size: tuple[int, int], least_px: float = 240.0
    ) -> Window:
        """A window with the picture's aspect that shows a box with its surroundings, inside the image if it fits, and
        at least so many pixels of its width."""
        aspect, (x0, y0, x1, y1) = size[0] / size[1], focus_px
        width = max(SURROUNDINGS * (x1 - x0), SURROUNDINGS * (y1 - y0) * aspect, least_px)
        width = min(width, image_size_px[0], image_size_px[1] * aspect)
        height = width / aspect
        x = min(max((x0 + x1 - width) / 2, 0.0), max(image_size_px[0] - width, 0.0))
        y = min(max((y0 + y1 - height) / 2, 0.0), max(image_size_px[1] - height, 0.0))
        return cls(x, y, size[0] / width, size)

    def to_picture(self, points_px: Array) -> Array:
        """Picture coordinates of image points, shape (..., 2)."""
        return (points_px - (self.x, self.y)) * self.scale

    def corners(self, box_px: Array) -> Box:
        """A box of shape (4,) in picture coordinates: x_min, y_min, x_max, y_max."""
        (x0, y0), (x1, y1) = self.to_picture(box_px.reshape(2, 2)).tolist()
        return x0, y0, x1, y1


NOMINAL_PX = 1280  # width of a picture for which the sizes below are meant
TEXT_PX, MIN_TEXT_PX = 15, 11
SMALL_TEXT_PX = 11  # up to this size, words stand twice as far apart
LINE_PX = 2.0
ARROW_HEAD = 0.45  # length of an arrow's head, as a share of the arrow's
SMOOTH = 4  # slanted lines are drawn larger by this factor, in a small mask, and shrunk


@cache
def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """The font that comes with Pillow, so that pictures are the same everywhere."""
    return ImageFont.load_default(size)


@cache
def text_size(text: str, size: int) -> tuple[int, int, int, int]:
    """Bounding box of a text set at (0, 0): left, top, right and bottom in pixels."""
    left, top, right, bottom = font(size).getbbox(text)
    return int(left), int(top), int(right), int(bottom)


def words_apart(text: str, size: int) -> str:
    """A text with double spaces in a small size, where a space is as wide as the gap between two letters."""
    return text.replace(" ", "  ") if size <= SMALL_TEXT_PX else text


class Canvas:
    """Draws on one picture."""

    def __init__(self, picture: Image.Image, width_px: int | None = None) -> None:
        """Scale lines and text for a picture of a width in pixels; its own if None."""
        self.picture, self.draw = picture, ImageDraw.Draw(picture)
        self.unit = (width_px or picture.width) / NOMINAL_PX
        self.text_px = max(MIN_TEXT_PX, round(TEXT_PX * self.unit))
        self._pad = max(2, round(self.text_px * 0.27))

    def line_px(self, weight: float = 1.0) -> int:
        """Thickness of a line of a weight, at least one pixel."""
        return max(1, round(LINE_PX * weight * self.unit))

    def _on_picture(self, box: Box, width: int) -> tuple[int, int, int, int] | None:
        """A box in whole pixels, cut just outside the picture; None if it is not to be seen."""
        x0, y0, x1, y1 = (round(side) for side in box)
        w, h = self.picture.size
        x0, y0, x1, y1 = max(x0, -2 * width), max(y0, -2 * width), min(x1 - 1, w + width), min(y1 - 1, h + width)
        return (x0, y0, max(x1, x0), max(y1, y0)) if x1 >= 0 and y1 >= 0 and x0 < w and y0 < h else None

    def box(self, box: Box, colour: Colour, weight: float = 1.0, *, halo: bool = False) -> None:
        """A box as an outline; a halo keeps it apart from a background of its own colour."""
        width = self.line_px(weight)
        if (corners := self._on_picture(box, width)) is None:
            return
        if halo:
            x0, y0, x1, y1 = corners
            self.draw.rectangle((x0 - 1, y0 - 1, x1 + 1, y1 + 1), outline=INK, width=1)
        self.draw.rectangle(corners, outline=colour, width=width)

    def dashed_box(self, box: Box, colour: Colour, weight: float = 1.0, dash_px: float = 7.0) -> None:
        """A box as a dashed outline; dashes begin at its corners."""
        width = self.line_px(weight)
        if (corners := self._on_picture(box, width)) is None:
            return
        x0, y0, x1, y1 = corners
        dash = max(2, round(dash_px * max(self.unit, 0.6)))
        for x in range(x0, x1 + 1, 2 * dash):
            end = min(x + dash - 1, x1)
            self.draw.rectangle((x, y0, end, min(y0 + width - 1, y1)), fill=colour)
            self.draw.rectangle((x, max(y1 - width + 1, y0), end, y1), fill=colour)
        for y in range(y0, y1 + 1, 2 * dash):
            end = min(y + dash - 1, y1)
            self.draw.rectangle((x0, y, min(x0 + width - 1, x1), end), fill=colour)
            self.draw.rectangle((max(x1 - width + 1, x0), y, x1, end), fill=colour)

    def brackets(self, box: Box, colour: Colour, weight: float = 1.0) -> None:
        """The four corners of a box, a little outside it."""
        width = self.line_px(weight)
        gap = 2 * width
        if (corners := self._on_picture((box[0] - gap, box[1] - gap, box[2] + gap, box[3] + gap), width)) is None:
            return
        x0, y0, x1, y1 = corners
        arm = max(2 * width, round(min(max(x1 - x0, y1 - y0) / 4, 18 * max(self.unit, 0.4))))
        for x, toward_x in ((x0, 1), (x1, -1)):
            for y, toward_y in ((y0, 1), (y1, -1)):
                for to_x, to_y in ((arm, width), (width, arm)):
                    far_x, far_y = x + toward_x * (to_x - 1), y + toward_y * (to_y - 1)
                    self.draw.rectangle((min(x, far_x), min(y, far_y), max(x, far_x), max(y, far_y)), fill=colour)

    def crossed(self, box: Box, colour: Colour, weight: float = 0.5) -> None:
        """The two diagonals of a box."""
        x0, y0, x1, y1 = box
        self.segments(np.array([[[x0, y0], [x1, y1]], [[x0, y1], [x1, y0]]]), colour, weight)

    def segments(self, segments: Array, colour: Colour, weight: float = 1.0) -> None:
        """Slanted lines without steps; their ends in pixels of the picture, shape (n, 2, 2)."""
        width = LINE_PX * weight * self.unit
        w, h = self.picture.size
        margin = width + 1
        kept = [cut for line in segments if (cut := _cut(line, (-margin, -margin, w + margin, h + margin))) is not None]
        if not kept:
            return
        lines = np.array(kept)
        low = np.maximum(np.floor(lines.min(axis=(0, 1)) - margin), 0).astype(int)
        high = np.minimum(np.ceil(lines.max(axis=(0, 1)) + margin), (w, h)).astype(int)
        size = np.maximum(high - low, 1)
        factor = SMOOTH if size.prod() < 200_000 else 2
        mask = Image.new("L", tuple((size * factor).tolist()))
        draw = ImageDraw.Draw(mask)
        for line in ((lines - low) * factor).reshape(-1, 4).tolist():
            draw.line(line, fill=255, width=max(1, round(max(width, 1.0) * factor)))
        self.picture.paste(colour, tuple(low.tolist()), mask.reduce(factor))

    def arrow(self, tip: tuple[float, float], direction: tuple[int, int], length: float) -> None:
        """A white arrow along one of the axes, in pixels of the picture."""
        (x, y), (right, down) = tip, direction
        head, shaft = ARROW_HEAD * length, ARROW_HEAD / 4 * length
        side = [(0.0, 0.0), (-head, 0.8 * head), (-head, shaft), (-length, shaft)]
        outline = [*side, *((along, -across) for along, across in reversed(side[1:]))]
        corners = [(x + right * along - down * across, y + down * along + right * across) for along, across in outline]
        self.draw.polygon(corners, fill=WHITE, outline=INK, width=max(1, self.line_px(0.75)))

    def plate_size(self, text: str) -> tuple[int, int]:
        """Width and height of a text on its plate."""
        left, top, right, bottom = text_size(words_apart(text, self.text_px), self.text_px)
        return right - left + 2 * self._pad, bottom - top + 2 * self._pad

    def plate(self, x: int, y: int, text: str, colour: Colour) -> None:
        """Text on a plate of a colour, its top-left corner at (x, y)."""
        self.picture.paste(_plate(text, colour, self.text_px, *self.plate_size(text)), (x, y))


@lru_cache(maxsize=1024)
def _plate(text: str, colour: Colour, text_px: int, width: int, height: int) -> Image.Image:
    """Text in the middle of a plate; a film shows the same ones again and again."""
    plate, text = Image.new("RGB", (width, height), colour), words_apart(text, text_px)
    left, top, right, bottom = text_size(text, text_px)
    place = (width - (right - left)) // 2 - left, (height - (bottom - top)) // 2 - top
    ImageDraw.Draw(plate).text(place, text, fill=ink_on(colour), font=font(text_px))
    return plate


def _cut(line: Array, box: Box) -> Array | None:
    """The part of a segment (2, 2) inside a box (Liang & Barsky, 1984); None if there is none or an end is NaN."""
    if not np.isfinite(line).all():
        return None
    start, step = line[0], line[1] - line[0]
    first, last = 0.0, 1.0
    for axis in (0, 1):
        for sign, limit in ((-1, -box[axis]), (1, box[axis + 2])):
            slope, room = sign * step[axis], limit - sign * start[axis]
            if slope == 0:
                if room < 0:
                    return None
            elif slope > 0:
                last = min(last, room / slope)
            else:
                first = max(first, room / slope)
    return np.array([start + first * step, start + last * step]) if first <= last else None


MAX_ROWS_AWAY = 16  # of text that a label may move away from its box
GAP_PX = 2
COLUMN_COST, OTHER_SIDE_COST, ROW_COST = 0.03, 0.1, 0.06
"""Of the next best column, of the other side of the box, and of a row away from it; to cover a boat costs 1."""
SHORTENED_FROM, LEFT_OUT_FROM = 0.3, 0.9  # a text is shortened, and an optional one left out, if that saves so much


@dataclass(frozen=True)
class Label:
    """A text on a coloured plate for a box in pixels of the picture, best placed above the box or below it."""

    box: Box
    text: str
    colour: Colour
    below: bool = False
    short: str = ""  # written instead where the text would cover too much; never if empty
    optional: bool = False  # left out where it would cover too much
    vessel: str | None = None  # that it is about, None for a false positive or a track


def draw_labels(canvas: Canvas, labels: list[Label], keep_clear: list[Box]) -> int:
    """Draw labels, optional ones last, and return how many have found a free place. Those of vessels are placed first,
    in an order that stays from frame to frame, and by widths in steps, so that a label keeps its place beside its box.
    Labels cover the boxes in `keep_clear` as little as possible."""
    size = np.array(canvas.picture.size)
    plates = np.empty((0, 4))
    chosen: list[tuple[Label, str, Array]] = []
    content = np.array(keep_clear, dtype=np.float64).reshape(-1, 4)

    def room(text: str) -> tuple[int, int]:
        width, height = canvas.plate_size(text)
        return -(-width // height) * height, height

    for label in sorted(
        labels, key=lambda label: (label.optional, label.vessel is None, label.vessel or "", label.below)
    ):
        x0, y0, x1, y1 = label.box
        if x1 < 0 or y1 < 0 or x0 > size[0] or y0 > size[1]:
            continue
        text = label.text
        cost, place = _best(label, room(text), size, content, plates)
        if label.short and cost > SHORTENED_FROM:
            less, other = _best(label, room(label.short), size, content, plates)
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
    away = (height + GAP_PX) * np.arange(1 + MAX_ROWS_AWAY)
    above, below = y0 - height - GAP_PX - away, y1 + GAP_PX + away
    first, second = (below, above) if label.below else (above, below)
    distance: Array = ROW_COST * np.arange(1.0 + MAX_ROWS_AWAY)
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
