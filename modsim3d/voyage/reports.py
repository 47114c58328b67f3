"""When the vessels of a scene made from AIS have reported, as `modsim3d ais` writes it beside the scene."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.ais.report_times import REPORT_TIMES
from modsim3d.ais.scene_folder import REPORT
from modsim3d.arrays import Array
from modsim3d.errors import InputError
from modsim3d.inputs.strict_json import load_json
from modsim3d.inputs.validation import shown
from modsim3d.voyage.logs.times import utc_s

_BYTES_PER_VALUE = 3


@dataclass(frozen=True, eq=False)
class Reports:
    """What is known of the reports that a scene's poses were made of.

    Attributes:
        start_s: Unix time of the scene's first step.
        used_s: Vessel → times of its positions since the first step, ascending; none for an older scene.
        jumps_s: Vessel → times of the positions that it cannot have reached, and that were dropped.
    """

    start_s: float
    used_s: Mapping[str, Array] = field(default_factory=dict)
    jumps_s: Mapping[str, Array] = field(default_factory=dict)


def read_reports(scene: Path) -> Reports | None:
    """The reports beside a scene file; None if the scene was not made from AIS.

    Raises:
        InputError: A file beside it is wrong.
    """
    times, report = scene.parent / REPORT_TIMES, scene.parent / REPORT
    if times.is_file():
        source = f"report times {times}"
        content = load_json(times, "report times", _BYTES_PER_VALUE)
        vessels = content.get("vessels") if isinstance(content, dict) else None
        if not isinstance(vessels, dict):
            raise InputError(source, [f"must be a mapping with start and vessels (got {shown(content)})"])
        used, jumps = ({name: _times(each, key) for name, each in vessels.items()} for key in ("used_s", "jumps_s"))
        if wrong := [name for name in vessels if used[name] is None or jumps[name] is None]:
            raise InputError(source, [f"vessels.{wrong[0]}: must have used_s and jumps_s, ascending seconds"])
        known = ({n: v for n, v in each.items() if v is not None} for each in (used, jumps))
        return Reports(_start(content, source), *known)
    if report.is_file():
        content = load_json(report, "report")
        return Reports(_start(content, f"report {report}"))
    return None


def _start(content: Any, source: str) -> float:
    text = content.get("start") if isinstance(content, dict) else None
    start_s = utc_s(text) if isinstance(text, str) else math.nan
    if math.isnan(start_s):
        raise InputError(source, [f"start: must be a time such as 2024-01-04T10:00:00Z (got {shown(text)})"])
    return start_s


def _times(entry: Any, key: str) -> Array | None:
    values = entry.get(key) if isinstance(entry, dict) else None
    if not isinstance(values, list) or not all(isinstance(v, int | float) for v in values):
        return None
    times = np.array(values, dtype=np.float64)
    return times if (np.diff(times) >= 0).all() else None
