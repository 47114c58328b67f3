"""What a tracker reads of an export says nothing of where a detection came from."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.writing.coco import coco_results
from modsim3d.formats.writing.registry import FORMATS
from modsim3d.formats.writing.request import ExportRequest
from modsim3d.runs.camera_sequences import camera_sequences
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from tests.formats.exported import VESSELS

READ_BY_TRACKERS = {
    "coco": ("dt.json",),
    "mot": ("**/det/det.txt", "**/seqinfo.ini", "seqmaps/*.txt", "frames.csv"),
    "yolo": ("predictions/*.txt", "images/*.png", "data.yaml"),
}


def told(path: Path) -> list[tuple[int, float]]:
    """The frame and the confidence of each detection in a file, in its order."""
    if path.suffix == ".json":
        return [(entry["image_id"], entry["score"]) for entry in json.loads(path.read_text())]
    rows = [line.replace(",", " ").split() for line in path.read_text().splitlines()]
    return [(int(row[0]), float(row[6])) if path.name == "det.txt" else (0, float(row[5])) for row in rows]


@pytest.mark.parametrize("name", READ_BY_TRACKERS)
def test_no_vessel_is_named_and_the_order_is_that_of_confidence(analytic_run, tmp_path: Path, name: str) -> None:
    FORMATS[name].write(ExportRequest(analytic_run, (0, 1)), tmp_path)
    truth = b"".join(path.read_bytes() for path in tmp_path.rglob("*") if path.is_file())
    files = [path for pattern in READ_BY_TRACKERS[name] for path in tmp_path.glob(pattern)]
    assert files and (name != "mot" or b"Zephyrine" in truth)
    for path in files:
        assert not [vessel for vessel in VESSELS if vessel.encode() in path.read_bytes()]
    detections = [told(path) for path in files if path.name in ("dt.json", "det.txt") or path.match("predictions/*")]
    assert sum(map(len, detections)) >= analytic_run.table("detections").num_rows
    for rows in detections:
        assert rows == sorted(rows, key=lambda row: (row[0], -row[1]))
        assert all(confidence == round(confidence, 6) for _, confidence in rows)


def test_boxes_have_three_decimals(analytic_run: StoredRun, tmp_path: Path) -> None:
    request = ExportRequest(analytic_run, (0, 1))
    for name in ("coco", "mot"):
        FORMATS[name].write(request, tmp_path / name)
    boxes = [entry["bbox"] for entry in json.loads((tmp_path / "coco" / "dt.json").read_text())]
    for path in tmp_path.glob("mot/modsim3d-all/*/det/det.txt"):
        boxes += [[float(side) for side in line.split(",")[2:6]] for line in path.read_text().splitlines()]
    assert len(boxes) == 2 * analytic_run.table("detections").num_rows
    assert all(side == round(side, 3) for box in boxes for side in box)
    for sequence in request.sequences:  # what the shares of YOLO are made of
        assert (sequence.detections.boxes_px == sequence.detections.boxes_px.round(3)).all()


def test_nothing_depends_on_where_detections_came_from_or_on_their_order(analytic_run, monkeypatch) -> None:
    first, coco = camera_sequences(analytic_run, (0, 1)), coco_results(labelled_run(analytic_run)[0])
    rows = RunRows.of(analytic_run)
    order = np.random.default_rng(0).permutation(rows.detections.num_rows)
    nobody = pa.nulls(len(order), pa.string())
    position = rows.detections.schema.get_field_index("vessel")
    detections = rows.detections.take(order).set_column(position, "vessel", nobody)
    frame, vessel = rows.detection_frame[order], np.full(len(order), -1)
    others = replace(rows, detections=detections, detection_frame=frame, detection_vessel=vessel)
    monkeypatch.setattr(RunRows, "of", lambda run: others)
    for one, other in zip(first, camera_sequences(analytic_run, (0, 1)), strict=True):
        for name, column in vars(one.detections).items():
            assert (column == getattr(other.detections, name)).all()
    assert coco_results(labelled_run(analytic_run)[0]) == coco
