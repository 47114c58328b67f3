"""COCO ground truth and results out of a labelled set.

Beside COCO's own keys an image has `condition`, `sequence`, `time_s` and `horizon`, its rows at the left and the right
edge, and an annotation `track_id`, `visible_fraction` and `distance_m`, where they are known. Results name nobody.

Masks are in `coco_masks`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import orjson

from modsim3d.formats.horizon import written_horizon
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.writing.coco_masks import check_masks, mask_entries
from modsim3d.formats.writing.request import ExportRequest
from modsim3d.outputs.placing import write_files
from modsim3d.runs.told import BOX_DECIMALS, told

FILES = ("gt.json", "dt.json")


def files(request: ExportRequest) -> tuple[str, ...]:
    """The paths of the files.

    Raises:
        ModsimError: Masks are asked for, and the run's truth has none.
    """
    if request.masks:
        check_masks(request)
    return FILES


def write(request: ExportRequest, folder: Path) -> None:
    """Write a run."""
    labelled, _ = labelled_run(request.run, request.cameras)
    write_coco(labelled, folder, mask_entries(request) if request.masks else None)


def write_coco(labelled: LabelledSet, folder: Path, masks: Iterable[dict[str, Any]] | None = None) -> tuple[Path, Path]:
    """Write `gt.json` and `dt.json` into a folder, which is made where it is not there, and return their paths.

    Args:
        labelled: The content.
        folder: The folder.
        masks: Keys to be added to each annotation, in their order.
    """
    truth, results = (folder / name for name in FILES)
    content = ground_truth(labelled)
    if masks is not None:
        for entry, more in zip(content["annotations"], masks, strict=True):
            entry |= more
    write_files({truth: orjson.dumps(content), results: orjson.dumps(coco_results(labelled))})
    return truth, results


def ground_truth(labelled: LabelledSet) -> dict[str, Any]:
    """The content of a ground truth; IDs begin at 1."""
    images, rows = labelled.images, labelled.annotations
    sizes, times = [list(map(_whole, size)) for size in images.sizes_px.tolist()], images.time_s.tolist()
    entries = []
    for k, name in enumerate(images.names):
        entry: dict[str, Any] = {"id": k + 1, "file_name": name, "width": sizes[k][0], "height": sizes[k][1]}
        entry["condition"] = labelled.conditions[images.condition[k]]
        entry["sequence"] = int(images.sequence[k])
        if math.isfinite(times[k]):
            entry["time_s"] = times[k]
        horizon = written_horizon(images.half_planes[k].tolist(), sizes[k][0])
        if horizon is not None:
            entry["horizon"] = horizon
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
    """The content of a results file, as a tracker may read it: numbers are rounded, the most confident comes first."""
    results = labelled.results
    found = told(results.image, results.label, results.boxes_px, results.confidence)
    columns = (column.tolist() for column in (found.frame, found.label, found.boxes_px, found.confidence))
    return [
        {
            "image_id": image + 1,
            "category_id": label + 1,
            "bbox": [round(side, BOX_DECIMALS) for side in _sides(box)],
            "score": score,
        }
        for image, label, box, score in zip(*columns, strict=True)
    ]


def _sides(corners: list[float]) -> list[float]:
    """Corner, width and height of a box."""
    x_min, y_min, x_max, y_max = corners
    return [x_min, y_min, x_max - x_min, y_max - y_min]


def _whole(value: float) -> float:
    """A whole number as one, as COCO has it."""
    return int(value) if value.is_integer() else value
