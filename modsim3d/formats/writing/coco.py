"""COCO ground truth and results out of a labelled set.

Beside COCO's own keys an image has `condition`, `sequence` and `time_s`, and an annotation `track_id`,
`visible_fraction` and `distance_m`, where they are known. Results name nobody.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import orjson

from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.writing.request import ExportRequest
from modsim3d.outputs.placing import write_files

FILES = ("gt.json", "dt.json")


def files(request: ExportRequest) -> tuple[str, ...]:
    """The paths of the files."""
    return FILES


def write(request: ExportRequest, folder: Path) -> None:
    """Write a run."""
    labelled, _ = labelled_run(request.run, request.cameras)
    write_coco(labelled, folder)


def write_coco(labelled: LabelledSet, folder: Path) -> tuple[Path, Path]:
    """Write `gt.json` and `dt.json` into a folder, which is made where it is not there, and return their paths."""
    truth, results = (folder / name for name in FILES)
    write_files({truth: orjson.dumps(ground_truth(labelled)), results: orjson.dumps(coco_results(labelled))})
    return truth, results


def ground_truth(labelled: LabelledSet) -> dict[str, Any]:
    """The content of a ground truth; IDs begin at 1."""
    images, rows = labelled.images, labelled.annotations
    sizes, times = images.sizes_px.tolist(), images.time_s.tolist()
    entries = []
    for k, name in enumerate(images.names):
        entry: dict[str, Any] = {"id": k + 1, "file_name": name, "width": sizes[k][0], "height": sizes[k][1]}
        entry["condition"] = labelled.conditions[images.condition[k]]
        entry["sequence"] = int(images.sequence[k])
        if math.isfinite(times[k]):
            entry["time_s"] = times[k]
        entries.append(entry)
    boxes = rows.boxes_px.tolist()
    annotations = []
    for row, (image, label) in enumerate(zip(rows.image.tolist(), rows.label.tolist(), strict=True)):
        box = _sides(boxes[row])
        entry = {"id": row + 1, "image_id": image + 1, "category_id": label + 1, "bbox": box, "area": box[2] * box[3]}
        entry["iscrowd"] = int(rows.crowd[row])
        if rows.ignored[row] and not rows.crowd[row]:
            entry["ignore"] = 1
        if rows.identity[row] >= 0:
            entry["track_id"] = int(rows.identity[row])
        for key, column in (("visible_fraction", rows.visible_fraction), ("distance_m", rows.depth_m)):
            if math.isfinite(column[row]):
                entry[key] = float(column[row])
        annotations.append(entry)
    categories = [{"id": k + 1, "name": name} for k, name in enumerate(labelled.labels)]
    return {"images": entries, "annotations": annotations, "categories": categories}


def coco_results(labelled: LabelledSet) -> list[dict[str, Any]]:
    """The content of a results file."""
    results = labelled.results
    columns = results.image.tolist(), results.label.tolist(), results.boxes_px.tolist(), results.confidence.tolist()
    return [
        {"image_id": image + 1, "category_id": label + 1, "bbox": _sides(box), "score": score}
        for image, label, box, score in zip(*columns, strict=True)
    ]


def _sides(corners: list[float]) -> list[float]:
    """Corner, width and height of a box."""
    x_min, y_min, x_max, y_max = corners
    return [x_min, y_min, x_max - x_min, y_max - y_min]
