"""What a tracker may read: the detections of a camera without their origin, one line of JSON for each of its frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import orjson

from modsim3d.arrays import Array, Indices
from modsim3d.detector.records import Detections
from modsim3d.runs.blocks import Block, CameraBlock
from modsim3d.scene.scene import Scene

TRACKER_INPUT = "tracker_input"
BOX_DECIMALS = 3
"""Of a box's edges in pixels: the last bits of exact edges tell true detections from false ones."""


def told_boxes_px(boxes_px: Array) -> Array:
    """Boxes as a tracker may read them, shapes (m, 4)."""
    return np.round(boxes_px, BOX_DECIMALS)


def told_order(frame: Indices, boxes_px: Array, label: Indices, confidence: Array) -> Indices:
    """The order in which a tracker may read detections, by frame, that tells nothing of where they came from.

    Within a frame the most confident comes first; equally confident ones follow each other by their boxes.

    Args:
        frame: Number of each detection's frame, shape (m,).
        boxes_px: Boxes as `told_boxes_px` gives them, shape (m, 4).
        label: Index of the label, shape (m,).
        confidence: Confidence, shape (m,).

    Returns:
        Rows of the detections, shape (m,).
    """
    return np.lexsort((label, *boxes_px.T[::-1], -confidence, frame))


def tracker_lines(block: Block, part: CameraBlock, scene: Scene) -> Iterator[bytes]:
    """The detections of a camera, one line for each of its frames."""
    times_s = scene.times_s(block.first, block.stop)[part.steps - block.first]
    return detection_lines(part.detections, scene.detector.labels, part.steps, times_s)


def detection_lines(detections: Detections, labels: Sequence[str], steps: Indices, times_s: Array) -> Iterator[bytes]:
    """Detections as a tracker may read them, one line for each frame; steps and times have shape (S,)."""
    boxes = told_boxes_px(detections.boxes_px)
    order = told_order(detections.frame, boxes, detections.label, detections.confidence)
    starts = np.searchsorted(detections.frame, np.arange(len(steps) + 1)).tolist()
    entries = [
        {"box_px": box, "label": labels[label], "confidence": confidence}
        for box, label, confidence in zip(
            boxes[order].tolist(), detections.label[order].tolist(), detections.confidence[order].tolist(), strict=True
        )
    ]
    for frame, (time_s, step) in enumerate(zip(times_s.tolist(), steps.tolist(), strict=True)):
        of_frame = entries[starts[frame] : starts[frame + 1]]
        yield orjson.dumps({"time_s": time_s, "step": step, "detections": of_frame}) + b"\n"
