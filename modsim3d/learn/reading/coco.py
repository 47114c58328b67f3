"""COCO ground truth and COCO results, as most detection libraries write them.

Beyond COCO's own keys these are read where they are: of an image `condition`, `sequence` (or `video_id`) and `time_s`
or `frame_id`; of an annotation `ignore`, `track_id` (or `instance_id`), `visible_fraction` and `distance_m`; of a
result `probabilities`, one for each category in their order. Masks are ignored: a box is taken from `bbox` alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import orjson

from modsim3d.errors import InputError
from modsim3d.learn.labelled import Labelled
from modsim3d.learn.reading.builder import Problems, Rows, corners, one_condition
from modsim3d.validation import load_json, nearest


def read_coco(condition: str, truth: Path, detections: Path, skip_bad: bool = False) -> Labelled:
    """One condition.

    Args:
        condition: Its name.
        truth: A COCO ground truth.
        detections: COCO results.
        skip_bad: Leave out entries that something is wrong with, and count them.

    Raises:
        InputError: Something is wrong; each problem names the index of its entry.
    """
    problems = Problems(f"ground truth {truth}", skip_bad)
    content = _object(truth, "ground truth", problems.source)
    categories = _categories(content, problems)
    images, sizes, names, sequences, times, own = _images(content, problems)
    rows = Rows()
    for index, entry in enumerate(_list(content, "annotations", problems)):
        _annotation(entry, f"annotations[{index}]", images, categories, rows, problems)
    notes = problems.settle()
    results = Problems(f"detections {detections}", skip_bad)
    found = Rows()
    for index, entry in enumerate(_results(detections)):
        _result(entry, f"[{index}]", images, categories, found, results)
    notes += results.settle()
    labels = [name for name, _ in sorted(categories.values(), key=lambda pair: pair[1])]
    return one_condition(condition, labels, names, sizes, rows, found, notes, sequences, times, own)


def _parse(path: Path, what: str) -> Any:
    """JSON, fast; where it is broken, slowly and with the place in the message."""
    try:
        return orjson.loads(path.read_bytes())
    except (OSError, orjson.JSONDecodeError):
        return load_json(path, what)


def _object(path: Path, what: str, source: str) -> Mapping[str, Any]:
    content = _parse(path, what)
    if not isinstance(content, dict):
        kind = "a list: is it the results file?" if isinstance(content, list) else f"{str(content)[:40]!r}"
        raise InputError(source, [f"must be a mapping with images, annotations and categories (got {kind})"])
    missing = [key for key in ("images", "annotations", "categories") if key not in content]
    if missing:
        raise InputError(source, [f"{key}: missing" for key in missing])
    return content


def _results(path: Path) -> list[Any]:
    content = _parse(path, "detections")
    if isinstance(content, list):
        return content
    got = ", ".join(list(content)[:5]) if isinstance(content, dict) else str(content)[:40]
    raise InputError(
        f"detections {path}",
        [f"must be a list of results with image_id, category_id, bbox and score (got a mapping with {got})"],
    )


def _list(content: Mapping[str, Any], key: str, problems: Problems) -> list[Any]:
    if not isinstance(content[key], list):
        raise InputError(problems.source, [f"{key}: must be a list"])
    found: list[Any] = content[key]
    return found


def _categories(content: Mapping[str, Any], problems: Problems) -> dict[Any, tuple[str, int]]:
    """Name and label of each category's ID, in the order of the file."""
    known: dict[Any, tuple[str, int]] = {}
    for index, entry in enumerate(_list(content, "categories", problems)):
        where = f"categories[{index}]"
        if (
            not isinstance(entry, dict)
            or not isinstance(entry.get("id"), int)
            or not isinstance(entry.get("name"), str)
            or not entry["name"]
        ):
            raise InputError(problems.source, [f"{where}: must have an id, a whole number, and a name"])
        if entry["id"] in known or entry["name"] in (name for name, _ in known.values()):
            raise InputError(problems.source, [f"{where}: id {entry['id']} or name '{entry['name']}' appears twice"])
        known[entry["id"]] = (entry["name"], len(known))
    if not known:
        raise InputError(problems.source, ["categories: is empty, must name at least one"])
    return known


