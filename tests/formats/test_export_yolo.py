"""YOLO folders are read back by our own reader and by supervision, which finds the truth perfect."""

from pathlib import Path

import numpy as np
import pytest
import supervision
import yaml
from supervision.metrics import MeanAveragePrecision

from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.reading.pair import read_pair
from modsim3d.formats.writing import yolo
from modsim3d.formats.writing.request import ExportRequest
from modsim3d.runs.stored_run import StoredRun
from tests.formats.exported import LABELS, STEPS


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
