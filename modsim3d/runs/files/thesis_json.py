"""The thesis's JSON: annotations, detections and poses by timestamp and vessel (Jessen & Mohr (2023)).

While a run goes on, a file has JSON Lines. At the end the annotations and detections (Figure 7.17), one line a frame,
become one JSON object: the lines without their outer braces, joined by commas. The poses (Figure 7.3), one line a step,
stay lines.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
import orjson

from modsim3d.boxes import centre_form
from modsim3d.detector.records import DUPLICATE, FRAGMENT
from modsim3d.runs.blocks import Block, CameraBlock
from modsim3d.scene.scene import Scene
from modsim3d.truth.modes import annotation_boxes

JOINED_BYTES = 1 << 22
"""Bytes of lines that are joined at a time."""


def annotation_lines(block: Block, part: CameraBlock, scene: Scene) -> Iterator[bytes]:
    """The annotations of a camera, one line a frame: timestamp → vessel ID → label and box with depth."""
    truth, rows = part.truth, part.target_rows
    boxes = centre_form(annotation_boxes(truth, scene.annotation.mode)[rows]).tolist()
    vessels, depths = truth.vessel[rows].tolist(), truth.depth_m[rows].tolist()
    names, labels = scene.vessel_names, [vessel.label for vessel in scene.vessels]
    entries: list[dict[str, Any]] = [{} for _ in part.steps]
    frames = np.searchsorted(part.steps, truth.step[rows]).tolist()
    for frame, vessel, box, depth in zip(frames, vessels, boxes, depths, strict=True):
        entries[frame][names[vessel]] = {"label": labels[vessel], "bbox": {**_bbox(box), "depth": depth}}
    return _lines(block, part, entries)


def detection_lines(block: Block, part: CameraBlock, scene: Scene) -> Iterator[bytes]:
    """The detections of a camera, one line a frame: timestamp → vessel ID or `false_positive_<n>` → label and so on."""
    detections, labels = part.detections, scene.detector.labels
    boxes, confidence = centre_form(detections.boxes_px).tolist(), detections.confidence.tolist()
    sources, frames, label_of = part.truth_row.tolist(), detections.frame.tolist(), detections.label.tolist()
    names, vessels = scene.vessel_names, part.truth.vessel
    entries: list[dict[str, Any]] = [{} for _ in part.steps]
    second = np.isin(detections.kind, (DUPLICATE, FRAGMENT))
    for i in np.argsort(second, kind="stable").tolist():  # a vessel's first detection gets its plain name
        entry, row, label = entries[frames[i]], sources[i], label_of[i]
        entry[_free_key(entry, names[vessels[row]] if row >= 0 else None)] = {
            "label": labels[label],
            "confidenceScore": confidence[i],
            "bbox": _bbox(boxes[i]),
        }
    return _lines(block, part, entries)


def pose_lines(scene: Scene, first: int, stop: int) -> bytes:
    """The poses of steps first to stop − 1; reading the lines gives exactly the same numbers."""
    poses = scene.poses.poses(first, stop)
    lines = []
    for row, timestamp in enumerate(scene.timestamps(first, stop)):
        entries = {
            name: {
                "center_position_m": poses.positions_m[row, column].tolist(),
                "heading_rad": float(poses.headings_rad[row, column]),
            }
            for column, name in enumerate(scene.vessel_names)
            if poses.present[row, column]
        }
        lines.append(orjson.dumps({timestamp: entries}) + b"\n")
    return b"".join(lines)


def _free_key(entry: dict[str, Any], vessel: str | None) -> str:
    """The next free key: false positives are numbered from 1; the second box of a vessel is `<vessel ID>#2`."""
    prefix, number = ("false_positive_", 1) if vessel is None else (f"{vessel}#", 2)
    if vessel is not None and vessel not in entry:
        return vessel
    while f"{prefix}{number}" in entry:
        number += 1
    return f"{prefix}{number}"


def _bbox(box: list[float]) -> dict[str, Any]:
    return {"centre": {"x": box[0], "y": box[1]}, "height": box[3], "width": box[2]}


def _lines(block: Block, part: CameraBlock, entries: list[dict[str, Any]]) -> Iterator[bytes]:
    timestamps = [block.timestamps[step - block.first] for step in part.steps.tolist()]
    return (orjson.dumps({timestamp: entry}) + b"\n" for timestamp, entry in zip(timestamps, entries, strict=True))


def join_lines(lines: Path, out: IO[bytes]) -> None:
    """Join a file of such lines to one JSON object.

    JSON escapes line breaks inside strings, so the bytes `}`, line break, `{` occur only between two lines.
    """
    separator = b"{\n"
    with lines.open("rb") as source:
        while some := source.readlines(JOINED_BYTES):
            out.write(separator + b"".join(some)[1:-2].replace(b"}\n{", b",\n"))
            separator = b",\n"
    out.write(b"{}\n" if separator == b"{\n" else b"\n}\n")
