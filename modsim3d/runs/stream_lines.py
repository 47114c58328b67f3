"""The lines of a stream: the cameras first, then what a tracker may read of each frame, step by step."""

from __future__ import annotations

import gc
import ipaddress
import re
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any

import orjson

from modsim3d.core.errors import ModsimError
from modsim3d.core.random_streams import Streams
from modsim3d.geometry.camera import Camera
from modsim3d.io.operating_system import POSIX
from modsim3d.runs.blocks import Block
from modsim3d.runs.pipeline import simulate_blocks
from modsim3d.runs.tracker_view import tracker_lines
from modsim3d.scene.cameras import measured_attitudes_at
from modsim3d.scene.scene import Scene


@dataclass(frozen=True)
class StepLines:
    """Lines of a stream for one step: a line for each camera that takes a frame, or one line that none does."""

    step: int
    time_s: float  # since the scene's first step
    lines: tuple[bytes, ...]  # complete


def header_line(scene: Scene) -> bytes:
    """The first line of a stream: what a tracker must know of the scene and its cameras before the first frame."""
    return orjson.dumps(header_of(scene)) + b"\n"


def header_of(scene: Scene) -> dict[str, Any]:
    """The content of the first line."""
    return {
        "scene": scene.name,
        "steps": None if scene.live else scene.steps,
        "labels": list(scene.detector.labels),
        "cameras": {camera.name: _calibration(camera) for camera in scene.cameras},
    }


def _calibration(camera: Camera) -> dict[str, Any]:
    lens, place = camera.intrinsics, asdict(camera.mount)
    vessel = place.pop("vessel")
    return {
        "image_size_px": lens.image_size_px,
        "focal_px": lens.focal_px,
        "principal_point_px": lens.principal_point_px,
        "skew": lens.skew,
        "distortion": None if lens.distortion is None else asdict(lens.distortion),
        "frame_rate_hz": camera.frame_rate_hz,
        "start_offset_s": camera.start_offset_s,
        **({"pose": place} if vessel is None else {"mount": {"vessel": vessel, **place}}),
    }


def step_lines(scene: Scene, *, one_by_one: bool) -> Iterator[StepLines]:
    """The lines of each step of a scene; those of a live scene's step come before the next step is waited for.
    `one_by_one` simulates each step by itself, so that none waits for later ones: it takes longer in all; the lines are
    the same. Raises ModsimError if the scene asks for what cannot be, or the poses that came are wrong."""
    streams = Streams(scene.seed)  # once, since to make them takes as long as to draw from them
    for block in simulate_blocks(scene, 1 if one_by_one else None):
        yield from _lines_of(block, scene, streams)


def _lines_of(block: Block, scene: Scene, streams: Streams) -> Iterator[StepLines]:
    attitudes = _attitudes(block, scene, streams)
    cameras = [
        (
            orjson.dumps(scene.cameras[part.camera].name),
            attitudes.get(scene.cameras[part.camera].mount.vessel),
            dict(zip(part.steps.tolist(), tracker_lines(block, part, scene).splitlines(keepends=True), strict=True)),
        )
        for part in block.cameras
    ]
    for row, time_s in enumerate(scene.times_s(block.first, block.stop).tolist()):
        step = block.first + row
        taken = [
            (name, None if series is None else series[row], lines[step])
            for name, series, lines in cameras
            if step in lines
        ]
        if taken:
            lines = tuple(_with_camera(line, name, len(taken), attitude) for name, attitude, line in taken)
        else:
            lines = (orjson.dumps({"frames_in_step": 0, "time_s": time_s, "step": step}) + b"\n",)
        yield StepLines(step, time_s, lines)


def _attitudes(block: Block, scene: Scene, streams: Streams) -> dict[str | None, list[bytes]]:
    """Measured roll, pitch and heading at each step, as JSON, of each vessel that carries a camera, by its name."""
    if not scene.own_ships:
        return {}
    measured = measured_attitudes_at(scene, streams, block.first, block.stop)
    return {
        scene.vessel_names[vessel]: [orjson.dumps(angles) for angles in measured[:, column].tolist()]
        for column, vessel in enumerate(scene.own_ships)
    }


