"""What a tracker may read: the detections of a camera without their origin, one line of JSON for each of its frames."""

from __future__ import annotations

from collections.abc import Sequence

import orjson

from modsim3d.arrays import Array, Indices
from modsim3d.detector.records import Detections
from modsim3d.runs.blocks import Block, CameraBlock
from modsim3d.runs.files.json_text import frame_lines, number_texts
from modsim3d.runs.told import Told
from modsim3d.scene.scene import Scene

TRACKER_INPUT = "tracker_input"


def tracker_lines(block: Block, part: CameraBlock, scene: Scene) -> bytes:
    """The detections of a camera, one line for each of its frames."""
    times_s = scene.times_s(block.first, block.stop)[part.steps - block.first]
    return detection_lines(part.detections, scene.detector.labels, part.steps, times_s)


def detection_lines(detections: Detections, labels: Sequence[str], steps: Indices, times_s: Array) -> bytes:
    """Detections as a tracker may read them, one line for each frame; steps and times have shape (S,)."""
    found = Told.of(detections)
    names = [b'],"label":' + orjson.dumps(label) + b',"confidence":' for label in labels]
    heads = [
        b'{"time_s":' + time_s + b',"step":' + step + b',"detections":['
        for time_s, step in zip(number_texts(times_s), number_texts(steps), strict=True)
    ]
    return frame_lines(
        heads,
        b"]}\n",
        found.frame,
        b'{"box_px":[',
        found.boxes_px,
        [names[label] for label in found.label.tolist()],
        found.confidence,
        b"}",
    )
