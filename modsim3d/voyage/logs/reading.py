"""Which reader a log of detections is for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from modsim3d.errors import InputError
from modsim3d.inputs.budgets import COCO_BYTES_PER_VALUE
from modsim3d.inputs.strict_json import load_json
from modsim3d.inputs.text_files import read_text
from modsim3d.inputs.validation import shown
from modsim3d.runs.files.replacing import RUN_FILE, files_of_run
from modsim3d.voyage.logs.bags import read_bag_log
from modsim3d.voyage.logs.coco import SECTIONS, read_coco_log
from modsim3d.voyage.logs.json_logs import read_lines_log, read_thesis_log
from modsim3d.voyage.logs.log import NO_OPTIONS, DetectionLog, LogOptions
from modsim3d.voyage.logs.mot import read_mot_log
from modsim3d.voyage.logs.runs import read_run_log
from modsim3d.voyage.logs.tables import read_table_log

_KNOWN = "a run folder, a ROS 2 bag, COCO .json, MOT .txt, .csv, .parquet, or .jsonl"


def read_log(path: Path, options: LogOptions = NO_OPTIONS) -> DetectionLog:
    """Read a log of detections, whose kind its name and its beginning tell.

    Raises:
        InputError: It cannot be read, is of no known kind, or is wrong.
    """
    log = _reader(path, options)
    if options.images is not None and ".json" not in path.suffixes:
        raise InputError("--images", [f"is for COCO results, and {path} says itself when its images were taken"])
    return replace(log.shifted(options.start), of_run=_is_of_run(path))


def _is_of_run(path: Path) -> bool:
    """Whether a log is a run, or a file that a run has written into its folder."""
    return (path / RUN_FILE).is_file() or path.name in files_of_run(path.parent)


def _reader(path: Path, options: LogOptions) -> DetectionLog:
    source = f"detections {path}"
    if not path.exists():
        raise InputError(source, ["no such file or folder"])
    if path.is_dir():
        if (path / RUN_FILE).is_file():
            return read_run_log(path)
        if (path / "metadata.yaml").is_file():
            return read_bag_log(path, options)
        raise InputError(source, [f"is a folder, and neither a run nor a ROS 2 bag; a log is {_KNOWN}"])
    kinds = path.name.lower().removesuffix(".gz").rsplit(".", 1)
    kind = kinds[1] if len(kinds) > 1 else ""
    if kind in ("mcap", "db3"):
        return read_bag_log(path, options)
    if kind in ("jsonl", "ndjson"):
        return read_lines_log(path, options)
    if kind == "json":
        return _json(path, source, options)
    if kind == "parquet":
        return read_table_log(path, options)
    if kind in ("txt", "csv"):
        return read_mot_log(path, options) if _begins_with_numbers(path) else read_table_log(path, options)
    raise InputError(source, [f"its name does not say what it is; a log is {_KNOWN}"])


def _begins_with_numbers(path: Path) -> bool:
    """Whether the first line of a text is numbers, as MOT's are, and not names of columns."""
    first = next((line for line in read_text(path, "detections").splitlines() if line.strip()), "")
    try:
        [float(part) for part in first.strip().rstrip(",").split(",")]
    except ValueError:
        return False
    return True


def _json(path: Path, source: str, options: LogOptions) -> DetectionLog:
    content = load_json(path, "detections", COCO_BYTES_PER_VALUE)
    if isinstance(content, list):
        if options.images is None:
            problem = "COCO results do not say when their images were taken: give the COCO file of these with --images"
            raise InputError(source, [problem])
        images: Any = load_json(options.images, "images", COCO_BYTES_PER_VALUE)
        return read_coco_log(path, content, images, options)
    if isinstance(content, dict) and any(key in content for key in SECTIONS):
        if missing := [key for key in SECTIONS if key not in content]:
            raise InputError(source, [f"{key}: missing" for key in missing])
        return read_coco_log(path, content, None, options)
    if isinstance(content, dict):
        return read_thesis_log(path, content, options)
    raise InputError(source, [f"must be COCO or a mapping from times to detections (got {shown(content)})"])
