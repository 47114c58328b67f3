"""Writes a scene folder that is ready to run: scene, vessels, poses, detector and report."""

from __future__ import annotations

import gzip
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import orjson
import yaml

from modsim3d.core.errors import ModsimError
from modsim3d.io.atomic_write import write_files
from modsim3d.io.input_files import read_text
from modsim3d.io.locks import LOCK_FILE
from modsim3d.io.strict_yaml import load_yaml
from modsim3d.scene.ais.options import time_text
from modsim3d.scene.ais.report import report
from modsim3d.scene.ais.traffic import AisTraffic

# ---- When each vessel has reported ----

REPORT_TIMES = "report_times.json.gz"
_DECIMALS = 3


def report_times(traffic: AisTraffic) -> bytes:
    """The content of `report_times.json.gz`: the start, and seconds since then of each vessel's positions.

    `used_s` are those of the positions that its poses are made of, `jumps_s` of those that it cannot have reached.
    """
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
CAMERA_HALF_ANGLE_RAD = math.atan(960 * 5e-6 / 0.007)
"""Half the angle that the scene's camera sees from left to right."""
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
annotation: {{mode: 0, source: rendered}} # the mode in which this detector was measured; 2 annotates what is seen
detector: detector.yaml
"""
DETECTOR_NOTE = """\
# The detector of {name}, spread over several labels: the same chance to miss a vessel whatever it is, none to take
# it for another, and false positives of all labels alike. That is an assumption; put measured numbers in their place.
"""


def check_free(folder: Path, overwrite: bool) -> None:
    """Refuse a folder that is not empty, unless it holds a scene made from AIS that may be replaced.

    Raises:
        ModsimError: The folder is not free, or is no folder.
    """
    if (folder.is_symlink() or folder.exists()) and not folder.is_dir():
        raise ModsimError(f"{folder} is there already and is not a folder: choose another with --out")
    if not folder.is_dir() or all(path.name == LOCK_FILE for path in folder.iterdir()):
        return
    ours = all((folder / name).is_file() for name in (SCENE, REPORT))
    if not overwrite:
        hint = "replace the scene in it with --overwrite, or " if ours else ""
        raise ModsimError(f"{folder} is not empty: {hint}choose another folder with --out")
    if not ours:
        raise ModsimError(f"{folder} is not empty and holds no scene made from AIS, so it is left alone")


def write_scene(
    traffic: AisTraffic, folder: Path, detector: Path, overwrite: bool = False, page: str | None = None
) -> None:
    """Write everything that the scene needs, and the report.

    Args:
        traffic: What the scene shows.
        folder: The scene folder; made if it does not exist.
        detector: A detector file with one label, to be copied or spread over the scene's labels.
        overwrite: Replace a scene folder that is there.
        page: The page that shows what became of the reports, as HTML; none is written if None.

    Raises:
        ModsimError: The folder is not free.
    """
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
    """The text of a detector file for some labels, made from a file with a single label.

    If that label is the only one, the file is copied as it is. Otherwise it gets a confusion matrix for all of them.
    """
    text = read_text(single, "detector file")
    data: dict[str, Any] = load_yaml(single, "detector file")
    if list(labels) == data["labels"]:
        return text
    data["labels"] = list(labels)
    for state in data["states"].values():
        (found,), (missed,) = state["confusion"]
        own = [[found if row == column else 0.0 for column in range(len(labels))] for row in range(len(labels))]
        state["confusion"] = [*own, [missed] * len(labels)]
        state["false_positive_labels"] = [1 / len(labels)] * len(labels)
    note = DETECTOR_NOTE.format(name=single.name)
    return note + yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110)
