"""A ROS 2 bag in MCAP of what a tracker may read, and beside it one of the truth.
The bag that a tracker plays names no vessel but own ship. docs/ros.md has topics, types and frames."""

from __future__ import annotations

import heapq
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.errors import InputError
from modsim3d.formats.writing import mcap_messages
from modsim3d.formats.writing.export_formats import ExportRequest
from modsim3d.formats.writing.mcap_messages import FrameBoxes, FramePlace, MeasuredMotion, Messages, quaternions
from modsim3d.geometry.camera_poses import camera_R_parent, vehicle_R_nominal, world_R_vehicle
from modsim3d.geometry.kinematics import first_derivative, slopes
from modsim3d.io.atomic_write import make_folder, put_in_place
from modsim3d.io.ros_bag import DETECTIONS_2D, ODOMETRY, message_types
from modsim3d.runs.blocks import Block, CameraBlock
from modsim3d.scene.cameras import OwnShips, own_ships_at
from modsim3d.scene.scene import Scene

if TYPE_CHECKING:
    from rosbags.interfaces import Connection, Qos
    from rosbags.rosbag2 import Writer
    from rosbags.typesys.store import Typestore

VERSION: Final = 8  # of `metadata.yaml`: ROS 2 Humble cannot read the profiles of 9, and every newer ROS reads 8


