"""What a tracker may read: the detections of a camera without their origin, one line of JSON for each of its frames."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import orjson

from modsim3d.arrays import Array, Indices
from modsim3d.detector.records import Detections
from modsim3d.runs.blocks import Block, CameraBlock
from modsim3d.scene.scene import Scene

TRACKER_INPUT = "tracker_input"
_DECIMALS = 3
"""Of a box's edges in pixels: the last bits of exact edges tell true detections from false ones."""


def without_origin(detections: Detections) -> tuple[Array, Indices]:
    """Boxes without the digits that tell true detections from false ones, and an order that tells nothing either.

    Returns:
        The rounded boxes in pixels, shape (m, 4), and the order of the rows, shape (m,): by frame, the most confident
        first, equal ones in order of their boxes.
    """
    boxes = np.round(detections.boxes_px, _DECIMALS)
    return boxes, np.lexsort((detections.label, *boxes.T[::-1], -detections.confidence, detections.frame))


def tracker_lines(block: Block, part: CameraBlock, scene: Scene) -> Iterator[bytes]:
    """The detections of a camera, one line a frame; the most confident first, equal ones in order of their boxes."""
    detections, labels = part.detections, scene.detector.labels
    boxes, order = without_origin(detections)
    starts = np.searchsorted(detections.frame, np.arange(len(part.steps) + 1)).tolist()
    entries = [
        {"box_px": box, "label": labels[label], "confidence": confidence}
        for box, label, confidence in zip(
            boxes[order].tolist(), detections.label[order].tolist(), detections.confidence[order].tolist(), strict=True
        )
    ]
    times_s = scene.times_s(block.first, block.stop)[part.steps - block.first].tolist()
    for frame, (time_s, step) in enumerate(zip(times_s, part.steps.tolist(), strict=True)):
        of_frame = entries[starts[frame] : starts[frame + 1]]
        yield orjson.dumps({"time_s": time_s, "step": step, "detections": of_frame}) + b"\n"
