"""Films of real pictures: labels and detections of public data sets in a folder of the user, as runs of labelled video.

A film is a folder with `truth.json` and `detections.json` (COCO) and the run of both. Films that are there stay.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.core.errors import ModsimError
from modsim3d.formats.detect_truth import detect_truth
from modsim3d.formats.video_targets import visible_fractions

LABELS, DETECTIONS = "evaluation/KITTI/data/gt/label_02", "data/detections/2D"
RATE_HZ, SIZE_PX = 10.0, (1242, 375)
"""Of the pictures; the sizes of KITTI's differ by up to 18 × 6 px."""
VISIBLE = {0: 1.0, 1: 0.7, 2: 0.3}
"""Visible share that stands for KITTI's classes of occlusion: fully visible, partly and largely occluded."""
SOUGHT, BESIDE, REGION = "Car", "Van", "DontCare"
"""A class that is to be detected, one that is ignored, since it hardly differs, and regions that nobody labelled."""
TO_DEVELOP, TO_JUDGE = range(14), (14, 15, 16, 18, 19, 20)
"""Numbers of films; in film 17 there is no car, so nothing can be followed."""
WEATHER = "daylight"


@dataclass(frozen=True)
class Detector:
    """A public detector's output: its name, the folder of its files, and the columns of box and score."""

    name: str
    folder: str
    first: int

    def entries(self, data: Path, number: int) -> Iterator[dict[str, Any]]:
        """Its detections in a film as COCO has them; scores above 1 are 1.

        Raises:
            ModsimError: A line is wrong.
        """
        path = data / DETECTIONS / self.folder / f"{number:04d}.txt"
        for at, line in enumerate(_lines(path), 1):
            try:
                values = [float(each) for each in line.split(",")]
                x, y, right, bottom, score = values[self.first : self.first + 5]
                frame = int(values[0])
            except (ValueError, IndexError):
                raise ModsimError(
                    f"{path} line {at}: must be numbers with commas between them (got {line!r})"
                ) from None
            if right > x and bottom > y:
                box = [x, y, right - x, bottom - y]
                yield {"image_id": frame, "category_id": 1, "bbox": box, "score": min(max(score, 0.0), 1.0)}


DETECTORS = {"rrc": Detector("RRC", "rrc/training/Car", 1), "yolov3": Detector("YOLOv3", "yolov3/train/Car", 2)}


@dataclass(frozen=True)
class Picture:
    """A film of real pictures; `run` has its truth and what the detector found."""

    folder: Path
    name: str
    place: str
    seed: int
    weather: str = WEATHER
    rate_hz: float = RATE_HZ

    @property
    def run(self) -> Path:
        """The run directory."""
        return self.folder / "run"

    @property
    def truth(self) -> Path:
        """What is labelled, as COCO."""
        return self.folder / "truth.json"

    @property
    def real(self) -> Path:
        """What the detector found, as COCO results."""
        return self.folder / "detections.json"


def pictures(data: Path, work: Path, detector: str, numbers: Sequence[int]) -> list[Picture]:
    """The films of a detector by their numbers, made where they are not there.

    Raises:
        ModsimError: A file of the data set is missing or wrong.
    """
    films = [Picture(work / detector / f"{number:04d}", f"{number:04d}", "kitti", number) for number in numbers]
    for film in films:
        _make(film, truth_of(data, film.seed), list(DETECTORS[detector].entries(data, film.seed)))
    return films


def _make(film: Picture, truth: Mapping[str, Any], found: Sequence[Mapping[str, Any]]) -> None:
    """Write a film's files and its run, if they are not there."""
    if (film.run / "run.json").is_file():
        return
    film.folder.mkdir(parents=True, exist_ok=True)
    film.truth.write_text(json.dumps(truth), encoding="utf-8")
    film.real.write_text(json.dumps(found), encoding="utf-8")
    detect_truth(film.truth, film.run, detections=film.real, overwrite=True)


def truth_of(data: Path, number: int) -> dict[str, Any]:
    """KITTI's labels of a film as COCO has them, with cars as targets.

    Raises:
        ModsimError: A line is wrong.
    """
    path = data / LABELS / f"{number:04d}.txt"
    rows = [line.split() for line in _lines(path)]
    try:
        frames = range(max(int(row[0]) for row in rows) + 1)
        entries = [_entry(at, row) for at, row in enumerate(rows, 1) if row[2] in (SOUGHT, BESIDE, REGION)]
    except (ValueError, IndexError):
        raise ModsimError(f"{path}: is no file of KITTI's tracking labels") from None
    _fill_in(entries)
    size = {"width": SIZE_PX[0], "height": SIZE_PX[1]}
    images = [{"id": frame, "sequence": f"{number:04d}", "time_s": frame / RATE_HZ, **size} for frame in frames]
    return {"images": images, "annotations": entries, "categories": [{"id": 1, "name": SOUGHT}]}


