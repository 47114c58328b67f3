"""Truth that is labels of videos: nothing is drawn, and a box stands for the silhouette in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modsim3d.core.boxes import areas
from modsim3d.truth.record import Truth, no_truth
from modsim3d.world.poses.labelled import LabelledPoses


def labelled_truth(labels: LabelledPoses, first: int, stop: int) -> Truth:
    """Truth of all cameras at steps first to stop − 1: the pixels of a vessel are those of its box, of which a share is
    visible. Who hides it is not known."""
    boxes = labels.boxes.take(slice(*np.searchsorted(labels.boxes.step, (first, stop))))
    rows, box_px = len(boxes), areas(boxes.boxes_px)
    return replace(
        no_truth(),
        step=boxes.step,
        camera=boxes.camera,
        vessel=boxes.vessel,
        full_boxes_px=boxes.boxes_px,
        visible_boxes_px=np.full((rows, 4), np.nan),
        silhouette_px=box_px,
        visible_px=box_px * boxes.visible_fraction,
        visible_fraction=boxes.visible_fraction,
        in_frame_fraction=boxes.in_frame_fraction,
        depth_m=boxes.depth_m,
        occluder_offsets=np.zeros(rows + 1, dtype=np.int64),
        annotated=np.ones(rows, dtype=bool),
        drawn=np.zeros(rows, dtype=bool),
    )
