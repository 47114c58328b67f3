"""What `detect --truth` makes of boxes, writes, and who can read it; over the truth of a run, what the run has."""

import contextlib
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pycocotools.coco import COCO
from scipy import stats

import modsim3d
from modsim3d.core.errors import ModsimError
from modsim3d.detector.records import KINDS
from modsim3d.formats.detect_truth import class_numbers, detect_truth
from modsim3d.formats.reading.coco import read_coco
from modsim3d.formats.reading.mot import read_mot
from modsim3d.formats.video_targets import FileClasses, to_labels, visible_fractions
from modsim3d.runs import pipeline
from modsim3d.runs.files.table_columns import BOX_SIDES, ERRORS
from modsim3d.runs.run import detect_run, run_scene
from modsim3d.runs.stored_run import open_run
from modsim3d.scene.reading import load_scene
from tests.cli.bad_input.builders import content
from tests.detector_variants import thesis_data, variant
from tests.formats.labelled_video.videos import TRACKS, coco, mot, rows, write
from tests.scenes import mistaken_strait
from tests.tracks.track_files import top_left

TWO = {"left": 30, "right": 20}


def detected(folder: Path, text: str) -> tuple[list[dict[str, Any]], tuple[str, ...]]:
    """The table of truth and the notes over lines of MOT, in images of 640 × 480 px."""
    folder.mkdir()
    (folder / "gt.txt").write_text(text)
    options = {"image_size_px": (640, 480), "frame_rate_hz": 10}
    result = modsim3d.detect_truth(folder / "gt.txt", folder / "out", detector="thesis", **options)
    return rows(folder / "out" / "truth.parquet"), result.notes


def test_mot_sequences_and_coco_results_come_out_as_their_evaluators_and_owners_read_them(tmp_path: Path) -> None:
    truth = mot(tmp_path / "bay")
    result = modsim3d.detect_truth(truth, tmp_path / "out", detector="thesis", seed=2)
    assert (tmp_path / "out" / "gt" / "gt.txt").read_bytes() == truth.read_bytes()
    assert sorted(str(path.relative_to(tmp_path / "out")) for path in result.files) == sorted(content(tmp_path / "out"))
    pair = read_mot("bay", tmp_path / "out/gt/gt.txt", tmp_path / "out/det/det.txt")
    assert len(pair.images) == 45
    table = rows(tmp_path / "out" / "detections.parquet")
    assert len(pair.results) == len(table) > 50
    (sequence,) = open_run(tmp_path / "out").scene.labels.sequences
    assert sequence.images == tuple(str(k) for k in range(1, 46))
    found = sorted(zip(pair.results.image.tolist(), pair.results.boxes_px.round(2).tolist(), strict=True))
    sides = ("x_min_px", "y_min_px", "x_max_px", "y_max_px")
    asked = sorted((row["step"], [round(row[side], 2) for side in sides]) for row in table)
    assert np.allclose([box for _, box in found], [box for _, box in asked], atol=0.02)
    truth = write(tmp_path / "gt.json", coco(TWO))
    modsim3d.detect_truth(truth, tmp_path / "coco", detector="thesis", frame_rate_hz=5)
    with contextlib.redirect_stdout(io.StringIO()):
        read = COCO(str(truth)).loadRes(str(tmp_path / "coco" / "dt.json"))
    entries = json.loads((tmp_path / "coco" / "dt.json").read_text())
    assert {entry["category_id"] for entry in entries} == {4}
    assert {entry["image_id"] for entry in entries} <= set(range(100, 150))
    assert len(read.anns) == len(entries) == len(rows(tmp_path / "coco" / "detections.parquet")) > 100
    assert len(read_coco("all", truth, tmp_path / "coco" / "dt.json").results) == len(entries)
    for name, frames in TWO.items():
        lines = (tmp_path / "coco" / f"tracker_input_{name}.jsonl").read_text().splitlines()
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
    monkeypatch.setattr(pipeline, "BLOCK_VESSELS", 10)
    modsim3d.detect_truth(truth, tmp_path / "two", seed=1, **options)
    one, two = (content(tmp_path / name) for name in ("one", "two"))
    assert one.pop("run.log") and two.pop("run.log") and one == two
    modsim3d.detect_truth(truth, tmp_path / "three", seed=2, **options)
    name = "det/det.txt" if kind == "MOT" else "dt.json"
    assert (tmp_path / "one" / name).read_bytes() != (tmp_path / "three" / name).read_bytes()


