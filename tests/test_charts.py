"""Charts in pages: what is drawn stays inside its axes, and is the same in each process."""

import os
import re
import subprocess
import sys

import numpy as np

from modsim3d.view.learn_figures import error_scatter


def test_an_ellipse_stays_inside_the_axes():
    rng = np.random.default_rng(0)
    groups = {"many": rng.normal(0, 1, (5000, 2)), "few": rng.normal(0, 1, (40, 2)) * (6, 1)}
    svg = error_scatter(groups, "e_x", "e_y", "errors")
    grid = [float(place) for place in re.findall(r'd="M([\d.]+) [\d.]+V', svg)]
    apart = grid[1] - grid[0]
    ellipses = re.findall(r'<polyline points="([^"]+)"', svg)
    assert len(ellipses) == 2
    for points in ellipses:
        across = [float(pair.split(",")[0]) for pair in points.split()]
        assert grid[0] - apart < min(across) and max(across) < grid[-1] + apart


def test_a_drawing_is_the_same_in_each_process():
    script = "from modsim3d.view.charts import Axes\nprint(Axes((0, 1), (0, 1)).drawing('', 'a title', 'x', 'y'))"
    drawn = {
        subprocess.run(
            [sys.executable, "-c", script], env={**os.environ, "PYTHONHASHSEED": seed}, capture_output=True, check=True
        ).stdout
        for seed in ("1", "2")
    }
    assert len(drawn) == 1
