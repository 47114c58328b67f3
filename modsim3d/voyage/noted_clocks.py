"""The clocks that a registration has found, as `--write-scene` notes them beside the scene."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.errors import InputError
from modsim3d.inputs.strict_json import load_json
from modsim3d.inputs.validation import shown

REGISTRATION = "registration.json"
"""What was registered, the clock of each camera's log included, which is no value of a scene."""


def noted_cameras(scene: Path) -> Mapping[str, Mapping[str, Any]]:
    """What is noted of each camera beside a scene file, `clock_s` at least; nothing if nothing was registered.

    Raises:
        InputError: The file is wrong.
    """
    path = scene.parent / REGISTRATION
    if not path.is_file():
        return {}
    content = load_json(path, "registration")
    cameras = content.get("cameras") if isinstance(content, dict) else None
    if not isinstance(cameras, dict):
        raise InputError(f"registration {path}", [f"must be a mapping with cameras (got {shown(content)})"])
    problems = []
    for name, noted in cameras.items():
        clock_s = noted.get("clock_s") if isinstance(noted, dict) else None
        if isinstance(clock_s, bool) or not isinstance(clock_s, int | float) or not np.isfinite(clock_s):
            problems.append(f"cameras.{name}.clock_s: must be the seconds to add to a log's times (got {shown(noted)})")
    if problems:
        raise InputError(f"registration {path}", problems)
    return cameras


def noted_clock_s(scene: Path, camera: str) -> float:
    """Seconds to add to the times of a camera's logs, as noted beside a scene file; 0 if nothing is.

    Raises:
        InputError: The file is wrong.
    """
    return float(noted_cameras(scene).get(camera, {"clock_s": 0.0})["clock_s"])
