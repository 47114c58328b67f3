"""COCO: results with the file of their images, or one file whose annotations have scores. The time of an image is its
`time_s`, `utc` or `date_captured`; with a frame rate, if that is empty or the same in all, as from many tools, that of
its `frame_id` or place. Its camera is `camera`, or `sequence` (or `video_id`) where that is a text or differs."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from modsim3d.core.errors import InputError
from modsim3d.formats.reading.builder import MAX_PROBLEMS, Confidences, Problems, image_names, is_number
from modsim3d.formats.reading.coco import KnownNames, categories_of
from modsim3d.io.input_files import read_text
from modsim3d.io.strict_text import check_values, parse_json
from modsim3d.io.validation import shown
from modsim3d.learn.voyage.logs.log import MIXED, TIME_FORM, Clock, DetectionLog, LogOptions, LogRows, all_utc, time_of
from modsim3d.scene.ais.options import time_text
from modsim3d.tracks.diagnosis import CENTRE, CORNERS, BoxForm

_CAPTURED = "date_captured"
_TIMES = ("time_s", "utc", _CAPTURED)
SECTIONS = ("images", "annotations", "categories")


def read_coco_log(path: Path, content: Any, images: Any, options: LogOptions) -> DetectionLog:
    """The log of a COCO file: its content is a list of results, or a mapping with images, annotations and categories.
    `images` is the content of the images' file, None if there. Raises InputError, which names entries by index."""
    source = f"detections {path}"
    problems = Problems(source, options.skip_bad)
    where = source if options.images is None else f"images {options.images}"
    truth = content if images is None else images
    if not isinstance(truth, dict) or any(not isinstance(truth.get(key), list) for key in ("images", "categories")):
        raise InputError(where, ["must be a mapping with lists of images and categories"])
    categories = categories_of(truth, Problems(where))
    results = content["annotations"] if isinstance(content, dict) else content
    if not isinstance(results, list):
        raise InputError(source, ["annotations: must be a list"])
    scores = [(f"[{k}]", result.get("score")) for k, result in enumerate(results) if isinstance(result, dict)]
    scored = any(value is not None for _, value in scores)
    confidences = Confidences.of(scores, options.confidence_scale, problems, "score") if scored else None
    rows = LogRows(source, problems, confidences)
    frame_of, clock, notes = _frames(truth, where, options, rows)
    # Each image has a frame, in their order.
    names = image_names(results, frame_of, [str(image.get("file_name", image["id"])) for image in truth["images"]])
    if names.image_ids_are_files:
        notes.append(f"{source}: its image_id are taken for the names of the images' files")
    if names.doubt and images is not None:  # annotations beside their images have IDs
        notes.append(f"{source}: {names.doubt}")
    lookup = KnownNames.of_results(results, names, categories, options.category_offset, problems)
    labels = [name for name, _ in categories.values()]
    for index, entry in enumerate(results):
        if (place := lookup.place(entry, f"[{index}]", problems)) is not None:
            rows.add(place.image, f"[{index}]", place.box_px, labels[place.label], entry.get("score"))
    numbers = {name: k for k, name in enumerate(labels)}
    return rows.log(clock, f"the images of {(options.images or path).name}", numbers, notes)


def _frames(
    truth: Mapping[str, Any], source: str, options: LogOptions, rows: LogRows
) -> tuple[dict[Any, int], Clock, list[str]]:
    """Number of the frame of each image by its ID, what their times count from, and what was taken for granted."""
    if wrong := [k for k, entry in enumerate(truth["images"]) if not isinstance(entry, dict)]:
        raise InputError(source, [f"images[{wrong[0]}]: must be a mapping (got {shown(truth['images'][wrong[0]])})"])
    cameras = _cameras(truth["images"])
    times, notes = _times(truth["images"], cameras, source, options.frame_rate_hz)
    lacking = [k for k, (time_s, _) in enumerate(times) if math.isnan(time_s)]
    if lacking:
        more = f", and {len(lacking) - 1:,} more" if len(lacking) > 1 else ""
        raise InputError(source, [f"images[{lacking[0]}]: {_wrong_time(truth['images'][lacking[0]])}{more}"])
    utc = all_utc([of_utc for _, of_utc in times])
    if utc is None:
        raise InputError(source, [f"images: {MIXED}"])
    frame_of: dict[Any, int] = {}
    problems, again = [], []
    for index, (entry, camera, (time_s, _)) in enumerate(zip(truth["images"], cameras, times, strict=True)):
        where, identity = f"images[{index}]", entry.get("id")
        if not isinstance(identity, str | int | float) or identity in frame_of:
            problems.append(f"{where}: must have an id of its own (got {shown(identity)})")
        elif rows.has(camera, time_s):
            again.append(f"{where}: another image has the time {time_text(time_s) if utc else f'{time_s:.12g} s'}")
        else:
            frame_of[identity] = rows.frame(camera, time_s, _size(entry))
    if again:
        more = f", and {len(again) - 1:,} more" if len(again) > 1 else ""
        problems.append(
            f"{again[0]}{more}; where cameras take images at one time, each image must name its camera; where times "
            "are too coarse, --frame-rate takes their places in the file"
        )
    if len(problems) > MAX_PROBLEMS:
        problems[MAX_PROBLEMS:] = [f"... and {len(problems) - MAX_PROBLEMS} more"]
    if problems:
        raise InputError(source, problems)
    return frame_of, Clock.UTC if utc else Clock.STEP, notes


