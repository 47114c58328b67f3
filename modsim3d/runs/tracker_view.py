"""Detections without what could tell where they came from: what a tracker may read of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import orjson

from modsim3d.core.arrays import Array, Columns, Indices
from modsim3d.detector.records import Detections
from modsim3d.runs.blocks import Block, CameraBlock
from modsim3d.runs.files.run_file import frame_lines, number_texts
from modsim3d.scene.scene import Scene

BOX_DECIMALS = 3  # of a box's edges in pixels: the last bits of exact edges tell true detections from false ones
_CONFIDENCE_DECIMALS = 6  # the last bits of exact ones tell some false positives from true ones, which more goes into


@dataclass(frozen=True, eq=False)
class TrackerDetections(Columns):
    """Detections as a tracker may read them: m rows by frame, the most confident of a frame first."""

    frame: Indices  # number of the frame, (m,)
    label: Indices  # index of the label, (m,)
    boxes_px: Array  # x_min, y_min, x_max, y_max, rounded, (m, 4)
    confidence: Array  # rounded, (m,)

    @classmethod
    def of(cls, detections: Detections) -> TrackerDetections:
        """Columns of a detector's detections that a tracker may read."""
        return anonymised(detections.frame, detections.label, detections.boxes_px, detections.confidence)


def anonymised(frame: Indices, label: Indices, boxes_px: Array, confidence: Array) -> TrackerDetections:
    """Round detections, and bring them into an order that tells nothing either. Equally confident detections of a frame
    follow each other by their boxes. For the arguments, in any order, see `TrackerDetections`."""
    boxes_px, confidence = boxes_px.round(BOX_DECIMALS), confidence.round(_CONFIDENCE_DECIMALS)
    order = np.lexsort((-confidence, frame))
    # Few detections are equally confident: only those are put in order of their boxes.
    before, after = order[:-1], order[1:]
    same = (frame[before] == frame[after]) & (confidence[before] == confidence[after])
    if same.any():
        tied = (np.append(same, False) | np.append(False, same)).nonzero()[0]
        rows = order[tied]
        order[tied] = rows[np.lexsort((label[rows], *boxes_px[rows].T[::-1], -confidence[rows], frame[rows]))]
    return TrackerDetections(frame, label, boxes_px, confidence).take(order)


TRACKER_INPUT = "tracker_input"


def tracker_lines(block: Block, part: CameraBlock, scene: Scene) -> bytes:
    """The detections of a camera, one line for each of its frames."""
    times_s = scene.times_s(block.first, block.stop)[part.steps - block.first]
    return detection_lines(part.detections, scene.detector.labels, part.steps, times_s)


def detection_lines(detections: Detections, labels: Sequence[str], steps: Indices, times_s: Array) -> bytes:
    """Detections as a tracker may read them, one line for each frame; steps and times have shape (S,)."""
    rows = TrackerDetections.of(detections)
    names = [b'],"label":' + orjson.dumps(label) + b',"confidence":' for label in labels]
    heads = [
        b'{"time_s":' + time_s + b',"step":' + step + b',"detections":['
        for time_s, step in zip(number_texts(times_s), number_texts(steps), strict=True)
    ]
    return frame_lines(
        heads,
        b"]}\n",
        rows.frame,
        b'{"box_px":[',
        rows.boxes_px,
        [names[label] for label in rows.label.tolist()],
        rows.confidence,
        b"}",
    )
