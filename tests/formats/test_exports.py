"""Exports read back by the programs that own the formats, by supervision and by our own readers."""

import configparser
import csv
import json
from collections.abc import Callable
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import supervision
import trackeval
import yaml
from hypothesis import given
from hypothesis import strategies as st
from pycocotools import mask as cocomask
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval
from supervision.metrics import MeanAveragePrecision
from trackers.eval import evaluate_mot_sequences

from modsim3d.core.errors import ModsimError
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.reading.pair import read_pair
from modsim3d.formats.writing import coco, mot, yolo
from modsim3d.formats.writing.coco import Pixels, coco_results, mask_entries
from modsim3d.formats.writing.export_formats import FORMATS, ExportRequest
from modsim3d.render.id_pass import Region
from modsim3d.runs.camera_sequences import SequenceTruth, camera_sequences
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from tests.formats.exported import LABELS, STEPS, VESSELS, exported_run

CLASS_NAMES = ("sailing_boat", "F_hre_ro-ro__gross", "RIB")
SEQUENCES = {
    mot.ALL_SET: ["name-2", "quay.2"],  # programs skip a line of a map that says `name`
    mot.CLASS_SET: [f"{camera}-{label}" for camera in ("name", "quay.2") for label in CLASS_NAMES],
}


@pytest.fixture(scope="module")
def folder(analytic_run: StoredRun) -> Path:
    mot.write(ExportRequest(analytic_run, (0, 1)), analytic_run.folder.parent / "mot")
    return analytic_run.folder.parent / "mot"


def rows_of(path: Path) -> list[list[str]]:
    return [line.split(",") for line in path.read_text().splitlines()]


def write_tracks(folder: Path, tracks: Path, kept: Callable[[list[str]], bool]) -> None:
    """A tracker's result that is some of the truth."""
    for truth in folder.glob("*/*/gt/gt.txt"):
        sequence = truth.parent.parent
        path = tracks / sequence.parent.name / "tracker" / "data" / f"{sequence.name}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        lines = [",".join([*row[:6], "1,-1,-1,-1\n"]) for row in rows_of(truth) if kept(row)]
        path.write_text("".join(lines))


def scores(folder: Path, tracks: Path, split: str) -> dict[str, dict[str, float]]:
    """HOTA, MOTA, IDF1 and counts of each sequence, by trackeval."""
    paths = {"GT_FOLDER": str(folder), "TRACKERS_FOLDER": str(tracks)}
    dataset = {**paths, "BENCHMARK": "modsim3d", "SPLIT_TO_EVAL": split, "PRINT_CONFIG": False}
    files = ("OUTPUT_SUMMARY", "OUTPUT_DETAILED", "PLOT_CURVES")
    quiet = dict.fromkeys(("PRINT_CONFIG", "PRINT_RESULTS", "TIME_PROGRESS", *files), False) | {"LOG_ON_ERROR": None}
    measures = trackeval.metrics
    metrics = [measures.HOTA(), *(each({"PRINT_CONFIG": False}) for each in (measures.CLEAR, measures.Identity))]
    found, _ = trackeval.Evaluator(quiet).evaluate([trackeval.datasets.MotChallenge2DBox(dataset)], metrics)
    return {
        name: {"HOTA": classes["pedestrian"]["HOTA"]["HOTA"].mean(), **classes["pedestrian"]["Count"]}
        | {key: classes["pedestrian"][metric][key] for metric, key in (("CLEAR", "MOTA"), ("Identity", "IDF1"))}
        for name, classes in found["MotChallenge2DBox"]["tracker"].items()
    }


PERFECT = pytest.approx((1, 1, 1), abs=1e-12)


@pytest.mark.parametrize("set_", SEQUENCES)
def test_trackeval_and_trackers_find_the_truth_perfect_in_every_sequence(analytic_run, folder, tmp_path, set_) -> None:
    write_tracks(folder, tmp_path, lambda row: row[6] == "1")
    found = scores(folder, tmp_path, set_.removeprefix("modsim3d-"))
    assert [*found] == [*sorted(SEQUENCES[set_]), "COMBINED_SEQ"]
    assert all((score["HOTA"], score["MOTA"], score["IDF1"]) == PERFECT for score in found.values())
    assert found["COMBINED_SEQ"]["GT_Dets"] == analytic_run.table("truth")["annotated"].to_numpy().sum()
    assert sorted({score["Frames"] for score in found.values() if "Frames" in score}) == [15, STEPS]
    if set_ == mot.ALL_SET:
        tracks, seqmap = tmp_path / set_ / "tracker" / "data", folder / "seqmaps" / f"{set_}.txt"
        again = evaluate_mot_sequences(folder / set_, tracks, seqmap, metrics=["CLEAR", "HOTA", "Identity"]).sequences
        assert [*again] == SEQUENCES[set_]
        assert all((each.HOTA.HOTA, each.CLEAR.MOTA, each.Identity.IDF1) == PERFECT for each in again.values())


