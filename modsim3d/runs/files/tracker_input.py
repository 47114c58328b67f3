"""What a tracker may read: the detections of a camera without their origin, one line of JSON for each of its frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import orjson

from modsim3d.arrays import Array, Indices
from modsim3d.detector.records import Detections
from modsim3d.runs.blocks import Block, CameraBlock
from modsim3d.runs.told import Told
from modsim3d.scene.scene import Scene

TRACKER_INPUT = "tracker_input"


def tracker_lines(block: Block, part: CameraBlock, scene: Scene) -> Iterator[bytes]:
    """The detections of a camera, one line for each of its frames."""
    times_s = scene.times_s(block.first, block.stop)[part.steps - block.first]
    return detection_lines(part.detections, scene.detector.labels, part.steps, times_s)


def detection_lines(detections: Detections, labels: Sequence[str], steps: Indices, times_s: Array) -> Iterator[bytes]:
    """Detections as a tracker may read them, one line for each frame; steps and times have shape (S,)."""
    found = Told.of(detections)
    starts = np.searchsorted(found.frame, np.arange(len(steps) + 1)).tolist()
    columns = found.boxes_px.tolist(), found.label.tolist(), found.confidence.tolist()
    entries = [
        {"box_px": box, "label": labels[label], "confidence": confidence}
        for box, label, confidence in zip(*columns, strict=True)
    ]
    for frame, (time_s, step) in enumerate(zip(times_s.tolist(), steps.tolist(), strict=True)):
        of_frame = entries[starts[frame] : starts[frame + 1]]
        yield orjson.dumps({"time_s": time_s, "step": step, "detections": of_frame}) + b"\n"
