"""Writes a scene folder that is ready to run: scene, vessels, poses, detector and report."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

from modsim3d.ais.detector_file import detector_text
from modsim3d.ais.options import time_text
from modsim3d.ais.report import report
from modsim3d.ais.traffic import Traffic
from modsim3d.errors import ModsimError

SCENE, VESSELS, POSES, DETECTOR, REPORT = (
    "scene.yaml",
    "vessels.json",
    "poses.json.gz",
    "detector.yaml",
    "report.json",
)
SCENE_TEXT = """\
# Traffic from AIS: {vessels} vessels from {start}, one step every {time_step:g} s; made by `modsim3d ais`.
# w1 points east, w2 north of latitude {latitude:.7f}, longitude {longitude:.7f}. report.json says what was left out
# and what was filled in; the identities in vessels.json are MMSI, and every air draft is typical of the ship type.
steps: {steps}
seed: 0
vessels: vessels.json
poses: {{file: poses.json.gz}}
cameras:
  shore:                               # 69° wide
    focal_length_m: 0.007
    pixel_size_m: [5.0e-6, 5.0e-6]
    principal_point_px: [960, 540]
    image_size_px: [1920, 1080]
    # Looks from {distance:.0f} m across the square kilometre that most vessels visit, at {target}.
    # It is clear of all hulls, but AIS does not say where land is: move it to where a camera could stand.
    pose: {{position_m: [{position[0]:g}, {position[1]:g}, {position[2]:g}], yaw_rad: {yaw:g}, pitch_rad: {pitch:g}}}
annotation: {{mode: 0, source: rendered}} # the mode in which this detector was measured; 2 annotates what is seen
detector: detector.yaml
"""


def check_free(folder: Path, overwrite: bool) -> None:
    """Refuse a folder that is not empty, unless it holds a scene made from AIS that may be replaced.

    Raises:
        ModsimError: The folder is not free, or is no folder.
    """
    if (folder.is_symlink() or folder.exists()) and not folder.is_dir():
        raise ModsimError(f"{folder} is there already and is no folder: choose another with --out")
    if not folder.is_dir() or not any(folder.iterdir()):
        return
    ours = all((folder / name).is_file() for name in (SCENE, REPORT))
    if not overwrite:
        hint = "replace the scene in it with --overwrite, or " if ours else ""
        raise ModsimError(f"{folder} is not empty: {hint}choose another folder with --out")
    if not ours:
        raise ModsimError(f"{folder} is not empty and holds no scene made from AIS: it is left alone")


def write_scene(traffic: Traffic, folder: Path, detector: Path, overwrite: bool = False) -> None:
    """Write everything that the scene needs, and the report.

    Args:
        traffic: The traffic.
        folder: The scene folder; made if it does not exist.
        detector: A detector file with one label, to be copied or spread over the scene's labels.
        overwrite: Replace an existing scene folder.

    Raises:
        ModsimError: The folder is not free.
    """
    check_free(folder, overwrite)
    labels = list(dict.fromkeys(sorted(traffic.label(vessel) for vessel in traffic.vessels)))
    texts = {
        VESSELS: _vessels_text(traffic),
        DETECTOR: detector_text(detector, labels),
        REPORT: json.dumps(report(traffic), indent=2, ensure_ascii=False) + "\n",
        SCENE: _scene_text(traffic),
    }
    packed = gzip.compress(_poses_text(traffic).encode("utf-8"), mtime=0)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / POSES).write_bytes(packed)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


def _scene_text(traffic: Traffic) -> str:
    camera = traffic.camera
    return SCENE_TEXT.format(
        vessels=len(traffic.vessels),
        start=time_text(traffic.grid.start_s),
        time_step=traffic.options.time_step_s,
        latitude=traffic.origin[0],
        longitude=traffic.origin[1],
        steps=len(traffic.grid.timestamps),
        distance=camera.distance_m,
        target="w1 {:g}, w2 {:g}".format(*camera.target_m),
        position=camera.position_m,
        yaw=camera.yaw_rad,
        pitch=camera.pitch_rad,
    )


def _vessels_text(traffic: Traffic) -> str:
    entries = {
        str(vessel.mmsi): {
            "air_draft_m": vessel.hull.air_draft_m,
            "beam_m": vessel.hull.beam_m,
            "length_m": vessel.hull.length_m,
            "label": traffic.label(vessel),
        }
        for vessel in traffic.vessels
    }
    return json.dumps(entries, indent=2, ensure_ascii=False) + "\n"


def _poses_text(traffic: Traffic) -> str:
    """Poses as in Figure 7.3 of Jessen & Mohr (2023), to a millimetre and 0.01 mrad, one line a step."""
    entries: list[list[str]] = [[] for _ in traffic.grid.timestamps]
    for vessel in traffic.vessels:
        steps = vessel.present.nonzero()[0].tolist()
        places, headings = vessel.places_m[vessel.present].tolist(), vessel.headings_rad[vessel.present].tolist()
        for step, (w1, w2), heading in zip(steps, places, headings, strict=True):
            pose = f'{{"center_position_m":[{w1:.3f},{w2:.3f},0.0],"heading_rad":{heading:.5f}}}'
            entries[step].append(f'"{vessel.mmsi}":{pose}')
    lines = (f'"{time}":{{{",".join(entry)}}}' for time, entry in zip(traffic.grid.timestamps, entries, strict=True))
    return "{" + ",\n".join(lines) + "}\n"
