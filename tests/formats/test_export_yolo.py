"""YOLO folders are read back by our own reader and by supervision; trackers read nothing of where boxes came from."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import supervision
import yaml
from supervision.metrics import MeanAveragePrecision

from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.reading.pair import read_pair
from modsim3d.formats.writing import yolo
from modsim3d.formats.writing.coco import coco_results
from modsim3d.formats.writing.export_formats import FORMATS, ExportRequest
from modsim3d.runs.camera_sequences import camera_sequences
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from tests.formats.exported import LABELS, STEPS, VESSELS


@pytest.fixture(scope="module")
def folder(analytic_run: StoredRun) -> Path:
    yolo.write(ExportRequest(analytic_run, (0, 1)), analytic_run.folder.parent / "yolo")
    return analytic_run.folder.parent / "yolo"


def test_every_frame_has_its_files_even_where_nothing_is_in_it(analytic_run: StoredRun, folder: Path) -> None:
    names = [f"{row['camera']}_{row['step']:06d}" for row in analytic_run.table("frames").to_pylist()]
    assert len(names) == STEPS + 15
    for kind in yolo.FOLDERS:
        assert sorted(path.stem for path in (folder / kind).iterdir()) == sorted(names)
    assert not (folder / "labels" / "name_000000.txt").read_bytes()
    assert not (folder / "predictions" / "name_000000.txt").read_bytes()
    assert yaml.safe_load((folder / "data.yaml").read_text())["names"] == dict(enumerate(LABELS))


def test_our_own_reader_reads_the_run_back(analytic_run: StoredRun, folder: Path) -> None:
    again, (first, _) = read_pair("all", folder / "labels", folder / "predictions"), labelled_run(analytic_run)
    assert again.labels == LABELS
    names = tuple(f"{name.split()[0]}_{int(name.split()[1]):06d}" for name in first.images.names)
    assert again.images.names == names
    assert again.images.sizes_px.tolist() == first.images.sizes_px.tolist()
    assert again.annotations.image.tolist() == first.annotations.image.tolist()
    assert again.annotations.label.tolist() == first.annotations.label.tolist()
    np.testing.assert_allclose(again.annotations.boxes_px, first.annotations.boxes_px, atol=1e-8)
    found = first.results
    order = np.lexsort((-found.confidence, found.image))
    assert again.results.label.tolist() == found.label[order].tolist()
    np.testing.assert_allclose(again.results.boxes_px, found.boxes_px[order], atol=1.1e-3)
    np.testing.assert_allclose(again.results.confidence, found.confidence[order], atol=1e-6)


def data_set(folder: Path, labels: str) -> supervision.DetectionDataset:
    paths = folder / "images", folder / labels, folder / "data.yaml"
    return supervision.DetectionDataset.from_yolo(*map(str, paths))


def test_supervision_reads_it_and_finds_the_truth_perfect(analytic_run: StoredRun, folder: Path) -> None:
    read = data_set(folder, "labels")
    truth = list(read.annotations.values())
    assert read.classes == list(LABELS)
    assert sum(map(len, truth)) == analytic_run.table("truth")["annotated"].to_numpy().sum()
    assert sum(not len(each) for each in truth) >= 5
    for each in truth:
        each.confidence = np.ones(len(each))
    assert MeanAveragePrecision().update(truth, truth).compute().map50_95 == pytest.approx(1)
    found = data_set(folder, "predictions").annotations.values()
    assert sum(map(len, found)) == analytic_run.table("detections").num_rows


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
