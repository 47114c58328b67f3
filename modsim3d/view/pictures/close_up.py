"""An arrow at a box, and a small picture of where in the image a part of it is."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from modsim3d.core.arrays import Array
from modsim3d.core.boxes import areas, intersections
from modsim3d.render.id_pass import AnyIdRenderer
from modsim3d.view import palette
from modsim3d.view.pictures.canvas import ARROW_HEAD, NOMINAL_PX, Box, Canvas, Window
from modsim3d.view.pictures.frame_picture import CameraView, frame_picture
from modsim3d.view.pictures.layers import Layers
from modsim3d.view.pictures.plain import background

ARROW_PX, ARROW_GAP_PX = 42.0, 6.0  # in a picture of nominal width
MIN_FRAME_PX = 9  # of the frame around a window in an inset
Arrow = tuple[tuple[float, float], tuple[int, int]]  # tip and direction


def close_up(
    camera_view: CameraView,
    window: Window,
    focus_px: Array,
    layers: Layers,
    id_renderer: AnyIdRenderer,
    *,
    clear_of: Sequence[Array] = (),
    **options: Any,
) -> Image.Image:
    """Layers of a frame, as `frame_picture` draws them with the options, and an arrow at a box in pixels of the image,
    from the side on which it covers least of some other boxes in the image."""
    nominal = options.get("nominal_width_px") or window.size[0]
    length = ARROW_PX * nominal / NOMINAL_PX
    arrow = _arrow(window.corners(focus_px), [window.corners(box) for box in clear_of], window.size, length)
    options["keep_clear"] = [*options.get("keep_clear", ()), _place(*arrow, length)]
    picture = frame_picture(camera_view, window, layers, id_renderer, **options)
    Canvas(picture, nominal).arrow(*arrow, length)
    return picture


def _arrow(focus: Box, boxes: list[Box], size: tuple[int, int], length: float) -> Arrow:
    """The arrow at a box, in pixels of a picture of a size."""
    width, height = size
    x0, y0, x1, y1 = max(focus[0], 0.0), max(focus[1], 0.0), min(focus[2], width), min(focus[3], height)
    x, y, gap = (x0 + x1) / 2, (y0 + y1) / 2, ARROW_GAP_PX * length / ARROW_PX
    beside: list[Arrow] = [((x0 - gap, y), (1, 0)), ((x1 + gap, y), (-1, 0))]
    arrows: list[Arrow] = [((x, y0 - gap), (0, 1)), ((x, y1 + gap), (0, -1)), *beside]
    places = np.array([_place(*arrow, length) for arrow in arrows])
    outside = areas(places) - intersections(places, np.array([0.0, 0.0, width, height]))
    covered = intersections(places[:, None], np.array(boxes).reshape(-1, 4)).sum(axis=1)
    return arrows[int(np.argmin(covered + 100 * outside))]


def _place(tip: tuple[float, float], direction: tuple[int, int], length: float) -> Box:
    """The box that an arrow fills."""
    (x, y), (right, down), half = tip, direction, 0.8 * ARROW_HEAD * length
    ends = np.array([[x, y], [x - right * length, y - down * length]])
    (x0, y0), (x1, y1) = ends.min(axis=0).tolist(), ends.max(axis=0).tolist()
    return (x0, y0 - half, x1, y1 + half) if right else (x0 - half, y0, x1 + half, y1)


def inset_of(camera_view: CameraView, window: Window, room: tuple[int, int]) -> Image.Image:
    """The whole image, small enough for some room, with the vessels as dots and a frame around the window."""
    image_size = camera_view.image_size_px
    whole = Window.whole(image_size, round(min(room[0], room[1] * image_size[0] / image_size[1])))
    inset = background(whole, camera_view.solids.sea_half_plane, image_size)
    draw = ImageDraw.Draw(inset)
    for box in camera_view.frame.truth.full_boxes_px:
        x, y = (box.reshape(2, 2).mean(axis=0) * whole.scale).tolist()
        draw.ellipse((x - 1.5, y - 1.5, x + 1.5, y + 1.5), fill=palette.VESSELS[3])
    low, shown = np.array([window.x, window.y]) * whole.scale, np.array(window.size) * whole.scale / window.scale
    grown = np.maximum(MIN_FRAME_PX - shown, 0) / 2
    corners = (*(low - grown).tolist(), *(low + shown + grown).tolist())
    draw.rectangle(corners, outline=palette.PAPER, width=2)
    return inset
