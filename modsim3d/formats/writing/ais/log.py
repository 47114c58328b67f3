"""Writes what an AIS receiver would log, and beside it which vessel is behind each number."""

import csv
import io
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from operator import xor
from pathlib import Path
from typing import Any

from modsim3d.core.errors import ModsimError
from modsim3d.core.random_streams import Purpose, Streams
from modsim3d.formats.writing.ais import reporting, sensors
from modsim3d.formats.writing.ais.sensors import Noise, SensorReadings, Station, Stay, stations
from modsim3d.formats.writing.export_formats import ExportRequest
from modsim3d.io.atomic_write import write_files
from modsim3d.scene.scene import Scene

EPOCH_S = 1_577_836_800  # Unix time of a scene's first step: 2020-01-01T00:00:00Z, the beginning of a minute
NO_SPEED, NO_COURSE, NO_HEADING, NO_TURN = 102.3, 360.0, 511, -128.0
MAX_SPEED_KN = 102.2
TURN_STEP, MAX_TURN = 4.733, 126  # the rate of turn in °/min is sent as its root times this, and from 708° on as 126
HEADING_FROM_M = 45.0  # from about 500 gross tonnage ships carry a gyrocompass, which measures the rate of turn
AT_ANCHOR, UNDER_WAY = 1, 0
BY_GPS = 1
NO_HOUR, NO_MINUTE = 24, 60
CARRIER_SENSE_STATE = 0b1_1100000000000000110  # of class B "CS", instead of slots (ITU-R M.1371-5, annex 8, table 70)

Fields = dict[str, Any]


def position_fields(station: Station, seen: SensorReadings, row: int, at_rest: bool, between: bool) -> Fields:
    """Message 1 or 3 of class A, or 18 of class B, which has no compass, with what was measured at a second."""
    speed, course = float(seen.speed_kn[row]), float(seen.course_deg[row])
    fields: Fields = {
        "msg_type": 18 if station.ais_class == "B" else 3 if between else 1,
        "mmsi": station.mmsi,
        "lat": float(seen.latitude_deg[row]),
        "lon": float(seen.longitude_deg[row]),
        "speed": NO_SPEED if math.isnan(speed) else min(round(10 * speed) / 10, MAX_SPEED_KN),
        "course": NO_COURSE if math.isnan(course) else round(10 * course) % 3600 / 10,
        "second": (EPOCH_S + int(seen.times_s[row])) % 60,
    }
    if station.ais_class == "B":
        flags = {"cs": True, "dsc": True, "band": True, "msg22": True}
        return fields | flags | {"heading": NO_HEADING, "radio": CARRIER_SENSE_STATE}
    turn = turn_field(float(seen.turn_deg_min[row])) if station.length_m >= HEADING_FROM_M else NO_TURN
    return fields | {
        "heading": round(float(seen.heading_deg[row])) % 360,
        "turn": turn,
        "status": AT_ANCHOR if at_rest else UNDER_WAY,
        "maneuver": 0,
    }


def turn_field(turn_deg_min: float) -> float:
    """The rate of turn that is sent for one, in degrees a minute. It is rounded to what the field can hold, since pyais
    takes 127 and 128 for codes with another meaning."""
    coded = min(round(TURN_STEP * math.sqrt(abs(turn_deg_min))), MAX_TURN)
    return math.copysign((coded / TURN_STEP) ** 2, turn_deg_min)


def static_fields(station: Station, part: int) -> Fields:
    """Message 5 of class A, which has no parts, or part 0 or 1 of message 24 of class B."""
    sides = dict(zip(("to_bow", "to_stern", "to_port", "to_starboard"), station.sides_m, strict=True))
    name, call_sign = {"shipname": f"SIM {station.mmsi:09d}"}, {"callsign": station.call_sign}
    fields: Fields = {"mmsi": station.mmsi, "ship_type": station.ship_type, **sides, **call_sign}
    if station.ais_class == "A":
        return fields | name | {"msg_type": 5, "epfd": BY_GPS, "hour": NO_HOUR, "minute": NO_MINUTE}
    # The number of the mother ship is for the tenders of ships, whose MMSI begins with 98.
    return fields | name | {"msg_type": 24, "partno": part, "mothership_mmsi": 0}


