"""What `detect --truth` makes of boxes and classes, what it writes, and who can read it."""

import contextlib
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pycocotools.coco import COCO

import modsim3d
from modsim3d.core.errors import ModsimError
from modsim3d.formats.labelled_video import detecting
from modsim3d.formats.labelled_video.detect_truth import class_numbers
from modsim3d.formats.labelled_video.detecting import TABLES
from modsim3d.formats.labelled_video.targets import FileClasses, to_labels, visible_fractions
from modsim3d.formats.reading.coco import read_coco
from modsim3d.formats.reading.mot import read_mot
from tests.cli.bad_input.builders import content
from tests.detector_variants import variant
from tests.formats.labelled_video.videos import TRACKS, coco, mot, rows, write

TWO = {"left": 30, "right": 20}


def detected(folder: Path, text: str) -> tuple[list[dict[str, Any]], tuple[str, ...]]:
    """The table of truth and the notes over lines of MOT, in images of 640 × 480 px."""
    folder.mkdir()
    (folder / "gt.txt").write_text(text)
    options = {"image_size_px": (640, 480), "frame_rate_hz": 10}
    result = modsim3d.detect_truth(folder / "gt.txt", folder / "out", detector="thesis", **options)
    return rows(folder / "out" / "truth.parquet"), result.notes


def test_a_mot_sequence_comes_out_as_one_that_evaluators_find(tmp_path: Path) -> None:
    truth = mot(tmp_path / "bay")
    result = modsim3d.detect_truth(truth, tmp_path / "out", detector="thesis", seed=2)
    assert (tmp_path / "out" / "gt" / "gt.txt").read_bytes() == truth.read_bytes()
    assert sorted(str(path.relative_to(tmp_path / "out")) for path in result.files) == sorted(content(tmp_path / "out"))
    pair = read_mot("bay", tmp_path / "out/gt/gt.txt", tmp_path / "out/det/det.txt")
    assert len(pair.images) == 45
    table = rows(tmp_path / "out" / "detections.parquet")
    assert len(pair.results) == len(table) > 50
    assert [row["image"] for row in rows(tmp_path / "out" / "frames.parquet")] == [str(k) for k in range(1, 46)]
    found = sorted(zip(pair.results.image.tolist(), pair.results.boxes_px.round(2).tolist(), strict=True))
    sides = ("x_min_px", "y_min_px", "x_max_px", "y_max_px")
    asked = sorted((row["step"], [round(row[side], 2) for side in sides]) for row in table)
    assert np.allclose([box for _, box in found], [box for _, box in asked], atol=0.02)
    for name, columns in TABLES.items():
        schema = pq.read_schema(tmp_path / "out" / f"{name}.parquet")
        assert schema.names == [column.name for column in columns]
        assert all(field.metadata[b"description"] for field in schema)


def test_coco_results_have_the_ids_of_the_file_and_its_owner_reads_them(tmp_path: Path) -> None:
    truth = write(tmp_path / "gt.json", coco(TWO))
    modsim3d.detect_truth(truth, tmp_path / "out", detector="thesis", frame_rate_hz=5)
    with contextlib.redirect_stdout(io.StringIO()):
        read = COCO(str(truth)).loadRes(str(tmp_path / "out" / "dt.json"))
    entries = json.loads((tmp_path / "out" / "dt.json").read_text())
    assert {entry["category_id"] for entry in entries} == {4}
    assert {entry["image_id"] for entry in entries} <= set(range(100, 150))
    assert len(read.anns) == len(entries) == len(rows(tmp_path / "out" / "detections.parquet")) > 100
    assert len(read_coco("all", truth, tmp_path / "out" / "dt.json").results) == len(entries)
    for name, frames in TWO.items():
        lines = (tmp_path / "out" / f"tracker_input_{name}.jsonl").read_text().splitlines()
        assert [json.loads(line)["time_s"] for line in lines] == [frame / 5 for frame in range(frames)]


