"""COCO: results with the file of their images, or one file whose annotations have scores.

The time of an image is its `time_s`, `utc` or `date_captured`. Many tools leave the last empty, or write the same into
all images: then, with a frame rate, the time is that of its `frame_id`, or else of its place in the file. The camera of
an image is `camera`, or `sequence` (or `video_id`) where that is a text or there are several.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from modsim3d.ais.options import time_text
from modsim3d.errors import InputError
from modsim3d.formats.reading.builder import MOST_PROBLEMS, Problems, is_number
from modsim3d.formats.reading.confidences import Confidences
from modsim3d.formats.reading.image_names import ImageNames, image_names
from modsim3d.inputs.validation import shown
from modsim3d.voyage.logs.log import Clock, DetectionLog, LogOptions, LogRows
from modsim3d.voyage.logs.times import MIXED, TIME_FORM, all_utc, time_of

_CAPTURED = "date_captured"
_TIMES = ("time_s", "utc", _CAPTURED)
SECTIONS = ("images", "annotations", "categories")


def read_coco_log(path: Path, content: Any, images: Any, options: LogOptions) -> DetectionLog:
    """The log of a COCO file.

    Args:
        path: The file of the detections.
        content: Its content: a list of results, or a mapping with images, annotations and categories.
        images: Content of the file of the images; None where `content` has them.
        options: What the files do not say.

    Raises:
        InputError: The files are wrong; each problem names the index of its entry.
    """
    source = f"detections {path}"
    problems = Problems(source, options.skip_bad)
    where = source if options.images is None else f"images {options.images}"
    truth = content if images is None else images
    categories = _categories(truth, where, options.category_offset)
    results = content["annotations"] if isinstance(content, dict) else content
    if not isinstance(results, list):
        raise InputError(source, ["annotations: must be a list"])
    scores = [(f"[{k}]", each.get("score")) for k, each in enumerate(results) if isinstance(each, dict)]
    scored = any(value is not None for _, value in scores)
    confidences = Confidences.of(scores, options.confidence_scale, problems, "score") if scored else None
    rows = LogRows(source, problems, confidences)
    frame_of, clock, notes = _frames(truth, where, options, rows)
    # Each image has a frame, in their order.
    names = image_names(results, frame_of, [str(each.get("file_name", each["id"])) for each in truth["images"]])
    if names.image_ids_are_files:
        notes.append(f"{source}: its image_id are taken for the names of the images' files")
    if names.doubt and images is not None:  # annotations beside their images have IDs
        notes.append(f"{source}: {names.doubt}")
    for index, entry in enumerate(results):
        place = f"[{index}]"
        if not isinstance(entry, dict):
            problems.add(f"{place}: must be a mapping (got {shown(entry)})")
        elif (frame := _frame_of(entry, names)) is None:
            problems.add(f"{place}: unknown image_id {shown(entry.get('image_id'))}")
        elif _key(entry.get("category_id")) not in categories:
            problems.add(f"{place}: unknown category_id {shown(entry.get('category_id'))}")
        else:
            label, box = categories[_key(entry["category_id"])], entry.get("bbox")
            rows.add(frame, place, box if isinstance(box, list) else [], label, entry.get("score"))
    labels = {name: k for k, name in enumerate(categories.values())}
    return rows.log(clock, f"the images of {(options.images or path).name}", labels, notes)


def _key(value: Any) -> Any:
    return value if isinstance(value, str | int | float) else None


def _frame_of(entry: Mapping[str, Any], names: ImageNames) -> int | None:
    """Number of the frame of a result; None if it names no image."""
    named = names.by_image_id.get(_key(entry.get("image_id")))
    return names.by_file_name.get(_key(entry.get("file_name")), named)


def _categories(truth: Any, source: str, offset: int) -> dict[Any, str]:
    if not isinstance(truth, dict) or any(not isinstance(truth.get(key), list) for key in ("images", "categories")):
        raise InputError(source, ["must be a mapping with lists of images and categories"])
    found: dict[Any, str] = {}
    for index, entry in enumerate(truth["categories"]):
        number, name = (entry.get("id"), entry.get("name")) if isinstance(entry, dict) else (None, None)
        if not is_number(number) or not isinstance(name, str) or not name or name in found.values():
            raise InputError(source, [f"categories[{index}]: must have an id, a whole number, and a name of its own"])
        found[number - offset] = name
    return found


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
        where, identity = f"images[{index}]", _key(entry.get("id"))
        if identity is None or identity in frame_of:
            problems.append(f"{where}: must have an id of its own (got {shown(entry.get('id'))})")
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
    if len(problems) > MOST_PROBLEMS:
        problems[MOST_PROBLEMS:] = [f"... and {len(problems) - MOST_PROBLEMS} more"]
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
    """Time of an image, NaN if it has none, and whether it is UTC."""
    key = _time_key(entry)
    return time_of(entry[key]) if key else (math.nan, False)


def _time_key(entry: Mapping[str, Any]) -> str:
    """The key that has the time of an image, empty if none has."""
    given = (key for key in _TIMES if entry.get(key) is not None)
    return next((key for key in given if not (key == _CAPTURED and entry[key] in ("", 0, "0"))), "")


def _wrong_time(entry: Mapping[str, Any]) -> str:
    """Why an image has no time."""
    if key := _time_key(entry):
        return f"{key} must be seconds, or a time such as {TIME_FORM} (got {shown(entry[key])})"
    return f"a time is needed: {', '.join(_TIMES)}, or --frame-rate, for their frame_id or places (got {shown(entry)})"


def _cameras(images: Sequence[Any]) -> list[str | None]:
    """The camera of each image: its `camera`, or its sequence if that is a text or there are several."""
    sequences = [entry.get("sequence", entry.get("video_id")) for entry in images]
    several = len({str(each) for each in sequences}) > 1
    names = []
    for entry, sequence in zip(images, sequences, strict=True):
        camera = entry.get("camera", sequence if several or isinstance(sequence, str) else None)
        names.append(None if camera is None else str(camera))
    return names


def _size(entry: Mapping[str, Any]) -> tuple[float, float]:
    width, height = entry.get("width"), entry.get("height")
    return float(width) if is_number(width) else math.nan, float(height) if is_number(height) else math.nan
