"""Which reader a pair of files is for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from modsim3d.errors import InputError
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.reading.coco import read_coco
from modsim3d.formats.reading.mot import read_mot
from modsim3d.formats.reading.yolo import read_yolo


@dataclass(frozen=True)
class ReadOptions:
    """What files do not say themselves.

    Attributes:
        labels: Names of the classes, for MOT and YOLO.
        image_size_px: Width and height, for MOT without `seqinfo.ini` and for YOLO without its images.
        skip_bad: Leave out wrong entries.
        frame_rate_hz: For MOT, and for COCO whose images have a `frame_id` alone.
        category_offset: Number to add to the category IDs of COCO results.
    """

    labels: tuple[str, ...] = ()
    image_size_px: tuple[float, float] | None = None
    skip_bad: bool = False
    frame_rate_hz: float | None = None
    category_offset: int = 0


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
    skip_bad, rate_hz, size_px = options.skip_bad, options.frame_rate_hz, options.image_size_px
    if kinds[0] == "COCO":
        return read_coco(condition, truth, detections, skip_bad, options.category_offset, rate_hz)
    if kinds[0] == "MOT":
        return read_mot(condition, truth, detections, options.labels, size_px, skip_bad, rate_hz)
    return read_yolo(condition, truth, detections, options.labels, size_px, skip_bad)


def _kind(path: Path) -> str:
    return "YOLO" if path.is_dir() else "MOT" if path.suffix in (".txt", ".csv") else "COCO"
