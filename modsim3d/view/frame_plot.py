"""A frame as a matplotlib figure, for notebooks and papers: the picture of the films, with axes in pixels around it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from modsim3d.core.errors import ModsimError
from modsim3d.runs.counts import faults_of
from modsim3d.runs.frames import Frame
from modsim3d.scene.scene import Scene
from modsim3d.view.films.plan import part_around
from modsim3d.view.pictures.canvas import Box
from modsim3d.view.pictures.frame_picture import CameraView
from modsim3d.view.pictures.layers import DETECTIONS, WEATHER, Layers
from modsim3d.view.pictures.legend import detection_entries, legend

if TYPE_CHECKING:  # so that `modsim3d.plot_frame` can be looked at without matplotlib
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN, BESIDE_IN, ABOVE_AND_BELOW_IN = 9.0, 0.7, 1.2  # of a figure of its own, and around the image in it
AXIS_PT = 38  # distance from the image to the legend: there stand the axis's numbers and name
KEY_DETAIL = 3  # pixels of the legend for each point
MARGIN = 0.35  # around the boxes when zoomed in, as a share of their width and height


def plot_frame(frame: Frame, axes: Axes | None = None, *, zoom: bool = False, labels: bool = True) -> Figure:
    """Draw sea, sky, vessels, truth, detections, misses and false positives of a frame.

    Args:
        frame: The frame to draw.
        axes: Axes to draw on; those of a new figure if None.
        zoom: Show only the part of the image in which vessels are.
        labels: Write names, classes and confidences.

    Raises:
        ModsimError: The frame has no scene, or matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise ModsimError("frame.plot() needs matplotlib: pip install 'modsim3d[view]'") from None
    from modsim3d.view.frame_artist import FrameArtist

    if frame.scene is None:
        raise ModsimError("this frame has no scene to draw: take it from simulate_frames() or the frames() of a run")
    left, top, right, bottom = _shown(frame, zoom)
    if axes is None:
        height_in = (WIDTH_IN - BESIDE_IN) * (bottom - top) / (right - left) + ABOVE_AND_BELOW_IN
        axes = Figure(figsize=(WIDTH_IN, height_in), layout="constrained").add_subplot()
    # Rows run downwards, as in an image.
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", xlabel="column [px]", ylabel="row [px]")
    axes.set_title(f"{frame.camera}, {frame.timestamp} s, detector {frame.state} ({WEATHER})")
    layers = DETECTIONS if labels else DETECTIONS.without("labels", "fractions")
    axes.add_artist(FrameArtist(axes, CameraView.of(frame.scene, frame), layers))
    figure = axes.figure.figure  # the whole one, where the axes are in a part of it
    figure.draw_without_rendering()
    _add_legend(axes, frame, frame.scene, layers)
    return figure


def _add_legend(axes: Axes, frame: Frame, scene: Scene, layers: Layers) -> None:
    from matplotlib.offsetbox import AnnotationBbox, OffsetImage

    from modsim3d.view.frame_artist import POINTS_PER_IN, TEXT_PT

    width_pt = axes.bbox.width * POINTS_PER_IN / axes.figure.figure.dpi
    entries = detection_entries(layers, scene.annotation.mode, faults_of([frame]))
    strip = legend(entries, round(KEY_DETAIL * width_pt), KEY_DETAIL * TEXT_PT)
    key = OffsetImage(np.asarray(strip), zoom=1 / KEY_DETAIL)
    below: dict[str, Any] = {"xycoords": "axes fraction", "boxcoords": "offset points", "box_alignment": (0.5, 1.0)}
    axes.add_artist(AnnotationBbox(key, (0.5, 0.0), (0.0, -AXIS_PT), frameon=False, pad=0.0, **below))


def _shown(frame: Frame, zoom: bool) -> Box:
    true = np.array([vessel is not None for vessel in frame.detections.vessels], dtype=bool)
    boxes = np.concatenate([frame.truth.full_boxes_px, frame.detections.boxes_px[true]])
    if zoom:
        return part_around(boxes, frame.image_size_px, MARGIN)
    return 0.0, 0.0, float(frame.image_size_px[0]), float(frame.image_size_px[1])