def payload(fields: Fields) -> tuple[str, int]:
    """The encoded message, and how many bits fill up its last character."""
    from pyais.encode import data_to_payload  # slow to import, and every campaign imports this module

    return data_to_payload(fields["msg_type"], fields).encode()


def lines(message: tuple[str, int], own: bool, channel: str, sequence: int, time_s: float) -> str:
    """The lines in the log of an encoded message with its fill bits: a tag block with the Unix time, and the sentence.
    `own` says whether own ship sent it, `channel` is `A` or `B`, `sequence` a number from 0 to 9, which the parts of a
    long message share, and `time_s` counts from the first step."""
    from pyais.encode import ais_to_nmea_0183

    text, fill_bits = message
    block = f"c:{EPOCH_S + math.floor(time_s)}"
    tag = f"\\{block}*{reduce(xor, block.encode('ascii'), 0):02X}\\"
    sentences = ais_to_nmea_0183(text, "AI", "VDO" if own else "VDM", channel, fill_bits, sequence)
    return "".join(f"{tag}{sentence}\r\n" for sentence in sentences)


LOG, TRUTH = "ais.nmea", "ais_truth.csv"
NOWHERE = (0.0, 0.0)  # latitude and longitude of a scene without an origin


@dataclass(frozen=True, order=True)
class ReceivedReport:
    """A report that is received; the order is that of the log."""

    time_s: float
    mmsi: int
    kind: int
    number: int
    message: tuple[str, int]
    own: bool


def files(request: ExportRequest) -> tuple[str, ...]:
    """The paths of the files. Raises ModsimError if the chosen cameras are on board several vessels."""
    own_ship(request)
    return LOG, TRUTH


def notes(request: ExportRequest) -> tuple[str, ...]:
    """Remarks on the files for the user."""
    if request.run.scene.origin is not None:
        return ()
    return ("the scene has no origin, so w1 = w2 = 0 is at latitude 0, longitude 0",)


def write(request: ExportRequest, folder: Path) -> None:
    """Write a run."""
    run, own = request.run, own_ship(request)
    run.check_has_steps()
    carried = stations(run.scene, own)
    arrivals = sorted(reports(run.scene, run.steps, carried))
    text = "".join(
        lines(report.message, report.own, "AB"[report.number % 2], number % 10, report.time_s)
        for number, report in enumerate(arrivals)
    )
    write_files({folder / LOG: text, folder / TRUTH: truth_table(run.scene, carried)})


def own_ship(request: ExportRequest) -> tuple[int, ...]:
    """The index of the vessel that carries the cameras; empty if all are ashore. Raises ModsimError for several."""
    request.run.scene.check_world("a log of AIS")
    names = request.run.scene.vessel_names
    carriers = {request.run.scene.cameras[index].mount.vessel for index in request.cameras} - {None}
    ships = tuple(index for index, name in enumerate(names) if name in carriers)
    if len(ships) > 1:
        vessels = " and ".join(f"'{names[index]}'" for index in ships)
        remedy = "a log of AIS has one own ship: choose the cameras of one of them with --camera"
        raise ModsimError(f"{request.run.folder}: the cameras are on board {vessels}, and {remedy}")
    return ships


def truth_table(scene: Scene, carried: tuple[Station, ...]) -> str:
    """Vessel behind each number, and vessels that have none, as CSV."""
    by_vessel = {station.vessel: station for station in carried}
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(("vessel", "ais_class", "mmsi", "own_ship"))
    for index, name in enumerate(scene.vessel_names):
        station = by_vessel.get(index)
        row = (station.ais_class, station.mmsi, int(station.own)) if station else (sensors.NO_CLASS, "", 0)
        writer.writerow((name, *row))
    return table.getvalue()