class Bag:
    """A bag that is being written."""

    def __init__(self, writer: Writer, store: Typestore) -> None:
        """An open writer, and the types of the messages."""
        self._writer, self._store = writer, store
        self._topics: dict[str, Connection] = {}

    def add_topic(self, topic: str, kind: str, *, latched: bool = False) -> None:
        """Add a topic of a type of messages; late readers get the last message of a latched one."""
        profiles = [_latched()] if latched else []
        self._topics[topic] = self._writer.add_connection(
            topic, kind, typestore=self._store, offered_qos_profiles=profiles
        )

    def write(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Add a message, with its stamp as the time at which it was recorded."""
        connection = self._topics[topic]
        self._writer.write(connection, stamp_ns, self._store.serialize_cdr(message, connection.msgtype))


@contextmanager
def open_bag(folder: Path, store: Typestore) -> Iterator[Bag]:
    """A bag in a folder that is not there yet: `metadata.yaml`, and a file with the folder's name and `.mcap`. It is
    not compressed: the bytes of zstd depend on which copy of its library the process has loaded."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    with Writer(folder, version=VERSION, storage_plugin=StoragePlugin.MCAP) as writer:
        yield Bag(writer, store)


def _latched() -> Qos:
    """The profile with which ROS publishes `/tf_static`."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    endless = QosTime(9223372036, 854775807)  # rmw's infinite duration
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL,
        deadline=endless,
        lifespan=endless,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=endless,
        avoid_ros_namespace_conventions=False,
    )


# ---- Names of topics and frames in a bag, after REP 103 and REP 105 ----

MAP = "map"  # the world's frame: x = w1, y = w2, z = w3


@dataclass(frozen=True)
class BagNames:
    """Names in the bags of an export."""

    cameras: Mapping[int, str]  # name in topics and frames, of each camera by its index
    # Prefix of topics and frames of each vessel that carries one of these, by its index: its name and a slash, or
    # nothing if it is the only vessel of the scene that carries cameras.
    vessels: Mapping[int, str]

    def base(self, vessel: int) -> str:
        """The frame of a vessel that carries a camera: x forward, y to port, z up."""
        return f"{self.vessels[vessel]}base_link"

    def imu(self, vessel: int) -> str:
        """The frame of its inertial unit, with the same axes."""
        return f"{self.vessels[vessel]}imu_link"

    def optical(self, camera: int) -> str:
        """The frame of a camera: z forward, x right, y down."""
        return f"{self.cameras[camera]}_optical_frame"


def bag_names(request: ExportRequest) -> BagNames:
    """The names for an export. Raises InputError if two cameras or two vessels have names that are the same in ROS."""
    scene = request.run.scene
    carriers = {scene.cameras[index].mount.vessel for index in request.cameras}
    own = [index for index in scene.own_ships if scene.vessel_names[index] in carriers]
    cameras = _tokens("camera", {index: scene.cameras[index].name for index in request.cameras}, scene.title)
    vessels = _tokens("vessel", {index: scene.vessel_names[index] for index in own}, scene.title)
    alone = len(scene.own_ships) == 1
    return BagNames(cameras, {index: "" if alone else f"{token}/" for index, token in vessels.items()})


def _tokens(kind: str, names: Mapping[int, str], source: str) -> dict[int, str]:
    tokens: dict[int, str] = {}
    for index, name in names.items():
        token = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
        if not token[:1].isalpha():  # ROS takes letters, digits and underscores, beginning with a letter
            token = f"{kind}_{token}".rstrip("_")
        same = [names[other] for other, other_token in tokens.items() if other_token == token]
        if same:
            problem = f"{kind}s '{same[0]}' and '{name}' are both called '{token}' in ROS"
            raise InputError(source, [f"{problem}: rename one, or export one at a time with --camera"])
        tokens[index] = token
    return tokens


@dataclass(frozen=True, eq=False)
class OwnMotion:
    """A vessel that carries a camera, at S steps."""

    vessel: int  # index into the scene's vessels
    place: FramePlace  # of its frame in the map
    velocities_m_s: Array  # of its origin, along its own axes: (S, 3)
    rates_rad_s: Array  # angular velocity along its own axes: (S, 3)
    measured: MeasuredMotion


def static_places(scene: Scene, names: BagNames) -> list[FramePlace]:
    """The frames that never move in their parents: cameras ashore, mounts on board, and inertial units."""
    places = [
        _fixed(names.base(vessel), names.imu(vessel), scene.imu.position_m, np.eye(3)) for vessel in names.vessels
    ]
    for index in names.cameras:
        if index in _cameras_that_add_angles(scene, names):
            continue
        mount = scene.cameras[index].mount
        parent = MAP if mount.vessel is None else names.base(scene.vessel_names.index(mount.vessel))
        turn = camera_R_parent(mount.roll_rad, mount.pitch_rad, mount.yaw_rad)
        places.append(_fixed(parent, names.optical(index), mount.position_m, turn.T))
    return places


def moving_cameras(scene: Scene, names: BagNames, first: int, stop: int) -> list[FramePlace]:
    """The cameras at steps first to stop − 1 that `composition: additive` moves on board, in the map."""
    places = []
    for index in _cameras_that_add_angles(scene, names):
        poses = scene.sight(scene.cameras[index], np.arange(first, stop)).camera_poses
        turns = quaternions(np.swapaxes(poses.camera_R_world, -1, -2))
        places.append(FramePlace(MAP, names.optical(index), poses.positions_m, turns))
    return places


def own_motions(scene: Scene, names: BagNames, first: int, stop: int) -> list[OwnMotion]:
    """The vessels that carry cameras at steps first to stop − 1; the numbers are those of `ownship.parquet`."""
    if not names.vessels:
        return []
    begin, end = scene.motion.with_neighbours(np.arange(first, stop))
    own, wanted = own_ships_at(scene, begin, end), slice(first - begin, stop - begin)
    turns = world_R_vehicle(own.headings_rad) @ np.swapaxes(vehicle_R_nominal(own.angles_rad), -1, -2)
    times_s = scene.times_s(begin, end)
    in_map = first_derivative(times_s, slopes(times_s, own.positions_m))
    velocities = (np.swapaxes(turns, -1, -2) @ in_map[..., None])[..., 0]
    return [
        _own_motion(own, column, names, turns[wanted, column], velocities[wanted, column], wanted)
        for column, vessel in enumerate(own.vessels.tolist())
        if vessel in names.vessels
    ]


def _own_motion(
    own: OwnShips, column: int, names: BagNames, turns: Array, velocities_m_s: Array, wanted: slice
) -> OwnMotion:
    vessel, here = int(own.vessels[column]), (wanted, column)
    place = FramePlace(MAP, names.base(vessel), own.positions_m[here], quaternions(turns))
    attitude = quaternions(_world_R_vessel(own.measured_attitudes_rad[here]))
    measured = MeasuredMotion(attitude, own.measured_rates_rad_s[here], own.measured_forces_m_s2[here])
    return OwnMotion(vessel, place, velocities_m_s, own.rates_rad_s[here], measured)


def _world_R_vessel(attitudes_rad: Array) -> Array:
    """Rotations to the world from roll, pitch and heading, shape (..., 3) to (..., 3, 3). The yaw in waves is about the
    world's axis, so it is part of the heading."""
    tilts = attitudes_rad * np.array([1.0, 1.0, 0.0])
    return world_R_vehicle(attitudes_rad[..., 2]) @ np.swapaxes(vehicle_R_nominal(tilts), -1, -2)


def vessels_in_map(scene: Scene, first: int, stop: int) -> list[tuple[FramePlace, Mask]]:
    """All vessels at steps first to stop − 1, and whether each is present, shape (stop − first,): the truth."""
    motion = scene.motion.at(np.arange(first, stop))
    vessels = []
    for column, name in enumerate(scene.vessel_names):
        present = motion.poses.present[:, column]
        turns = np.where(present[:, None, None], motion.world_R_vessel[:, column], np.eye(3))
        place = FramePlace(MAP, f"truth/{name}", motion.poses.positions_m[:, column], quaternions(turns))
        vessels.append((place, present))
    return vessels


def _fixed(parent: str, child: str, position_m: tuple[float, float, float], parent_R_child: Array) -> FramePlace:
    return FramePlace(parent, child, np.array([position_m], dtype=np.float64), quaternions(parent_R_child[None]))


def _cameras_that_add_angles(scene: Scene, names: BagNames) -> list[int]:
    """Cameras on board whose angles and place are not rigid in their vessel's frame."""
    if scene.waves is None or scene.waves.composition != "additive":
        return []
    return [index for index in names.cameras if scene.cameras[index].mount.vessel is not None]


class StampedMessage(NamedTuple):
    """A message, its topic, and its time."""

    stamp_ns: int
    topic: str
    message: Any


class BagRecording:
    """The bag for a tracker and the bag of the truth."""

    def __init__(self, scene: Scene, names: BagNames, stamps_ns: Indices, messages: Messages) -> None:
        """`stamps_ns` has the time of each step of the scene."""
        self._scene, self._names, self._make = scene, names, messages
        self._stamps_ns: list[int] = stamps_ns.tolist()

    def begin(self, tracker: Bag, truth: Bag) -> None:
        """Add the topics, and the frames that never move."""
        names, static = self._names, static_places(self._scene, self._names)
        for name in names.cameras.values():
            tracker.add_topic(f"/{name}/camera_info", mcap_messages.CAMERA_INFO)
            tracker.add_topic(f"/{name}/detections", DETECTIONS_2D)
            truth.add_topic(f"/truth/{name}/boxes", DETECTIONS_2D)
        for prefix in names.vessels.values():
            tracker.add_topic(f"/{prefix}odom", ODOMETRY)
            tracker.add_topic(f"/{prefix}imu", mcap_messages.IMU)
        if names.vessels:
            tracker.add_topic("/tf", mcap_messages.TRANSFORMS)
        truth.add_topic("/tf", mcap_messages.TRANSFORMS)
        if static:
            tracker.add_topic("/tf_static", mcap_messages.TRANSFORMS, latched=True)
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

    def _moving(self, block: Block, places: list[FramePlace]) -> Iterator[StampedMessage]:
        for row, stamp in enumerate(self._stamps_ns[block.first : block.stop]):
            yield StampedMessage(stamp, "/tf", self._make.transforms(stamp, [(place, row) for place in places]))

    def _own_ship(self, block: Block, motion: OwnMotion) -> Iterator[StampedMessage]:
        prefix, unit = self._names.vessels[motion.vessel], self._names.imu(motion.vessel)
        imu = self._scene.imu  # variances of all errors are those of noise and offset
        rate = imu.rate_noise_rad_s**2 + imu.rate_bias_rad_s**2
        force = imu.acceleration_noise_m_s2**2 + imu.acceleration_bias_m_s2**2
        # Those of roll, pitch and heading are ROS's, about x, y and z.
        variances = mcap_messages.Variances(imu.attitude_std_rad**2, np.full(3, rate), np.full(3, force))
        for row, stamp in enumerate(self._stamps_ns[block.first : block.stop]):
            speeds = motion.velocities_m_s[row], motion.rates_rad_s[row]
            yield StampedMessage(stamp, f"/{prefix}odom", self._make.odometry(stamp, motion.place, row, *speeds))
            yield StampedMessage(stamp, f"/{prefix}imu", self._make.imu(stamp, unit, motion.measured, row, variances))

    def _camera(self, part: CameraBlock) -> Iterator[StampedMessage]:
        name, frame = self._names.cameras[part.camera], self._names.optical(part.camera)
        intrinsics = self._scene.cameras[part.camera].intrinsics
        for stamp, boxes in self._stamped(part, mcap_messages.detected_boxes(part, self._scene)):
            yield StampedMessage(stamp, f"/{name}/camera_info", self._make.camera_info(stamp, frame, intrinsics))
            yield StampedMessage(stamp, f"/{name}/detections", self._make.detections(stamp, frame, boxes))

    def _truth(self, part: CameraBlock) -> Iterator[StampedMessage]:
        topic, frame = f"/truth/{self._names.cameras[part.camera]}/boxes", self._names.optical(part.camera)
        for stamp, boxes in self._stamped(part, mcap_messages.true_boxes(part, self._scene)):
            yield StampedMessage(stamp, topic, self._make.detections(stamp, frame, boxes))

    def _vessels(self, block: Block) -> Iterator[StampedMessage]:
        vessels = vessels_in_map(self._scene, block.first, block.stop)
        for row, stamp in enumerate(self._stamps_ns[block.first : block.stop]):
            present = [(place, row) for place, mask in vessels if mask[row]]
            yield StampedMessage(stamp, "/tf", self._make.transforms(stamp, present))

    def _stamped(self, part: CameraBlock, frames: Iterable[FrameBoxes]) -> Iterator[tuple[int, FrameBoxes]]:
        return zip((self._stamps_ns[step] for step in part.steps.tolist()), frames, strict=True)


def _write(bag: Bag, sources: Iterable[Iterator[StampedMessage]]) -> None:
    """Write the messages of sources in order of time, and at one time in the order of the sources."""
    for stamp_ns, topic, message in heapq.merge(*sources, key=lambda stamped: stamped.stamp_ns):
        bag.write(topic, stamp_ns, message)


BAGS = ("detections", "truth")  # folders of the bags; the first is a tracker's
FILES = tuple(f"{bag}/{name}" for bag in BAGS for name in (f"{bag}.mcap", "metadata.yaml"))


def files(request: ExportRequest) -> tuple[str, ...]:
    """The paths of the files. Raises ModsimError if rosbags is not installed, the run has no step or knows no places,
    or its names or times cannot be those of a bag."""
    request.run.scene.check_world("a bag of poses")
    _recording(request)
    return FILES


def write(request: ExportRequest, folder: Path) -> None:
    """Write a run."""
    run, store = request.run, message_types("--format mcap")
    if run.stored is not None:
        run.stored.check_checksums()
    recording = _recording(request)
    with _bag_folders(folder) as (tracker_folder, truth_folder), ExitStack() as bags:
        tracker, truth = (bags.enter_context(open_bag(path, store)) for path in (tracker_folder, truth_folder))
        recording.begin(tracker, truth)
        for block in run.blocks():
            recording.write(block, tracker, truth)


def _recording(request: ExportRequest) -> BagRecording:
    run = request.run
    run.check_has_steps()
    messages, scene = Messages(message_types("--format mcap")), run.scene
    stamps_ns = mcap_messages.stamps_ns(scene.timestamps(0, run.steps), scene.title)
    return BagRecording(scene, bag_names(request), stamps_ns, messages)


@contextmanager
def _bag_folders(folder: Path) -> Iterator[list[Path]]:
    """Folders to write the bags to; all of their files get their places when all are complete."""
    work = folder / ".mcap.partial"
    with ExitStack() as places:
        for bag in BAGS:
            make_folder(folder / bag)
        final = {name: places.enter_context(put_in_place(folder / name)) for name in FILES}
        places.callback(shutil.rmtree, work, ignore_errors=True)
        shutil.rmtree(work, ignore_errors=True)  # of a command that was killed
        yield [work / bag for bag in BAGS]
        for name, partial in final.items():
            (work / name).replace(partial)
