"""The times of a log on the scene's clock: seconds since its first step."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.core.arrays import Array, Mask
from modsim3d.core.errors import InputError
from modsim3d.core.text import duration_text
from modsim3d.io.misreadings import other_unit
from modsim3d.io.strict_text import load_json
from modsim3d.io.validation import shown
from modsim3d.learn.voyage.logs.log import MIN_UNIX_S, Clock, DetectionLog, utc_s
from modsim3d.scene.ais.options import time_text
from modsim3d.scene.ais.scene_folder import REPORT, REPORT_TIMES
from modsim3d.scene.scene import Scene

# ---- The clocks that a registration has found ----

REGISTRATION = "registration.json"  # what was registered, clocks of logs included, which no scene has


def noted_cameras(scene: Path) -> Mapping[str, Mapping[str, Any]]:
    """Notes on each camera beside a scene file, `clock_s` at least, or empty. Raises InputError if it is wrong."""
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
    """Seconds to add to the times of a camera's logs, as noted beside a scene file, see `noted_cameras`, or 0."""
    return float(noted_cameras(scene).get(camera, {"clock_s": 0.0})["clock_s"])


# ---- When the vessels of a scene made from AIS have reported ----

_BYTES_PER_VALUE = 3


@dataclass(frozen=True, eq=False)
class Reports:
    """Facts about the reports behind a scene's poses: times of each vessel's positions since the first step, ascending,
    `used_s`, empty for an older scene, and those of dropped ones, `jumps_s`, where it cannot have been."""

    start_s: float  # Unix time of the scene's first step
    used_s: Mapping[str, Array] = field(default_factory=dict)
    jumps_s: Mapping[str, Array] = field(default_factory=dict)


def read_reports(scene: Path) -> Reports | None:
    """The reports beside a scene file; None if it was not made from AIS. Raises InputError if they are wrong."""
    times, report = scene.parent / REPORT_TIMES, scene.parent / REPORT
    if times.is_file():
        source = f"report times {times}"
        content = load_json(times, "report times", _BYTES_PER_VALUE)
        vessels = content.get("vessels") if isinstance(content, dict) else None
        if not isinstance(vessels, dict):
            raise InputError(source, [f"must be a mapping with start and vessels (got {shown(content)})"])
        used, jumps = ({name: _times(entry, key) for name, entry in vessels.items()} for key in ("used_s", "jumps_s"))
        if wrong := [name for name in vessels if used[name] is None or jumps[name] is None]:
            raise InputError(source, [f"vessels.{wrong[0]}: must have used_s and jumps_s, ascending seconds"])
        columns = ({n: v for n, v in table.items() if v is not None} for table in (used, jumps))
        return Reports(_start(content, source), *columns)
    return Reports(_start(load_json(report, "report"), f"report {report}")) if report.is_file() else None


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


_NEAR_S = 1e-6
_OUTSIDE_S = 0.1
_HOUR_S = 3600.0
_ZONES = 14.5  # no two zones are further apart from UTC, in hours
_WHOLE_HOURS = 0.02  # clocks that differ by whole hours up to this much of one are probably in two time zones


@dataclass(frozen=True)
class SceneClock:
    """Time and length of a scene."""

    length_s: float  # from the first step to the last
    first_s: float  # the first time as its poses write it
    start_s: float | None  # Unix time of the first step; None if the scene does not say

    @classmethod
    def of(cls, scene: Scene) -> SceneClock:
        """The clock of a scene; one made by `modsim3d ais` has the start beside it, and poses may have Unix times."""
        reports = read_reports(scene.path)
        first_s = float(scene.timestamps(0, 1)[0])
        start_s = reports.start_s if reports is not None else first_s if first_s >= MIN_UNIX_S else None
        return cls(float(scene.times_s(scene.steps - 1, scene.steps)[0]), first_s, start_s)

    def span(self, clock: Clock) -> str:
        """The first and the last step in words, by a clock."""
        if clock is Clock.UTC and self.start_s is not None:
            return f"{time_text(self.start_s)} to {time_text(self.start_s + self.length_s)}"
        zero = self.first_s if clock is Clock.STAMP else 0.0
        return f"{zero:.12g} s to {zero + self.length_s:.12g} s"


def on_scene_clock(times_s: Array, kind: Clock, source: str, scene: Scene, clock: SceneClock) -> Array:
    """Times by a clock, (n,), since the scene's first step. Raises InputError if that is UTC and the scene has none."""
    if kind is Clock.STEP:
        return times_s
    if kind is Clock.STAMP:
        return times_s - clock.first_s
    if clock.start_s is None:
        problem = (
            f"its times are UTC (from {time_text(float(times_s.min()))}), and {scene.title} does not say when it "
            "starts: a scene of modsim3d ais has report.json beside it, which does; or let its poses have Unix times"
        )
        if unit := _unit(times_s, kind, clock.length_s):
            problem = f"has times from {time_text(float(times_s.min()))} if they are Unix times{unit}"
        raise InputError(source, [problem])
    return times_s - clock.start_s


def within_scene(log_s: Array, clock_s: float, length_s: float) -> tuple[Array, Mask]:
    """Times of a log's F frames by a registered clock, and which are within the scene, from 0 to `length_s`, (F,) each.
    `log_s` ascend by the log's own clock; `clock_s` is added, 0 if not registered. A clock is not known to the
    millisecond: frames outside by less than half the time between two, and 0.1 s at most, are at the nearest step."""
    frame_s = float(np.diff(log_s).min()) if len(log_s) > 1 else 0.0
    outside_s = max(min(frame_s / 2, _OUTSIDE_S), _NEAR_S) if clock_s else _NEAR_S
    times_s = log_s + clock_s
    return np.clip(times_s, 0, length_s), (times_s >= -outside_s) & (times_s <= length_s + outside_s)


def check_overlap(log: DetectionLog, times_s: Array, scene: Scene, clock: SceneClock) -> None:
    """Raise InputError, with both spans, for a log with most frames, at `times_s` (F,), outside of the scene."""
    outside = (times_s < -_NEAR_S) | (times_s > clock.length_s + _NEAR_S)
    if 2 * outside.sum() <= len(outside):
        return
    spans = f"has frames from {log.span}, and {scene.title} is from {clock.span(log.clock)}"
    unit = _unit(log.time_s, log.clock, clock.length_s)
    if not outside.all():
        what = f"{outside.sum():,} of {len(outside):,} frames are before or after the scene"
        raise InputError(log.source, [f"{spans}: {what}{unit or '; give a part of the log, or a longer scene'}"])
    later = times_s.min() > clock.length_s
    apart_s = times_s.min() - clock.length_s if later else -times_s.max()
    hours, zones = abs(times_s.min() / _HOUR_S), ""
    if log.clock is Clock.UTC and 0.5 < hours < _ZONES and abs(hours - round(hours)) < _WHOLE_HOURS:
        zones = f"; the starts differ by {round(hours)} h: is one of the clocks in local time?"
    order = "after the scene's last step" if later else "before the scene's first step"
    raise InputError(log.source, [f"{spans}: the log is {order}, by {duration_text(float(apart_s))}{zones}{unit}"])


def _unit(times_s: Array, kind: Clock, length_s: float) -> str:
    """The unit that times are in; Unix times that are in the future are none."""
    past = kind is Clock.UTC and times_s.max(initial=0.0) < time.time() + 24 * _HOUR_S
    return "" if past else other_unit(times_s, length_s) or ": they are in the future" * (kind is Clock.UTC)
