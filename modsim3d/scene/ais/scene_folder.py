"""Writes a scene folder that is ready to run, and reports what was read, dropped and filled in."""

import gzip
import json
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import yaml

from modsim3d.core.errors import ModsimError
from modsim3d.io.atomic_write import write_files
from modsim3d.io.input_files import read_text
from modsim3d.io.overwrite_guard import LOCK_FILE
from modsim3d.io.strict_text import load_yaml
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
                "left_out": _positive(tally.dropped),
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
        "replaced": _positive(vessel.replaced),
    }


def _positive(counts: Counter[str]) -> dict[str, int]:
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
    return {name: count for name, count in _positive(traffic.dropped).items() if name in REASONS}


def _replaced(traffic: AisTraffic) -> dict[str, int]:
    """Replacement → number of missing values of used messages that it stands for."""
    return _positive(sum((vessel.replaced for vessel in traffic.vessels), Counter[str]()))


def _defaults(traffic: AisTraffic) -> dict[str, int]:
    return _positive(Counter(name for vessel in traffic.vessels for name in vessel.hull.defaults))


def summary_rows(traffic: AisTraffic) -> list[tuple[str, list[tuple[str, str, str]]]]:
    """Tables for the terminal: title, and rows of name, number and meaning."""
    options = traffic.options
    times = f"{time_text(traffic.grid.start_s)} to {time_text(traffic.grid.end_s)}"
    groups = Counter(vessel.hull.group for vessel in traffic.vessels)
    present = sum(len(vessel.steps) for vessel in traffic.vessels)
    away = f"{len(traffic.elsewhere)} more are there at no step" if traffic.elsewhere else ""
    read = [(tally.path.name, f"{tally.messages:,}", f"messages, {tally.format}") for tally in traffic.files]
    made = [
        ("messages used", f"{messages_used(traffic):,}", f"of {messages_read(traffic):,}"),
        ("particulars", f"{traffic.dropped['particulars_only']:,}", "messages with names and dimensions only"),
        ("vessels", f"{len(traffic.vessels):,}", away),
        ("steps", f"{len(traffic.grid.timestamps):,}", f"every {options.time_step_s:g} s, {times}"),
        ("poses", f"{present:,}", f"away where reports are more than {options.max_gap_s:g} s apart"),
        ("farthest", f"{_farthest_m(traffic) / 1000:.1f} km", _flatness(_farthest_m(traffic))),
        ("origin", "{:.5f}, {:.5f}".format(*traffic.origin), "latitude, longitude of w1 = w2 = 0"),
    ]

    def explained(counts: dict[str, int], meaning: dict[str, str]) -> list[tuple[str, str, str]]:
        return [
            (name, f"{count:,}", meaning[name].format(max_speed_kn=options.max_speed_kn))
            for name, count in counts.items()
        ]

    return [
        ("read", read),
        ("result", made),
        ("vessels by ship type", [(g, str(n), f"label {options.label(g)}") for g, n in sorted(groups.items())]),
        ("messages dropped", explained(_dropped(traffic), REASONS)),
        ("values replaced, in messages", explained(_replaced(traffic), REPLACED)),
        ("defaults, in vessels", explained(_defaults(traffic), DEFAULTS)),
    ]


def _farthest_m(traffic: AisTraffic) -> float:
    return max(float(np.linalg.norm(vessel.places_m, axis=1).max()) for vessel in traffic.vessels)


def _flatness(distance_m: float) -> str:
    """Whether the plane is far off at a distance d: it moves places towards the origin by d³ / 6R²."""
    off_m = distance_m**3 / (6 * EARTH_RADIUS_M**2)
    text = "from the origin"
    return text if off_m < NOTICEABLE_M else f"{text}, where the plane is {off_m:.0f} m off: take less, with --region"


REPORT_TIMES = "report_times.json.gz"
_DECIMALS = 3


def report_times(traffic: AisTraffic) -> bytes:
    """The content of `report_times.json.gz`: the start, and seconds since then of each vessel's positions. `used_s` are
    those of the positions that its poses are made of, `jumps_s` of those that it cannot have reached."""
    vessels = {
        str(vessel.mmsi): {
            "used_s": vessel.reported_s.round(_DECIMALS).tolist(),
            "jumps_s": vessel.jumps_s.round(_DECIMALS).tolist(),
        }
        for vessel in traffic.vessels
    }
    content = {"start": time_text(traffic.grid.start_s), "vessels": vessels}
    return gzip.compress(orjson.dumps(content), mtime=0)


SCENE, REPORT, PAGE = "scene.yaml", "report.json", "ais.html"
FILES = (SCENE, REPORT, PAGE, "vessels.json", "detector.yaml", "poses.json.gz", REPORT_TIMES)
CAMERA_HALF_ANGLE_RAD = math.atan(960 * 5e-6 / 0.007)  # half the angle that the scene's camera sees from left to right
SCENE_TEXT = """\
# Traffic from AIS: {vessels} vessels from {start}, one step every {time_step:g} s; made by `modsim3d ais`.
# w1 points east, w2 north of the origin. report.json says what was left out
# and what was filled in; the identities in vessels.json are MMSI, and every air draft is typical of the ship type.
steps: {steps}
seed: 0
origin: {{latitude_deg: {latitude:.7f}, longitude_deg: {longitude:.7f}}}
vessels: vessels.json
poses: {{file: poses.json.gz}}
cameras:
  shore:                               # 69° wide
    focal_length_m: 0.007
    pixel_size_m: [5.0e-6, 5.0e-6]
    principal_point_px: [960, 540]
    image_size_px: [1920, 1080]
    # Looks from {camera.distance_m:.0f} m across the square kilometre that most vessels visit, at {target}.
    # It is clear of all hulls, but AIS does not say where land is: move it to where a camera could stand.
    pose: {{position_m: [{position}], yaw_rad: {camera.yaw_rad:g}, pitch_rad: {camera.pitch_rad:g}}}
annotation: {{mode: 0, source: rendered}} # whole vessels, hidden parts too; 2 annotates what is seen
detector: detector.yaml
"""
DETECTOR_NOTE = """\
# The detector of {name}, spread over several labels: the same chance to miss a vessel whatever it is, none to take
# it for another, and false positives of all labels alike. That is an assumption; put measured numbers in their place.
"""


