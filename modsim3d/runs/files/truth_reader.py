"""The truth of a finished run, read back from its table."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modsim3d.runs.files.columns import (
    Occluders,
    flags,
    indices,
    integers,
    numbers,
    of_steps,
    read_rows,
    truth_boxes_px,
)
from modsim3d.runs.files.tables import TRUTH_NUMBERS
from modsim3d.scene.scene import Scene
from modsim3d.truth.truth_record import Truth


def read_truth(folder: Path, scene: Scene, first: int, stop: int) -> Truth:
    """The truth of steps first to stop − 1 as the detector was given it.

    The table does not say which boxes intersect in space, so `intersections` is empty.

    Args:
        folder: A finished run directory.
        scene: The scene of the run.
        first: First step.
        stop: The step after the last.
    """
    table = read_rows(folder / "truth.parquet", of_steps(first, stop))
    occluders = Occluders.of(table, scene.occluder_names)
    return Truth(
        step=integers(table, "step"),
        camera=indices(table, "camera", [camera.name for camera in scene.cameras]),
        vessel=indices(table, "vessel", scene.vessel_names),
        full_boxes_px=truth_boxes_px(table, "full"),
        visible_boxes_px=truth_boxes_px(table, "visible"),
        **{name: numbers(table, name) for name in TRUTH_NUMBERS},
        occluder_offsets=occluders.offsets,
        occluder=occluders.name,
        occluder_px=occluders.px,
        annotated=flags(table, "annotated"),
        intersections=np.empty((0, 4), dtype=np.int64),
    )
