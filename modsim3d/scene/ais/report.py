"""Counts of what was read, dropped and filled in, for `report.json` and the terminal, and what each reason means."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from modsim3d.scene.ais.options import time_text
from modsim3d.scene.ais.traffic import AisTraffic
from modsim3d.scene.ais.vessel_track import VesselTrack

EARTH_RADIUS_M = 6.371e6
NOTICEABLE_M = 5.0
REASONS = {
    "unreadable": "rows with a cell that cannot be read",
    "checksum": "sentences that do not match their checksum",
    "undecodable": "messages that cannot be decoded",
    "too_long": "sentences in lines of more than 2,048 bytes",
    "incomplete": "sentences whose other parts are missing",
    "no_time": "sentences without a time",
    "not_a_ship": "base stations, aids to navigation, aircraft, beacons",
    "long_range": "long-range reports, to 180 m only",
    "other_message": "messages of types that give no ship's position",
    "no_position": "latitude 91, longitude 181, both 0, or empty",
    "impossible_position": "latitude beyond ±90 or longitude beyond ±180",
    "outside_region": "outside the region",
    "outside_window": "before or after the scene",
    "duplicate": "same vessel and time as another",
    "jump": "faster than {max_speed_kn:g} kn from the position before",
}
NO_FAULTS = ("not_a_ship", "long_range", "other_message", "outside_region", "outside_window")
"""Reasons that lie in what was asked of the files or in the kind of sender."""
REPLACED = {
    "heading_from_course": "heading 511: course over ground in its place",
    "heading_from_bearing": "heading and course missing: bearing between positions",
    "heading_held": "heading missing while hardly moving: the heading before or after",
    "heading_unknown": "no heading, course or movement at all: north",
    "course_from_heading": "course 360: heading in its place",
    "course_unknown": "no course or heading: straight lines between positions",
    "speed_unknown": "speed 102.3: straight lines between positions",
}
DEFAULTS = {
    "type": "ship type missing: dimensions of the group 'unknown'",
    "length": "length missing: typical of the ship type",
    "beam": "beam missing: typical of the ship type",
    "antenna": "antenna's place missing: taken to be the middle of the hull",
    "air_draft": "air draft, never in AIS: typical of the ship type",
}


def report(traffic: AisTraffic) -> dict[str, Any]:
    """The content of `report.json`; it does not depend on the order of rows in the files."""
    options, camera = traffic.options, traffic.camera
    return {
        "start": time_text(traffic.grid.start_s),
        "end": time_text(traffic.grid.end_s),
        "steps": len(traffic.grid.timestamps),
        "time_step_s": options.time_step_s,
        "origin_deg": {"latitude": traffic.origin[0], "longitude": traffic.origin[1]},
        "warning": warning(traffic),
        "region": None if options.region is None else str(options.region),
        "swap_coordinates": options.swap_coordinates,
        "max_gap_s": options.max_gap_s,
        "max_speed_kn": options.max_speed_kn,
        "files": [
            {
                "file": tally.path.name,
                "format": tally.format,
                "messages": tally.messages,
                "left_out": _some(tally.dropped),
                "problems": tally.problems,
            }
            for tally in traffic.files
        ],
        "messages": {
            "read": messages_read(traffic),
            "used": messages_used(traffic),
            "particulars_only": traffic.dropped["particulars_only"],
            "dropped": _dropped(traffic),
        },
        "replaced": _replaced(traffic),
        "defaults": _defaults(traffic),
        "vessels": {str(vessel.mmsi): _vessel(traffic, vessel) for vessel in traffic.vessels},
        "vessels_at_no_step": [str(mmsi) for mmsi in traffic.elsewhere],
        "farthest_m": round(_farthest_m(traffic), 1),
        "camera": {"position_m": camera.position_m, "target_m": camera.target_m, "yaw_rad": camera.yaw_rad},
    }


def _vessel(traffic: AisTraffic, vessel: VesselTrack) -> dict[str, Any]:
    hull = vessel.hull
    return {
        "name": hull.name,
        "ship_type": hull.group,
        "label": traffic.options.label(hull.group),
        "messages": vessel.messages,
        "steps_present": len(vessel.steps),
        "length_m": hull.length_m,
        "beam_m": hull.beam_m,
        "air_draft_m": hull.air_draft_m,
        "centre_from_antenna_m": {"ahead": hull.ahead_m, "to_port": hull.to_port_m},
        "defaults": hull.defaults,
        "replaced": _some(vessel.replaced),
    }


def _some(counts: Counter[str]) -> dict[str, int]:
    """Counts that are not zero, in alphabetical order."""
    return {name: count for name, count in sorted(counts.items()) if count}


def messages_read(traffic: AisTraffic) -> int:
    """Number of messages in all files."""
    return sum(tally.messages for tally in traffic.files)


def messages_used(traffic: AisTraffic) -> int:
    """Number of positions that tracks were made from."""
    return messages_read(traffic) - sum(traffic.dropped.values())


def warning(traffic: AisTraffic) -> str | None:
    """Warning that comes first where more messages were lost to faults than were used, or all together are odd."""
    lost = {name: count for name, count in _dropped(traffic).items() if name not in NO_FAULTS}
    lost["duplicate"] = lost.get("duplicate", 0) - traffic.repeated  # of several receivers
    used, count = messages_used(traffic), sum(lost.values())
    if count <= used:
        return traffic.odd or None
    reasons = ", ".join(f"{name} {lost[name]:,}" for name in sorted(lost, key=lambda name: -lost[name]) if lost[name])
    return f"{count:,} of {count + used:,} messages were lost ({reasons}): are their times and identities right?"


def _dropped(traffic: AisTraffic) -> dict[str, int]:
    """Reason → number of messages dropped."""
    return {name: count for name, count in _some(traffic.dropped).items() if name in REASONS}


def _replaced(traffic: AisTraffic) -> dict[str, int]:
    """Replacement → number of missing values of used messages that it stands for."""
    return _some(sum((vessel.replaced for vessel in traffic.vessels), Counter[str]()))


def _defaults(traffic: AisTraffic) -> dict[str, int]:
    """Default → number of vessels that it is used for."""
    return _some(Counter(name for vessel in traffic.vessels for name in vessel.hull.defaults))


def summary_rows(traffic: AisTraffic) -> list[tuple[str, list[tuple[str, str, str]]]]:
    """Tables for the terminal: title, and rows of name, number and meaning."""
    options = traffic.options
    times = f"{time_text(traffic.grid.start_s)} to {time_text(traffic.grid.end_s)}"
    present = sum(len(vessel.steps) for vessel in traffic.vessels)
    away = f"{len(traffic.elsewhere)} more are there at no step" if traffic.elsewhere else ""
    read = [(tally.path.name, str(tally.messages), f"messages, {tally.format}") for tally in traffic.files]
    made = [
        ("messages used", str(messages_used(traffic)), f"of {messages_read(traffic)}"),
        ("particulars", str(traffic.dropped["particulars_only"]), "messages with names and dimensions only"),
        ("vessels", str(len(traffic.vessels)), away),
        ("steps", str(len(traffic.grid.timestamps)), f"every {options.time_step_s:g} s, {times}"),
        ("poses", str(present), f"away where reports are more than {options.max_gap_s:g} s apart"),
        ("farthest", f"{_farthest_m(traffic) / 1000:.1f} km", _flatness(_farthest_m(traffic))),
        ("origin", "{:.5f}, {:.5f}".format(*traffic.origin), "latitude, longitude of w1 = w2 = 0"),
    ]

    def explained(counts: dict[str, int], meaning: dict[str, str]) -> list[tuple[str, str, str]]:
        return [
            (name, str(count), meaning[name].format(max_speed_kn=options.max_speed_kn))
            for name, count in counts.items()
        ]

    return [
        ("read", read),
        ("result", made),
        ("messages dropped", explained(_dropped(traffic), REASONS)),
        ("values replaced, in messages", explained(_replaced(traffic), REPLACED)),
        ("defaults, in vessels", explained(_defaults(traffic), DEFAULTS)),
    ]


def _farthest_m(traffic: AisTraffic) -> float:
    """The greatest distance of a vessel from the origin."""
    return max(float(np.linalg.norm(vessel.places_m, axis=1).max()) for vessel in traffic.vessels)


def _flatness(distance_m: float) -> str:
    """Whether the plane is far off at a distance d: it moves places towards the origin by d³ / 6R²."""
    off_m = distance_m**3 / (6 * EARTH_RADIUS_M**2)
    text = "from the origin"
    return text if off_m < NOTICEABLE_M else f"{text}, where the plane is {off_m:.0f} m off: take less, with --region"
