"""AIS reports as NMEA sentences, through pyais.

pyais cuts off what does not fit the steps of a field (tenths of a knot and of a degree), so numbers are rounded first.
"""

from __future__ import annotations

import math
from functools import reduce
from operator import xor
from typing import Any

from pyais.encode import ais_to_nmea_0183, data_to_payload

from modsim3d.formats.writing.ais.sensors import Measured
from modsim3d.formats.writing.ais.stations import Station

EPOCH_S = 1_577_836_800
"""Unix time of a scene's first step: 2020-01-01T00:00:00Z, the beginning of a minute."""
NO_SPEED, NO_COURSE, NO_HEADING, NO_TURN = 102.3, 360.0, 511, -128.0
FASTEST_KN = 102.2
TURN_STEP, MOST_TURN = 4.733, 126
"""The rate of turn in degrees a minute is sent as its root times this, and from 708° a minute on as 126."""
HEADING_FROM_M = 45.0
"""From about 500 gross tonnage ships carry a gyrocompass, which measures the rate of turn."""
AT_ANCHOR, UNDER_WAY = 1, 0
BY_GPS = 1
NO_HOUR, NO_MINUTE = 24, 60
CARRIER_SENSE_STATE = 0b1_1100000000000000110
"""What class B "CS" sends where others tell about their slots (ITU-R M.1371-5, annex 8, table 70)."""

Fields = dict[str, Any]


def position_fields(station: Station, seen: Measured, row: int, at_rest: bool, between: bool) -> Fields:
    """Message 1 or 3 of class A, or 18 of class B, with what was measured at a second.

    Class B has no compass.
    """
    speed, course = float(seen.speed_kn[row]), float(seen.course_deg[row])
    fields: Fields = {
        "msg_type": 18 if station.ais_class == "B" else 3 if between else 1,
        "mmsi": station.mmsi,
        "lat": float(seen.latitude_deg[row]),
        "lon": float(seen.longitude_deg[row]),
        "speed": NO_SPEED if math.isnan(speed) else min(round(10 * speed) / 10, FASTEST_KN),
        "course": NO_COURSE if math.isnan(course) else round(10 * course) % 3600 / 10,
        "second": (EPOCH_S + int(seen.times_s[row])) % 60,
    }
    if station.ais_class == "B":
        flags = {"cs": True, "dsc": True, "band": True, "msg22": True}
        return fields | flags | {"heading": NO_HEADING, "radio": CARRIER_SENSE_STATE}
    turn = turn_field(float(seen.turn_deg_min[row])) if station.length_m >= HEADING_FROM_M else NO_TURN
    status = AT_ANCHOR if at_rest else UNDER_WAY
    return fields | {
        "heading": round(float(seen.heading_deg[row])) % 360,
        "turn": turn,
        "status": status,
        "maneuver": 0,
    }


def turn_field(turn_deg_min: float) -> float:
    """The rate of turn that is sent for one, in degrees a minute.

    It is rounded to what the field can hold, since pyais takes 127 and 128 for codes with another meaning.
    """
    coded = min(round(TURN_STEP * math.sqrt(abs(turn_deg_min))), MOST_TURN)
    return math.copysign((coded / TURN_STEP) ** 2, turn_deg_min)


def static_fields(station: Station, part: int) -> Fields:
    """Message 5 of class A, which has no parts, or part 0 or 1 of message 24 of class B."""
    sides = dict(zip(("to_bow", "to_stern", "to_port", "to_starboard"), station.sides_m, strict=True))
    name, call_sign = {"shipname": station.ship_name}, {"callsign": station.call_sign}
    fields: Fields = {"mmsi": station.mmsi, "ship_type": station.ship_type, **sides, **call_sign}
    if station.ais_class == "A":
        return fields | name | {"msg_type": 5, "epfd": BY_GPS, "hour": NO_HOUR, "minute": NO_MINUTE}
    # The number of the mother ship is for the tenders of ships, whose MMSI begins with 98.
    return fields | name | {"msg_type": 24, "partno": part, "mothership_mmsi": 0}


def payload(fields: Fields) -> tuple[str, int]:
    """The encoded message, and how many bits fill up its last character."""
    encoded: tuple[str, int] = data_to_payload(fields["msg_type"], fields).encode()
    return encoded


def lines(message: tuple[str, int], own: bool, channel: str, sequence: int, time_s: float) -> str:
    """The lines of a message in the log: a tag block with the Unix time, and the sentence.

    Args:
        message: The encoded message and its fill bits.
        own: Whether own ship sent it.
        channel: `A` or `B`.
        sequence: Number from 0 to 9, which the parts of a long message share.
        time_s: When it was sent, in seconds since the first step.
    """
    text, fill_bits = message
    block = f"c:{EPOCH_S + math.floor(time_s)}"
    tag = f"\\{block}*{reduce(xor, block.encode('ascii'), 0):02X}\\"
    sentences = ais_to_nmea_0183(text, "AI", "VDO" if own else "VDM", channel, fill_bits, sequence)
    return "".join(f"{tag}{sentence}\r\n" for sentence in sentences)
