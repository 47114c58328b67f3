"""A run directory as a labelled set: its own truth, its detections, and what it knows of where they came from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from modsim3d.arrays import Array, Indices
from modsim3d.boxes import corner_form
from modsim3d.detector.records import FALSE_KINDS, KINDS
from modsim3d.formats.tables import CENTRE_FORM
from modsim3d.learn.labelled import NOBODY, Annotations, Images, LabelledSet, Results
from modsim3d.stored_run import StoredRun, open_run


def labelled_run(folder: Path) -> tuple[LabelledSet, StoredRun]:
    """A run: an image for each camera and step, a condition for each performance state."""
    run = open_run(folder)
    scene, tables = run.scene, run.tables()
    cameras = [camera.name for camera in scene.cameras]
    states = tuple(state.name for state in scene.detector.states)
    frames = tables["frames"]
    order = np.lexsort((_numbers(frames, "step"), _places(frames, "camera", cameras)))
    camera = _places(frames, "camera", cameras)[order]
    step = _numbers(frames, "step").astype(np.int64)[order]
    times = np.asarray(scene.times_s(0, scene.steps))[step]
    stride = int(step.max(initial=0)) + 1
    row_of = np.full(len(cameras) * stride, NOBODY)
    row_of[camera * stride + step] = np.arange(len(order))

    def image(table: pa.Table) -> Indices:
        return row_of[_places(table, "camera", cameras) * stride + _numbers(table, "step").astype(np.int64)]

    images = Images(
        names=tuple(f"{cameras[c]} {s}" for c, s in zip(camera.tolist(), step.tolist(), strict=True)),
        sizes_px=np.array([scene.cameras[c].intrinsics.image_size_px for c in range(len(cameras))], dtype=float)[
            camera
        ],
        condition=_places(frames, "state", states)[order],
        source=np.zeros(len(order), dtype=np.int64),
        sequence=camera,
        time_s=times,
    )
    annotated = tables["truth"].filter(tables["truth"]["annotated"])
    side = "visible" if scene.annotation.mode == 2 else "full"
    vessels, labels = list(scene.vessel_names), tuple(scene.detector.labels)
    truth = Annotations(
        image=image(annotated),
        label=_places(annotated, "label", labels),
        boxes_px=np.column_stack(
            [_numbers(annotated, f"{side}_{end}_px") for end in ("x_min", "y_min", "x_max", "y_max")]
        ),
        ignored=np.zeros(len(annotated), dtype=bool),
        crowd=np.zeros(len(annotated), dtype=bool),
        identity=_places(annotated, "vessel", vessels),
        visible_fraction=_numbers(annotated, "visible_fraction"),
        depth_m=_numbers(annotated, "depth_m"),
    ).by_image()
    detections = tables["detections"]
    results = _results(detections, image(detections), labels, vessels, truth, len(images))
    return LabelledSet(labels, states, images, truth, results), run


def _results(
    table: pa.Table, image: Indices, labels: tuple[str, ...], vessels: list[str], truth: Annotations, images: int
) -> Results:
    boxes = corner_form(np.column_stack([_numbers(table, name) for name in CENTRE_FORM]))
    kind = _places(table, "kind", KINDS)
    row_of = np.full(images * max(len(vessels), 1), NOBODY)
    row_of[truth.image * len(vessels) + truth.identity] = np.arange(len(truth))
    vessel = _places(table, "vessel", vessels)
    own = ~np.isin(kind, FALSE_KINDS) & (vessel >= 0)
    origin = np.where(own, row_of[image * len(vessels) + np.maximum(vessel, 0)], NOBODY)
    return Results(
        image=image,
        label=_places(table, "label", labels),
        boxes_px=boxes,
        confidence=_numbers(table, "confidence"),
        origin=origin,
    ).by_image()


def _numbers(table: pa.Table, name: str) -> Array:
    """A column of numbers, NaN for null."""
    return table[name].to_numpy(zero_copy_only=False).astype(np.float64)  # type: ignore[no-any-return]


def _places(table: pa.Table, name: str, names: Any) -> Indices:
    """A column of names as their places among all names, −1 for null."""
    known = {value: place for place, value in enumerate(names)}
    return np.array([known.get(value, NOBODY) for value in table[name].to_pylist()], dtype=np.int64)
