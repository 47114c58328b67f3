"""Our own JSON: lines of `modsim3d stream` and `tracker_input_CAMERA.jsonl`, and the thesis's detections by time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from modsim3d.errors import InputError
from modsim3d.formats.reading.builder import Problems, is_number
from modsim3d.formats.reading.confidences import Confidences
from modsim3d.inputs.strict_json import check_values, parse_json
from modsim3d.inputs.text_files import read_text
from modsim3d.inputs.validation import shown
from modsim3d.tracks.files.box_forms import CENTRE, CORNERS, BoxForm
from modsim3d.voyage.logs.log import Clock, DetectionLog, LogOptions, LogRows
from modsim3d.voyage.logs.times import MIXED, all_utc, time_of

_FORM = '{"camera": "bow", "time_s": 0.2, "detections": [{"box_px": [1, 2, 3, 4], "label": "boat", "confidence": 0.9}]}'
_THESIS = '{"0.2": {"a": {"label": "boat", "confidenceScore": 0.9, "bbox": {"centre": {"x": 2, "y": 3}, …}}}}'

_Frame = tuple[str, str | None, float, bool, list[tuple[str, list[float], str | None, object]]]
"""Place, camera, time, whether that is UTC, and place, box, label and confidence of each detection."""


def read_lines_log(path: Path, options: LogOptions) -> DetectionLog:
    """The log of a file with a frame on each line.

    Raises:
        InputError: A line is wrong.
    """
    source = f"detections {path}"
    text = read_text(path, "detections")
    check_values(text, source, 4)
    problems = Problems(source, options.skip_bad)
    frames = [
        frame
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip()
        and (frame := _line(parse_json(line, source, number, "line"), f"line {number}", problems)) is not None
    ]
    return _log(source, frames, Clock.STEP, "its lines", problems, options, CORNERS)


def read_thesis_log(path: Path, content: Mapping[str, Any], options: LogOptions) -> DetectionLog:
    """The log of a mapping from times to detections by name (Jessen & Mohr (2023), Figure 7.17).

    Raises:
        InputError: An entry is wrong.
    """
    source = f"detections {path}"
    problems = Problems(source, options.skip_bad)
    frames: list[_Frame] = []
    for text, entries in content.items():
        time_s, utc = time_of(text)
        if math.isnan(time_s) or not isinstance(entries, dict):
            problems.add(f"{text}: must be a time with its detections, as in {_THESIS} (got {shown(entries)})")
            continue
        found = [_thesis(entry, f"{text}.{name}", problems) for name, entry in entries.items()]
        frames.append((text, None, time_s, utc, [each for each in found if each is not None]))
    return _log(source, frames, Clock.STAMP, "its times", problems, options, CENTRE)


def _line(content: Any, where: str, problems: Problems) -> _Frame | None:
    """The frame of a line; None for the head of a stream, a step without frames, and a line that is wrong."""
    if isinstance(content, dict) and "detections" not in content and ("cameras" in content or "step" in content):
        return None
    if not isinstance(content, dict) or not isinstance(entries := content.get("detections"), list):
        problems.add(f"{where}: must be a frame such as {_FORM} (got {shown(content)})")
        return None
    time_s, utc = time_of(content.get("utc", content.get("time_s")))
    camera = content.get("camera")
    if math.isnan(time_s) or not (camera is None or isinstance(camera, str)):
        problems.add(f"{where}: time_s must be seconds, utc a time, and camera a name")
        return None
    found = [_detection(entry, f"{where}: detections[{k}]", problems) for k, entry in enumerate(entries)]
    return where, camera, time_s, utc, [each for each in found if each is not None]


def _detection(entry: Any, where: str, problems: Problems) -> tuple[str, list[float], str | None, object] | None:
    box = entry.get("box_px") if isinstance(entry, dict) else None
    if not isinstance(box, list) or len(box) != 4 or not all(map(is_number, box)):
        problems.add(f"{where}: box_px must be x_min, y_min, x_max, y_max in pixels (got {shown(entry)})")
        return None
    sides = [box[0], box[1], box[2] - box[0], box[3] - box[1]]
    return where, sides, _label(entry), entry.get("confidence")


def _thesis(entry: Any, where: str, problems: Problems) -> tuple[str, list[float], str | None, object] | None:
    try:
        box = entry["bbox"]
        x, y, width, height = box["centre"]["x"], box["centre"]["y"], box["width"], box["height"]
        sides = [x - width / 2, y - height / 2, width, height]
    except (KeyError, TypeError):
        problems.add(f"{where}: must be a detection as in {_THESIS} (got {shown(entry)})")
        return None
    return where, sides, _label(entry), entry.get("confidenceScore")


def _label(entry: Mapping[str, Any]) -> str | None:
    return None if entry.get("label") is None else str(entry["label"])


def _log(
    source: str, frames: list[_Frame], clock: Clock, origin: str, problems: Problems, options: LogOptions, form: BoxForm
) -> DetectionLog:
    utc = all_utc([of_utc for *_, of_utc, _ in frames])
    if utc is None:
        raise InputError(source, [MIXED])
    scores = [(where, score) for *_, found in frames for where, _, _, score in found if score is not None]
    confidences = Confidences.of(scores, options.confidence_scale, problems) if scores else None
    rows = LogRows(source, problems, confidences, form)
    for where, camera, time_s, _, found in frames:
        if rows.has(camera, time_s):
            problems.add(f"{where}: has the time of another frame{f' of {camera}' if camera else ''}, {time_s:.12g}")
            continue
        number = rows.frame(camera, time_s)
        for place, box, label, confidence in found:
            rows.add(number, place, box, label, confidence)
    return rows.log(Clock.UTC if utc else clock, origin)