def test_flags_and_classes_of_mot_say_what_is_no_target_and_visibility_where_it_comes_from(tmp_path: Path) -> None:
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


def test_boxes_are_cut_at_the_image_and_keys_below_detector_are_set_and_kept(tmp_path):
    text = "1,1,101,101,40,40,1,1\n1,2,121,111,40,40,0,1\n"
    (row,), _ = detected(tmp_path / "hidden", text)
    assert (row["visible_fraction"], row["annotated"]) == (1 - 20 * 30 / 40**2, True)
    text = "1,1,-19,101,60,40,1,1,1\n1,2,701,100,50,50,1,1,1\n2,1,621,461,60,40,1,1,1\n"
    table, notes = detected(tmp_path / "cut", text)
    sides = [f"full_{side}_px" for side in ("x_min", "y_min", "x_max", "y_max")]
    assert [[row[side] for side in sides] for row in table] == [[0, 100, 40, 140], [620, 460, 640, 480]]
    assert "1 of 3 boxes are left out: outside their image" in notes
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


def test_detections_do_not_depend_on_the_order_of_the_file_and_an_earlier_result_does_not_stay(tmp_path: Path) -> None:
    for order in (0, 1):
        write(tmp_path / f"{order}.json", coco(TWO, order))
        modsim3d.detect_truth(tmp_path / f"{order}.json", tmp_path / str(order), detector="thesis", frame_rate_hz=5)
    same = ("detections.parquet", "truth.parquet", "tracker_input_left.jsonl", "tracker_input_right.jsonl")
    for name in same:
        assert (tmp_path / "0" / name).read_bytes() == (tmp_path / "1" / name).read_bytes(), name
    found = [(tmp_path / "0" / f"tracker_input_{name}.jsonl").read_text().splitlines()[0] for name in TWO]
    assert found[0] != found[1]
    write(tmp_path / "gt.json", coco(TWO))
    modsim3d.detect_truth(tmp_path / "gt.json", tmp_path / "out", detector="thesis", frame_rate_hz=5)
    (tmp_path / "out" / "notes.txt").write_text("mine")
    with pytest.raises(ModsimError, match="holds a run: use overwrite=True"):
        modsim3d.detect_truth(mot(tmp_path / "bay"), tmp_path / "out", detector="thesis")
    result = modsim3d.detect_truth(tmp_path / "bay/gt/gt.txt", tmp_path / "out", detector="thesis", overwrite=True)
    kept = {str(path.relative_to(tmp_path / "out")) for path in result.files}
    assert set(content(tmp_path / "out")) == {*kept, "notes.txt"}


def test_false_alarms_stay_below_the_horizon_and_time_begins_with_the_file(tmp_path: Path) -> None:
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
    assert line["time_s"] == 0.5 and other[-1]["timestamp"] == "1000006.75"


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


