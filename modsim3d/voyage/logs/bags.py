"""ROS 2 bags with `vision_msgs/Detection2DArray`: each message is a frame, at the time of its header."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.errors import InputError, ModsimError
from modsim3d.formats.reading.builder import Problems
from modsim3d.formats.reading.confidences import Confidences
from modsim3d.formats.writing.mcap.definitions import DETECTIONS, VISION_MSGS
from modsim3d.inputs.opening import note_input
from modsim3d.inputs.validation import shown
from modsim3d.tracks.files.box_forms import CENTRE
from modsim3d.voyage.logs.log import Clock, DetectionLog, LogOptions, LogRows
from modsim3d.voyage.logs.times import LEAST_UNIX_S

_NANO = 1_000_000_000


def read_bag_log(path: Path, options: LogOptions) -> DetectionLog:
    """The log of a bag: a folder with `metadata.yaml`, its file in `.db3`, or any in `.mcap`.

    A camera is the first part of its topic's name: `/bow/detections` is that of `bow`.

    Raises:
        InputError: It cannot be read, or has no such topic.
        ModsimError: rosbags is not installed.
    """
    source = f"detections {path}"
    if path.suffix.lower() == ".db3":
        path = path.parent
        if not (path / "metadata.yaml").is_file():
            raise InputError(source, ["metadata.yaml is missing beside it: give the whole folder of the bag"])
    messages = list(_messages(path, source))
    problems = Problems(source, options.skip_bad)
    topics = {_camera(topic): topic for topic, _, _ in messages}
    every = [(topic, stamp, k, found) for topic, stamp, message in messages for k, found in enumerate(message)]
    scores = [(f"{topic} at {stamp / _NANO:.12g} s, [{k}]", score) for topic, stamp, k, (_, _, score, _) in every]
    given = any(score is not None for _, score in scores)
    confidences = Confidences.of(scores, options.confidence_scale, problems) if given else None
    rows = LogRows(source, problems, confidences, CENTRE)
    clock = Clock.UTC if messages and messages[0][1] >= LEAST_UNIX_S * _NANO else Clock.STAMP
    for topic, stamp, message in messages:
        where, camera = f"{topic} at {stamp / _NANO:.12g} s", _camera(topic)
        if topics[camera] != topic:
            which = f"{topic} and {topics[camera]} are both of camera {shown(camera)}"
            raise InputError(source, [f"{which}: give a bag with one topic of a camera"])
        if (stamp >= LEAST_UNIX_S * _NANO) != (clock is Clock.UTC):
            raise InputError(source, [f"{where}: some stamps are Unix time and others are not"])
        if rows.has(camera, stamp / _NANO):
            problems.add(f"{where}: another message has the same stamp")
            continue
        frame = rows.frame(camera, stamp / _NANO)
        for k, (box, label, score, turn_rad) in enumerate(message):
            if abs(np.sin(turn_rad)) > 1e-6:  # half a turn changes nothing
                problems.add(f"{where}, [{k}]: bbox.center.theta must be 0, an upright box (got {turn_rad:g})")
                continue
            rows.add(frame, f"{where}, [{k}]", box, label, score)
    return rows.log(clock, "its messages")


def _camera(topic: str) -> str | None:
    parts = [part for part in topic.split("/") if part]
    return parts[-2] if len(parts) > 1 else None


def ros_name(camera: str) -> str:
    """What a camera of a scene is called in topics."""
    token = re.sub(r"[^A-Za-z0-9]+", "_", camera).strip("_")
    return token if token[:1].isalpha() else f"camera_{token}".rstrip("_")


Found = tuple[list[float], str | None, float | None, float]
"""Left, top, width and height, label and score, and the angle by which the box is turned."""


def _messages(path: Path, source: str) -> Iterator[tuple[str, int, list[Found]]]:
    """Topic, stamp in nanoseconds and detections of each message."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError:
        raise ModsimError('detections in a ROS 2 bag need rosbags: pip install "modsim3d[ros]"') from None
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        note_input(file)
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in VISION_MSGS.items():
        store.register(get_types_from_msg(text, name))
    try:
        with AnyReader([path], default_typestore=store) as reader:
            wanted = [each for each in reader.connections if each.msgtype == DETECTIONS]
            if not wanted:
                topics = ", ".join(f"{each.topic} ({each.msgtype})" for each in reader.connections) or "no topic"
                raise InputError(source, [f"must have a topic of {DETECTIONS} (got {topics})"])
            for connection, _, raw in reader.messages(wanted):
                message: Any = reader.deserialize(raw, connection.msgtype)
                stamp = int(message.header.stamp.sec) * _NANO + int(message.header.stamp.nanosec)
                yield connection.topic, stamp, [_found(each) for each in message.detections]
    except ModsimError:
        raise
    except Exception as error:  # of a damaged bag the readers raise whatever they meet, not only their own errors
        raise InputError(source, [f"cannot be read as a ROS 2 bag: {error}"]) from None


def _found(detection: Any) -> Found:
    box = detection.bbox
    centre = getattr(box.center, "position", box.center)  # vision_msgs 2 and 3 have x and y in the pose itself
    sides = [centre.x - box.size_x / 2, centre.y - box.size_y / 2, box.size_x, box.size_y]
    turn_rad = float(getattr(box.center, "theta", 0.0))
    kinds = [getattr(each, "hypothesis", each) for each in detection.results]  # vision_msgs 2 has it in the result
    best = max(kinds, key=lambda each: float(each.score), default=None)
    if best is None:
        return sides, None, None, turn_rad
    label = best.class_id if hasattr(best, "class_id") else best.id  # as vision_msgs 2 calls it
    return sides, str(label) or None, float(best.score), turn_rad
