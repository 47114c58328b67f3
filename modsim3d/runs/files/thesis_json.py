"""The thesis's JSON: annotations, detections and poses by timestamp and vessel (Jessen & Mohr (2023)).

While a run goes on, a file has JSON Lines. At the end the annotations and detections (Figure 7.17), one line a frame,
become one JSON object: the lines without their outer braces, joined by commas. The poses (Figure 7.3), one line a step,
stay lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import IO

import numpy as np
import orjson

from modsim3d.arrays import Array, Indices
from modsim3d.boxes import centre_form
from modsim3d.detector.records import DUPLICATE, FRAGMENT
from modsim3d.runs.blocks import Block, CameraBlock
from modsim3d.runs.files.json_text import Column, frame_lines, string_texts
from modsim3d.scene.scene import Scene
from modsim3d.truth.modes import annotation_boxes

JOINED_BYTES = 1 << 17
"""Bytes of lines that are joined at a time."""


def annotation_lines(block: Block, part: CameraBlock, scene: Scene) -> bytes:
    """The annotations of a camera, one line a frame: timestamp → vessel ID → label and box with depth."""
    truth, rows = part.truth, part.target_rows
    names = string_texts(scene.vessel_names)
    labels = _label_texts([vessel.label for vessel in scene.vessels], b"bbox")
    heads = [name + label + b"{" for name, label in zip(names, labels, strict=True)]
    boxes = centre_form(annotation_boxes(truth, scene.annotation.mode)[rows])
    return _lines(
        block,
        part,
        np.searchsorted(part.steps, truth.step[rows]),
        [heads[vessel] for vessel in truth.vessel[rows].tolist()],
        *_box_columns(boxes),
        b',"depth":',
        truth.depth_m[rows],
        b"}}",
    )


def detection_lines(block: Block, part: CameraBlock, scene: Scene) -> bytes:
    """The detections of a camera, one line a frame: timestamp → vessel ID or `false_positive_<n>` → label and so on."""
    detections = part.detections
    second = np.isin(detections.kind, (DUPLICATE, FRAGMENT))
    order = np.lexsort((second, detections.frame))  # a vessel's first detection gets its plain name
    frame, rows = detections.frame[order], part.truth_row[order]
    vessel = np.full(len(rows), -1)
    vessel[rows >= 0] = part.truth.vessel[rows[rows >= 0]]
    before = _before_in_group(frame * (len(scene.vessels) + 1) + vessel + 1)
    labels = _label_texts(scene.detector.labels, b"confidenceScore")
    return _lines(
        block,
        part,
        frame,
        _keys(scene, vessel, before),
        [labels[label] for label in detections.label[order].tolist()],
        detections.confidence[order],
        b',"bbox":{',
        *_box_columns(centre_form(detections.boxes_px[order])),
        b"}}",
    )


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


def _before_in_group(group: Indices) -> Indices:
    """How many rows before each row are of its group, shape (n,)."""
    order = np.argsort(group, kind="stable")
    ordered, before = group[order], np.empty_like(order)
    before[order] = np.arange(len(group)) - np.searchsorted(ordered, ordered)
    return before


def _keys(scene: Scene, vessel: Indices, before: Indices) -> list[bytes]:
    """The key of each detection in the object of its frame.

    It is the vessel's ID, and `<vessel ID>#2` for the vessel's second box. False positives are numbered from 1.

    Args:
        scene: The scene.
        vessel: The vessel of each of m detections, −1 for a false positive, shape (m,).
        before: How many detections of the frame before each are of its vessel, shape (m,).
    """
    names = string_texts(scene.vessel_names)
    keys = [names[index] for index in vessel.tolist()]
    for row in np.flatnonzero((vessel < 0) | (before > 0)).tolist():
        prefix = f"{scene.vessel_names[vessel[row]]}#" if vessel[row] >= 0 else "false_positive_"
        keys[row] = orjson.dumps(f"{prefix}{before[row] + 1}")
    return keys


def _label_texts(labels: Sequence[str], after: bytes) -> list[bytes]:
    """What follows the key of an entry, up to what comes after its label."""
    return [b':{"label":' + label + b',"' + after + b'":' for label in string_texts(labels)]


def _box_columns(boxes: Array) -> tuple[Column, ...]:
    """Boxes in centre form, shape (n, 4), up to the width."""
    x, y, width, height = boxes.T
    return b'"centre":{"x":', x, b',"y":', y, b'},"height":', height, b',"width":', width


def _lines(block: Block, part: CameraBlock, frame: Indices, *columns: Column) -> bytes:
    timestamps = string_texts(block.timestamps)
    heads = [b"{" + timestamps[step - block.first] + b":{" for step in part.steps.tolist()]
    return frame_lines(heads, b"}}\n", frame, *columns)


def join_lines(lines: Path, out: IO[bytes]) -> None:
    """Join a file of such lines to one JSON object.

    JSON escapes line breaks inside strings, so the bytes `}`, line break, `{` occur only between two lines.
    """
    with lines.open("rb") as source:
        if not source.read(1):
            out.write(b"{}\n")
            return
        out.write(b"{\n")
        end = b""  # perhaps a part of what is between two lines
        while some := source.read(JOINED_BYTES):
            text = (end + some).replace(b"}\n{", b",\n")
            out.write(memoryview(text)[:-2])
            end = text[-2:]
        out.write(b"\n}\n")
