"""A scene with its cameras as they were registered, as a folder that every command takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import orjson

from modsim3d.ais.report_times import REPORT_TIMES
from modsim3d.ais.scene_folder import REPORT
from modsim3d.detector.file.writing import detector_text as yaml_text
from modsim3d.errors import ModsimError
from modsim3d.scene.parts import SCENE_FILE
from modsim3d.scene.scene import Scene
from modsim3d.voyage.labelled_voyage import Registered
from modsim3d.voyage.noted_clocks import REGISTRATION, noted_cameras
from modsim3d.voyage.registration import Registration

_VESSELS = "vessels.json"
_HEAD = (
    "Scene '{name}', with its cameras as they were registered; made by `modsim3d learn --write-scene`.",
    "registration.json has the clocks of the logs, which `modsim3d learn --scene` adds to their times.",
)


def scene_files(scene: Scene, registered: Sequence[Registered], folder: Path) -> dict[Path, bytes | str]:
    """The files of a copy of a scene whose cameras have the registered values.

    The scene is `scene.yaml`, so that the folder stands for it. What `modsim3d ais` wrote beside the scene is copied
    too, so that the copy knows as much of its vessels.

    Args:
        scene: The scene.
        registered: The registration of each camera.
        folder: Where the copy will be.

    Raises:
        ModsimError: A camera was registered in several logs, so that it has several values.
    """
    names = [each.registration.camera for each in registered]
    if twice := [name for name in names if names.count(name) > 1]:
        raise ModsimError(f"--write-scene: camera '{twice[0]}' was registered in several logs: join them, or give one")
    cameras = {name: dict(keys) for name, keys in scene.copy.document["cameras"].items()}
    for each in registered:
        cameras[each.registration.camera] = _camera_keys(cameras[each.registration.camera], each.registration)
    document = {**scene.copy.document, "cameras": cameras}
    found = _files_beside(scene)
    if isinstance(document.get("vessels"), dict):
        found[Path(_VESSELS)], document["vessels"] = _json(document["vessels"]), _VESSELS
    beside = (scene.path.parent / name for name in (REPORT, REPORT_TIMES))
    found |= {Path(path.name): path.read_bytes() for path in beside if path.is_file()}
    found[Path(REGISTRATION)] = _json(_content(scene, registered))
    found[Path(SCENE_FILE)] = yaml_text(document, [line.format(name=scene.name) for line in _HEAD])
    return {folder / name: content for name, content in found.items()}


def _files_beside(scene: Scene) -> dict[Path, bytes | str]:
    """The files that the copy's scene file names."""
    with TemporaryDirectory() as temporary:
        written = Path(temporary)
        scene_file = scene.copy.write(written)
        paths = [path for path in written.rglob("*") if path.is_file() and path != scene_file]
        return {path.relative_to(written): path.read_bytes() for path in paths}


def _camera_keys(keys: Mapping[str, Any], registration: Registration) -> dict[str, Any]:
    """The keys of a camera with what its registration adds."""
    values, place = registration.values, "mount" if keys.get("mount") else "pose"
    posed = dict(keys[place])
    along, port, up = posed["position_m"]
    posed["position_m"] = [along, port, up + values["height_m"]]
    for name in ("roll", "pitch", "yaw"):
        posed[f"{name}_rad"] = posed.get(f"{name}_rad", 0.0) + float(np.radians(values[f"{name}_deg"]))
    changed = {**keys, place: posed, "focal_length_m": keys["focal_length_m"] * (1 + values["focal_share"])}
    if values["k1"]:
        bent = dict(keys.get("distortion") or {})
        changed["distortion"] = bent | {"k1": bent.get("k1", 0.0) + values["k1"]}
    return changed


def _content(scene: Scene, registered: Sequence[Registered]) -> dict[str, Any]:
    """What was registered: the clock is added to the times of the log, the others are in the scene already.

    A camera that was not registered keeps what is noted of it beside the scene.
    """
    return {
        "format": 1,
        "cameras": dict(noted_cameras(scene.path))
        | {
            each.registration.camera: {
                "log": each.source,
                "clock_s": each.clock_s + each.registration.values["clock_s"],
                "known": each.known.given(),
                "added": {
                    found.name: {"value": found.value, "low": found.low, "high": found.high, "held": found.held or None}
                    for found in each.registration.estimates
                },
            }
            for each in registered
        },
    }


def _json(content: Mapping[str, Any]) -> bytes:
    return orjson.dumps(content, option=orjson.OPT_INDENT_2 | orjson.OPT_NON_STR_KEYS) + b"\n"
