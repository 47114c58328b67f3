"""Logs of the strait's bow camera, whose detector's clock is late and which is not mounted as the scene says."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.voyages.cases import SHOEBOXES
from benchmarks.voyages.wrong_camera import Voyage
from modsim3d.core.arrays import Array
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene

REALLY = {"clock_s": 3.7, "pitch_deg": 0.4, "yaw_deg": 2.0}
ANALYTIC = {**SHOEBOXES, "annotation.source": "analytic"}


def strait_scene(folder: Path, **settings: object) -> Path:
    """The strait with truth that needs no rendering, as a file of its own."""
    return load_scene("strait", settings={**ANALYTIC, **settings}).copy.write(folder)


def strait_log(scene: Scene, path: Path, seed: int = 0) -> Path:
    """What the detector wrote, as CSV."""
    found = Voyage.of(scene, "bow", REALLY).detections(seed)
    return written(path, found.times_s[found.frame], found.boxes_px)


def written(path: Path, times_s: Array, boxes_px: Array) -> Path:
    """A log with a row for each detection."""
    table = np.column_stack([times_s, boxes_px])
    np.savetxt(path, table, "%.3f", ",", header="time_s,left,top,right,bottom", comments="")
    return path
