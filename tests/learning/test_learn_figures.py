from __future__ import annotations

import re

import numpy as np

from modsim3d.view.learn_figures import precision_recall


def points(svg):
    text = re.search(r'<polyline points="([^"]*)"', svg).group(1)
    return np.array([part.split(",") for part in text.split()], dtype=float)


def test_a_curve_is_drawn_where_it_moves_however_many_false_detections_follow():
    recall = np.concatenate([np.linspace(0.002, 0.8, 400), np.full(200_000, 0.8)])
    precision = np.concatenate([1 - 0.2 * np.linspace(0, 1, 400) ** 2, 320 / np.arange(400, 200_400)])
    drawn = points(precision_recall({"usual": (recall, precision)}, "boats"))
    assert len(drawn) <= 802
    assert np.abs(np.diff(drawn, axis=0)).max() < 5  # of 390 by 260
    assert np.ptp(drawn[:, 0]) > 300 and np.ptp(drawn[:, 1]) > 250


def test_a_curve_of_one_point_is_drawn():
    assert len(points(precision_recall({"usual": (np.array([0.5]), np.array([1.0]))}, "boats"))) == 1
