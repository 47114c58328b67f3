"""Which reader a pair of files, or a file of truth alone, is for."""

from __future__ import annotations

from pathlib import Path

from modsim3d.errors import InputError
from modsim3d.formats.horizon import with_horizon
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.reading.builder import NO_OPTIONS, ReadOptions
from modsim3d.formats.reading.coco import read_coco
from modsim3d.formats.reading.mot import read_mot
from modsim3d.formats.reading.yolo import read_yolo
from modsim3d.paths import StrPath, as_path


def read_pair(condition: str, truth: StrPath, detections: StrPath, options: ReadOptions = NO_OPTIONS) -> LabelledSet:
    """Read one condition: folders are YOLO's, `.txt` and `.csv` are MOT's, anything else is COCO's.

    Raises:
        InputError: The files are wrong, or of two kinds.
    """
    truth, detections = as_path(truth, "truth"), as_path(detections, "detections")
    missing = [(what, path) for what, path in (("truth", truth), ("detections", detections)) if not path.exists()]
    if missing:
        raise InputError(f"condition {condition}", [f"{what} {path}: no such file or folder" for what, path in missing])
    kinds = [_kind(path) for path in (truth, detections)]
    if kinds[0] != kinds[1]:
        raise InputError(
            f"condition {condition}", [f"{truth} looks like {kinds[0]} and {detections} like {kinds[1]}: give one kind"]
        )
    read = {"COCO": read_coco, "MOT": read_mot, "YOLO": read_yolo}[kinds[0]]
    return with_horizon(read(condition, truth, detections, options), options.horizon)


def read_truth(truth: StrPath, options: ReadOptions = NO_OPTIONS) -> tuple[LabelledSet, str]:
    """Read the truth of a labelled video without any detections, and say of which kind it is: `MOT` or `COCO`.

    Raises:
        InputError: The file is wrong, or it is a folder, as YOLO's are.
    """
    path = as_path(truth, "truth")
    if not path.exists():
        raise InputError(f"truth {path}", ["no such file"])
    kind = _kind(path)
    if kind == "YOLO":
        raise InputError(f"truth {path}", ["is a folder: a file with tracks is needed, MOT gt.txt or COCO JSON"])
    return {"COCO": read_coco, "MOT": read_mot}[kind](path.stem, path, None, options), kind


def _kind(path: Path) -> str:
    return "YOLO" if path.is_dir() else "MOT" if path.suffix in (".txt", ".csv") else "COCO"
