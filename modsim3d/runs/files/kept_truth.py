"""Whether the columns that an interrupted run kept of a block can be the truth of that block."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array, Mask
from modsim3d.runs.files.row_checks import MOST_DEPTH_M, ROUNDING, frames_taken
from modsim3d.scene.scene import Scene
from modsim3d.truth.truth_record import COLUMNS, Truth, no_truth

_INTEGERS = ("step", "camera", "vessel", "occluder_offsets", "occluder", "intersections")
_OF_OCCLUDERS = ("occluder", "occluder_px")
_EMPTY = {name: getattr(no_truth(), name) for name in COLUMNS}


def truth_of_columns(columns: Mapping[str, NDArray[Any]], scene: Scene, first: int, stop: int) -> Truth | None:
    """The truth of steps first to stop − 1 of a scene; None if the columns cannot be that."""
    if not _has_form(columns):
        return None
    truth = Truth(**columns)
    return truth if _has_places(truth, scene, first, stop) and _has_values(truth, scene) else None


def _has_form(columns: Mapping[str, NDArray[Any]]) -> bool:
    """Whether all columns are there, each of its kind and with as many rows as it must have."""
    if columns.keys() != set(COLUMNS) or any(columns[name].ndim != _EMPTY[name].ndim for name in COLUMNS):
        return False
    rows, occluders = len(columns["step"]), len(columns["occluder"])
    own = {"occluder_offsets": rows + 1, "intersections": len(columns["intersections"])}
    counts = {**dict.fromkeys(COLUMNS, rows), **dict.fromkeys(_OF_OCCLUDERS, occluders), **own}
    return all(
        columns[name].shape == (counts[name], *_EMPTY[name].shape[1:]) and columns[name].dtype.kind in _kinds(name)
        for name in COLUMNS
    )


def _kinds(name: str) -> str:
    """Kinds of NumPy's types that a column may have."""
    return "b" if name in ("annotated", "drawn") else "i" if name in _INTEGERS else "if"


def _has_places(truth: Truth, scene: Scene, first: int, stop: int) -> bool:
    """Whether rows are in order, of frames that were taken, and whether indices name what the scene has."""
    names = len(scene.occluder_names)
    indices = ((truth.camera, len(scene.cameras)), (truth.vessel, len(scene.vessels)), (truth.occluder, names))
    if not all(((index >= 0) & (index < count)).all() for index, count in indices):
        return False
    within = ((first <= truth.step) & (truth.step < stop)).all()
    frame = truth.step * len(scene.cameras) + truth.camera
    offsets = truth.occluder_offsets
    pairs = truth.intersections[:, 2:]
    return bool(
        within
        and np.isin(frame, frames_taken(scene, first, stop)).all()
        and (np.diff(frame * len(scene.vessels) + truth.vessel) > 0).all()
        and offsets[0] == 0
        and offsets[-1] == len(truth.occluder)
        and (np.diff(offsets) >= 0).all()
        and ((pairs >= 0) & (pairs < names)).all()
    )


def _has_values(truth: Truth, scene: Scene) -> bool:
    """Whether boxes lie in their images, and numbers in their ranges; NaN only where it may be."""
    sizes_px = np.array([camera.intrinsics.image_size_px for camera in scene.cameras], dtype=np.float64)[truth.camera]
    most_px = sizes_px.prod(axis=1) * (1 + ROUNDING)
    hidden = np.repeat(most_px, np.diff(truth.occluder_offsets))
    unseen = np.isnan(truth.visible_boxes_px).all(axis=1)
    if scene.annotation.mode == 2 and (truth.annotated & unseen).any():
        return False
    ranges = (
        (truth.silhouette_px, 0.0, most_px, False),
        (truth.visible_px, 0.0, most_px, True),
        (truth.visible_fraction, 0.0, 1 + ROUNDING, True),
        (truth.in_frame_fraction, 0.0, 1 + ROUNDING, True),
        (truth.depth_m, -MOST_DEPTH_M, MOST_DEPTH_M, False),
        (truth.occluder_px, 0.0, hidden, False),
    )
    boxes = _in_image(truth.full_boxes_px, sizes_px) & (unseen | _in_image(truth.visible_boxes_px, sizes_px))
    return bool(boxes.all()) and all(
        bool((((least <= values) & (values <= most)) | (np.isnan(values) & unknown)).all())
        for values, least, most, unknown in ranges
    )


def _in_image(boxes_px: Array, sizes_px: Array) -> Mask:
    """Whether boxes, shape (n, 4), are within images of these sizes, shape (n, 2), with no side below 0, shape (n,)."""
    slack = ROUNDING * sizes_px
    low, high = boxes_px[:, :2], boxes_px[:, 2:]
    return np.asarray(((low >= -slack) & (high <= sizes_px + slack) & (high >= low - slack)).all(axis=1))
