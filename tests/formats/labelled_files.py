"""A labelled video as COCO, MOT and YOLO files in whatever form a test asks for, and sets of random numbers."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest

from modsim3d.core.errors import InputError
from modsim3d.formats.labelled import Annotations, Images, LabelledSet, Results
from modsim3d.formats.reading.builder import NO_OPTIONS, ReadOptions
from modsim3d.formats.reading.pair import read_pair

WIDTH, HEIGHT = 1920, 1080
NAMES = ("boat", "sailboat", "ship")
Change = Callable[..., tuple[float, ...]]
CHANGES: dict[str, Change] = {
    "right": lambda x, y, w, h: (x, y, w, h),
    "corners": lambda x, y, w, h: (x, y, x + w, y + h),
    "centres": lambda x, y, w, h: (x + w / 2, y + h / 2, w, h),
    "top left": lambda x, y, w, h: (x - w / 2, y - h / 2, w, h),
    "exchanged": lambda x, y, w, h: (y, x, h, w),
    "shares": lambda x, y, w, h: (x / WIDTH, y / HEIGHT, w / WIDTH, h / HEIGHT),
    "per cent": lambda x, y, w, h: (100 * x / WIDTH, 100 * y / HEIGHT, 100 * w / WIDTH, 100 * h / HEIGHT),
    "from below": lambda x, y, w, h: (x, HEIGHT - y - h, w, h),
    "larger": lambda x, y, w, h: (2 * x, 2 * y, 2 * w, 2 * h),
}
"""What files may have of a left, top, width and height; those of YOLO have centres, where `centres` is right."""
RIGHT, CENTRES = CHANGES["right"], CHANGES["centres"]


@dataclass(frozen=True)
class Video:
    """Left, top, width, height of each of k boats in n frames, and of what is detected of them, shapes (n, k, 4)."""

    true: np.ndarray[Any, Any]
    found: np.ndarray[Any, Any]

    @classmethod
    def of(cls, seed: int = 0, frames: int = 40, noise_px: float = 2.0, bias: float = 1.0) -> Self:
        """Six boats that cross the image from edge to edge, and boxes `bias` times as large."""
        rng, step = np.random.default_rng(seed), np.arange(frames)[:, None]
        size = np.array([[40.0, 16], [90, 40], [300, 90], [30, 12], [200, 70], [60, 50]])
        left = np.array([5.0, 300, 900, 1200, 1500, 1700]) + step * np.array([8.0, -6, 5, 9, 3, 2])
        top = np.array([480.0, 500, 470, 700, 640, 900]) + 0 * step
        high = np.stack([left + size[:, 0], top + size[:, 1]], -1)
        low = np.clip(np.stack([left, top], -1), 0, None)
        true = np.concatenate([low, np.clip(high, None, [WIDTH, HEIGHT]) - low], -1)
        found = true + rng.normal(0, noise_px, true.shape) * np.minimum(1, true[..., 2:3] / 60)
        found[..., 2:] *= bias
        return cls(true, found)


def coco(folder: Path, video: Video, truth: Change, detections: Change, size: tuple[int, int] = (WIDTH, HEIGHT)) -> Any:
    """Paths of the truth and the detections."""
    rows = [(k, j) for k in range(len(video.true)) for j in range(video.true.shape[1])]
    entry = lambda k, j: {"image_id": k + 1, "category_id": j % 3 + 1}  # noqa: E731
    content = {
        "images": [{"id": k + 1, "width": size[0], "height": size[1]} for k in range(len(video.true))],
        "categories": [{"id": k + 1, "name": name} for k, name in enumerate(NAMES)],
        "annotations": [{**entry(k, j), "bbox": list(map(float, truth(*video.true[k, j])))} for k, j in rows],
    }
    found = [{**entry(k, j), "bbox": list(map(float, detections(*video.found[k, j]))), "score": 0.9} for k, j in rows]
    (folder / "gt.json").write_text(json.dumps(content))
    (folder / "dt.json").write_text(json.dumps(found))
    return folder / "gt.json", folder / "dt.json"


def mot(
    folder: Path,
    video: Video,
    truth: Change = RIGHT,
    detections: Change = RIGHT,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    tail: Callable[[int, int], str] = lambda k, j: "1,1,1",
    found_tail: str = "0.9,-1,-1,-1",
    length: int = 40,
    first: int = 1,
) -> Any:
    """The same; `tail` is what follows the box in line j of frame k."""
    info = f"[Sequence]\nname=bay\nframeRate=5\nseqLength={length}\nimWidth={size[0]}\nimHeight={size[1]}\n"
    (folder / "seqinfo.ini").write_text(info)
    whole = {"gt.txt": "", "det.txt": ""}
    for k in range(len(video.true)):
        for j in range(video.true.shape[1]):
            for name, boxes, change in (("gt.txt", video.true, truth), ("det.txt", video.found, detections)):
                x, y, w, h = boxes[k, j]
                box = change(x, y, w, h) if change is CHANGES["shares"] else change(x + 1, y + 1, w, h)
                start, end = (j + 1, tail(k, j)) if name == "gt.txt" else (-1, found_tail)
                whole[name] += f"{k + first},{start},{','.join(f'{float(number):.6f}' for number in box)},{end}\n"
    for name, text in whole.items():
        (folder / name).write_text(text)
    return folder / "gt.txt", folder / "det.txt"


def yolo(folder: Path, video: Video, truth: Change = CENTRES, detections: Change = CENTRES) -> Any:
    """The same; shares of the image."""
    for name, boxes, change, end in (("set/labels", video.true, truth, ""), ("p", video.found, detections, " 0.9")):
        (folder / name).mkdir(parents=True, exist_ok=True)
        for k, of_frame in enumerate(boxes):
            shares = (CHANGES["shares"](*change(*box)) for box in of_frame)
            lines = (f"{j % 3} {' '.join(f'{n:.8f}' for n in box)}{end}\n" for j, box in enumerate(shares))
            (folder / name / f"{k:03}.txt").write_text("".join(lines))
    return folder / "set", folder / "p"


def refused(told: str, truth: Path, detections: Path, options: ReadOptions = NO_OPTIONS) -> None:
    """Check that a pair of files is refused with a message that matches."""
    with pytest.raises(InputError, match=told):
        read_pair("day", truth, detections, options)


def random_boxes(rng, count, extent=400.0):
    corner, side = rng.uniform(0, extent, (count, 2)), rng.uniform(20, 120, (count, 2))
    return np.concatenate([corner, corner + side], axis=1)


def images(count, size_px=(600.0, 600.0), time_s=None, half_planes=None):
    zeros = np.zeros(count, dtype=np.int64)
    names = tuple(f"image{k}" for k in range(count))
    times = np.full(count, np.nan) if time_s is None else time_s
    seas = np.full((count, 3), np.nan) if half_planes is None else half_planes
    return Images(names, np.tile(size_px, (count, 1)), zeros, zeros, zeros, times, seas)


def rows_of(image, label, boxes_px):
    columns = (np.asarray(each, dtype=np.int64) for each in (image, label))
    return *columns, np.asarray(boxes_px, dtype=float).reshape(-1, 4)


def truth(image, label, boxes_px, ignored=None, crowd=None, identity=None, visible=None):
    nothing, unknown = np.zeros(len(image), dtype=bool), np.full(len(image), np.nan)
    flags = [nothing if each is None else np.asarray(each, dtype=bool) for each in (ignored, crowd)]
    tracks = np.full(len(image), -1) if identity is None else np.asarray(identity, dtype=np.int64)
    fractions = unknown if visible is None else visible
    return Annotations(*rows_of(image, label, boxes_px), *flags, tracks, fractions, unknown)


def found(image, label, boxes_px, confidence, probabilities=None, origin=None):
    return Results(*rows_of(image, label, boxes_px), np.asarray(confidence, dtype=float), probabilities, origin)


def random_set(seed, image_count=12, labels=3, crowds=True, ties=False):
    """Crowded images, with regions that are ignored, images without truth and images without detections."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(0, 6 * image_count))
    image = np.sort(rng.integers(0, image_count, count))
    boxes, label = random_boxes(rng, count, 250), rng.integers(0, labels, count)
    crowd = rng.random(count) < (0.08 if crowds else 0)
    ignored = crowd | (rng.random(count) < (0.08 if crowds else 0))
    kept = np.repeat(rng.random(count) < 0.8, rng.integers(1, 3, count))
    source = np.repeat(np.arange(count), np.diff(np.append(np.flatnonzero(np.ones(count)), count)))[: len(kept)]
    source = source[rng.random(len(source)) < 0.9]
    moved = boxes[source] + rng.normal(0, 8, (len(source), 4))
    moved[:, 2:] = np.maximum(moved[:, 2:], moved[:, :2] + 4)
    extra = int(rng.integers(0, 2 * image_count))
    confidence = rng.random(len(source) + extra)
    detected_label = np.where(rng.random(len(source)) < 0.8, label[source], rng.integers(0, labels, len(source)))
    whole = found(
        np.concatenate([image[source], rng.integers(0, image_count, extra)]),
        np.concatenate([detected_label, rng.integers(0, labels, extra)]),
        np.concatenate([moved, random_boxes(rng, extra, 250)]),
        np.round(confidence, 1) if ties else confidence,
    )
    names = tuple("abcdefgh"[:labels])
    detections = whole.by_image()
    return LabelledSet(names, ("all",), images(image_count), truth(image, label, boxes, ignored, crowd), detections)
