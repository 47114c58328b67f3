"""One picture of one frame: the window of the image that matters, truth and detections drawn on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from modsim3d.block import Frame
from modsim3d.frames import Array
from modsim3d.view import palette
from modsim3d.view.palette import Colour

Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class Window:
    """A part of the image, and how large to draw it.

    Attributes:
        x: Column of its left edge.
        y: Row of its top edge.
        scale: Picture pixels for one image pixel.
        size: Width and height of the picture.
    """

    x: float
    y: float
    scale: float
    size: tuple[int, int]

    @classmethod
    def around(cls, focus_px: Box, image_size_px: tuple[int, int], size: tuple[int, int]) -> Window:
        """A window with the picture's aspect that shows a box with its surroundings, inside the image if it fits."""
        aspect = size[0] / size[1]
        width = max(5.0 * (focus_px[2] - focus_px[0]), 5.0 * (focus_px[3] - focus_px[1]) * aspect, 240.0)
        width = min(width, image_size_px[0], image_size_px[1] * aspect)
        corner = []
        for low, high, span, limit in (
            (focus_px[0], focus_px[2], width, image_size_px[0]),
            (focus_px[1], focus_px[3], width / aspect, image_size_px[1]),
        ):
            corner.append(min(max((low + high - span) / 2, 0.0), max(limit - span, 0.0)))
        return cls(corner[0], corner[1], size[0] / width, size)

    def to_picture(self, points_px: Array) -> Array:
        """Picture coordinates of image points, shape (..., 2)."""
        return (points_px - (self.x, self.y)) * self.scale


def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """The font that Pillow carries, so that pictures are the same everywhere."""
    return ImageFont.load_default(size)


def background(window: Window, sea_half_plane: Array, ids: NDArray[np.uint32] | None) -> Image.Image:
    """Sky, sea and vessels of a window.

    Args:
        window: What to show.
        sea_half_plane: (a, b, c) of the horizon.
        ids: Vessel index + 1 at each pixel of the whole image, or None to show no vessels.
    """
    width, height = window.size
    columns = window.x + (np.arange(width) + 0.5) / window.scale
    rows = window.y + (np.arange(height) + 0.5) / window.scale
    a, b, c = sea_half_plane
    sea = a * columns[None, :] + b * rows[:, None] + c >= 0
    picture = np.where(sea[..., None], np.array(palette.SEA, dtype=np.uint8), np.array(palette.SKY, dtype=np.uint8))
    if ids is not None:
        i = np.clip(rows.astype(int), 0, ids.shape[0] - 1)
        j = np.clip(columns.astype(int), 0, ids.shape[1] - 1)
        shown = ids[np.ix_(i, j)]
        for vessel in np.unique(shown[shown > 0]):
            picture[shown == vessel] = palette.darker(palette.vessel_colour(int(vessel) - 1))
        picture[(rows < 0) | (rows >= ids.shape[0])] = palette.PAPER
        picture[:, (columns < 0) | (columns >= ids.shape[1])] = palette.PAPER
    return Image.fromarray(picture)


def draw_frame(picture: Image.Image, window: Window, frame: Frame, vessels: Sequence[str]) -> None:
    """Draw truth, detections, misses and false positives of a frame.

    Args:
        picture: From `background`.
        window: The same.
        frame: What to draw.
        vessels: IDs of the scene's vessels, for their colours.
    """
    draw = ImageDraw.Draw(picture)
    truth, detections = frame.truth, frame.detections
    for i in range(len(truth)):
        if truth.annotated[i]:
            missed = not truth.detected[i]
            _box(draw, window, truth.boxes_px[i], palette.ALARM if missed else palette.TRUTH, 2)
            if missed:
                _label(draw, window, truth.boxes_px[i], f"{truth.vessels[i]} missed", palette.ALARM, below=True)
        if not truth.annotated[i] or not np.array_equal(truth.full_boxes_px[i], truth.boxes_px[i]):
            _dashed(draw, window, truth.full_boxes_px[i], palette.TRUTH)
    for i in range(len(detections)):
        source = detections.vessels[i]
        colour = palette.ALARM if source is None else palette.vessel_colour(vessels.index(source))
        text = f"{detections.labels[i]} {detections.confidence[i]:.2f}"
        if source is None:
            _dashed(draw, window, detections.boxes_px[i], colour, width=3)
            text = f"false: {text}"
        else:
            _box(draw, window, detections.boxes_px[i], colour, 3)
        _label(draw, window, detections.boxes_px[i], text, colour)


def _corners(window: Window, box_px: Array) -> Box:
    (x0, y0), (x1, y1) = window.to_picture(np.reshape(box_px, (2, 2)))
    return float(x0), float(y0), max(float(x1) - 1, float(x0)), max(float(y1) - 1, float(y0))


def outline_box(
    draw: ImageDraw.ImageDraw, window: Window, box_px: Array, colour: Colour, width: int, *, dashed: bool
) -> None:
    """A box as an outline, solid or dashed."""
    (_dashed if dashed else _box)(draw, window, box_px, colour, width)


def _box(draw: ImageDraw.ImageDraw, window: Window, box_px: Array, colour: Colour, width: int) -> None:
    draw.rectangle(_corners(window, box_px), outline=colour, width=width)


def _dashed(draw: ImageDraw.ImageDraw, window: Window, box_px: Array, colour: Colour, width: int = 2) -> None:
    x0, y0, x1, y1 = _corners(window, box_px)
    dash = 7.0
    for (ax, ay), (bx, by) in (
        ((x0, y0), (x1, y0)),
        ((x0, y1), (x1, y1)),
        ((x0, y0), (x0, y1)),
        ((x1, y0), (x1, y1)),
    ):
        length = max(abs(bx - ax), abs(by - ay))
        for start in np.arange(0, length, 2 * dash):
            stop = min(start + dash, length)
            from_, to = start / length, stop / length
            draw.line(
                (ax + (bx - ax) * from_, ay + (by - ay) * from_, ax + (bx - ax) * to, ay + (by - ay) * to),
                fill=colour,
                width=width,
            )


def _label(
    draw: ImageDraw.ImageDraw, window: Window, box_px: Array, text: str, colour: Colour, below: bool = False
) -> None:
    """Text on a plate of its colour, above or below a box, inside the picture; nothing if the box is outside it."""
    x0, y0, x1, y1 = _corners(window, box_px)
    width, height = window.size
    if x1 < 0 or y1 < 0 or x0 > width or y0 > height:
        return
    used = font(15)
    left, top, right, bottom = draw.textbbox((0, 0), text, font=used)
    w, h = right - left + 8, bottom - top + 8
    x = min(max(x0, 0), width - w)
    y = min(max(y1 + 2 if below else y0 - h - 1, 0), height - h)
    draw.rectangle((x, y, x + w, y + h), fill=colour)
    draw.text((x + 4 - left, y + 4 - top), text, fill=palette.INK, font=used)