def _images(
    content: Mapping[str, Any], problems: Problems
) -> tuple[dict[Any, int], list[list[float]], list[str], list[int], list[float], list[str | None]]:
    """Rows of the images' IDs, in ascending order of the IDs as COCO's own tools have them."""
    entries: list[tuple[int, dict[str, Any]]] = []
    seen: set[Any] = set()
    for index, entry in enumerate(_list(content, "images", problems)):
        where = f"images[{index}]"
        if not isinstance(entry, dict) or not isinstance(entry.get("id"), int):
            problems.add(f"{where}: must have an id, a whole number")
        elif entry["id"] in seen:
            problems.add(f"{where}: id {entry['id']} appears twice")
        else:
            seen.add(entry["id"])
            entries.append((index, entry))
    entries.sort(key=lambda pair: pair[1]["id"])
    rows: dict[Any, int] = {}
    sizes, names, sequences, times, own = [], [], [], [], []
    numbers: dict[Any, int] = {}
    for index, entry in entries:
        given = [entry.get("width"), entry.get("height")]
        size = [float(side) for side in given if isinstance(side, int | float) and side > 0]
        if len(size) < 2:
            problems.add(f"images[{index}]: width and height must be above 0 (got {given[0]} and {given[1]})")
            continue
        rows[entry["id"]] = len(rows)
        sizes.append(size)
        names.append(str(entry.get("file_name", entry["id"])))
        sequences.append(numbers.setdefault(entry.get("sequence", entry.get("video_id")), len(numbers)))
        own.append(None if entry.get("condition") is None else str(entry["condition"]))
        time = entry.get("time_s", entry.get("frame_id"))
        times.append(float(time) if isinstance(time, int | float) else math.nan)
    return rows, sizes, names, sequences, times, own


def _place(
    entry: Any, where: str, images: Mapping[Any, int], categories: Mapping[Any, tuple[str, int]], problems: Problems
) -> tuple[int, int] | None:
    """Row of the image and label."""
    if not isinstance(entry, dict):
        problems.add(f"{where}: must be a mapping (got {str(entry)[:40]!r})")
        return None
    for key, known in (("image_id", images), ("category_id", categories)):
        value = entry.get(key)
        if isinstance(value, list | dict) or value not in known:
            hint = (
                "missing" if key not in entry else f"unknown {key} {value!r} ({nearest(str(value), map(str, known))})"
            )
            problems.add(f"{where}: {hint}" if key in entry else f"{where}: {key} is missing")
            return None
    return images[entry["image_id"]], categories[entry["category_id"]][1]


_MOST = {"visible_fraction": 1 + 1e-6, "distance_m": math.inf}


def _number(entry: Mapping[str, Any], key: str, where: str, problems: Problems) -> float:
    """A number from 0 to the most of its key, NaN where it is not given."""
    value = entry.get(key)
    if value is None:
        return math.nan
    if not isinstance(value, int | float) or isinstance(value, bool):
        problems.add(f"{where}: {key} must be a number (got {value!r})")
    elif not 0 <= value <= _MOST[key]:
        problems.add(f"{where}: {key} must be {'from 0 to 1' if _MOST[key] < math.inf else '0 or more'} (got {value})")
    else:
        return float(value)
    return math.nan


def _annotation(
    entry: Any,
    where: str,
    images: Mapping[Any, int],
    categories: Mapping[Any, tuple[str, int]],
    rows: Rows,
    problems: Problems,
) -> None:
    place = _place(entry, where, images, categories, problems)
    box = corners(entry.get("bbox"), where, problems) if place else None
    if place is None or box is None:
        return
    known = len(problems.lines)
    visible_fraction, distance_m = (_number(entry, key, where, problems) for key in ("visible_fraction", "distance_m"))
    if len(problems.lines) > known:
        return
    crowd = bool(entry.get("iscrowd", 0))
    rows.image.append(place[0])
    rows.label.append(place[1])
    rows.boxes.append(box)
    rows.crowd.append(crowd)
    rows.ignored.append(crowd or bool(entry.get("ignore", 0)))
    identity = entry.get("track_id", entry.get("instance_id"))
    rows.identity.append(identity if isinstance(identity, int | str) else None)
    rows.visible_fraction.append(visible_fraction)
    rows.distance_m.append(distance_m)


def _result(
    entry: Any,
    where: str,
    images: Mapping[Any, int],
    categories: Mapping[Any, tuple[str, int]],
    rows: Rows,
    problems: Problems,
) -> None:
    place = _place(entry, where, images, categories, problems)
    box = corners(entry.get("bbox"), where, problems) if place else None
    if place is None or box is None:
        return
    score, given = entry.get("score"), entry.get("probabilities")
    if not isinstance(score, int | float) or isinstance(score, bool) or not 0 <= score <= 1:
        problems.add(f"{where}: score must be from 0 to 1 (got {score!r})")
        return
    if given is not None and not _distribution(given, len(categories)):
        problems.add(f"{where}: probabilities must be {len(categories)} numbers from 0 to 1 (got {str(given)[:60]})")
        return
    rows.image.append(place[0])
    rows.label.append(place[1])
    rows.boxes.append(box)
    rows.confidence.append(float(score))
    rows.probabilities.append(given)


def _distribution(values: Any, count: int) -> bool:
    return (
        isinstance(values, list)
        and len(values) == count
        and all(isinstance(value, int | float) and 0 <= value <= 1 for value in values)
    )
