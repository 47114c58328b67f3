"""Truth and detections of labelled videos, in the place of drawn and simulated ones."""

from dataclasses import replace

import numpy as np

from modsim3d.core.arrays import NOBODY, positions
from modsim3d.core.boxes import areas, errors_between
from modsim3d.core.errors import ModsimError
from modsim3d.detector.records import FALSE_POSITIVE, TRUE, CameraFrames, Detections, Targets
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


def given_detections(labels: LabelledPoses, frames: CameraFrames, targets: Targets) -> Detections:
    """Detections of a real detector in a camera's frames. Those that detect nothing are false; those of a box that is
    not annotated, since nothing of it is visible or it is too small, are neither right nor false and left out."""
    given, boxes = labels.detections, labels.boxes
    camera = [each.name for each in labels.sequences].index(frames.camera)
    if given is None:
        raise ModsimError("the labels have no detections")
    found = given.take(np.isin(given.step, frames.steps) & (given.camera == camera))
    vessels, last = len(targets.vessel_ids), np.append(boxes.vessel, NOBODY)
    key = np.searchsorted(frames.steps, found.step) * vessels + last[found.row]
    target = positions(targets.frame * vessels + targets.vessel, np.where(found.row >= 0, key, NOBODY))
    counts = (found.row < 0) | (target >= 0)
    found, target = found.take(counts), target[counts]
    own = target >= 0
    errors_px = np.full((len(found), 4), np.nan)
    errors_px[own] = errors_between(found.boxes_px[own], targets.boxes_px[target[own]])
    return Detections(
        states=np.zeros(len(frames), dtype=np.int64),
        frame=np.searchsorted(frames.steps, found.step),
        target=target,
        partner=np.full(len(found), NOBODY),
        kind=np.where(own, TRUE, FALSE_POSITIVE),
        label=found.label,
        confidence=found.confidence,
        boxes_px=found.boxes_px,
        errors_px=errors_px,
        redrawn=np.zeros(len(found), dtype=bool),
        gated=np.zeros(len(targets), dtype=bool),
    )
