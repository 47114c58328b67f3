"""Logs of the strait's bow camera, whose detector's clock is late and which is not mounted as the scene says."""

from pathlib import Path

import numpy as np

from benchmarks.voyages.cases import SHOEBOXES
from modsim3d import load_scene
from modsim3d.core.arrays import Array

REALLY = {"clock_s": 3.7, "pitch_deg": 0.4, "yaw_deg": 2.0}


def strait_scene(folder: Path, **settings: object) -> Path:
    """The strait with truth that needs no rendering, as a file of its own."""
    return load_scene("strait", settings={**SHOEBOXES, "annotation.source": "analytic", **settings}).copy.write(folder)


def written(path: Path, times_s: Array, boxes_px: Array) -> Path:
    """A log with a row for each detection."""
    table = np.column_stack([times_s, boxes_px])
    np.savetxt(path, table, "%.3f", ",", header="time_s,left,top,right,bottom", comments="")
    return path
