"""Tracks in the world from a ROS 2 bag: `vision_msgs/Detection3DArray` or `nav_msgs/Odometry`, in the frame `map`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from modsim3d.arrays import Array
from modsim3d.errors import InputError, ModsimError
from modsim3d.inputs.validation import nearest, shown
from modsim3d.runs.stored_run import StoredRun
from modsim3d.tracks.files.text_table import source_of
from modsim3d.tracks.world_rows import WorldRows

MAP = "map"
"""The frame of the scene's axes in the bags that a run is exported to."""
ARRAYS, ODOMETRY = "vision_msgs/msg/Detection3DArray", "nav_msgs/msg/Odometry"
KINDS = (ARRAYS, ODOMETRY)
_VISION_MSGS = {
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
    ),
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\n"
        "vision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\n"
        "string id\n"
    ),
    ARRAYS: "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n",
}
"""Fields of vision_msgs 4, for bags that hold no definitions, as those in SQLite of Humble."""


class _Estimate(NamedTuple):
    """What a message says of a track; its covariances are rows of 6 × 6, and all zeros stand for unknown."""

    place: str
    track: str
    stamp_ns: int
    position_m: tuple[float, float]
    covariance: Array
    quaternion: tuple[float, float, float, float]
    velocity_m_s: tuple[float, float, float]
    velocity_covariance: Array


def read_world_bag(path: Path, run: StoredRun, topic: str | None = None) -> WorldRows:
    """The rows of a bag.

    Args:
        path: Its folder.
        run: The run.
        topic: The topic of the tracks; None for the only one that can be.

    Raises:
        InputError: It cannot be read, has no such topic or several, or another frame.
        ModsimError: rosbags is not installed.
    """
    source = source_of(path)
    found = list(_estimates(path, source, topic))
    start = float(run.scene.timestamps(0, 1)[0])
    covariance = np.full((len(found), 4, 4), np.nan)
    velocity = np.full((len(found), 2), np.nan)
    if found:
        covariance[:, :2, :2] = _known(np.array([each.covariance for each in found]))[:, :2, :2]
        velocity, covariance[:, 2:, 2:] = _velocities(found)
    return WorldRows(
        source=source,
        name=path.name,
        place=lambda row: found[row].place,
        track=[each.track for each in found],
        time_s=np.array([each.stamp_ns for each in found], dtype=np.float64) / 1e9 - start,
        position_m=np.array([each.position_m for each in found], dtype=np.float64).reshape(-1, 2),
        velocity_m_s=velocity,
        covariance=covariance,
    )


def _known(covariances: Array) -> Array:
    """Covariances of shape (k, 36) as (k, 6, 6), NaN where they are all zero or begin with −1, ROS's unknown."""
    unknown = (covariances == 0).all(axis=1) | (covariances[:, 0] == -1)
    return np.where(unknown[:, None], np.nan, covariances).reshape(-1, 6, 6)


def _velocities(found: list[_Estimate]) -> tuple[Array, Array]:
    """Velocities in the map and their covariances, shapes (k, 2) and (k, 2, 2); a bag of zeros says none."""
    quaternions = np.array([each.quaternion for each in found], dtype=np.float64)
    velocity = np.array([each.velocity_m_s for each in found], dtype=np.float64)
    length = np.linalg.norm(quaternions, axis=1)
    quaternions[~(length > 0)] = (0.0, 0.0, 0.0, 1.0)  # an orientation that nobody filled in
    turn = Rotation.from_quat(quaternions)
    covariance = _known(np.array([each.velocity_covariance for each in found]))[:, :3, :3]
    if not velocity.any():
        return np.full((len(found), 2), np.nan), np.full((len(found), 2, 2), np.nan)
    matrices = turn.as_matrix()
    in_map = matrices @ covariance @ np.swapaxes(matrices, -1, -2)
    return turn.apply(velocity)[:, :2], in_map[:, :2, :2]


def _estimates(path: Path, source: str, topic: str | None) -> Iterator[_Estimate]:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError:
        raise ModsimError('tracks in a ROS 2 bag need rosbags: pip install "modsim3d[ros]"') from None
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in _VISION_MSGS.items():
        store.register(get_types_from_msg(text, name))
    try:
        with AnyReader([path], default_typestore=store) as reader:
            chosen = _chosen({each.topic: each.msgtype for each in reader.connections}, source, topic)
            wanted = [each for each in reader.connections if each.topic == chosen]
            for number, (connection, _, raw) in enumerate(reader.messages(wanted), start=1):
                message: Any = reader.deserialize(raw, connection.msgtype)
                place = f"{chosen} message {number}"
                if (frame := message.header.frame_id) != MAP:
                    problem = f"{place}: frame_id must be '{MAP}', the scene's axes (got {shown(frame)})"
                    raise InputError(source, [problem])
                yield from (_of_array if connection.msgtype == ARRAYS else _of_odometry)(place, message)
    except ModsimError:
        raise
    except Exception as error:  # of a damaged bag the readers raise whatever they meet, not only their own errors
        raise InputError(source, [f"cannot be read as a ROS 2 bag: {error}"]) from None


def _chosen(topics: dict[str, str], source: str, topic: str | None) -> str:
    """The topic of the tracks."""
    able = [name for name, kind in topics.items() if kind in KINDS]
    if topic is not None:
        if topic not in able:
            raise InputError(source, [f"has no topic {topic} of {' or '.join(KINDS)} ({nearest(topic, able)})"])
        return topic
    for kind in KINDS:  # own ship's odometry is often there too
        of_kind = [name for name in able if topics[name] == kind]
        if len(of_kind) == 1:
            return of_kind[0]
        if of_kind:
            names = ", ".join(sorted(of_kind))
            raise InputError(source, [f"must have one topic of {kind} (got {len(of_kind)}: {names})"])
    names = ", ".join(f"{name} ({kind})" for name, kind in sorted(topics.items())) or "no topic at all"
    raise InputError(source, [f"must have a topic of {' or '.join(KINDS)} (got {names})"])


def _of_array(place: str, message: Any) -> Iterator[_Estimate]:
    stamp_ns = _stamp_ns(message.header)
    for each in message.detections:
        best = each.results[0].pose if len(each.results) else None
        centre = best.pose if best else each.bbox.center
        covariance = np.asarray(best.covariance) if best else np.zeros(36)
        at = (centre.position.x, centre.position.y)
        track = each.id if hasattr(each, "id") else each.tracking_id  # as vision_msgs 2 calls it
        yield _Estimate(place, track, stamp_ns, at, covariance, (0, 0, 0, 1), (0, 0, 0), np.zeros(36))


def _of_odometry(place: str, message: Any) -> Iterator[_Estimate]:
    pose, twist = message.pose, message.twist
    turn, speed = pose.pose.orientation, twist.twist.linear
    yield _Estimate(
        place,
        message.child_frame_id,
        _stamp_ns(message.header),
        (pose.pose.position.x, pose.pose.position.y),
        np.asarray(pose.covariance),
        (turn.x, turn.y, turn.z, turn.w),
        (speed.x, speed.y, speed.z),
        np.asarray(twist.covariance),
    )


def _stamp_ns(header: Any) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)
