"""Builds ROS messages from what a run has."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from decimal import ROUND_HALF_EVEN, Context, Decimal, InvalidOperation
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.boxes import centre_form
from modsim3d.core.errors import InputError
from modsim3d.geometry.camera import Distortion, Intrinsics
from modsim3d.io.ros_bag import DETECTIONS_2D, NANO, ODOMETRY
from modsim3d.runs.blocks import CameraBlock
from modsim3d.runs.tracker_view import TrackerDetections
from modsim3d.scene.scene import Scene
from modsim3d.truth.record import annotation_boxes

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


@dataclass(frozen=True, eq=False)
class FrameBoxes:
    """The n boxes of a frame."""

    boxes_px: Array  # x_min, y_min, x_max, y_max: (n, 4)
    labels: list[str]
    scores: list[float]
    ids: list[str]  # names of the vessels; empty texts where a tracker must not know them


def detected_boxes(part: CameraBlock, scene: Scene) -> Iterator[FrameBoxes]:
    """The detections of each frame without their origin, as `tracker_input_CAMERA.jsonl` has them."""
    detections = TrackerDetections.of(part.detections)
    labels = [scene.detector.labels[label] for label in detections.label.tolist()]
    scores = detections.confidence.tolist()
    for rows in _rows(np.searchsorted(detections.frame, np.arange(len(part.steps) + 1))):
        yield FrameBoxes(detections.boxes_px[rows], labels[rows], scores[rows], [""] * (rows.stop - rows.start))


def true_boxes(part: CameraBlock, scene: Scene) -> Iterator[FrameBoxes]:
    """The annotated vessels of each frame, by name."""
    truth = part.truth.take(part.target_rows)
    vessels = [scene.vessels[vessel] for vessel in truth.vessel.tolist()]
    boxes = annotation_boxes(truth, scene.annotation.mode)
    for rows in _rows(np.searchsorted(truth.step, np.append(part.steps, np.iinfo(np.int64).max))):
        group = vessels[rows]
        names, labels = [vessel.name for vessel in group], [vessel.label for vessel in group]
        yield FrameBoxes(boxes[rows], labels, [1.0] * len(group), names)


def _rows(starts: np.ndarray) -> Iterator[slice]:
    return map(slice, starts[:-1].tolist(), starts[1:].tolist())


CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
IMU = "sensor_msgs/msg/Imu"

MAX_S = 2**31 - 1  # ROS keeps seconds in 32 bits with a sign, and a bag holds no negative times
_UNIT, _EXACT = Decimal("1e-9"), Context(prec=40)


def stamps_ns(timestamps: Sequence[str], source: str) -> Indices:
    """Nanoseconds of steps with ascending times in seconds, (n,); digits beyond the ninth decimal are rounded. Raises
    InputError of `source` if a time is before 0 or too late for ROS, or two differ too little for it."""
    stamps = [_nanoseconds(text) for text in timestamps]
    for text, stamp in zip(timestamps, stamps, strict=True):
        if stamp is None:
            problem = f"time {text} s: ROS knows times from 0 to {MAX_S} s; count the times of the poses from 0"
            raise InputError(source, [problem])
    ns = np.array(stamps, dtype=np.int64)
    same = np.flatnonzero(np.diff(ns) <= 0)
    if len(same):
        pair = f"times {timestamps[int(same[0])]} s and {timestamps[int(same[0]) + 1]} s"
        raise InputError(source, [f"{pair}: ROS counts in nanoseconds and cannot tell them apart"])
    return ns


def _nanoseconds(text: str) -> int | None:
    """Nanoseconds of a time; None if ROS does not know it."""
    try:
        ns = int(Decimal(text).quantize(_UNIT, ROUND_HALF_EVEN, _EXACT).scaleb(9, _EXACT))
    except InvalidOperation:
        return None
    return ns if 0 <= ns < (MAX_S + 1) * NANO else None


@dataclass(frozen=True, eq=False)
class FramePlace:
    """Place of a frame in its parent at S steps."""

    parent: str
    child: str
    positions_m: Array  # its origin in the parent: (S, 3)
    quaternions: Array  # rotation from it to its parent as x, y, z, w: (S, 4)


@dataclass(frozen=True, eq=False)
class MeasuredMotion:
    """Measurements of an inertial unit at S steps."""

    quaternions: Array  # rotation from its axes to the map as x, y, z, w: (S, 4)
    rates_rad_s: Array  # angular velocity along its axes: (S, 3)
    forces_m_s2: Array  # specific force along its axes: (S, 3)


class Variances(NamedTuple):
    """Variances of the errors of an inertial unit about or along each axis, shape (3,) each."""

    turn_rad2: Array
    rates_rad2_s2: Array
    forces_m2_s4: Array


def quaternions(parent_R_child: Array) -> Array:
    """Quaternions x, y, z, w with w ≥ 0 of rotations, shape (S, 3, 3) to (S, 4)."""
    xyzw: Array = Rotation.from_matrix(parent_R_child).as_quat(canonical=True)
    return xyzw


class Messages:
    """Builds messages of the types of a store."""

    def __init__(self, store: Typestore) -> None:
        """Take the types by their short names."""
        self._types: dict[str, Any] = {name.replace("/msg/", "/"): kind for name, kind in store.types.items()}
        self._no_pose = self._pose_with_covariance(self._pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), np.zeros((6, 6)))

    def detections(self, stamp_ns: int, frame: str, boxes: FrameBoxes) -> Any:
        """A `Detection2DArray` of the boxes of a frame."""
        header = self._header(stamp_ns, frame)
        rows = zip(centre_form(boxes.boxes_px).tolist(), boxes.labels, boxes.scores, boxes.ids, strict=True)
        return self._make(DETECTIONS_2D, header, [self._detection(header, *row) for row in rows])

    def camera_info(self, stamp_ns: int, frame: str, intrinsics: Intrinsics) -> Any:
        """A `CameraInfo`; the image is not rectified, so R is the identity and P has K's numbers."""
        width, height = intrinsics.image_size_px
        lens, matrix = intrinsics.distortion or Distortion(), intrinsics.matrix
        distortion = np.array([lens.k1, lens.k2, lens.p1, lens.p2, lens.k3])
        matrices = matrix.ravel(), np.eye(3).ravel(), np.column_stack([matrix, np.zeros(3)]).ravel()
        whole = self._types["sensor_msgs/RegionOfInterest"](0, 0, 0, 0, False)  # zeros: the whole image
        header = self._header(stamp_ns, frame)
        return self._make(CAMERA_INFO, header, height, width, "plumb_bob", distortion, *matrices, 0, 0, whole)

    def transforms(self, stamp_ns: int, places: Iterable[tuple[FramePlace, int]]) -> Any:
        """A `TFMessage` of frames, each with the index of the step in its `FramePlace`."""
        kind, transform = self._types["geometry_msgs/TransformStamped"], self._types["geometry_msgs/Transform"]
        entries = []
        for place, step in places:
            moved = transform(self._vector(place.positions_m[step]), self._quaternion(place.quaternions[step]))
            entries.append(kind(self._header(stamp_ns, place.parent), place.child, moved))
        return self._make(TRANSFORMS, entries)

    def odometry(self, stamp_ns: int, place: FramePlace, step: int, velocity_m_s: Array, rates_rad_s: Array) -> Any:
        """An `Odometry` without error: the pose of a frame in its parent, velocity and rates along its own axes."""
        pose = self._pose(place.positions_m[step], place.quaternions[step])
        twist = self._types["geometry_msgs/Twist"](self._vector(velocity_m_s), self._vector(rates_rad_s))
        exact = np.zeros(36)
        covered = self._types["geometry_msgs/TwistWithCovariance"](twist, exact)
        header = self._header(stamp_ns, place.parent)
        return self._make(ODOMETRY, header, place.child, self._pose_with_covariance(pose, exact), covered)

    def imu(self, stamp_ns: int, frame: str, measured: MeasuredMotion, step: int, variances: Variances) -> Any:
        """An `Imu` of an inertial unit at a step."""
        turn, rate, force = (np.diag(variance).ravel() for variance in variances)
        attitude, header = self._quaternion(measured.quaternions[step]), self._header(stamp_ns, frame)
        rates, forces = self._vector(measured.rates_rad_s[step]), self._vector(measured.forces_m_s2[step])
        return self._make(IMU, header, attitude, turn, rates, rate, forces, force)

    def _make(self, kind: str, *fields: Any) -> Any:
        return self._types[kind.replace("/msg/", "/")](*fields)

    def _header(self, stamp_ns: int, frame: str) -> Any:
        seconds, rest = divmod(stamp_ns, NANO)
        return self._types["std_msgs/Header"](self._types["builtin_interfaces/Time"](seconds, rest), frame)

    def _detection(self, header: Any, box: list[float], label: str, score: float, identity: str) -> Any:
        x, y, width, height = box
        hypothesis = self._types["vision_msgs/ObjectHypothesis"](label, score)
        centre = self._types["vision_msgs/Pose2D"](self._types["vision_msgs/Point2D"](x, y), 0.0)
        return self._types["vision_msgs/Detection2D"](
            header,
            [self._types["vision_msgs/ObjectHypothesisWithPose"](hypothesis, self._no_pose)],
            self._types["vision_msgs/BoundingBox2D"](centre, width, height),
            identity,
        )

    def _vector(self, values: Iterable[float]) -> Any:
        return self._types["geometry_msgs/Vector3"](*map(float, values))

    def _quaternion(self, values: Iterable[float]) -> Any:
        return self._types["geometry_msgs/Quaternion"](*map(float, values))

    def _pose(self, position_m: Iterable[float], quaternion: Iterable[float]) -> Any:
        point = self._types["geometry_msgs/Point"](*map(float, position_m))
        return self._types["geometry_msgs/Pose"](point, self._quaternion(quaternion))

    def _pose_with_covariance(self, pose: Any, covariance: Array) -> Any:
        return self._types["geometry_msgs/PoseWithCovariance"](pose, covariance.ravel())
