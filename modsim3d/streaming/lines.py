"""The lines of a stream: the cameras first, then what a tracker may read of each frame, step by step."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import orjson

from modsim3d.geometry.camera import Camera
from modsim3d.random_streams import Streams
from modsim3d.runs.blocks import Block
from modsim3d.runs.files.tracker_input import tracker_lines
from modsim3d.runs.pipeline import simulate_blocks
from modsim3d.scene.own_ships import measured_attitudes_at
from modsim3d.scene.scene import Scene


@dataclass(frozen=True)
class StepLines:
    """What a stream says of one step: a line for each camera that takes a frame, or one line that none does.

    Attributes:
        step: Number of the step, from 0.
        time_s: Time since the scene's first step.
        lines: The complete lines.
    """

    step: int
    time_s: float
    lines: tuple[bytes, ...]


def header_line(scene: Scene) -> bytes:
    """The first line of a stream: what a tracker must know of the scene and its cameras before the first frame."""
    header = {
        "scene": scene.name,
        "steps": None if scene.live else scene.steps,
        "labels": list(scene.detector.labels),
        "cameras": {camera.name: _calibration(camera) for camera in scene.cameras},
    }
    return orjson.dumps(header) + b"\n"


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

    Args:
        scene: The scene.
        one_by_one: Simulate each step by itself, so that none waits for later ones. It takes longer in all; the lines
            are the same.

    Raises:
        ModsimError: The scene asks for what cannot be, or the poses that came are wrong.
    """
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
            (name, None if known is None else known[row], lines[step])
            for name, known, lines in cameras
            if step in lines
        ]
        if taken:
            lines = tuple(_with_camera(line, name, len(taken), known) for name, known, line in taken)
        else:
            lines = (orjson.dumps({"frames_in_step": 0, "time_s": time_s, "step": step}) + b"\n",)
        yield StepLines(step, time_s, lines)


def _attitudes(block: Block, scene: Scene, streams: Streams) -> dict[str | None, list[bytes]]:
    """Measured roll, pitch and heading at each step, as JSON, of each vessel that carries a camera, by its name."""
    if not scene.own_ships:
        return {}
    measured = measured_attitudes_at(scene, streams, block.first, block.stop)
    return {
        scene.vessel_names[vessel]: [orjson.dumps(each) for each in measured[:, column].tolist()]
        for column, vessel in enumerate(scene.own_ships)
    }


def _with_camera(line: bytes, name: bytes, frames: int, attitude: bytes | None) -> bytes:
    """A line of `tracker_input_<camera>.jsonl` with what is known of the camera and the step before its keys."""
    on_board = b"" if attitude is None else b'"attitude_rad":%b,' % attitude
    return b'{"camera":%b,"frames_in_step":%d,%b' % (name, frames, on_board) + line[1:]
