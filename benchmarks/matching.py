"""How long reading and matching a large labelled set takes: python -m benchmarks.matching [truth boxes]."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import orjson

from modsim3d.formats.matching import Rule, match
from modsim3d.formats.reading.coco import read_coco

BOXES, IMAGES = 200_000, 40_000


def written(folder: Path, boxes: int) -> tuple[Path, Path]:
    """COCO files with so many annotations, seven in eight detected, and a sixth as many false positives."""
    rng = np.random.default_rng(0)
    image = rng.integers(0, IMAGES, boxes)
    corner, side = rng.uniform(0, 1500, (boxes, 2)), rng.uniform(10, 200, (boxes, 2))
    seen = np.flatnonzero(rng.random(boxes) < 0.875)
    false = rng.integers(0, IMAGES, boxes // 6)
    content = {
        "images": [{"id": k, "width": 1920, "height": 1080} for k in range(IMAGES)],
        "categories": [{"id": 1, "name": "boat"}],
        "annotations": [
            {"image_id": k, "category_id": 1, "bbox": box}
            for k, box in zip(image.tolist(), np.hstack([corner, side]).tolist(), strict=True)
        ],
    }
    moved = np.hstack([corner[seen] + rng.normal(0, 3, (len(seen), 2)), side[seen]])
    elsewhere = np.hstack([rng.uniform(0, 1500, (len(false), 2)), rng.uniform(10, 200, (len(false), 2))])
    where = np.concatenate([image[seen], false]).tolist()
    results = [
        {"image_id": k, "category_id": 1, "bbox": box, "score": score}
        for k, box, score in zip(
            where, np.vstack([moved, elsewhere]).tolist(), rng.random(len(where)).tolist(), strict=True
        )
    ]
    truth, detections = folder / "gt.json", folder / "dt.json"
    truth.write_bytes(orjson.dumps(content))
    detections.write_bytes(orjson.dumps(results))
    return truth, detections


def main(boxes: int) -> None:
    """Measure and say it."""
    with tempfile.TemporaryDirectory() as folder:
        files = written(Path(folder), boxes)
        start = time.perf_counter()
        labelled = read_coco("all", *files)
        seconds = time.perf_counter() - start
    print(f"read      {seconds:5.2f} s  {len(labelled.annotations)} annotations, {len(labelled.results)} detections")
    for method in ("confidence", "optimal", "centre"):
        start = time.perf_counter()
        matched = match(labelled, Rule(method))
        print(f"{method:<10}{time.perf_counter() - start:5.2f} s  {len(matched.pairs[0])} matches")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else BOXES)
