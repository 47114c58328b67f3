"""Reads ROS 2 bags, with rosbags, which is an extra."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from modsim3d.core.errors import InputError, ModsimError
from modsim3d.io.input_files import note_input

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

T = TypeVar("T")

BAG_FILE = "metadata.yaml"  # file that every bag has in its folder
BAG_ENDINGS = (".mcap", ".db3")
NANO = 1_000_000_000

DETECTIONS_2D, DETECTIONS_3D = "vision_msgs/msg/Detection2DArray", "vision_msgs/msg/Detection3DArray"
ODOMETRY = "nav_msgs/msg/Odometry"
_DETECTION = (
    "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox{0}D bbox\nstring id\n"
)
VISION_MSGS = {
    "vision_msgs/msg/Point2D": "float64 x\nfloat64 y\n",
    "vision_msgs/msg/Pose2D": "vision_msgs/Point2D position\nfloat64 theta\n",
    "vision_msgs/msg/BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
    ),
    "vision_msgs/msg/Detection2D": _DETECTION.format(2),
    "vision_msgs/msg/Detection3D": _DETECTION.format(3),
    DETECTIONS_2D: "std_msgs/Header header\nvision_msgs/Detection2D[] detections\n",
    DETECTIONS_3D: "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n",
}
"""Fields of vision_msgs 4, that of Humble and newer, for bags without definitions, as those in SQLite of Humble."""


class BagMessage(NamedTuple):
    """A message with its topic, the type of that, and the stamp of its header in nanoseconds."""

    topic: str
    kind: str
    stamp_ns: int
    content: Any


def message_types(needed_by: str) -> Typestore:
    """The types of all messages that are written or read. Raises ModsimError, which names `needed_by`, if rosbags
    is not installed."""
    try:
        import rosbags.highlevel  # noqa: F401
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError:
        raise ModsimError(f'{needed_by} needs rosbags: pip install "modsim3d[ros]"') from None
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in VISION_MSGS.items():
        store.register(get_types_from_msg(text, name))
    return store


def is_bag(path: Path) -> bool:
    """Whether a folder is that of a bag, or a file is one of its files by its name."""
    return (path / BAG_FILE).is_file() if path.is_dir() else path.suffix.lower() in BAG_ENDINGS


def read_bag(
    path: Path, what: str, chosen: Callable[[Mapping[str, str]], Container[str]], read: Callable[[BagMessage], T]
) -> Iterator[T]:
    """Results of `read` for the messages of some topics of a bag, in order of time. `path` is the bag's folder, or a
    file in it; a file in MCAP may also be alone. `chosen` gives the wanted topics from the types of all. Raises
    InputError if the bag cannot be read, and ModsimError if rosbags is not installed."""
    source, store = f"{what} {path}", message_types(f"reading {what} from a ROS 2 bag")
    from rosbags.highlevel import AnyReader

    if path.is_file() and (path.parent / BAG_FILE).is_file():
        path = path.parent
    elif path.suffix.lower() == ".db3":
        raise InputError(source, [f"{BAG_FILE} is missing beside it: give the whole folder of the bag"])
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        note_input(file)
    try:
        with AnyReader([path], default_typestore=store) as reader:
            topics = chosen({link.topic: link.msgtype for link in reader.connections})
            for connection, _, raw in reader.messages([link for link in reader.connections if link.topic in topics]):
                content: Any = reader.deserialize(raw, connection.msgtype)
                stamp = content.header.stamp
                stamp_ns = int(stamp.sec) * NANO + int(stamp.nanosec)
                yield read(BagMessage(connection.topic, connection.msgtype, stamp_ns, content))
    except ModsimError:
        raise
    except Exception as error:  # of a damaged bag the readers raise whatever they meet, not only their own errors
        raise InputError(source, [f"cannot be read as a ROS 2 bag: {error}"]) from None