def check_free(folder: Path, overwrite: bool) -> None:
    """Refuse a folder that is not empty, unless it holds a scene made from AIS that may be replaced. Raises ModsimError
    if the folder is not free, or is no folder."""
    if (folder.is_symlink() or folder.exists()) and not folder.is_dir():
        raise ModsimError(f"{folder} is there already and is not a folder: choose another with --out")
    if not folder.is_dir() or all(path.name == LOCK_FILE for path in folder.iterdir()):
        return
    has_scene = all((folder / name).is_file() for name in (SCENE, REPORT))
    if not overwrite:
        hint = "replace the scene in it with --overwrite, or " if has_scene else ""
        raise ModsimError(f"{folder} is not empty: {hint}choose another folder with --out")
    if not has_scene:
        raise ModsimError(f"{folder} is not empty and holds no scene made from AIS, so it is left alone")


def write_scene(
    traffic: AisTraffic, folder: Path, detector: Path, overwrite: bool = False, page: str | None = None
) -> None:
    """Write everything that the scene needs, and the report. `detector` is a detector file with the scene's labels, or
    with one label, to be spread over them; `page` is the HTML page that shows what became of the reports. Raises
    ModsimError if the folder is not free."""
    check_free(folder, overwrite)
    labels = sorted({traffic.options.label(vessel.hull.group) for vessel in traffic.vessels})
    files = {
        "vessels.json": _json_text(_vessels(traffic)),
        "detector.yaml": detector_text(detector, labels),
        REPORT: _json_text(report(traffic)),
        SCENE: _scene_text(traffic),
    }
    if page is not None:
        files[PAGE] = page
    packed = gzip.compress(_poses_text(traffic).encode("utf-8"), mtime=0)
    binary = {folder / "poses.json.gz": packed, folder / REPORT_TIMES: report_times(traffic)}
    write_files(binary | {folder / name: text for name, text in files.items()})


def _json_text(content: Any) -> str:
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


def _scene_text(traffic: AisTraffic) -> str:
    camera = traffic.camera
    return SCENE_TEXT.format(
        vessels=len(traffic.vessels),
        start=time_text(traffic.grid.start_s),
        time_step=traffic.options.time_step_s,
        latitude=traffic.origin[0],
        longitude=traffic.origin[1],
        steps=len(traffic.grid.timestamps),
        camera=camera,
        target="w1 {:g}, w2 {:g}".format(*camera.target_m),
        position=", ".join(f"{value:g}" for value in camera.position_m),
    )


def _vessels(traffic: AisTraffic) -> dict[str, Any]:
    return {
        str(vessel.mmsi): {
            "air_draft_m": vessel.hull.air_draft_m,
            "beam_m": vessel.hull.beam_m,
            "length_m": vessel.hull.length_m,
            "label": traffic.options.label(vessel.hull.group),
        }
        for vessel in traffic.vessels
    }


def _poses_text(traffic: AisTraffic) -> str:
    """Poses as in Figure 7.3 of Jessen & Mohr (2023), to a millimetre and 0.01 mrad, one line a step."""
    entries: list[list[str]] = [[] for _ in traffic.grid.timestamps]
    for vessel in traffic.vessels:
        columns = vessel.steps.tolist(), vessel.places_m.tolist(), vessel.headings_rad.tolist()
        for step, (w1, w2), heading in zip(*columns, strict=True):
            pose = f'{{"center_position_m":[{w1:.3f},{w2:.3f},0.0],"heading_rad":{heading:.5f}}}'
            entries[step].append(f'"{vessel.mmsi}":{pose}')
    lines = (f'"{time}":{{{",".join(entry)}}}' for time, entry in zip(traffic.grid.timestamps, entries, strict=True))
    return "{" + ",\n".join(lines) + "}\n"


def detector_text(single: Path, labels: Sequence[str]) -> str:
    """The text of a detector file for some labels. One that has them is copied as it is. One with a single other label
    gets a confusion matrix for all of them."""
    text = read_text(single, "detector file")
    data: dict[str, Any] = load_yaml(single, "detector file")
    if set(labels) <= set(data["labels"]):
        return text
    data["labels"] = list(labels)
    for section in [data.get("dropout", {}), *(state.get("dropout", {}) for state in data["states"].values())]:
        section |= {key: section[key] * len(labels) for key in ("intercept", "learned_log_odds") if key in section}
    for state in data["states"].values():
        (hit,), (missed,) = state["confusion"]
        own = [[hit if row == column else 0.0 for column in range(len(labels))] for row in range(len(labels))]
        state["confusion"] = [*own, [missed] * len(labels)]
        state["false_positive_labels"] = [1 / len(labels)] * len(labels)
    note = DETECTOR_NOTE.format(name=single.name)
    return note + yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110)
