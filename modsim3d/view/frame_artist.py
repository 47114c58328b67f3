"""A frame within the axes of a matplotlib figure."""

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase

from modsim3d.render.id_pass import PlainIds
from modsim3d.view.pictures.canvas import NOMINAL_PX, TEXT_PX, Window
from modsim3d.view.pictures.frame_picture import CameraView, frame_picture
from modsim3d.view.pictures.layers import Layers

TEXT_PT, POINTS_PER_IN = 8, 72


class FrameArtist(Artist):
    """Draws layers of a frame as large as its axes are at the time, so that no pixel of the picture is resampled."""

    def __init__(self, axes: Axes, camera_view: CameraView, layers: Layers) -> None:
        """Take what to draw, and the axes that it fills."""
        super().__init__()
        self.set_zorder(0)
        self._axes, self._camera_view, self._layers = axes, camera_view, layers

    def draw(self, renderer: RendererBase) -> None:
        """Draw the part of the image that the axes show."""
        area, detail = self._axes.bbox, float(renderer.get_image_magnification())
        (left, right), (_, top) = self._axes.get_xlim(), self._axes.get_ylim()
        size = max(1, round(area.width * detail)), max(1, round(area.height * detail))
        window = Window(left, top, size[0] / (right - left), size)
        # A text of TEXT_PX in a picture of nominal width is to be TEXT_PT high.
        pixels_per_point = detail * self._axes.figure.figure.dpi / POINTS_PER_IN
        nominal_px = round(NOMINAL_PX * TEXT_PT * pixels_per_point / TEXT_PX)
        picture = frame_picture(self._camera_view, window, self._layers, PlainIds(), nominal_width_px=nominal_px)
        context = renderer.new_gc()
        renderer.draw_image(context, area.x0, area.y0, np.asarray(picture.convert("RGBA"))[::-1])
        context.restore()