def test_a_track_on_a_hidden_vessel_costs_nothing_and_is_not_taken_from_an_annotated_one(folder, tmp_path) -> None:
    write_tracks(folder, tmp_path, lambda row: True)
    rows = rows_of(folder / mot.ALL_SET / "name-2" / "gt" / "gt.txt")
    hidden = [row for row in rows if row[6:8] == ["0", "8"]]
    assert hidden and len(hidden) + sum(row[6:8] == ["1", "1"] for row in rows) == len(rows)
    found = scores(folder, tmp_path, "all").values()
    assert all((score["HOTA"], score["MOTA"], score["IDF1"]) == PERFECT for score in found)
    boxes = np.array([[10.0, 10, 50, 50], [12, 10, 52, 50], [48, 10, 90, 50], [10, 10, 50, 50]])  # two look alike
    seen, nothing = np.array([True, False, False, False]), [np.zeros(4)] * 3
    truth = SequenceTruth(np.array([0, 0, 0, 1]), np.arange(4), np.zeros(4, int), seen, boxes, *nothing)
    assert mot._near_scored(truth).tolist() == [False, True, False, False]


@pytest.mark.parametrize(("camera", "name"), [*enumerate(SEQUENCES[mot.ALL_SET])])
def test_our_own_reader_reads_the_run_back(analytic_run, folder, camera: int, name: str) -> None:
    sequence = folder / mot.ALL_SET / name
    again = read_pair("all", sequence / "gt" / "gt.txt", sequence / "det" / "det.txt")
    first, _ = labelled_run(analytic_run, [camera])
    rows, kept = first.annotations, ~again.annotations.ignored
    assert again.images.sizes_px.tolist() == first.images.sizes_px.tolist()
    assert again.annotations.image[kept].tolist() == rows.image.tolist()
    np.testing.assert_allclose(again.annotations.boxes_px[kept], rows.boxes_px, atol=1e-8)
    np.testing.assert_allclose(again.annotations.visible_fraction[kept], rows.visible_fraction, atol=1e-6)
    identities = rows.identity.tolist()
    pairs = set(zip(again.annotations.identity[kept].tolist(), identities, strict=True))
    assert len(pairs) == len(set(identities))
    found = first.results
    order = np.lexsort((-found.confidence, found.image))
    assert again.results.image.tolist() == found.image[order].tolist()
    np.testing.assert_allclose(again.results.confidence, found.confidence[order], atol=1e-6)
    np.testing.assert_allclose(again.results.boxes_px, found.boxes_px[order], atol=1.1e-3)


@pytest.fixture(scope="module")
def written(analytic_run: StoredRun) -> Path:
    yolo.write(ExportRequest(analytic_run, (0, 1)), analytic_run.folder.parent / "yolo")
    return analytic_run.folder.parent / "yolo"


def data_set(written: Path, labels: str) -> supervision.DetectionDataset:
    paths = written / "images", written / labels, written / "data.yaml"
    return supervision.DetectionDataset.from_yolo(*map(str, paths))