def test_what_a_tracker_reads_names_no_track_and_its_order_tells_nothing(tmp_path: Path) -> None:
    write(tmp_path / "gt.json", coco(TWO))
    options = {"detector": "thesis", "frame_rate_hz": 5}
    modsim3d.detect_truth(mot(tmp_path / "bay"), tmp_path / "mot", **options)
    modsim3d.detect_truth(tmp_path / "gt.json", tmp_path / "coco", **options)
    names = ("mot/det/det.txt", "mot/tracker_input_bay.jsonl", "coco/dt.json", "coco/tracker_input_left.jsonl")
    for name in names:
        text = (tmp_path / name).read_bytes()
        assert not any(str(track).encode() in text for track in TRACKS)
        assert not any(word in text for word in (b"kind", b"false", b"vessel", b"track", b"true"))
    lines = [list(map(float, line.split(","))) for line in (tmp_path / names[0]).read_text().splitlines()]
    assert lines == sorted(lines, key=lambda line: (line[0], -line[6]))
    assert {line[1] for line in lines} == {-1}
    entries = json.loads((tmp_path / names[2]).read_text())
    read = [json.loads(line) for name in names[1::2] for line in (tmp_path / name).read_text().splitlines()]
    scores = [found["confidence"] for line in read for found in line["detections"]]
    assert all(score == round(score, 6) for score in [*scores, *(entry["score"] for entry in entries)])
    assert entries == sorted(entries, key=lambda entry: (entry["image_id"], -entry["score"]))
    assert any(str(TRACKS[0]) == row["vessel"] for row in rows(tmp_path / "mot" / "detections.parquet"))


@pytest.mark.parametrize("kind", ["MOT", "COCO"])
def test_the_same_file_and_seed_give_the_same_bytes_however_the_work_is_split(tmp_path, monkeypatch, kind) -> None:
    truth = mot(tmp_path / "bay") if kind == "MOT" else write(tmp_path / "gt.json", coco(TWO))
    write(tmp_path / "detector.yaml", variant("persistence of misses and box errors, 10 s"))
    due = {"detector.gates.update_interval_s": 0.4}
    options = {"detector": tmp_path / "detector.yaml", "frame_rate_hz": 5, "settings": due}
    modsim3d.detect_truth(truth, tmp_path / "one", seed=1, **options)
    monkeypatch.setattr(detecting, "BLOCK_BOXES", 10)
    monkeypatch.setattr(detecting, "BLOCK_FRAMES", 7)
    modsim3d.detect_truth(truth, tmp_path / "two", seed=1, **options)
    assert content(tmp_path / "one") == content(tmp_path / "two")
    modsim3d.detect_truth(truth, tmp_path / "three", seed=2, **options)
    name = "det/det.txt" if kind == "MOT" else "dt.json"
    assert (tmp_path / "one" / name).read_bytes() != (tmp_path / "three" / name).read_bytes()


def test_detections_of_a_sequence_do_not_depend_on_how_the_file_lists_it(tmp_path: Path) -> None:
    for order in (0, 1):
        write(tmp_path / f"{order}.json", coco(TWO, order))
        modsim3d.detect_truth(tmp_path / f"{order}.json", tmp_path / str(order), detector="thesis", frame_rate_hz=5)
    same = ("detections.parquet", "truth.parquet", "tracker_input_left.jsonl", "tracker_input_right.jsonl")
    for name in same:
        assert (tmp_path / "0" / name).read_bytes() == (tmp_path / "1" / name).read_bytes(), name
    found = [(tmp_path / "0" / f"tracker_input_{name}.jsonl").read_text().splitlines()[0] for name in TWO]
    assert found[0] != found[1]


def test_flags_and_classes_of_mot_say_what_is_no_target(tmp_path: Path) -> None:
    truth = mot(tmp_path / "bay", frames=10, classes=(1, 2, 8))
    text = truth.read_text().replace(",60,1,2,", ",60,0,2,")
    truth.write_text(text)
    with pytest.raises(ModsimError, match="class 8 is not one of the detector's labels") as refused:
        modsim3d.detect_truth(truth, tmp_path / "out", detector="three_labels")
    assert "class 2" not in str(refused.value)  # its boxes are flagged
    labels = ("ferry", "ferry", "-", "-", "-", "-", "-", "sailboat")
    result = modsim3d.detect_truth(truth, tmp_path / "out", detector="three_labels", labels=labels)
    assert result.counts.annotated == 20
    found = {row["vessel"]: row["label"] for row in rows(tmp_path / "out" / "truth.parquet")}
    assert found == {str(TRACKS[0]): "ferry", str(TRACKS[2]): "sailboat"}
    assert "10 of 30 boxes are left out: not to be considered" in result.notes
    summary = json.loads((tmp_path / "out" / "detect.json").read_text())
    assert summary["class_numbers"] == {"sailboat": 8, "motorboat": 9, "ferry": 1}
    classes = {line.split(",")[7] for line in (tmp_path / "out" / "det" / "det.txt").read_text().splitlines()}
    assert classes <= {"8", "9", "1"} and len(classes) > 1


