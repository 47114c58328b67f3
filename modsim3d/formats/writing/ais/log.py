"""Writes what an AIS receiver would log, and beside it which vessel is behind each number."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from modsim3d.errors import ModsimError
from modsim3d.formats.writing.ais.reporting import (
    AGE_S,
    STATIC_B_AFTER_S,
    Schedule,
    heard,
    own_static_schedule,
    position_schedule,
    rate,
    static_schedule,
)
from modsim3d.formats.writing.ais.sensors import Measured, Noise, measured
from modsim3d.formats.writing.ais.sentences import lines, payload, position_fields, static_fields
from modsim3d.formats.writing.ais.stations import NO_CLASS, Station, stations
from modsim3d.formats.writing.ais.stays import Stay, stays
from modsim3d.formats.writing.request import ExportRequest
from modsim3d.outputs.placing import write_files
from modsim3d.random_streams import Purpose, Streams
from modsim3d.scene.scene import Scene

LOG, TRUTH = "ais.nmea", "ais_truth.csv"
NOWHERE = (0.0, 0.0)
"""Latitude and longitude of a scene without an origin."""


@dataclass(frozen=True, order=True)
class Report:
    """A report that is received; the order is that of the log."""

    time_s: float
    mmsi: int
    kind: int
    number: int
    message: tuple[str, int]
    own: bool


def files(request: ExportRequest) -> tuple[str, ...]:
    """The paths of the files.

    Raises:
        ModsimError: The chosen cameras are on board several vessels.
    """
    own_ship(request)
    return LOG, TRUTH


def notes(request: ExportRequest) -> tuple[str, ...]:
    """What the user should know of the files."""
    if request.run.scene.origin is not None:
        return ()
    return ("the scene has no origin, so w1 = w2 = 0 is at latitude 0, longitude 0",)


def write(request: ExportRequest, folder: Path) -> None:
    """Write a run."""
    run, own = request.run, own_ship(request)
    run.check_has_steps()
    carried = stations(run.scene, own)
    found = sorted(reports(run.scene, run.steps, carried))
    text = "".join(
        lines(each.message, each.own, "AB"[each.number % 2], number % 10, each.time_s)
        for number, each in enumerate(found)
    )
    write_files({folder / LOG: text, folder / TRUTH: truth_table(run.scene, carried)})


def own_ship(request: ExportRequest) -> tuple[int, ...]:
    """The index of the vessel that carries the chosen cameras; empty if all of them are ashore.

    Raises:
        ModsimError: Several vessels carry them.
    """
    names = request.run.scene.vessel_names
    carriers = {request.run.scene.cameras[index].mount.vessel for index in request.cameras} - {None}
    found = tuple(index for index, name in enumerate(names) if name in carriers)
    if len(found) > 1:
        vessels = " and ".join(f"'{names[index]}'" for index in found)
        raise ModsimError(
            f"{request.run.folder}: the cameras are on board {vessels}, and a log of AIS has one own ship: choose the "
            "cameras of one of them with --camera"
        )
    return found


def truth_table(scene: Scene, carried: tuple[Station, ...]) -> str:
    """Which vessel is behind each number, and which vessels have none, as CSV."""
    by_vessel = {station.vessel: station for station in carried}
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(("vessel", "ais_class", "mmsi", "own_ship"))
    for index, name in enumerate(scene.vessel_names):
        station = by_vessel.get(index)
        row = (station.ais_class, station.mmsi, int(station.own)) if station else (NO_CLASS, "", 0)
        writer.writerow((name, *row))
    return table.getvalue()


def reports(scene: Scene, steps: int, carried: tuple[Station, ...]) -> Iterator[Report]:
    """All reports that are received in the first steps of a scene, those of one station after another."""
    streams = Streams(scene.seed)
    for station, found in zip(carried, stays(scene, steps, carried), strict=True):
        seconds = int(found[-1].times_s[-1]) + 1 if found else 0
        sender = _Sender(scene, station, streams, Noise.of(station.name, streams, seconds))
        for number, stay in enumerate(found):
            yield from sender.reports(stay, number)


class _Sender:
    """A station at work; it counts what it sends."""

    def __init__(self, scene: Scene, station: Station, streams: Streams, noise: Noise) -> None:
        self._scene, self._station, self._streams, self._noise = scene, station, streams, noise
        self._sent = [0, 0, 0]

    def reports(self, stay: Stay, number: int) -> Iterator[Report]:
        """What is received during a stay; `number` is its own, from 0."""
        station, scene = self._station, self._scene
        seen = measured(stay, self._noise, scene.origin or NOWHERE, scene.ais.position_noise_m)
        phases = self._streams.uniforms(Purpose.AIS_PHASE, station.name, first=number, count=1)[0].tolist()
        if station.own:
            yield from self._own_positions(seen, stay)
        else:
            yield from self._positions(seen, stay, phases[0])
        for part in range(1 if station.ais_class == "A" else 2):
            schedule = static_schedule(stay.times_s, stay.end_s, phases[1], part * STATIC_B_AFTER_S)
            if station.own:  # whose station is asked for them when the log begins
                schedule = own_static_schedule(stay.times_s, stay.end_s)
            message = payload(static_fields(station, part))
            for time_s, _, ordinal in self._received(schedule, stay, part + 1):
                yield Report(time_s, station.mmsi, part + 1, ordinal, message, station.own)

    def _own_positions(self, seen: Measured, stay: Stay) -> Iterator[Report]:
        """Own ship's position, which its own station gives once a second."""
        for row in range(len(seen.times_s)):
            time_s = float(seen.times_s[row]) + AGE_S
            message = payload(position_fields(self._station, seen, row, stay.at_rest, False))
            yield Report(time_s, self._station.mmsi, 0, 0, message, True)

    def _positions(self, seen: Measured, stay: Stay, phase: float) -> Iterator[Report]:
        often = rate(seen, self._station.ais_class, stay.at_rest)
        schedule = position_schedule(stay.times_s, stay.end_s, often, self._station.ais_class, phase)
        for time_s, row, ordinal in self._received(schedule, stay, 0):
            fields = position_fields(self._station, seen, row, stay.at_rest, bool(often.between[row]))
            yield Report(time_s, self._station.mmsi, 0, ordinal, payload(fields), False)

    def _received(self, schedule: Schedule, stay: Stay, kind: int) -> Iterator[tuple[float, int, int]]:
        """Time, row of the measurements and number of each report; own ship's are never lost."""
        station, first, count = self._station, self._sent[kind], len(schedule.due_s)
        self._sent[kind] += count
        draws = self._streams.uniforms(Purpose.AIS_SLOT, station.name, str(kind), first=first, count=count)
        lost = 0.0 if station.own else self._scene.ais.drop_out
        found = heard(schedule, stay.times_s, stay.end_s, lost, draws)
        yield from zip(found.times_s.tolist(), found.rows.tolist(), (found.numbers + first).tolist(), strict=True)
