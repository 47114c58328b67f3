"""All that a tracker in the world is given of a run, step by step, as it would arrive on board."""

import math
from collections import deque
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from modsim3d.core.arrays import Array
from modsim3d.formats.writing.ais.log import EPOCH_S, NO_COURSE, NO_HEADING, NO_SPEED, NOWHERE, lines, reports
from modsim3d.formats.writing.ais.sensors import stations
from modsim3d.geometry.kinematics import KNOT_M_S
from modsim3d.runs.camera_sequences import CameraSequence, sequences_of
from modsim3d.runs.locating import Locations, Viewpoints, locate
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.tracker_view import TrackerDetections
from modsim3d.scene.ais.messages import local_metres, wrapped_deg
from modsim3d.scene.cameras import OwnShips, own_ships_at
from modsim3d.scene.scene import Scene
from modsim3d.tracking.trackers.interface import SensedFrame
from modsim3d.tracking.trackers.world_interface import AisReport, Navigation, WorldFacts, WorldFrame, WorldStep


def sensed_frames(times_s: Array, rows: TrackerDetections) -> list[SensedFrame]:
    """The detections of each of F frames at these times, (F,), in arrays of their own, which a tracker may write to."""
    edges = np.searchsorted(rows.frame, np.arange(len(times_s) + 1)).tolist()
    return [
        SensedFrame(time_s, rows.boxes_px[a:b].copy(), rows.label[a:b].copy(), rows.confidence[a:b].copy())
        for time_s, (a, b) in zip(times_s.tolist(), pairwise(edges), strict=True)
    ]


def facts_of(scene: Scene) -> WorldFacts:
    """Facts on a scene that a tracker knows before the first step."""
    own_ships = tuple(scene.vessel_names[index] for index in scene.own_ships)
    return WorldFacts(scene.cameras, tuple(scene.detector.labels), own_ships, scene.sea, scene.origin)


def world_steps(rows: RunRows, *, bare: bool = False) -> Iterator[WorldStep]:
    """All steps of a run, in order; `bare` leaves out what a tracker of images is not given: places and AIS. Raises
    ModsimError where the scene is one of labels, without places, and this is not bare."""
    scene, steps = rows.scene, rows.steps
    if not bare:
        scene.check_world("a tracker in the world")
    cameras = sequences_of(rows, tuple(range(len(scene.cameras))))
    frames: dict[int, list[WorldFrame]] = {}
    for sequence in cameras:
        for step, frame in zip(sequence.steps.tolist(), _frames(scene, sequence, bare), strict=True):
            frames.setdefault(step, []).append(frame)
    own = own_ships_at(scene, 0, steps) if scene.own_ships else None
    received = deque([] if bare else ais_reports(scene, steps))
    for step, time_s in enumerate(scene.times_s(0, steps).tolist()):
        arrived = []
        while received and received[0].received_s <= time_s:
            arrived.append(received.popleft())
        readings = () if own is None else tuple(_readings(scene, own, step))
        yield WorldStep(step, time_s, tuple(frames.get(step, ())), tuple(arrived), readings)


def _frames(scene: Scene, sequence: CameraSequence, bare: bool) -> Iterator[WorldFrame]:
    steps, detections, camera = sequence.steps, sequence.detections, sequence.camera
    sensed = sensed_frames(sequence.times_s, detections)
    if bare or not len(steps):
        yield from (WorldFrame(camera.name, frame, _NOWHERE, np.empty(3), np.empty((3, 3))) for frame in sensed)
        return
    every = vars(locate(scene, camera.name, steps[detections.frame], detections.boxes_px)).values()
    poses = Viewpoints.of(scene, camera, steps, measured=True).poses()
    edges = np.searchsorted(detections.frame, np.arange(len(steps) + 1)).tolist()
    for row, (frame, (a, b)) in enumerate(zip(sensed, pairwise(edges), strict=True)):
        located = Locations(*(values[a:b] for values in every))
        yield WorldFrame(camera.name, frame, located, poses.positions_m[row], poses.camera_R_world[row])


_NOWHERE = Locations(*(np.empty(shape) for shape in (*[(0,)] * 5, (0, 2), (0, 2, 2))))


def _readings(scene: Scene, own: OwnShips, step: int) -> Iterator[Navigation]:
    columns = own.positions_m, own.measured_attitudes_rad, own.measured_rates_rad_s, own.measured_forces_m_s2
    for column, vessel in enumerate(own.vessels.tolist()):
        yield Navigation(scene.vessel_names[vessel], *(values[step, column].copy() for values in columns))


def ais_reports(scene: Scene, steps: int) -> list[AisReport]:
    """The reports of other vessels' AIS that are received in the first steps of a scene, in order of time: those that
    `modsim3d export --format ais` writes."""
    import pyais  # slow, and every campaign imports this module

    others = tuple(station for station in stations(scene, scene.own_ships) if not station.own)
    ais = sorted(reports(scene, steps, others))
    texts = [lines(report.message, False, "AB"[report.number % 2], report.number % 10, report.time_s) for report in ais]
    decoded = [pyais.decode(*_sentences(text)) for text in texts]
    places = iter(_places([message for message in decoded if hasattr(message, "lat")], scene.origin or NOWHERE))
    return [
        _with_place(report.time_s, text, message, next(places))
        if hasattr(message, "lat")
        else AisReport(report.time_s, report.mmsi, text, sides_m=_sides(message))
        for report, text, message in zip(ais, texts, decoded, strict=True)
    ]


def _sentences(text: str) -> list[bytes]:
    return [line.rpartition("\\")[2].encode() for line in text.splitlines()]


def _sides(message: Any) -> tuple[int, int, int, int] | None:
    """The sides that a message of names gives; None for part A of message 24, which has none."""
    sides = [getattr(message, f"to_{side}", None) for side in ("bow", "stern", "port", "starboard")]
    return None if None in sides else tuple(sides)  # type: ignore[return-value]


def _places(messages: Sequence[Any], origin: tuple[float, float]) -> Array:
    """Place, turn of true north and velocity of reports of positions, shape (n, 5)."""
    latitude, longitude, speed, course = np.array(
        [(message.lat, message.lon, message.speed, message.course) for message in messages], dtype=np.float64
    ).reshape(-1, 4).T  # fmt: skip
    metres = local_metres(latitude, longitude, origin) if len(messages) else np.empty((0, 2))
    # True north differs from w2 by the convergence of the meridians, as in the export.
    north = np.deg2rad(wrapped_deg(longitude - origin[1])) * np.sin(np.deg2rad(latitude))
    angle, fast = np.deg2rad(course) - north, speed * KNOT_M_S
    known = (speed < NO_SPEED) & (course < NO_COURSE)
    velocity = [np.where(known, fast * np.sin(angle), np.nan), np.where(known, fast * np.cos(angle), np.nan)]
    return np.column_stack([metres, north, *velocity])


def _with_place(received_s: float, text: str, message: Any, row: Array) -> AisReport:
    sent_s, heading = math.floor(received_s), None
    if message.heading < NO_HEADING:
        heading = float(wrapped_deg(90 - message.heading + np.rad2deg(row[2]))) * math.pi / 180
    measured_s = float(sent_s - (EPOCH_S + sent_s - message.second) % 60)
    velocity = None if np.isnan(row[3]) else row[3:]
    return AisReport(received_s, int(message.mmsi), text, measured_s, row[:2], velocity, heading)
