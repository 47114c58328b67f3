"""What is in the two bags of a run: topics, and the messages of a block of steps in order of time."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from modsim3d.arrays import Indices
from modsim3d.formats.writing.mcap.bag import Bag
from modsim3d.formats.writing.mcap.boxes import Boxes, detected_boxes, true_boxes
from modsim3d.formats.writing.mcap.definitions import CAMERA_INFO, DETECTIONS, IMU, ODOMETRY, TRANSFORMS
from modsim3d.formats.writing.mcap.messages import Messages, Place, Variances
from modsim3d.formats.writing.mcap.names import BagNames
from modsim3d.formats.writing.mcap.places import (
    OwnMotion,
    moving_cameras,
    own_motions,
    static_places,
    vessels_in_map,
)
from modsim3d.motion.imu import Imu
from modsim3d.runs.blocks import Block, CameraBlock
from modsim3d.scene.scene import Scene


class Stamped(NamedTuple):
    """A message, its topic, and its time."""

    stamp_ns: int
    topic: str
    message: Any


class Recording:
    """The bag for a tracker and the bag of the truth."""

    def __init__(self, scene: Scene, names: BagNames, stamps_ns: Indices, messages: Messages) -> None:
        """`stamps_ns` has the time of each step of the scene."""
        self._scene, self._names, self._make = scene, names, messages
        self._stamps_ns: list[int] = stamps_ns.tolist()

    def begin(self, tracker: Bag, truth: Bag) -> None:
        """Add the topics, and the frames that never move."""
        names, static = self._names, static_places(self._scene, self._names)
        for name in names.cameras.values():
            tracker.add_topic(f"/{name}/camera_info", CAMERA_INFO)
            tracker.add_topic(f"/{name}/detections", DETECTIONS)
            truth.add_topic(f"/truth/{name}/boxes", DETECTIONS)
        for prefix in names.vessels.values():
            tracker.add_topic(f"/{prefix}odom", ODOMETRY)
            tracker.add_topic(f"/{prefix}imu", IMU)
        if names.vessels:
            tracker.add_topic("/tf", TRANSFORMS)
        truth.add_topic("/tf", TRANSFORMS)
        if static:
            tracker.add_topic("/tf_static", TRANSFORMS, latched=True)
            first = self._stamps_ns[0]
            tracker.write("/tf_static", first, self._make.transforms(first, [(place, 0) for place in static]))

    def write(self, block: Block, tracker: Bag, truth: Bag) -> None:
        """Add the messages of a block."""
        parts = [part for part in block.cameras if part.camera in self._names.cameras]
        motions = own_motions(self._scene, self._names, block.first, block.stop)
        moving = [motion.place for motion in motions]
        moving += moving_cameras(self._scene, self._names, block.first, block.stop)
        _write(
            tracker,
            [
                *([self._moving(block, moving)] if moving else []),
                *(self._own_ship(block, motion) for motion in motions),
                *(self._camera(part) for part in parts),
            ],
        )
        _write(truth, [self._vessels(block), *(self._truth(part) for part in parts)])

    def _moving(self, block: Block, places: list[Place]) -> Iterator[Stamped]:
        for row, stamp in enumerate(self._stamps_ns[block.first : block.stop]):
            yield Stamped(stamp, "/tf", self._make.transforms(stamp, [(place, row) for place in places]))

    def _own_ship(self, block: Block, motion: OwnMotion) -> Iterator[Stamped]:
        prefix, unit = self._names.vessels[motion.vessel], self._names.imu(motion.vessel)
        variances = _variances(self._scene.imu)
        for row, stamp in enumerate(self._stamps_ns[block.first : block.stop]):
            speeds = motion.velocities_m_s[row], motion.rates_rad_s[row]
            yield Stamped(stamp, f"/{prefix}odom", self._make.odometry(stamp, motion.place, row, *speeds))
            yield Stamped(stamp, f"/{prefix}imu", self._make.imu(stamp, unit, motion.measured, row, variances))

    def _camera(self, part: CameraBlock) -> Iterator[Stamped]:
        name, frame = self._names.cameras[part.camera], self._names.optical(part.camera)
        intrinsics = self._scene.cameras[part.camera].intrinsics
        for stamp, boxes in self._stamped(part, detected_boxes(part, self._scene)):
            yield Stamped(stamp, f"/{name}/camera_info", self._make.camera_info(stamp, frame, intrinsics))
            yield Stamped(stamp, f"/{name}/detections", self._make.detections(stamp, frame, boxes))

    def _truth(self, part: CameraBlock) -> Iterator[Stamped]:
        topic, frame = f"/truth/{self._names.cameras[part.camera]}/boxes", self._names.optical(part.camera)
        for stamp, boxes in self._stamped(part, true_boxes(part, self._scene)):
            yield Stamped(stamp, topic, self._make.detections(stamp, frame, boxes))

    def _vessels(self, block: Block) -> Iterator[Stamped]:
        vessels = vessels_in_map(self._scene, block.first, block.stop)
        for row, stamp in enumerate(self._stamps_ns[block.first : block.stop]):
            present = [(place, row) for place, there in vessels if there[row]]
            yield Stamped(stamp, "/tf", self._make.transforms(stamp, present))

    def _stamped(self, part: CameraBlock, frames: Iterable[Boxes]) -> Iterator[tuple[int, Boxes]]:
        return zip((self._stamps_ns[step] for step in part.steps.tolist()), frames, strict=True)


def _write(bag: Bag, sources: Iterable[Iterator[Stamped]]) -> None:
    """Write the messages of sources in order of time, and at one time in the order of the sources."""
    for stamp_ns, topic, message in heapq.merge(*sources, key=lambda stamped: stamped.stamp_ns):
        bag.write(topic, stamp_ns, message)


def _variances(imu: Imu) -> Variances:
    """Variances of all errors: noise and offset. Those of roll, pitch and heading are ROS's, about x, y and z."""
    rate = imu.rate_noise_rad_s**2 + imu.rate_bias_rad_s**2
    force = imu.acceleration_noise_m_s2**2 + imu.acceleration_bias_m_s2**2
    return Variances(imu.attitude_std_rad**2, np.full(3, rate), np.full(3, force))