def test_frames_of_a_slow_camera_lead_back_to_steps_and_yolo_files_are_read_back(analytic_run, folder, written):
    with (folder / "frames.csv").open() as table:
        steps = {(row["camera"], int(row["frame"])): int(row["step"]) for row in csv.DictReader(table)}
    frames = analytic_run.table("frames").to_pylist()
    assert sorted((row["camera"], row["step"]) for row in frames) == sorted((c, s) for (c, _), s in steps.items())
    annotated = [row for row in analytic_run.table("truth").to_pylist() if row["annotated"]]
    truth = {(row["step"], row["vessel"]) for row in annotated if row["camera"] == "quay.2"}
    rows = rows_of(folder / mot.ALL_SET / "quay.2" / "gt" / "gt.txt")
    with (folder / "vessels.csv").open() as table:
        vessels = {row["identity"]: row["vessel"] for row in csv.DictReader(table)}
    assert [*vessels.values()] == [*VESSELS]
    assert {(steps["quay.2", int(row[0])], vessels[row[1]]) for row in rows if row[6] == "1"} == truth
    info = configparser.ConfigParser()
    info.read(folder / mot.ALL_SET / "quay.2" / "seqinfo.ini")
    entries = dict(info["Sequence"])
    assert (entries["seqlength"], entries["framerate"]) == ("15", "0.4")
    assert (entries["imwidth"], entries["imheight"]) == ("320", "201")
    for kind, truth in (("gt/gt.txt", True), ("det/det.txt", False)):
        for camera, whole in zip(("name", "quay.2"), SEQUENCES[mot.ALL_SET], strict=True):
            parts = [rows_of(folder / mot.CLASS_SET / f"{camera}-{name}" / kind) for name in CLASS_NAMES]
            assert sorted(chain(*parts)) == sorted(rows_of(folder / mot.ALL_SET / whole / kind))
            assert all(parts) or not truth
    labels = analytic_run.table("detections").to_pylist()
    ribs = sum(row["label"] == LABELS[2] and row["camera"] == "name" for row in labels)
    assert len(rows_of(folder / mot.CLASS_SET / "name-RIB" / "det" / "det.txt")) == ribs
    names = [f"{row['camera']}_{row['step']:06d}" for row in analytic_run.table("frames").to_pylist()]
    assert len(names) == STEPS + 15
    for kind in yolo.FOLDERS:
        assert sorted(path.stem for path in (written / kind).iterdir()) == sorted(names)
    assert not (written / "labels" / "name_000000.txt").read_bytes()
    assert not (written / "predictions" / "name_000000.txt").read_bytes()
    assert yaml.safe_load((written / "data.yaml").read_text())["names"] == dict(enumerate(LABELS))
    again, (first, _) = read_pair("all", written / "labels", written / "predictions"), labelled_run(analytic_run)
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
    read = data_set(written, "labels")
    truth = list(read.annotations.values())
    assert read.classes == list(LABELS)
    assert sum(map(len, truth)) == analytic_run.table("truth")["annotated"].to_numpy().sum()
    assert sum(not len(each) for each in truth) >= 5
    for each in truth:
        each.confidence = np.ones(len(each))
    assert MeanAveragePrecision().update(truth, truth).compute().map50_95 == pytest.approx(1)
    found = data_set(written, "predictions").annotations.values()
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


def test_boxes_have_three_decimals_and_nothing_says_where_they_came_from(analytic_run, tmp_path, monkeypatch):
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


# pycocotools 2.0.11 under NumPy 2
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation doesn't accept a copy:DeprecationWarning")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    return exported_run(tmp_path_factory.mktemp("coco"))


@pytest.fixture(scope="module")
def coco_folder(run: StoredRun) -> Path:
    coco.write(ExportRequest(run, (0, 1), masks=True), run.folder.parent / "coco")
    return run.folder.parent / "coco"


@pytest.fixture
def truth(coco_folder: Path) -> COCO:
    return COCO(str(coco_folder / "gt.json"))


@pytest.mark.parametrize("kind", ["bbox", "segm"])
def test_pycocotools_finds_the_truth_perfect(truth: COCO, kind: str) -> None:
    keys = ("image_id", "category_id", "bbox", "segmentation")
    results = [{key: entry[key] for key in keys} | {"score": 1.0} for entry in truth.loadAnns(truth.getAnnIds())]
    scored = COCOeval(truth, truth.loadRes(results), kind)
    scored.evaluate()
    scored.accumulate()
    scored.summarize()
    assert scored.stats[[0, 1, 2, 8]] == pytest.approx(1)  # AP of all, 0.5 and 0.75; AR of 100 detections


def test_in_mode_0_the_mask_is_the_whole_vessel_even_of_a_hidden_one(tmp_path: Path) -> None:
    run = exported_run(tmp_path, mode=0)
    coco.write(ExportRequest(run, (0,), masks=True), tmp_path / "coco")
    entries = json.loads((tmp_path / "coco" / "gt.json").read_text())["annotations"]
    hidden = [entry for entry in entries if not entry["i_area"]]
    assert hidden
    for entry in hidden:
        assert entry["i_bbox"] == [0, 0, 0, 0] and not cocomask.decode(entry["i_segm"]).any()
        assert entry["segmentation"] == entry["a_segm"] and entry["area"] == entry["a_area"] > 0