def _times(
    images: Sequence[Mapping[str, Any]], cameras: Sequence[str | None], source: str, rate_hz: float | None
) -> tuple[list[tuple[float, bool]], list[str]]:
    """Time of each image, and whether it is UTC; and a remark if it is not what the images have."""
    times = [_time(entry) for entry in images]
    if rate_hz is None or any(entry.get(key) is not None for entry in images for key in ("time_s", "utc")):
        return times, []
    if not any(math.isnan(time_s) for time_s, _ in times) and len(set(zip(cameras, times, strict=True))) == len(times):
        return times, []
    numbered = all(is_number(entry.get("frame_id")) for entry in images)
    place, counts = [], dict[str | None, int]()
    for entry, camera in zip(images, cameras, strict=True):
        counts[camera] = counts.get(camera, -1) + 1
        place.append(float(entry["frame_id"]) if numbered else counts[camera])
    used = "frame_id" if numbered else "places in the file"
    given = any(entry.get(_CAPTURED) is not None for entry in images)
    why = f"{_CAPTURED} is empty or the same in several images" if given else "the images have no times"
    notes = [f"{source}: {why}, so their {used} are taken, at {rate_hz:g} Hz"] if given or not numbered else []
    return [(number / rate_hz, False) for number in place], notes


def _time(entry: Mapping[str, Any]) -> tuple[float, bool]:
    key = _time_key(entry)
    return time_of(entry[key]) if key else (math.nan, False)


def _time_key(entry: Mapping[str, Any]) -> str:
    given = (key for key in _TIMES if entry.get(key) is not None)
    return next((key for key in given if not (key == _CAPTURED and entry[key] in ("", 0, "0"))), "")


def _wrong_time(entry: Mapping[str, Any]) -> str:
    if key := _time_key(entry):
        return f"{key} must be seconds, or a time such as {TIME_FORM} (got {shown(entry[key])})"
    return f"a time is needed: {', '.join(_TIMES)}, or --frame-rate, for their frame_id or places (got {shown(entry)})"


def _cameras(images: Sequence[Any]) -> list[str | None]:
    """The camera of each image: its `camera`, or its sequence if that is a text or there are several."""
    sequences = [entry.get("sequence", entry.get("video_id")) for entry in images]
    several = len({str(name) for name in sequences}) > 1
    names = []
    for entry, sequence in zip(images, sequences, strict=True):
        camera = entry.get("camera", sequence if several or isinstance(sequence, str) else None)
        names.append(None if camera is None else str(camera))
    return names


def _size(entry: Mapping[str, Any]) -> tuple[float, float]:
    width, height = entry.get("width"), entry.get("height")
    return float(width) if is_number(width) else math.nan, float(height) if is_number(height) else math.nan


# ---- Our own JSON ----

_FORM = '{"camera": "bow", "time_s": 0.2, "detections": [{"box_px": [1, 2, 3, 4], "label": "boat", "confidence": 0.9}]}'
_THESIS = '{"0.2": {"a": {"label": "boat", "confidenceScore": 0.9, "bbox": {"centre": {"x": 2, "y": 3}, …}}}}'

_Frame = tuple[str, str | None, float, bool, list[tuple[str, list[float], str | None, object]]]
"""Place, camera, time, whether that is UTC, and place, box, label and confidence of each detection."""


def read_lines_log(path: Path, options: LogOptions) -> DetectionLog:
    """The log of a file with a frame on each line. Raises InputError if a line is wrong."""
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
    """The log of a mapping from times to detections by name (Jessen & Mohr (2023), Figure 7.17), or InputError."""
    source = f"detections {path}"
    problems = Problems(source, options.skip_bad)
    frames: list[_Frame] = []
    for text, entries in content.items():
        time_s, utc = time_of(text)
        if math.isnan(time_s) or not isinstance(entries, dict):
            problems.add(f"{text}: must be a time with its detections, as in {_THESIS} (got {shown(entries)})")
            continue
        detections = [_thesis(entry, f"{text}.{name}", problems) for name, entry in entries.items()]
        frames.append((text, None, time_s, utc, [detection for detection in detections if detection is not None]))
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
    detections = [_detection(entry, f"{where}: detections[{k}]", problems) for k, entry in enumerate(entries)]
    return where, camera, time_s, utc, [detection for detection in detections if detection is not None]


def _detection(entry: Any, where: str, problems: Problems) -> tuple[str, list[float], str | None, object] | None:
    box = entry.get("box_px") if isinstance(entry, dict) else None
    if not isinstance(box, list) or len(box) != 4 or not all(map(is_number, box)):
        problems.add(f"{where}: box_px must be x_min, y_min, x_max, y_max in pixels (got {shown(entry)})")
        return None
    return where, [box[0], box[1], box[2] - box[0], box[3] - box[1]], _label(entry), entry.get("confidence")


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
    scores = [(where, score) for *_, detections in frames for where, _, _, score in detections if score is not None]
    confidences = Confidences.of(scores, options.confidence_scale, problems) if scores else None
    rows = LogRows(source, problems, confidences, form)
    for where, camera, time_s, _, detections in frames:
        if rows.has(camera, time_s):
            problems.add(f"{where}: has the time of another frame{f' of {camera}' if camera else ''}, {time_s:.12g}")
            continue
        number = rows.frame(camera, time_s)
        for place, box, label, confidence in detections:
            rows.add(number, place, box, label, confidence)
    return rows.log(Clock.UTC if utc else clock, origin)
