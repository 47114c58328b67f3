"""frame.plot(): it is the picture of the films with axes around it, and no plotting library is imported before."""

import pickle
import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.offsetbox import AnnotationBbox

import modsim3d
from modsim3d import CameraView, ModsimError, Window, frame_picture, load_scene, simulate_frames
from modsim3d.render.id_pass import PlainIds
from modsim3d.runs.counts import Outcome, frame_outcomes
from modsim3d.view import frame_plot
from modsim3d.view.pictures.layers import DETECTIONS, NAMES, WEATHER
from modsim3d.view.pictures.plain import below_horizon
from tests.scenes import mistaken_strait


@pytest.fixture(scope="module")
def frame():
    """With a missed vessel and a false positive."""
    frames = simulate_frames(load_scene("harbour", mode=2, seed=3, steps=200, source="rectangles"))
    return next(f for f in frames if np.any(f.truth.annotated & ~f.truth.detected) and None in f.detections.vessels)


def drawn(figure: Figure) -> FigureCanvasAgg:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return canvas


@pytest.mark.parametrize("labels", [True, False])
def test_plot_is_the_picture_of_the_films(frame, labels):
    figure = frame.plot(labels=labels)
    pixels, area = np.asarray(drawn(figure).buffer_rgba())[..., :3], figure.axes[0].bbox
    size = round(area.width), round(area.height)
    layers = DETECTIONS if labels else DETECTIONS.without("labels", "fractions")
    window = Window(0.0, 0.0, size[0] / frame.image_size_px[0], size)
    nominal_px = round(1280 / 15 * 8 * figure.dpi / 72)  # text of 8 points
    view = CameraView.of(frame.scene, frame)
    picture = np.asarray(frame_picture(view, window, layers, PlainIds(), nominal_width_px=nominal_px))
    left, top = round(area.x0), len(pixels) - round(area.y0) - size[1]
    same = pixels[top : top + size[1], left : left + size[0]] == picture
    assert isinstance(figure, Figure) and same[3:-3, 3:-3].all()  # without the axes' own lines


def test_the_legend_names_what_is_wrong_in_the_frame(tmp_path, monkeypatch):
    drawn, legend = [], frame_plot.legend
    monkeypatch.setattr(frame_plot, "legend", lambda entries, *rest: drawn.append(entries) or legend(entries, *rest))
    frames = list(simulate_frames(load_scene(mistaken_strait(tmp_path))))
    for flag in Outcome:
        marked = next(f for f in frames if any(o & flag for o in frame_outcomes(f)))
        every = set(frame_outcomes(marked))
        marked.plot()
        expected = {NAMES[each] for each in Outcome if any(each & other for other in every)}
        named = {entry.text for entry in drawn[-1]} & set(NAMES.values())
        assert named == expected | {NAMES[Outcome.FALSE_POSITIVE]}


@pytest.mark.parametrize("zoom", [False, True])
def test_the_image_or_every_vessel_fills_the_figure_above_the_legend(frame, zoom):
    figure, (width, height), boxes = frame.plot(zoom=zoom), frame.image_size_px, frame.truth.full_boxes_px
    axes, image = figure.axes[0], figure.axes[0].bbox
    assert axes.get_title() == f"{frame.camera}, {frame.timestamp} s, detector {frame.state} ({WEATHER})"
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    if zoom:
        assert left <= boxes[:, 0].min() and right >= boxes[:, 2].max() and bottom - top < height
        assert top <= boxes[:, 1].min() and bottom >= boxes[:, 3].max()
    else:
        assert (left, right, bottom, top) == (0, width, height, 0)
    (key,) = (artist for artist in axes.artists if isinstance(artist, AnnotationBbox))
    place = key.get_window_extent(drawn(figure).get_renderer())
    assert -1 < place.y0 < place.y1 < image.y0
    assert image.width > 0.8 * figure.bbox.width and figure.bbox.height - image.height < 1.5 * figure.dpi


def test_a_pickled_frame_draws_itself_and_one_without_scene_or_matplotlib_says_what_it_needs(frame, monkeypatch):
    assert pickle.loads(pickle.dumps(frame)).plot().axes
    with pytest.raises(ModsimError, match="simulate_frames"):
        replace(frame, scene=None).plot()
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.delitem(sys.modules, "modsim3d.view.frame_plot")
    assert modsim3d.plot_frame.__doc__, "help(modsim3d) looks at every name"
    with pytest.raises(ModsimError, match=r"modsim3d\[view\]"):
        frame.plot()


def test_plot_draws_on_axes_that_it_is_given_also_of_a_figure_within_a_figure(frame):
    figure = Figure()
    whole, part = figure.subfigures(1, 2)
    (left, right), other = part.subplots(1, 2), whole.subplots()
    assert frame.plot(right) is frame.plot(other) is figure
    assert [len(axes.artists) for axes in (left, right, other)] == [0, 2, 2]


def test_part_of_the_image_below_the_horizon_has_the_area_that_it_should():
    corners = np.array([[0, 0], [10, 0], [10, 100], [0, 100]], dtype=float)
    for plane, area in (((0, 1, -30), 700), ((0, -1, 30), 300), ((0, 0, 1), 1000), ((0, 0, -1), 0)):
        x, y = below_horizon(corners, corners, np.array(plane, dtype=float)).T
        assert abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / 2 == pytest.approx(area), plane
        assert ((y >= 0) & (y <= 100)).all(), plane