def _entry(number: int, row: Sequence[str]) -> dict[str, Any]:
    frame, track, occlusion = int(row[0]), int(row[1]), int(row[4])
    left, top, right, bottom = map(float, row[6:10])
    flags = {"iscrowd": int(row[2] == REGION), "ignore": int(row[2] == BESIDE)}
    entry = {
        "id": number,
        "image_id": frame,
        "category_id": 1,
        "bbox": [left, top, right - left, bottom - top],
        **flags,
    }
    if row[2] == REGION:
        return entry
    known = {"visible_fraction": VISIBLE[occlusion]} if occlusion in VISIBLE else {}
    return {**entry, "track_id": track, "distance_m": max(float(row[15]), 0.0), **known}


def _fill_in(entries: Sequence[dict[str, Any]]) -> None:
    """Give the overlap with other boxes as visible share where the occlusion is unknown."""
    solid = sorted((each for each in entries if not each["iscrowd"]), key=lambda each: each["image_id"])
    if not solid:
        return
    image, corner = (np.array([each[key] for each in solid]) for key in ("image_id", "bbox"))
    boxes_px = np.hstack([corner[:, :2], corner[:, :2] + corner[:, 2:]])
    for entry, share in zip(solid, visible_fractions(image, boxes_px, boxes_px[:, 3]).tolist(), strict=True):
        entry.setdefault("visible_fraction", share)


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise ModsimError(f"{path}: cannot be read ({error.strerror}); --data is a folder as the page says") from None


def checksums(data: Path, numbers: Sequence[int], detector: str) -> Mapping[str, str]:
    """SHA-256 of all files of labels and of a detector's, one after the other.

    Raises:
        ModsimError: A file is missing.
    """
    folders = {"labels": data / LABELS, "detections": data / DETECTIONS / DETECTORS[detector].folder}
    return {
        name: hashlib.sha256(
            "".join(f"{line}\n" for n in numbers for line in _lines(folder / f"{n:04d}.txt")).encode()
        ).hexdigest()
        for name, folder in folders.items()
    }


RIVER_TRUTH, RIVER_FOUND = "fvessel/Video-01_gt_tracking.txt", "fvessel/Video-01_re_detection.txt"
RIVER_SIZE_PX, RIVER_HZ, BLOCKS = (2560, 1440), 1.0, 10
STREETS, STREET_SIZE_PX, STREET_HZ = ("TUD-Campus", "TUD-Stadtmitte"), (640, 480), 25.0


def river(data: Path, work: Path) -> list[Picture]:
    """Blocks of FVessel's Video-01, each as a film of its own.

    Raises:
        ModsimError: A file is missing or wrong.
    """
    truth, found = (_numbers(data / name) for name in (RIVER_TRUTH, RIVER_FOUND))
    edges = np.linspace(0, max(row[0] for row in truth) + 1, BLOCKS + 1).astype(int).tolist()
    films = []
    for number, (first, stop) in enumerate(pairwise(edges)):
        film = Picture(work / "fvessel" / f"block_{number}", f"block {number + 1}", "river", number, rate_hz=RIVER_HZ)
        films.append(film)
        _make_of_rows(film, truth, found, range(first, stop), RIVER_SIZE_PX, "Vessel")
    return films


def streets(data: Path, work: Path) -> list[Picture]:
    """People in the two shortest films of MOT15.

    Raises:
        ModsimError: A file is missing or wrong.
    """
    films = []
    for number, name in enumerate(STREETS):
        film = Picture(work / "tud" / name, name, "street", number, rate_hz=STREET_HZ)
        films.append(film)
        truth, found = (_numbers(data / "tud" / name / file) for file in ("gt.txt", "det.txt"))
        frames = range(1, int(max(row[0] for row in truth)) + 1)
        _make_of_rows(film, truth, found, frames, STREET_SIZE_PX, "Person")
    return films


def _make_of_rows(
    film: Picture,
    truth: Sequence[Sequence[float]],
    found: Sequence[Sequence[float]],
    frames: range,
    size_px: tuple[int, int],
    label: str,
) -> None:
    """Make a film of rows of frame, identity, left, top, width, height and confidence."""
    size = {"width": size_px[0], "height": size_px[1], "sequence": film.name}
    images = [{"id": frame, "time_s": frame / film.rate_hz, **size} for frame in frames]
    entries = [
        {"id": at, "image_id": int(row[0]), "category_id": 1, "track_id": int(row[1]), "bbox": row[2:6]}
        for at, row in enumerate(truth, 1)
        if row[0] in frames
    ]
    results = [
        {"image_id": int(row[0]), "category_id": 1, "bbox": row[2:6], "score": row[6]}
        for row in found
        if row[0] in frames
    ]
    _make(film, {"images": images, "annotations": entries, "categories": [{"id": 1, "name": label}]}, results)


def _numbers(path: Path) -> list[list[float]]:
    try:
        return [[float(each) for each in line.split(",")] for line in _lines(path)]
    except ValueError:
        raise ModsimError(f"{path}: must be numbers with commas between them") from None