def test_boxes_of_other_images_hide_nothing_and_classes_of_mot_have_names_or_one_label():
    boxes = np.tile([[0.0, 0.0, 10.0, 10.0]], (3, 1))
    assert visible_fractions(np.array([0, 0, 1]), boxes, boxes[:, 3]).tolist() == [1, 1, 1]
    assert visible_fractions(np.array([0, 0, 1]), boxes, np.array([9.0, 10.0, 99.0])).tolist() == [0, 1, 1]
    boxes = np.array([[0.0, 0, 10, 10], [5, 0, 15, 10]])  # the foot counts where it was before the box was cut
    assert visible_fractions(np.zeros(2, dtype=np.int64), boxes, np.array([14.0, 11.0])).tolist() == [1, 0.5]
    classes = FileClasses("MOT", ("class_1", "class_2", "class_3"), (1, 2, 3))
    labels = ("class_3", "class_1", "class_9")
    found, notes = to_labels(classes, np.array([True, False, True]), None, labels)
    assert (found.tolist(), notes) == ([1, -1, 0], [])
    assert class_numbers(classes, found.tolist(), labels) == {"class_3": 3, "class_1": 1, "class_9": 4}
    used, classes = np.array([True, True]), FileClasses("MOT", ("class_1", "class_3"), (1, 3))  # as detections may say
    assert to_labels(classes, used, ("ship", "-", "boat"), ("ship", "boat"))[0].tolist() == [0, 1]
    for wrong, said in ((("ship", *["boat"] * 4), "5 names, and the file 3 classes"), ("ship,boat", "a list of names")):
        with pytest.raises((ModsimError, TypeError), match=said):
            to_labels(classes, used, wrong, ("ship", "boat"))
    classes = FileClasses("COCO", ("ferry", "tug", "buoy"), (7, 5, 6))  # whose label's number is that of the first
    found, _ = to_labels(classes, np.array([True, True, True]), ("ship", "ship", "-"), ("boat", "ship"))
    assert found.tolist() == [1, 1, -1]
    assert class_numbers(classes, found.tolist(), ("boat", "ship", "kayak")) == {"boat": 8, "ship": 7, "kayak": 9}


NUMBERS = (*BOX_SIDES, *ERRORS, "confidence")
ALPHA = 1e-6


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the strait's camera ashore, whose horizon stays, before a detector that makes every kind of mistake."""
    folder = tmp_path_factory.mktemp("as a run")
    path = mistaken_strait(folder, 60)
    scene = yaml.safe_load(path.read_text())
    scene["cameras"].pop("bow")
    for key in ("frame_rate_hz", "start_offset_s"):
        scene["cameras"]["quay"].pop(key)
    path.write_text(yaml.safe_dump(scene))
    run_scene(load_scene(path), folder / "run")
    return folder / "run"


def as_coco(run: Path, folder: Path) -> Path:
    """The truth of a run under its own names, its rows in no order."""
    truth = [row for row in rows(run / "truth.parquet") if row["annotated"]]
    size = {"width": 1920, "height": 1080}
    labels = sorted({row["label"] for row in truth})
    content = {
        "categories": [{"id": 3 * k + 5, "name": name} for k, name in enumerate(labels)],
        "images": [
            {"id": 1000 - frame["step"], "time_s": float(frame["timestamp"]), "sequence": frame["camera"]} | size
            for frame in rows(run / "frames.parquet")
        ],
        "annotations": [
            {"image_id": 1000 - row["step"], "category_id": 3 * labels.index(row["label"]) + 5}
            | {"bbox": top_left(np.array([[row[f"visible_{side}"] for side in BOX_SIDES]]))[0].tolist()}
            | {"track_id": row["vessel"], "visible_fraction": row["visible_fraction"], "distance_m": row["depth_m"]}
            for row in truth[::-1]
        ],
    }
    (folder / "gt.json").write_text(json.dumps(content))
    return folder / "gt.json"


SETTINGS: dict[str, dict[str, object]] = {
    "every kind of mistake": {},
    "another": {
        "detector.false_positives.model": "per_image",
        "detector.false_positives.rate": 0.8,
        "detector.false_positives.size": None,
        "detector.gates.update_interval_s": 0.4,
        "detector.performance.schedule": [[3, "haze"]],
        "detector.persistence.class_s": 0,
    },
}


@pytest.mark.parametrize("settings", SETTINGS.values(), ids=SETTINGS)
def test_over_a_runs_truth_under_its_names_each_detection_is_that_of_the_run(run: Path, tmp_path: Path, settings):
    detect_run(run, tmp_path / "run", seed=8, settings=settings)
    scene = open_run(run).scene
    ((a, b, c),) = np.unique(scene.sea_half_planes(scene.cameras[0], np.arange(3)), axis=0)
    options = {"detector": run / "scene" / "detector.yaml", "seed": 8, "settings": settings}
    horizon = (0, -c / b, 1920, -(a * 1920 + c) / b)
    detect_truth(as_coco(run, tmp_path), tmp_path / "new", horizon=horizon, **options)
    asked, found = (rows(tmp_path / folder / "detections.parquet") for folder in ("run", "new"))
    assert len(asked) > 70
    for one, other in zip(asked, found, strict=True):
        for key in ("step", "label", "state", "kind", "vessel", "detection"):
            assert one[key] == other[key]
        for key in NUMBERS:
            assert one[key] == other[key] or abs(one[key] - other[key]) < 2e-3, key
    assert {row["kind"] for row in found} == {*KINDS} - {"on_vessel"}


