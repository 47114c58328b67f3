"""Charts in pages: what is drawn stays inside its axes, and is the same in each process."""

import re

import numpy as np

from modsim3d.view import palette
from modsim3d.view.pages import charts
from modsim3d.view.pages.charts import Axes, error_scatter, precision_recall, timeline


def test_an_ellipse_stays_inside_the_axes():
    rng = np.random.default_rng(0)
    groups = {"many": rng.normal(0, 1, (5000, 2)), "few": rng.normal(0, 1, (40, 2)) * (6, 1)}
    svg = error_scatter(groups, ["red", "blue"], "e_x", "e_y")
    left, width = (float(re.search(rf'<rect[^>]* {name}="([\d.]+)"', svg).group(1)) for name in ("x", "width"))
    ellipses = re.findall(r'<polyline points="([^"]+)"', svg)
    assert len(ellipses) == 2
    for points in ellipses:
        across = [float(pair.split(",")[0]) for pair in points.split()]
        assert left < min(across) and max(across) < left + width


def test_a_drawing_is_the_same_in_each_process(monkeypatch):
    monkeypatch.setattr(charts, "hash", None, raising=False)  # that of a text differs from process to process
    assert len({Axes((0, 1), (0, 1)).drawing("", "a title", "x", "y") for _ in range(2)}) == 1


def points(svg):
    text = re.search(r'<polyline points="([^"]*)"', svg).group(1)
    return np.array([part.split(",") for part in text.split()], dtype=float)


def test_a_curve_is_drawn_where_it_moves_however_many_false_detections_follow():
    recall = np.concatenate([np.linspace(0.002, 0.8, 400), np.full(200_000, 0.8)])
    precision = np.concatenate([1 - 0.2 * np.linspace(0, 1, 400) ** 2, 320 / np.arange(400, 200_400)])
    drawn = points(precision_recall({"usual": (recall, precision)}, ["red"]))
    assert len(drawn) <= 802 and np.abs(np.diff(drawn, axis=0)).max() < 5  # of 374 by 252
    axes = Axes((0, 1), (0, 1.02))
    for end in (0, -1):
        np.testing.assert_allclose(drawn[end], axes.place(recall[end], precision[end]), atol=0.06)
    assert len(points(precision_recall({"one point": (np.array([0.5]), np.array([1.0]))}, ["red"]))) == 1


def test_states_have_the_ramp_of_the_palette_on_a_timeline():
    svg = timeline(np.array([0.0, 3.0]), np.array([3.0, 5.0]), [2, 0], ["excellent", "good", "bad"])
    drawn = re.findall(r'<rect[^>]*fill="color-mix\(in srgb, (#[0-9a-f]{6})', svg)
    first, _, last = map(palette.css, palette.state_colours(3))
    assert drawn == [last, first]