def test_visibility_comes_from_the_file_or_from_overlap_and_the_result_says_which(tmp_path: Path) -> None:
    known = modsim3d.detect_truth(mot(tmp_path / "a", visible=",0.25"), tmp_path / "1", detector="thesis")
    assert known.occlusion == {"from_file": 120, "from_overlap": 0}
    assert {row["visible_fraction"] for row in rows(tmp_path / "1" / "truth.parquet")} == {0.25}
    overlap = modsim3d.detect_truth(mot(tmp_path / "b", visible=""), tmp_path / "2", detector="thesis")
    assert overlap.occlusion == {"from_file": 0, "from_overlap": 120}
    assert any("visibility of 120 of 120 boxes comes from overlap" in note for note in overlap.notes)
    assert min(row["visible_fraction"] for row in rows(tmp_path / "2" / "truth.parquet")) < 0.9
    nowhere = modsim3d.detect_truth(mot(tmp_path / "c", visible=",0"), tmp_path / "3", detector="thesis")
    assert (nowhere.counts.annotated, nowhere.counts.fully_hidden) == (0, 120)
    truth = mot(tmp_path / "d")  # 1 everywhere, though boxes cover each other
    truth.write_text(truth.read_text() + "\n1,1,30,230,120,60,1,1,1\n1,2,30,210,120,60,1,1,1\n")
    doubted = modsim3d.detect_truth(truth, tmp_path / "4", detector="thesis")
    assert any("visibility is 1 everywhere, but other boxes cover more than half" in note for note in doubted.notes)


def test_boxes_are_cut_at_the_image_and_hidden_by_those_that_are_not_to_be_detected(tmp_path: Path) -> None:
    text = "1,1,101,101,40,40,1,1\n1,2,121,111,40,40,0,1\n"
    (row,), _ = detected(tmp_path / "hidden", text)
    assert (row["visible_fraction"], row["from_overlap"], row["annotated"]) == (1 - 20 * 30 / 40**2, True, True)
    text = "1,1,-19,101,60,40,1,1,1\n1,2,701,100,50,50,1,1,1\n2,1,621,461,60,40,1,1,1\n"
    table, notes = detected(tmp_path / "cut", text)
    sides = [f"full_{side}_px" for side in ("x_min", "y_min", "x_max", "y_max")]
    assert [[row[side] for side in sides] for row in table] == [[0, 100, 40, 140], [620, 460, 640, 480]]
    assert "1 of 3 boxes are left out: outside their image" in notes


def test_keys_below_detector_are_set_and_kept_in_the_summary(tmp_path: Path) -> None:
    truth = mot(tmp_path / "bay")
    settings = {"detector.states.good.false_discovery_rate": 0.0, "detector.performance.schedule": [[0, "good"]]}
    result = modsim3d.detect_truth(truth, tmp_path / "out", detector="thesis", settings=settings)
    assert result.counts.false_positives == 0
    summary = json.loads((tmp_path / "out" / "detect.json").read_text())
    assert summary["detector"]["states"]["good"]["false_discovery_rate"] == 0
    (tmp_path / "again.yaml").write_text(json.dumps(summary["detector"]))
    modsim3d.detect_truth(truth, tmp_path / "again", detector=tmp_path / "again.yaml")
    for name in ("det/det.txt", "detections.parquet"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "out" / name).read_bytes()


def test_what_an_earlier_result_had_does_not_stay_beside_a_new_one(tmp_path: Path) -> None:
    write(tmp_path / "gt.json", coco(TWO))
    modsim3d.detect_truth(tmp_path / "gt.json", tmp_path / "out", detector="thesis", frame_rate_hz=5)
    (tmp_path / "out" / "notes.txt").write_text("mine")
    with pytest.raises(ModsimError, match="exists: use --overwrite"):
        modsim3d.detect_truth(mot(tmp_path / "bay"), tmp_path / "out", detector="thesis")
    result = modsim3d.detect_truth(tmp_path / "bay/gt/gt.txt", tmp_path / "out", detector="thesis", overwrite=True)
    kept = {str(path.relative_to(tmp_path / "out")) for path in result.files}
    assert set(content(tmp_path / "out")) == {*kept, "notes.txt"}


def test_false_alarms_stay_below_the_horizon_that_is_given(tmp_path: Path) -> None:
    truth = mot(tmp_path / "bay", frames=60)
    settings = {"detector.false_positives.model": "per_image", "detector.false_positives.rate": 3}
    heights = {}
    for horizon in (None, 300, (0, 300, 640, 200)):
        out = tmp_path / str(horizon)
        options = {"detector": "thesis", "settings": settings, "horizon": horizon}
        result = modsim3d.detect_truth(truth, out, **options)
        found = [row for row in rows(out / "detections.parquet") if row["kind"] == "false_positive"]
        heights[horizon] = np.array([(row["centre_x_px"], row["y_max_px"]) for row in found])
        assert any("false positives lie anywhere" in note for note in result.notes) == (horizon is None)
    assert (heights[None][:, 1] < 250).any()
    assert (heights[300][:, 1] > 300).all()
    tilted = heights[(0, 300, 640, 200)]
    assert (tilted[:, 1] > 300 - 100 * tilted[:, 0] / 640 - 1).all() and (tilted[:, 1] < 300).any()