MASKS = st.tuples(st.integers(0, 7), st.integers(0, 5), st.integers(1, 8), st.integers(1, 6), st.integers(0, 2**48))


@given(st.lists(MASKS, max_size=3))
def test_pixels_are_encoded_as_pycocotools_does(parts: list[tuple[int, ...]]) -> None:
    """Masks anywhere in an image of 9 × 7 pixels, as tiles that share none."""
    image, pieces = np.zeros((7, 9), dtype=bool), []
    for x, y, width, height, seed in parts:
        region = Region(x, y, min(width, 9 - x), min(height, 7 - y))
        place = slice(region.y, region.y + region.height), slice(region.x, region.x + region.width)
        bits = np.random.default_rng(seed).random((region.height, region.width)) < (seed % 5) / 4
        bits &= ~image[place]
        image[place] |= bits
        pieces.append((bits, region))
    pixels = Pixels.of(pieces, (9, 7))
    expected = cocomask.encode(np.asfortranarray(image.astype(np.uint8)))
    assert pixels.encoded == {"size": [7, 9], "counts": expected["counts"].decode()}
    assert pixels.area == image.sum()
    assert pixels.box == cocomask.toBbox(expected).tolist()


@given(st.lists(st.integers(1, 2**20), min_size=1, max_size=9))
def test_long_runs_are_encoded_as_pycocotools_does(counts: list[int]) -> None:
    height = 1 + len(counts) % 3
    counts[-1] += -sum(counts) % height
    size = [height, sum(counts) // height]
    expected = cocomask.frPyObjects({"size": size, "counts": counts}, *size)["counts"].decode()
    edges = np.cumsum(counts)[: len(counts) // 2 * 2]
    pixels = Pixels((size[1], size[0]), edges[0::2], edges[1::2])
    assert pixels.encoded["counts"] == expected


def test_masks_are_those_of_the_truth_table_of_each_camera_and_whole_numbers_are_whole(run, truth, coco_folder):
    rows = sorted((r for r in run.table("truth").to_pylist() if r["annotated"]), key=lambda row: row["camera"])
    entries = truth.loadAnns(truth.getAnnIds())
    assert len(rows) == len(entries) > 100
    assert sum(row["visible_fraction"] < 1 for row in rows) > 5
    for row, entry in zip(rows, entries, strict=True):
        for key, box, count in (("a", "full", "silhouette_px"), ("i", "visible", "visible_px")):
            sides = [row[f"{box}_{side}_px"] for side in ("x_min", "y_min", "x_max", "y_max")]
            assert entry[f"{key}_area"] == cocomask.area(entry[f"{key}_segm"]) == row[count]
            x, y, width, height = entry[f"{key}_bbox"]
            assert [x, y, x + width, y + height] == sides
            assert cocomask.toBbox(entry[f"{key}_segm"]).tolist() == entry[f"{key}_bbox"]
        assert (entry["bbox"], entry["area"]) == (entry["i_bbox"], entry["i_area"])
        both = cocomask.merge([entry["a_segm"], entry["i_segm"]], intersect=True)
        assert cocomask.area(both) == entry["i_area"]
        assert truth.annToMask(entry).sum() == entry["area"]
    content = json.loads((coco_folder / "gt.json").read_text())
    whole = {
        "images": ("id", "width", "height", "sequence"),
        "annotations": ("id", "image_id", "category_id", "iscrowd", "track_id", "area", "a_area", "i_area"),
        "categories": ("id",),
    }
    for part, keys in whole.items():
        assert content[part]
        assert {type(entry[key]) for entry in content[part] for key in keys} == {int}
    for result in json.loads((coco_folder / "dt.json").read_text()):
        assert type(result["image_id"]) is type(result["category_id"]) is int
    both, bow, quay = (list(mask_entries(ExportRequest(run, c, masks=True))) for c in ((0, 1), (0,), (1,)))
    assert both == bow + quay
    request = ExportRequest(run, (1,), masks=True)
    (sequence,) = request.sequences
    truth = sequence.truth
    counted = truth.visible_px - (np.arange(len(truth)) == 2)
    request.__dict__["sequences"] = (replace(sequence, truth=replace(truth, visible_px=counted)),)
    with pytest.raises(ModsimError, match=r"vessel '\w+' has \d+ pixels in the image of camera 'quay.2' at step \d+"):
        list(mask_entries(request))
