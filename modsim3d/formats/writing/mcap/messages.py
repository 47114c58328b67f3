"""Builds ROS messages from what a run has."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from modsim3d.arrays import Array
from modsim3d.boxes import centre_form
from modsim3d.formats.writing.mcap.boxes import Boxes
from modsim3d.formats.writing.mcap.definitions import CAMERA_INFO, DETECTIONS, IMU, ODOMETRY, TRANSFORMS
from modsim3d.formats.writing.mcap.stamps import NANO
from modsim3d.geometry.camera import Intrinsics
from modsim3d.geometry.lens import Distortion

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


@dataclass(frozen=True, eq=False)
class Place:
    """Where a frame is in its parent at S steps.

    Attributes:
        parent: Name of the parent.
        child: Name of the frame.
        positions_m: Its origin in the parent, shape (S, 3).
        quaternions: The rotation from it to its parent as x, y, z, w, shape (S, 4).
    """

    parent: str
    child: str
    positions_m: Array
    quaternions: Array


@dataclass(frozen=True, eq=False)
class Measured:
    """What an inertial unit measures at S steps.

    Attributes:
        quaternions: The rotation from its axes to the map as x, y, z, w, shape (S, 4).
        rates_rad_s: Angular velocity along its axes, shape (S, 3).
        forces_m_s2: Specific force along its axes, shape (S, 3).
    """

    quaternions: Array
    rates_rad_s: Array
    forces_m_s2: Array


class Variances(NamedTuple):
    """Variances of the errors of an inertial unit about or along each axis, shape (3,) each."""

    turn_rad2: Array
    rates_rad2_s2: Array
    forces_m2_s4: Array


def quaternions(parent_R_child: Array) -> Array:
    """Quaternions x, y, z, w with w ≥ 0 of rotations, shape (S, 3, 3) to (S, 4)."""
    found: Array = Rotation.from_matrix(parent_R_child).as_quat(canonical=True)
    return found


class Messages:
    """Builds messages of the types of a store."""

    def __init__(self, store: Typestore) -> None:
        """Take the types by their short names."""
        self._types: dict[str, Any] = {name.replace("/msg/", "/"): kind for name, kind in store.types.items()}
        self._no_pose = self._pose_with_covariance(self._pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), np.zeros((6, 6)))

    def detections(self, stamp_ns: int, frame: str, boxes: Boxes) -> Any:
        """A `Detection2DArray` of the boxes of a frame."""
        header = self._header(stamp_ns, frame)
        rows = zip(centre_form(boxes.boxes_px).tolist(), boxes.labels, boxes.scores, boxes.ids, strict=True)
        return self._make(DETECTIONS, header, [self._detection(header, *row) for row in rows])

    def camera_info(self, stamp_ns: int, frame: str, intrinsics: Intrinsics) -> Any:
        """A `CameraInfo`; the image is not rectified, so R is the identity and P has K's numbers."""
        width, height = intrinsics.image_size_px
        lens, matrix = intrinsics.distortion or Distortion(), intrinsics.matrix
        return self._make(
            CAMERA_INFO,
            self._header(stamp_ns, frame),
            height,
            width,
            "plumb_bob",
            np.array([lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]),
            matrix.ravel(),
            np.eye(3).ravel(),
            np.column_stack([matrix, np.zeros(3)]).ravel(),
            0,
            0,
            self._types["sensor_msgs/RegionOfInterest"](0, 0, 0, 0, False),  # zeros: the whole image
        )

    def transforms(self, stamp_ns: int, places: Iterable[tuple[Place, int]]) -> Any:
        """A `TFMessage` of frames, each with the index of the step in its `Place`."""
        kind = self._types["geometry_msgs/TransformStamped"]
        entries = [
            kind(
                self._header(stamp_ns, place.parent),
                place.child,
                self._types["geometry_msgs/Transform"](
                    self._vector(place.positions_m[step]), self._quaternion(place.quaternions[step])
                ),
            )
            for place, step in places
        ]
        return self._make(TRANSFORMS, entries)

    def odometry(self, stamp_ns: int, place: Place, step: int, velocity_m_s: Array, rates_rad_s: Array) -> Any:
        """An `Odometry` without error: the pose of a frame in its parent, velocity and rates along its own axes."""
        pose = self._pose(place.positions_m[step], place.quaternions[step])
        twist = self._types["geometry_msgs/Twist"](self._vector(velocity_m_s), self._vector(rates_rad_s))
        exact = np.zeros(36)
        return self._make(
            ODOMETRY,
            self._header(stamp_ns, place.parent),
            place.child,
            self._pose_with_covariance(pose, exact),
            self._types["geometry_msgs/TwistWithCovariance"](twist, exact),
        )

    def imu(self, stamp_ns: int, frame: str, measured: Measured, step: int, variances: Variances) -> Any:
        """An `Imu` of an inertial unit at a step."""
        turn, rate, force = (np.diag(each).ravel() for each in variances)
        return self._make(
            IMU,
            self._header(stamp_ns, frame),
            self._quaternion(measured.quaternions[step]),
            turn,
            self._vector(measured.rates_rad_s[step]),
            rate,
            self._vector(measured.forces_m_s2[step]),
            force,
        )

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
