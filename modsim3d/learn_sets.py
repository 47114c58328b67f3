"""A run directory as a labelled set: its own truth, its detections, and what it knows of where they came from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa

from modsim3d.arrays import Indices
from modsim3d.detector.records import FALSE_KINDS, KINDS
from modsim3d.formats.columns import NOBODY, detection_boxes_px, indices, integers, numbers, truth_boxes_px
from modsim3d.learn.labelled import Found, Images, Labelled, Truth, sorted_by_image
from modsim3d.stored_run import StoredRun, open_run


def labelled_run(folder: Path) -> tuple[Labelled, StoredRun]:
    """A run: an image for each camera and step, a condition for each performance state."""
    run = open_run(folder)
    scene, tables = run.scene, run.tables()
    cameras = [camera.name for camera in scene.cameras]
    states = tuple(state.name for state in scene.detector.states)
    frames = tables["frames"]
    camera, step = indices(frames, "camera", cameras), integers(frames, "step")
    order = np.lexsort((step, camera))
    camera, step = camera[order], step[order]
    times = np.asarray(scene.times_s(0, scene.steps))[step]
    stride = int(step.max(initial=0)) + 1
    row_of = np.full(len(cameras) * stride, NOBODY)
    row_of[camera * stride + step] = np.arange(len(order))

    def image(table: pa.Table) -> Indices:
        rows: Indices = row_of[indices(table, "camera", cameras) * stride + integers(table, "step")]
        return rows

    images = Images(
        names=tuple(f"{cameras[c]} {s}" for c, s in zip(camera.tolist(), step.tolist(), strict=True)),
        sizes_px=np.array([scene.cameras[c].intrinsics.image_size_px for c in range(len(cameras))], dtype=float)[
            camera
        ],
        condition=indices(frames, "state", states)[order],
        source=np.zeros(len(order), dtype=np.int64),
        sequence=camera,
        time_s=times,
    )
    annotated = tables["truth"].filter(tables["truth"]["annotated"])
    side = "visible" if scene.annotation.mode == 2 else "full"
    vessels, labels = list(scene.vessel_names), tuple(scene.detector.labels)
    truth = Truth(
        image=image(annotated),
        label=indices(annotated, "label", labels),
        boxes_px=truth_boxes_px(annotated, side),
        ignored=np.zeros(len(annotated), dtype=bool),
        crowd=np.zeros(len(annotated), dtype=bool),
        identity=indices(annotated, "vessel", vessels),
        visible_fraction=numbers(annotated, "visible_fraction"),
        distance_m=numbers(annotated, "depth_m"),
    )
    truth = Truth(**sorted_by_image(truth)[0])
    detections = tables["detections"]
    found = _found(detections, image(detections), labels, vessels, truth, len(images))
    return Labelled(labels, states, images, truth, found), run


def _found(
    table: pa.Table, image: Indices, labels: tuple[str, ...], vessels: list[str], truth: Truth, images: int
) -> Found:
    kind = indices(table, "kind", KINDS)
    row_of = np.full(images * max(len(vessels), 1), NOBODY)
    row_of[truth.image * len(vessels) + truth.identity] = np.arange(len(truth))
    vessel = indices(table, "vessel", vessels)
    own = ~np.isin(kind, FALSE_KINDS) & (vessel >= 0)
    origin = np.where(own, row_of[image * len(vessels) + np.maximum(vessel, 0)], NOBODY)
    found = Found(
        image=image,
        label=indices(table, "label", labels),
        boxes_px=detection_boxes_px(table),
        confidence=numbers(table, "confidence"),
        origin=origin,
    )
    return Found(**sorted_by_image(found)[0])