@pytest.fixture(scope="module")
def busy(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """A long MOT sequence of many boxes, half of them half hidden, with what a detector of one state made of it."""
    folder, rng = tmp_path_factory.mktemp("busy"), np.random.default_rng(1)
    places = rng.uniform((900, 600), (4000, 3000), (300, 40, 2))
    lines = [
        f"{frame + 1},{track},{x:.2f},{y:.2f},900,500,1,1,{1 if track % 2 else 0.5}\n"
        for frame, of_frame in enumerate(places)
        for track, (x, y) in enumerate(of_frame)
    ]
    (folder / "gt.txt").write_text("".join(lines))
    data = thesis_data() | {
        "initial_state": "good",
        "transition_matrix": np.eye(4).tolist(),
        "dropout": {"model": "table", "visible_fraction": {"edges": [0.75], "odds": [4.0, 1.0]}},
    }
    (folder / "detector.yaml").write_text(yaml.safe_dump(data))
    options = {"image_size_px": (6000, 4000), "frame_rate_hz": 10}
    detect_truth(folder / "gt.txt", folder / "out", detector=folder / "detector.yaml", seed=3, **options)
    return rows(folder / "out" / "truth.parquet"), rows(folder / "out" / "detections.parquet")


def test_misses_box_errors_and_false_alarms_are_those_of_the_detector_file(busy) -> None:
    truth, detections = busy
    good = thesis_data()["states"]["good"]
    for visible, odds in ((1.0, 1.0), (0.5, 4.0)):
        seen = [row["detected"] for row in truth if row["visible_fraction"] == visible]
        rate = good["confusion"][-1][0]
        asked = odds * rate / (1 - rate) / (1 + odds * rate / (1 - rate))
        assert len(seen) == 6000
        assert stats.binomtest(len(seen) - sum(seen), len(seen), asked).pvalue > ALPHA
    errors = np.array([[row[key] for key in ERRORS] for row in detections if row["kind"] == "true"])
    mean, variance = np.array(good["box_error"]["mean"]), np.diag(good["box_error"]["covariance"])
    count = len(errors)
    assert np.all(np.abs(errors.mean(axis=0) - mean) < 6 * np.sqrt(variance / count))
    assert np.all(np.abs(np.var(errors, axis=0) / variance - 1) < 6 * np.sqrt(2 / count))
    false = sum(row["vessel"] is None for row in detections)
    rate, true = good["false_discovery_rate"], len(detections) - false
    expected = true * rate / (1 - rate)
    assert abs(false - expected) < 6 * np.sqrt(expected)


def test_a_run_exported_and_detected_again_has_the_same_rates(run: Path, tmp_path: Path) -> None:
    """Under other names its random numbers are others, and its shares the same but for chance."""
    truth = json.loads(as_coco(run, tmp_path).read_text())
    for image in truth["images"]:
        image["sequence"] = "elsewhere"
    (tmp_path / "gt.json").write_text(json.dumps(truth))
    detector = run / "scene" / "detector.yaml"
    detect_truth(tmp_path / "gt.json", tmp_path / "new", detector=detector, seed=7, horizon=500)
    asked, found = (rows(folder / "frames.parquet") for folder in (run, tmp_path / "new"))
    for key, of in (("n_detected", "n_annotated"), ("n_false", "n_detected")):
        table = [[sum(row[key] for row in each), sum(row[of] for row in each)] for each in (asked, found)]
        assert stats.chi2_contingency(table).pvalue > ALPHA
    assert rows(run / "detections.parquet") != rows(tmp_path / "new" / "detections.parquet")
