"""A ROS 2 bag in MCAP: topics, and messages in their order."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from rosbags.interfaces import Connection, Qos
    from rosbags.rosbag2 import Writer
    from rosbags.typesys.store import Typestore

VERSION: Final = 8
"""Of `metadata.yaml`: ROS 2 Humble cannot read the profiles of version 9, and every newer ROS reads 8."""


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
    """A bag in a folder that is not there yet: `metadata.yaml`, and a file with the folder's name and `.mcap`.

    It is not compressed: the bytes of zstd depend on which copy of its library the process has loaded.
    """
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