def _with_camera(line: bytes, name: bytes, frames: int, attitude: bytes | None) -> bytes:
    """A line of `tracker_input_<camera>.jsonl` with what is known of the camera and the step before its keys."""
    on_board = b"" if attitude is None else b'"attitude_rad":%b,' % attitude
    return b'{"camera":%b,"frames_in_step":%d,%b' % (name, frames, on_board) + line[1:]


class Pace:
    """Lets no step leave before its time. `latest` is the step that left latest after its time, None before the
    first, and `late_s` how much later. Every due time is counted from the first step, so that errors do not add up."""

    def __init__(
        self, clock: Callable[[], float] = time.monotonic, sleep: Callable[[float], object] = time.sleep
    ) -> None:
        """Start with the first step that is waited for."""
        self.late_s = 0.0
        self.latest: int | None = None
        self._clock, self._sleep = clock, sleep
        self._zero: float | None = None

    def wait(self, step: int, time_s: float) -> None:
        """Wait until the time of a step has come; a step that is late leaves at once."""
        if self._zero is None:
            self._zero = self._clock() - time_s
        due = self._zero + time_s
        while (left := due - self._clock()) > 0:
            self._sleep(left)
        if self.latest is None or -left > self.late_s:
            self.late_s, self.latest = -left, step


_COLLECT_AFTER = 700  # new objects: looking through so few takes a tenth of a millisecond


@contextmanager
def short_collections() -> Iterator[None]:
    """Leave out of every search what is there now: to look through all objects of the libraries takes 10 to 20 ms."""
    threshold = gc.get_threshold()
    gc.freeze()
    gc.set_threshold(_COLLECT_AFTER, *threshold[1:])
    try:
        yield
    finally:
        gc.set_threshold(*threshold)
        gc.unfreeze()


STANDARD_OUTPUT = "-"
_TCP = re.compile(r"tcp://(?:\[(?P<six>[^\[\]/]+)\]|(?P<four>[^\[\]/:]+)):(?P<port>[0-9]{1,5})")
_EXAMPLE = "tcp://127.0.0.1:5000, tcp://[::1]:5000, or port 0 for any free port"


@dataclass(frozen=True)
class Address:
    """An IP address of this computer and a port; 0 is any free port."""

    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> Address:
        """The address that `--to` names. Raises ModsimError if it is none."""
        if not text.startswith("tcp://"):
            raise ModsimError(
                f"--to '{text}': is neither - (standard output) nor tcp://ADDRESS:PORT ({_EXAMPLE}); "
                "for a file use --to - > FILE"
            )
        match = _TCP.fullmatch(text)
        if match is None:
            raise ModsimError(f"--to '{text}': an address and a port are needed: {_EXAMPLE}")
        if (port := int(match["port"])) > 65535:
            raise ModsimError(f"--to '{text}': a port is a number from 0 to 65535 (got {port})")
        host = match["six"] or ("127.0.0.1" if match["four"] == "localhost" else match["four"])
        try:
            (ipaddress.IPv6Address if match["six"] else ipaddress.IPv4Address)(host)
        except ValueError:
            raise ModsimError(f"--to '{text}': '{host}' is no IP address of this computer: {_EXAMPLE}") from None
        return cls(host, port)

    def __str__(self) -> str:
        """As `--to` takes it."""
        return f"tcp://{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"

    @property
    def loopback(self) -> bool:
        """Whether only programs of this computer reach it."""
        return ipaddress.ip_address(self.host).is_loopback

    def listen(self, receive_bytes: int) -> socket.socket:
        """A socket that listens there and does not block; `receive_bytes` bounds what a connection takes in unread.
        Raises ModsimError if the port is taken or may not be used, or this computer has no such address."""
        listener = None
        try:
            family, kind, protocol, _, place = socket.getaddrinfo(
                self.host, self.port, type=socket.SOCK_STREAM, flags=socket.AI_NUMERICHOST
            )[0]
            listener = socket.socket(family, kind, protocol)
            if POSIX:  # Windows would let two programs listen on one port
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
            listener.setblocking(False)
            listener.bind(place)
            listener.listen()
        except OSError as error:
            if listener is not None:
                listener.close()
            raise ModsimError(
                f"--to {self}: cannot listen there: {error.strerror or error}; port 0 takes any free port"
            ) from None
        return listener
