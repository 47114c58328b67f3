"""Small labelled videos."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

TRACKS = (7_654_321, 8_765_432, 9_876_543)  # numbers that nothing else in a file can be


def mot(folder: Path, frames: int = 40, classes: tuple[int, ...] = (1, 1, 1), visible: str = ",1") -> Path:
    """Three tracks that pass each other, in a MOT sequence of its own folder."""
    lines = [
        f"{frame},{track},{30 + 90 * k + frame * (1 - k)},{200 + 40 * k},120,60,1,{number}{visible}"
        for frame in range(1, frames + 1)
        for k, (track, number) in enumerate(zip(TRACKS, classes, strict=True))
    ]
    (folder / "gt").mkdir(parents=True)
    (folder / "gt" / "gt.txt").write_text("\n".join(lines))
    info = f"[Sequence]\nname=bay\nframeRate=10\nseqLength={frames + 5}\nimWidth=640\nimHeight=480\n"
    (folder / "seqinfo.ini").write_text(info)
    return folder / "gt" / "gt.txt"


def coco(sequences: dict[str, int], order: int = 0, categories: tuple[str, ...] = ("Vessel",)) -> dict[str, Any]:
    """Sequences of so many frames, whose images and boxes are listed in an order of their own."""
    rng = np.random.default_rng(order)
    names = list(sequences) if not order else list(sequences)[::-1]
    images, boxes = [], []
    for name in names:
        for frame in range(sequences[name]):
            image = {"id": len(images) + 100, "width": 640, "height": 480, "sequence": name, "frame_id": frame}
            images.append(image)
            for k, track in enumerate(TRACKS):
                box = [30 + 90 * k + frame * (1 - k), 200 + 40 * k, 120, 60]
                entry = {"id": len(boxes) + 1, "image_id": image["id"], "category_id": 4}
                boxes.append(entry | {"bbox": box, "track_id": track})
    if order:
        rng.shuffle(images)
        rng.shuffle(boxes)
    entries = [{"id": 4 + k, "name": name} for k, name in enumerate(categories)]
    return {"images": images, "annotations": boxes, "categories": entries}


def write(path: Path, content: dict[str, Any]) -> Path:
    path.write_text(json.dumps(content))
    return path


def rows(path: Path) -> list[dict[str, Any]]:
    table: list[dict[str, Any]] = pq.read_table(path).to_pylist()
    return table
