"""The part of a camera's image that a picture shows, and how large."""

from __future__ import annotations

from dataclasses import dataclass

from modsim3d.arrays import Array

Box = tuple[float, float, float, float]
"""x_min, y_min, x_max, y_max in pixels."""
SURROUNDINGS = 4.0
"""How many times as wide and high as a box a window around it is."""


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
    def around(cls, focus_px: Box, image_size_px: tuple[int, int], size: tuple[int, int]) -> Window:
        """A window with the picture's aspect that shows a box with its surroundings, inside the image if it fits."""
        aspect = size[0] / size[1]
        width = max(
            SURROUNDINGS * (focus_px[2] - focus_px[0]), SURROUNDINGS * (focus_px[3] - focus_px[1]) * aspect, 240.0
        )
        width = min(width, image_size_px[0], image_size_px[1] * aspect)
        height = width / aspect
        x = min(max((focus_px[0] + focus_px[2] - width) / 2, 0.0), max(image_size_px[0] - width, 0.0))
        y = min(max((focus_px[1] + focus_px[3] - height) / 2, 0.0), max(image_size_px[1] - height, 0.0))
        return cls(x, y, size[0] / width, size)

    def to_picture(self, points_px: Array) -> Array:
        """Picture coordinates of image points, shape (..., 2)."""
        return (points_px - (self.x, self.y)) * self.scale

    def corners(self, box_px: Array) -> Box:
        """A box of shape (4,) in picture coordinates: x_min, y_min, x_max, y_max."""
        (x0, y0), (x1, y1) = self.to_picture(box_px.reshape(2, 2)).tolist()
        return x0, y0, x1, y1
