"""The detections of a run as a log: what a tracker may read of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modsim3d.formats.reading.builder import Problems
from modsim3d.formats.reading.confidences import Confidences
from modsim3d.runs.camera_sequences import camera_sequences
from modsim3d.runs.stored_run import opened_run
from modsim3d.voyage.logs.log import Clock, DetectionLog, LogRows


def read_run_log(folder: Path) -> DetectionLog:
    """The log of all cameras of a run; nothing of its truth is read.

    Raises:
        ModsimError: It is no run.
    """
    run, source = opened_run(folder), f"detections {folder}"
    problems = Problems(source)
    rows = LogRows(source, problems, Confidences("confidence", 0, 1, True, ""))
    for each in camera_sequences(run, tuple(range(len(run.scene.cameras)))):
        frames = [rows.frame(each.camera.name, time_s, each.size_px) for time_s in each.times_s.tolist()]
        found, labels = each.detections, run.scene.detector.labels
        sides = np.column_stack([found.boxes_px[:, :2], found.boxes_px[:, 2:] - found.boxes_px[:, :2]]).tolist()
        columns = found.frame.tolist(), sides, found.label.tolist(), found.confidence.tolist()
        for row, (frame, box, label, score) in enumerate(zip(*columns, strict=True)):
            rows.add(frames[frame], f"{each.camera.name} row {row}", box, labels[label], score)
    return rows.log(Clock.STEP, "its table of frames")
