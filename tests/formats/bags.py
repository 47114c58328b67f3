"""A voyage to export, and readers of bags: with rosbags, with mcap_ros2, and byte by byte."""

from collections import defaultdict
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

import modsim3d
from tests.scenes import camera_keys

STEPS = 14
FERRY, KAYAK, OWN = "MMSI-257123456", "MMSI-257999999", "own ship"
"""IDs that no topic, class or camera has in it."""
VESSELS = {
    OWN: {"length_m": 20, "beam_m": 6, "air_draft_m": 4, "label": "boat"},
    FERRY: {"length_m": 60, "beam_m": 12, "air_draft_m": 15, "label": "ship"},
    KAYAK: {"length_m": 5, "beam_m": 1, "air_draft_m": 2, "label": "boat"},
}
LENS = camera_keys(1280, 720, focal_length_m=0.008, pixel_size_m=[1e-5, 0.8e-5], principal_point_px=[650, 340])


def voyage(**keys: Any) -> modsim3d.Scene:
    """Own ship in waves, with cameras that look ahead and abeam; a camera ashore; a ferry and a kayak that come and go.
    Nobody is there at steps 5 to 8. `keys` replace keys of the scene."""
    time_s = np.arange(STEPS) * 0.1
    place = np.zeros((STEPS, 3, 2))
    place[:, 0] = np.stack([6 * time_s, 0.5 * time_s**2], axis=1)
    place[:, 1] = np.stack([150 - 4 * time_s, 20 + 8 * time_s], axis=1)
    place[:, 2] = np.stack([70 + 0 * time_s, 12 - time_s], axis=1)
    heading = np.stack([0.1 * time_s, 2.0 + 0 * time_s, -1.6 + 0.3 * time_s], axis=1)
    heading[5:9, 1:] = np.nan
    place[np.isnan(heading)] = np.nan
    ahead = {"vessel": OWN, "position_m": [6, 0.5, 6], "roll_rad": 0.05, "pitch_rad": 0.1, "yaw_rad": 0.1}
    abeam = {"vessel": OWN, "position_m": [0, 1, 5], "pitch_rad": 0.02, "yaw_rad": 0.35}
    bent = {"k1": -0.08, "k2": 0.02, "p1": 0.001, "p2": -0.002, "k3": 0.003}
    imu = {"position_m": [1, 0.2, 2], "rate_noise_rad_s": 0.01, "rate_bias_rad_s": 0.02}
    imu |= {"acceleration_noise_m_s2": 0.1, "acceleration_bias_m_s2": 0.2, "attitude_noise_rad": 0.03}
    imu |= {"attitude_bias_rad": 0.04, "heading_noise_rad": 0.05, "heading_bias_rad": 0.12}
    scene = {
        "vessels": VESSELS,
        "poses": {"positions_m": place, "headings_rad": heading, "time_step_s": 0.1},
        "cameras": {
            "bow.cam": {**LENS, "distortion": bent, "mount": ahead},
            "2-beam": {**LENS, "skew": 3.0, "frame_rate_hz": 4, "start_offset_s": 0.1, "mount": abeam},
            "quay": {**LENS, "pose": {"position_m": [0, -90, 12], "pitch_rad": 0.06, "yaw_rad": 0.85}},
        },
        "waves": {"level": "small"},
        "imu": imu,
        "annotation": {"mode": 0, "source": "analytic"},
        "detector": "coastal",
        "seed": 3,
    }
    return modsim3d.Scene.from_dict(scene | keys, name="voyage")


class Message(NamedTuple):
    """A message of a bag."""

    stamp_ns: int
    content: Any


Topics = dict[str, list[Message]]


def read_with_rosbags(bag: Path) -> Topics:
    topics: Topics = defaultdict(list)
    with AnyReader([bag]) as reader:
        for connection, stamp_ns, raw in reader.messages():
            topics[connection.topic].append(Message(stamp_ns, reader.deserialize(raw, connection.msgtype)))
    return dict(topics)


def read_with_mcap_ros2(bag: Path) -> Topics:
    """The same with the reader of MCAP's authors."""
    topics: Topics = defaultdict(list)
    with (bag / f"{bag.name}.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, raw, message in reader.iter_decoded_messages():
            topics[channel.topic].append(Message(raw.log_time, message))
    return dict(topics)


def plain(message: Any) -> Any:
    """A message of either reader as mappings, lists and numbers."""
    if isinstance(message, np.ndarray):
        return message.tolist()
    if isinstance(message, list | tuple):
        return [plain(each) for each in message]
    if is_dataclass(message):
        return {each.name: plain(getattr(message, each.name)) for each in fields(message) if each.name[0] != "_"}
    if hasattr(message, "__slots__"):
        return {name: plain(getattr(message, name)) for name in message.__slots__}
    return message


def all_bytes(bag: Path) -> bytes:
    """The bytes of all files of a bag, none of which is compressed."""
    with (bag / f"{bag.name}.mcap").open("rb") as stream:
        parts = [record for record in StreamReader(stream, emit_chunks=True).records if isinstance(record, Chunk)]
    assert parts and {part.compression for part in parts} == {""}
    return b"\n".join(path.read_bytes() for path in bag.iterdir())


def stamp_of(header: Any) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def boxes_of(message: Any) -> np.ndarray:
    """x_min, y_min, x_max, y_max of the detections of a message, shape (n, 4)."""
    boxes = [detection.bbox for detection in message.detections]
    centre = np.array([(box.center.position.x, box.center.position.y) for box in boxes]).reshape(-1, 2)
    half = np.array([(box.size_x, box.size_y) for box in boxes]).reshape(-1, 2) / 2
    return np.concatenate([centre - half, centre + half], axis=1)


class Frames:
    """The frames of a bag: transforms by parent and child, as tf2 keeps them."""

    def __init__(self, *bags: Topics) -> None:
        self._parents: dict[tuple[int | None, str], tuple[str, np.ndarray]] = {}
        for topics in bags:
            for topic, fixed in (("/tf_static", True), ("/tf", False)):
                for message in topics.get(topic, []):
                    for each in message.content.transforms:
                        when = None if fixed else stamp_of(each.header)
                        assert (when, each.child_frame_id) not in self._parents
                        self._parents[when, each.child_frame_id] = each.header.frame_id, matrix_of(each.transform)

    def map_T(self, frame: str, stamp_ns: int) -> np.ndarray:
        """The transform from a frame to the map at a time, shape (4, 4)."""
        whole = np.eye(4)
        while frame != "map":
            key = (stamp_ns, frame) if (stamp_ns, frame) in self._parents else (None, frame)
            frame, parent_T_frame = self._parents[key]
            whole = parent_T_frame @ whole
        return whole


def matrix_of(transform: Any) -> np.ndarray:
    matrix, turn, shift = np.eye(4), transform.rotation, transform.translation
    matrix[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    matrix[:3, 3] = shift.x, shift.y, shift.z
    return matrix


def projected(points_camera: np.ndarray, info: Any) -> np.ndarray:
    """Pixels of points in an optical frame, shape (n, 3) to (n, 2), by OpenCV's formula for plumb_bob."""
    k1, k2, p1, p2, k3 = info.d
    x, y = points_camera[:, 0] / points_camera[:, 2], points_camera[:, 1] / points_camera[:, 2]
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    bent_y = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return (np.array(info.k).reshape(3, 3) @ np.array([bent_x, bent_y, np.ones(len(x))]))[:2].T
