"""Which reader a pair of files is for."""

from __future__ import annotations

from pathlib import Path

from modsim3d.errors import InputError
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.reading.builder import ReadOptions
from modsim3d.formats.reading.coco import read_coco
from modsim3d.formats.reading.mot import read_mot
from modsim3d.formats.reading.yolo import read_yolo


def read_pair(condition: str, truth: Path, detections: Path, options: ReadOptions) -> LabelledSet:
    """Read one condition: folders are YOLO's, `.txt` and `.csv` are MOT's, anything else is COCO's.

    Raises:
        InputError: The files are wrong, or of two kinds.
    """
    missing = [(what, path) for what, path in (("truth", truth), ("detections", detections)) if not path.exists()]
    if missing:
        raise InputError(f"condition {condition}", [f"{what} {path}: no such file or folder" for what, path in missing])
    kinds = [_kind(path) for path in (truth, detections)]
    if kinds[0] != kinds[1]:
        raise InputError(
            f"condition {condition}", [f"{truth} looks like {kinds[0]} and {detections} like {kinds[1]}: give one kind"]
        )
    read = {"COCO": read_coco, "MOT": read_mot, "YOLO": read_yolo}[kinds[0]]
    return read(condition, truth, detections, options)


def _kind(path: Path) -> str:
    return "YOLO" if path.is_dir() else "MOT" if path.suffix in (".txt", ".csv") else "COCO"