def test_the_detectors_time_begins_with_the_file_and_a_tracker_reads_the_files_own(tmp_path: Path) -> None:
    schedule = {"detector.performance.schedule": [[2, "terrible"]], "detector.persistence.class_s": 1}
    for start_s in (0, 1_000_000):
        labelled = coco(TWO)
        for image in labelled["images"]:
            image["time_s"] = start_s + image["frame_id"] / 4
        truth = write(tmp_path / f"{start_s}.json", labelled)
        modsim3d.detect_truth(truth, tmp_path / str(start_s), detector="thesis", settings=schedule)
    one, other = (rows(tmp_path / name / "detections.parquet") for name in ("0", "1000000"))
    assert [{**row, "timestamp": ""} for row in one] == [{**row, "timestamp": ""} for row in other]
    assert {row["state"] for row in one if row["step"] >= 8} == {"terrible"} != {row["state"] for row in one}
    line = json.loads((tmp_path / "1000000" / "tracker_input_right.jsonl").read_text().splitlines()[2])
    assert line["time_s"] == 1_000_000.5


SIDE = 12
CORNER = st.integers(0, SIDE - 1)
BOX = st.tuples(CORNER, CORNER, st.integers(1, 8), st.integers(1, 8))


def painted(boxes: np.ndarray) -> list[float]:
    """The same by painting pixels, one box after the other."""
    fractions = []
    for one in boxes:
        image = np.zeros((40, 40), dtype=bool)
        for x_min, y_min, x_max, y_max in boxes[boxes[:, 3] > one[3]]:
            image[y_min:y_max, x_min:x_max] = True
        part = image[one[1] : one[3], one[0] : one[2]]
        fractions.append(1 - part.mean())
    return fractions


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.lists(BOX, min_size=1, max_size=7))
def test_a_box_is_hidden_by_all_boxes_with_a_lower_foot_as_painting_shows(given_boxes: list[tuple[int, ...]]) -> None:
    boxes = np.array([[x, y, x + width, y + height] for x, y, width, height in given_boxes])
    images = np.zeros(len(boxes), dtype=np.int64)
    found = visible_fractions(images, boxes.astype(float), boxes[:, 3].astype(float))
    assert np.allclose(found, painted(boxes), atol=1e-12)
    shuffled = np.random.default_rng(len(boxes)).permutation(len(boxes))
    again = visible_fractions(images, boxes[shuffled].astype(float), boxes[shuffled, 3].astype(float))
    assert np.allclose(again, found[shuffled], atol=1e-12)


def test_boxes_of_other_images_and_of_the_same_foot_which_may_be_cut_hide_nothing() -> None:
    boxes = np.tile([[0.0, 0.0, 10.0, 10.0]], (3, 1))
    assert visible_fractions(np.array([0, 0, 1]), boxes, boxes[:, 3]).tolist() == [1, 1, 1]
    assert visible_fractions(np.array([0, 0, 1]), boxes, np.array([9.0, 10.0, 99.0])).tolist() == [0, 1, 1]
    boxes = np.array([[0.0, 0, 10, 10], [5, 0, 15, 10]])  # the foot counts where it was before the box was cut
    assert visible_fractions(np.zeros(2, dtype=np.int64), boxes, np.array([14.0, 11.0])).tolist() == [1, 0.5]


def test_classes_of_mot_have_the_names_that_learning_gives_them_and_several_may_be_one_label() -> None:
    classes = FileClasses("MOT", ("class_1", "class_2", "class_3"), (1, 2, 3))
    labels = ("class_3", "class_1", "class_9")
    found, notes = to_labels(classes, np.array([True, False, True]), None, labels)
    assert (found.tolist(), notes) == ([1, -1, 0], [])
    assert class_numbers(classes, found.tolist(), labels) == {"class_3": 3, "class_1": 1, "class_9": 4}
    classes = FileClasses("COCO", ("ferry", "tug", "buoy"), (7, 5, 6))  # whose label's number is that of the first
    found, _ = to_labels(classes, np.array([True, True, True]), ("ship", "ship", "-"), ("boat", "ship"))
    assert found.tolist() == [1, 1, -1]
    assert class_numbers(classes, found.tolist(), ("boat", "ship", "kayak")) == {"boat": 8, "ship": 7, "kayak": 9}