def reports(scene: Scene, steps: int, carried: tuple[Station, ...]) -> Iterator[ReceivedReport]:
    """All reports that are received in the first steps of a scene, those of one station after another."""
    streams = Streams(scene.seed)
    for station, stays in zip(carried, sensors.stays(scene, steps, carried), strict=True):
        seconds = int(stays[-1].times_s[-1]) + 1 if stays else 0
        sender = _Sender(scene, station, streams, Noise.of(station.name, streams, seconds))
        for number, stay in enumerate(stays):
            yield from sender.reports(stay, number)


class _Sender:
    """A station at work; it counts what it sends."""

    def __init__(self, scene: Scene, station: Station, streams: Streams, noise: Noise) -> None:
        self._scene, self._station, self._streams, self._noise = scene, station, streams, noise
        self._sent = [0, 0, 0]

    def reports(self, stay: Stay, number: int) -> Iterator[ReceivedReport]:
        """Reports received during a stay; `number` is its own, from 0."""
        station, scene = self._station, self._scene
        seen = sensors.measured(stay, self._noise, scene.origin or NOWHERE, scene.ais.position_noise_m)
        phases = self._streams.uniforms(Purpose.AIS_PHASE, station.name, first=number, count=1)[0].tolist()
        if station.own:
            yield from self._own_positions(seen, stay)
        else:
            yield from self._positions(seen, stay, phases[0])
        for part in range(1 if station.ais_class == "A" else 2):
            schedule = reporting.static_schedule(stay.times_s, stay.end_s, phases[1], part * reporting.STATIC_B_AFTER_S)
            if station.own:  # whose station is asked for them when the log begins
                schedule = reporting.own_static_schedule(stay.times_s, stay.end_s)
            message = payload(static_fields(station, part))
            for time_s, _, ordinal in self._received(schedule, stay, part + 1):
                yield ReceivedReport(time_s, station.mmsi, part + 1, ordinal, message, station.own)

    def _own_positions(self, seen: SensorReadings, stay: Stay) -> Iterator[ReceivedReport]:
        """Own ship's position, which its own station gives once a second."""
        for row in range(len(seen.times_s)):
            time_s = float(seen.times_s[row]) + reporting.AGE_S
            message = payload(position_fields(self._station, seen, row, stay.at_rest, False))
            yield ReceivedReport(time_s, self._station.mmsi, 0, 0, message, True)

    def _positions(self, seen: SensorReadings, stay: Stay, phase: float) -> Iterator[ReceivedReport]:
        often = reporting.rate(seen, self._station.ais_class, stay.at_rest)
        schedule = reporting.position_schedule(stay.times_s, stay.end_s, often, self._station.ais_class, phase)
        for time_s, row, ordinal in self._received(schedule, stay, 0):
            fields = position_fields(self._station, seen, row, stay.at_rest, bool(often.between[row]))
            yield ReceivedReport(time_s, self._station.mmsi, 0, ordinal, payload(fields), False)

    def _received(self, schedule: reporting.Schedule, stay: Stay, kind: int) -> Iterator[tuple[float, int, int]]:
        """Time, row of the measurements and number of each report; own ship's are never lost."""
        station, first, count = self._station, self._sent[kind], len(schedule.due_s)
        self._sent[kind] += count
        draws = self._streams.uniforms(Purpose.AIS_SLOT, station.name, str(kind), first=first, count=count)
        lost = 0.0 if station.own else self._scene.ais.drop_out
        batch = reporting.heard(schedule, stay.times_s, stay.end_s, lost, draws)
        yield from zip(batch.times_s.tolist(), batch.rows.tolist(), (batch.numbers + first).tolist(), strict=True)
