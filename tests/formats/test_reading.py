"""COCO, MOT and YOLO files as their formats say and as other programs write them; and the horizon in an image."""

import json
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from modsim3d.core.errors import InputError
from modsim3d.formats.labelled import UNKNOWN, half_plane, joined, read_horizon, with_horizon, written_horizon
from modsim3d.formats.reading.builder import ReadOptions
from modsim3d.formats.reading.pair import read_pair, read_truth
from modsim3d.formats.reading.yolo import image_size_px
from modsim3d.io.misreadings import are_rounded
from tests.formats.labelled_files import images, random_set, refused

TRUTH = {
    "images": [{"id": 30, "width": 640, "height": 480, "file_name": "b.png"}, {"id": 7, "width": 640, "height": 480}],
    "categories": [{"id": 90, "name": "ferry"}, {"id": 4, "name": "kayak"}],
    "annotations": [
        {"image_id": 30, "category_id": 4, "bbox": [10, 20, 30, 40], "segmentation": {"counts": "abc", "size": [4, 4]}},
        {"image_id": 30, "category_id": 90, "bbox": [100, 20, 30.5, 40], "iscrowd": 1, "track_id": 5},
        {"image_id": 7, "category_id": 90, "bbox": [0, 0, 5, 5], "visible_fraction": 0.25, "distance_m": 80},
    ],
}
RESULTS = [
    {"image_id": 30, "category_id": 90, "bbox": [11, 20, 30, 40], "score": 0.75, "segmentation": {"counts": "x"}},
    {"image_id": 7, "category_id": 4, "bbox": [1, 2, 3, 4], "score": 1, "probabilities": [0.1, 0.9]},
]


def written(tmp_path, truth=TRUTH, results=RESULTS):
    for name, content in (("gt.json", truth), ("dt.json", results)):
        (tmp_path / name).write_text(content if isinstance(content, str) else json.dumps(content))
    return tmp_path / "gt.json", tmp_path / "dt.json"


def read(tmp_path, truth=TRUTH, results=RESULTS, **given):
    return read_pair("day", *written(tmp_path, truth, results), ReadOptions(**given))


def changed(where, **keys):
    truth, results = deepcopy(TRUTH), deepcopy(RESULTS)
    entry = results[where] if isinstance(where, int) else truth[where[0]][where[1]]
    new = {key: value for key, value in (entry | keys).items() if value is not None}
    entry.clear()
    entry.update(new)
    return truth, results


FIRST, SECOND = ("images", 0), ("images", 1)
BAD = [
    (changed(1, image_id=99), r"detections .*\n  \[1\]: unknown image_id 99"),
    (changed(0, category_id=0), r"\[0\]: unknown category_id 0"),
    (changed(1, score=None), r"\[1\]: score must be from 0 to 1 \(got null\)"),
    (changed(1, score=1.5), r"\[1\]: score must be from 0 to 1 \(got 1.5\)"),
    (changed(1, bbox=[1, 2, 0, 4]), r"\[1\]: bbox has no area: width 0, height 4"),
    (changed(1, bbox=[1, 2, 3]), r"\[1\]: bbox must be \[x, y, width, height\]"),
    (changed(1, probabilities=[1]), r"\[1\]: probabilities must be 2 numbers"),
    (changed(("annotations", 2), bbox=[0, 0, 5, -1]), r"ground truth .*\n  annotations\[2\]: bbox has no area"),
    (changed(("annotations", 0), bbox=None), r"annotations\[0\]: bbox must be"),
    (changed(("annotations", 0), image_id=None), r"annotations\[0\]: image_id is missing"),
    (changed(("annotations", 1), category_id=5), r"annotations\[1\]: unknown category_id 5"),
    (changed(SECOND, id=30), r"images\[1\]: id 30 appears twice"),
    (changed(FIRST, width=0), r"images\[0\]: width and height must be pixels, above 0"),
    (changed(FIRST, width="640"), r"images\[0\]: width and height must be pixels, above 0 \(got '640' and 480\)"),
    (changed(SECOND, sequence=[1]), r"images\[1\]: sequence must be a whole number or text \(got \[1\]\)"),
    (changed(SECOND, time_s="noon"), r"images\[1\]: time_s and frame_id must be numbers \(got 'noon'\)"),
    (changed(SECOND, horizon=[1, 2, 3]), r"images\[1\]: horizon must be a row, \[left, right\], its rows at both"),
    (changed(("annotations", 2), bbox=[0, 0, 1e200, 5]), r"annotations\[2\]: bbox must be in pixels, at most 1e\+07"),
    (changed(("categories", 1), name="ferry"), r"categories\[1\]: .* appears twice"),
    (changed(("categories", 1), name=""), r"categories\[1\]: must have an id, a whole number, and a name"),
    (changed(("annotations", 2), distance_m="far"), r"annotations\[2\]: distance_m must be a number"),
    (changed(("annotations", 2), distance_m=-4), r"annotations\[2\]: distance_m must be 0 or more \(got -4\)"),
    (changed(("annotations", 2), visible_fraction=25), r"\[2\]: visible_fraction must be from 0 to 1 \(got 25\)"),
    ((TRUTH, {"annotations": []}), "must be a list of results"),
    ((RESULTS, RESULTS), "a list: is it the results file?"),
    (({"images": []}, RESULTS), "annotations: missing\n  categories: missing"),
    ((json.dumps(TRUTH)[:150], RESULTS), r"line 1, column \d+: .*is it cut off"),
    ((TRUTH, "[{]"), "line 1, column 3"),
]


def test_coco_ids_may_be_any_and_what_is_wrong_is_refused_with_every_problem(tmp_path):
    labelled = read(tmp_path)
    truth, found = labelled.annotations, labelled.results
    assert labelled.labels == ("ferry", "kayak")
    assert labelled.images.names == ("7", "b.png")  # in the order of the IDs, as COCO's tools have it
    assert (truth.image.tolist(), truth.label.tolist()) == ([0, 1, 1], [0, 1, 0])
    assert truth.boxes_px[1].tolist() == [10, 20, 40, 60]
    assert truth.crowd.tolist() == truth.ignored.tolist() == [False, False, True]
    assert truth.identity.tolist() == [-1, -1, 0]
    assert truth.visible_fraction[0] == 0.25 and truth.depth_m[0] == 80
    assert (found.label.tolist(), found.confidence.tolist()) == ([1, 0], [1, 0.75])
    assert found.probabilities[0].tolist() == [0.1, 0.9] and np.isnan(found.probabilities[1]).all()
    # a condition that an image leaves empty is that of the pair
    images = [{**TRUTH["images"][0], "condition": None}, {**TRUTH["images"][1], "condition": "fog"}]
    assert read(tmp_path, {**TRUTH, "images": images}).conditions == ("fog", "day")
    empty = read(tmp_path, {**TRUTH, "annotations": []}, [])
    assert (len(empty.images), len(empty.annotations), len(empty.results)) == (2, 0, 0)
    for files, message in BAD:
        with pytest.raises(InputError, match=message):
            read(tmp_path, *files)
    results = [{**RESULTS[0], "image_id": k} for k in range(30)] + RESULTS
    with pytest.raises(InputError) as raised:
        read(tmp_path, results=results)
    assert len(raised.value.problems) == 21 and "9 more" in raised.value.problems[-1]
    labelled = read(tmp_path, results=results, skip_bad=True)
    assert len(labelled.results) == 3 and "29 entries left out, the first because [0]" in labelled.notes[0]
    for where, keys in ((("annotations", 2), {"distance_m": -4}), (("images", 1), {"width": 0})):  # and not there
        truth, results = changed(where, **keys)
        labelled = read(tmp_path, truth, [entry for entry in results if entry["image_id"] == 30], skip_bad=True)
        assert len(labelled.annotations) == 2 and np.isnan(labelled.annotations.depth_m).all()
        assert (labelled.images.sizes_px > 0).all() and "ground truth" in labelled.notes[0]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_coco_written_and_read_is_the_same(seed, tmp_path_factory):
    labelled = random_set(seed)
    truth, found = labelled.annotations, labelled.results

    def entries(rows, **more):
        boxes = np.hstack([rows.boxes_px[:, :2], rows.boxes_px[:, 2:] - rows.boxes_px[:, :2]])
        columns = {"image_id": rows.image, "category_id": rows.label, "bbox": boxes, **more}
        return [{key: column[k].tolist() for key, column in columns.items()} for k in range(len(rows))]

    gt = {
        "images": [{"id": k, "width": 600, "height": 600} for k in range(len(labelled.images))],
        "categories": [{"id": k, "name": name} for k, name in enumerate(labelled.labels)],
        "annotations": entries(truth, iscrowd=truth.crowd.astype(int), ignore=truth.ignored.astype(int)),
    }
    again = read(tmp_path_factory.mktemp("coco"), gt, entries(found, score=found.confidence))
    for part in ("annotations", "results"):
        for name, column in vars(getattr(labelled, part)).items():
            if isinstance(column, np.ndarray):
                np.testing.assert_allclose(getattr(getattr(again, part), name), column, atol=1e-9)


def mot(tmp_path, truth="1,3,10,20,30,40,1,1,0.5\n", detections="1,-1,12,20,30,40,0.9\n", size=(640, 480), labels=()):
    (tmp_path / "gt.txt").write_text(truth)
    (tmp_path / "det.txt").write_text(detections)
    return read_pair("day", tmp_path / "gt.txt", tmp_path / "det.txt", ReadOptions(labels, size))


def test_mot_is_read_and_an_empty_column_does_not_shift_the_others(tmp_path):
    folder = tmp_path / "gt"
    folder.mkdir()
    (tmp_path / "seqinfo.ini").write_text("[Sequence]\nimWidth=1920\nimHeight=1080\nseqLength=4\nframeRate=5\n")
    (folder / "gt.txt").write_text("1,3,10,20,30,40,1,1,0.5\n2,3,11,20,30,40,1,1,1\n2,4,0,0,9,9,0,1,1\n")
    (tmp_path / "det.txt").write_text("2,-1,12,20,30,40,0.9,-1,-1,-1\n1,-1,300,20,30,40,0.3\n")
    labelled = read_pair("day", folder / "gt.txt", tmp_path / "det.txt", ReadOptions(labels=("boat",)))
    assert labelled.labels == ("boat",)
    assert labelled.images.time_s.tolist() == pytest.approx([0, 0.2, 0.4, 0.6])
    assert labelled.images.sizes_px[0].tolist() == [1920, 1080]
    truth, found = labelled.annotations, labelled.results
    assert truth.boxes_px[0].tolist() == [9, 19, 39, 59]  # the format counts pixels from 1
    assert (found.boxes_px[1].tolist(), found.image.tolist()) == ([11, 19, 41, 59], [0, 1])
    assert (truth.identity.tolist(), truth.ignored.tolist()) == ([0, 0, 1], [False, False, True])
    assert truth.visible_fraction.tolist() == [0.5, 1, 1]
    wrong = "-1,-1,12,20,30,40,0.9\n1,-1,12,20,0,40,0.9\n1,-1,1\n1,-1,1,1,1,1,x\n1,-1,1,1,1,1,7\n"
    (tmp_path / "det.txt").write_text(wrong)
    with pytest.raises(InputError) as raised:
        read_pair("day", folder / "gt.txt", tmp_path / "det.txt", ReadOptions())
    places = [line.partition(":")[0] for line in raised.value.problems[:-1]]
    assert places == [f"det.txt line {k}" for k in (3, 4, 1, 2, 5)]
    assert raised.value.problems[-1].startswith("confidences are from 0.9 to 7 here: confidence_scale")
    (tmp_path / "seqinfo.ini").unlink()
    refused("give image_size_px", folder / "gt.txt", tmp_path / "det.txt", ReadOptions())
    assert len(mot(tmp_path, detections="1,-1,12,20,30,40,0.9,\n").results) == 1
    for said, wrong in (
        (r"det.txt line 1: must be numbers \(got '1,-1,,12", {"detections": "1,-1,,12,20,30,40,0.9\n"}),
        ("gt.txt line 1: frame must be a whole number from 1 to", {"truth": "1700000000000,3,10,20,30,40,1,1,0.5\n"}),
    ):
        with pytest.raises(InputError, match=said):
            mot(tmp_path, **wrong)
    truth = "1,3,10,20,30,40,1,2,1\n1,4,100,20,30,40,1,5,1\n"
    labelled = mot(tmp_path, truth, "1,-1,12,20,30,40,0.9,5,-1,-1\n", labels=("a", "b"))
    assert labelled.labels == ("b", "class_5")
    assert (labelled.annotations.label.tolist(), labelled.results.label.tolist()) == ([0, 1], [1])


def test_yolo(tmp_path):
    truth, predictions = tmp_path / "set", tmp_path / "predictions"
    (truth / "labels").mkdir(parents=True)
    predictions.mkdir()
    (truth / "labels" / "a.txt").write_text("0 0.5 0.5 0.25 0.5\n1 0.25 0.25 0.1 0.1\n")
    (truth / "labels" / "b.txt").write_text("")
    (truth / "labels" / "images.txt").write_text("images/d.png\n")
    (truth / "data.yaml").write_text("names: {0: sailboat, 1: ferry}\n")
    (predictions / "c.txt").write_text("1 0.5 0.5 0.2 0.2 0.75\n")
    given = ReadOptions(image_size_px=(800, 400))
    labelled = read_pair("day", truth, predictions, given)
    assert labelled.labels == ("sailboat", "ferry")
    assert labelled.images.names == ("a", "b", "c", "d")
    assert labelled.annotations.boxes_px[0].tolist() == [300, 100, 500, 300]
    assert labelled.results.image.tolist() == [2] and labelled.results.confidence.tolist() == [0.75]
    (predictions / "c.txt").write_text("1 0.5 0.5 0.2 0.2\n0.5 0.1 0.1 0.1 0.1 0.9\n0 400 300 20 20 0.9\n")
    refused(r"c.txt line 1: has 5 numbers.*\n.*c.txt line 2: class.*\n.*line 3: .*shares", truth, predictions, given)
    refused("give image_size_px", truth, predictions, ReadOptions())


def yolo(tmp_path, line="0 0.5 0.5 0.25 0.5\n", data="names: [ferry]\n", labels=()):
    truth, predictions = tmp_path / "labels", tmp_path / "predictions"
    truth.mkdir(exist_ok=True)
    predictions.mkdir(exist_ok=True)
    (truth / "a.txt").write_text(line)
    (tmp_path / "data.yaml").write_text(data)
    return read_pair("day", truth, predictions, ReadOptions(labels, (800, 400)))


def test_yolo_names_are_those_of_their_numbers(tmp_path):
    assert yolo(tmp_path, data="names: {2: kayak, 1: ferry}\n").labels == ("class_0", "ferry", "kayak")
    numbered, twice = "names: must be numbered", "'ferry' names more than one class"
    for said, wrong in (
        (numbered, {"data": "names: {0: ferry, x: kayak}\n"}),
        (numbered, {"data": "names: {-1: ferry}\n"}),
        (numbered, {"data": "names: {1000000000: ferry}\n"}),
        (twice, {"data": "names: [ferry, ferry]\n"}),
        (twice, {"labels": ("ferry", "ferry")}),
        ("a.txt line 1: class must be a whole number from 0 to", {"line": "900000000 0.5 0.5 0.25 0.5\n"}),
    ):
        with pytest.raises(InputError, match=said):
            yolo(tmp_path, **wrong)


def test_joined_sets_keep_their_rows_apart_and_a_row_and_two_points_are_the_same_line():
    first, second = random_set(1, labels=2), random_set(2, labels=3)
    both = joined([first, second])
    assert both.labels == ("a", "b", "c") and both.conditions == ("all",)
    assert len(both.images) == len(first.images) + len(second.images)
    ours = both.annotations.image[len(first.annotations) :]
    np.testing.assert_array_equal(ours, second.annotations.image + len(first.images))
    assert set(both.images.source.tolist()) == {0, 1}
    assert np.all(np.diff(both.results.image) >= 0)
    lines = [read_horizon(value, 640.0) for value in (300, [300, 300], [0, 300, 10, 300])]
    assert lines == [tuple(half_plane(300, []))] * 3
    a, b, c = read_horizon([200, 264], 640.0)
    assert [a * x + b * y + c for x, y in ((0, 200), (320, 232), (640, 264))] == pytest.approx([0, 0, 0])
    assert b > 0  # the sea is below
    for value in ("300", True, [], [1, 2, 3], [5, 1, 5, 9], [1, None], 1e8, [float("nan")] * 2):
        assert read_horizon(value, 640.0) is None, value
    for sea in (UNKNOWN, (0.0, 0.0, 1.0), (1.0, 0.0, -300.0), (0.0, -1.0, 300.0)):  # the sea is below no line
        assert written_horizon(sea, 640.0) is None, sea


@given(roll=st.floats(-1.2, 1.2), below=st.floats(-2000, 2000), width=st.floats(100, 4000))
def test_a_horizon_that_is_written_is_read_back(roll, below, width):
    sea = np.array([np.sin(roll), np.cos(roll), -below])
    again = np.array(read_horizon(written_horizon(sea.tolist(), width), width))
    corners = np.array([[0, 0, 1], [width, 0, 1], [0, 500, 1], [width, 500, 1]])
    np.testing.assert_allclose(corners @ again * np.cos(roll), corners @ sea, atol=1e-3)


def test_what_is_not_there_is_no_other_kind_and_images_that_say_their_horizon_keep_it(tmp_path):
    yolo(tmp_path)
    with pytest.raises(InputError) as raised:
        read_pair("day", tmp_path / "labels", tmp_path / "nowhere", ReadOptions())
    assert raised.value.problems == (f"detections {tmp_path / 'nowhere'}: no such file or folder",)
    gt, _ = written(tmp_path)
    (tmp_path / "det.txt").touch()
    refused(r"looks like COCO and .* like MOT", gt, tmp_path / "det.txt", ReadOptions())
    labelled = random_set(0, image_count=2)
    labelled = replace(labelled, images=images(2, half_planes=np.array([UNKNOWN, (0.0, 1.0, -50.0)])))
    assert with_horizon(labelled, None) is labelled
    found = with_horizon(labelled, (200.0,)).images.half_planes
    np.testing.assert_array_equal(found, [[0, 1, -200], [0, 1, -50]])
    with pytest.raises(InputError, match="lies below images of 600 × 600 px"):
        with_horizon(labelled, (700.0,))
    files = tmp_path / "gt.txt", tmp_path / "det.txt"
    for path, line in zip(files, ("1,3,10,20,30,40,1,1,0.5\n", "1,-1,12,20,30,40,0.9\n"), strict=True):
        path.write_text(line)
    options = ReadOptions(image_size_px=(640, 480), frame_rate_hz=5, horizon=(0, 200, 640, 264))
    np.testing.assert_allclose(read_pair("day", *files, options).images.half_planes, [[-0.1, 1, -200]])
    assert np.isnan(read_pair("day", *files, replace(options, horizon=None)).images.half_planes).all()


NAMES = ("frame_000.jpg", "frame_001.jpg", "frame_002.jpg")


def coco(tmp_path, results, names=NAMES, first_id=11, images=None, annotations=None):
    common = {"width": 640, "height": 480, **(images or {})}
    truth = {
        "images": [{"id": first_id + k, "file_name": name, **common} for k, name in enumerate(names)],
        "categories": [{"id": 1, "name": "kayak"}, {"id": 2, "name": "ferry"}],
        "annotations": annotations or [{"image_id": first_id, "category_id": 1, "bbox": [1, 2, 30, 40]}],
    }
    (tmp_path / "gt.json").write_text(json.dumps(truth))
    (tmp_path / "dt.json").write_text(json.dumps(results))
    return tmp_path / "gt.json", tmp_path / "dt.json"


def result(image_id, category_id=1, **more):
    return {"image_id": image_id, "category_id": category_id, "bbox": [1, 2, 30, 40], "score": 0.87512} | more


NUMBERED = ("000010.jpg", "000011.jpg", "000012.jpg")


def test_an_image_is_named_by_its_id_or_its_file_unless_two_have_it_and_categories_can_be_moved(tmp_path):
    for names, results, rows, doubtful in (
        (NAMES, [result("frame_002"), result("frame_000")], [0, 2], False),  # ultralytics: the name without its ending
        (tuple(f"images/val/{name}" for name in NAMES), [result("frame_002"), result("frame_000")], [0, 2], False),
        (NAMES, [result("frame_002.jpg"), result("frame_000.jpg")], [0, 2], False),
        (("000100.jpg", "000101.jpg", "000102.jpg"), [result(102), result(100)], [0, 2], False),  # ultralytics too
        (NAMES, [result(13), result(11)], [0, 2], False),  # detectron2 and mmdetection: the ID
        (
            ("000012.jpg", "000013.jpg", "000011.jpg"),
            [result(11, file_name="000011.jpg"), result(12, file_name="000012.jpg")],
            [0, 2],
            False,
        ),
        (NUMBERED, [result(11), result(12)], [0, 1], True),
        (NUMBERED, [result(11), result(13)], [0, 2], False),
        (NUMBERED, [result(10), result(11)], [0, 1], False),
        (NUMBERED, [result(11, file_name="000011.jpg")], [1], False),
    ):
        labelled = read_pair("day", *coco(tmp_path, results, names))
        assert labelled.results.image.tolist() == rows and set(labelled.results.confidence) == {0.87512}, results
        assert any("the name of another's file" in note for note in labelled.notes) == doubtful
    files = coco(tmp_path, [result("a"), result("b")], ("one/a.jpg", "two/a.jpg", "b.jpg"))
    refused(r"\[0\]: unknown image_id 'a'", *files)
    truth, detections = coco(tmp_path, [result("north")])
    images = [{"id": name, "width": 640, "height": 480} for name in ("south", "north")]
    box = {"image_id": "south", "category_id": 1, "bbox": [1, 2, 30, 40]}
    truth.write_text(json.dumps(json.loads(truth.read_text()) | {"images": images, "annotations": [box]}))
    labelled = read_pair("day", truth, detections)
    assert labelled.images.names == ("north", "south") and labelled.results.image.tolist() == [0]
    files = coco(tmp_path, [result(11, 0), result(12, 1)])
    hint = "category IDs are off by one: add 1 to those of the detections, with `modsim3d.learn_detector` by "
    hint += "category_offset=1"
    refused(rf"\[0\]: unknown category_id 0 \(known: 1, 2\)\n  {hint}\Z", *files)
    assert read_pair("day", *files, ReadOptions(category_offset=1)).results.label.tolist() == [0, 1]
    refused(r"\[1\]: unknown category_id 7 .*\Z", *coco(tmp_path, [result(11, 1), result(12, 7)]), ReadOptions())


def test_what_was_meant_is_looked_for_in_what_is_shown_and_tracks_twice_in_an_image_refused(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr("modsim3d.formats.reading.coco.nearest", lambda name, known: asked.append(name) or "a hint")
    refused(r"480 more", *coco(tmp_path, [result(f"shot_{k}") for k in range(500)]), ReadOptions())
    assert len(asked) == 20  # among thousands of images each takes a tenth of a second
    monkeypatch.undo()
    twice = [{"image_id": 11, "category_id": 1, "bbox": [1, 2, 30, 40], "track_id": 4}] * 2
    refused(r"annotations\[1\]: identity 4 is in the image 11 already", *coco(tmp_path, [], annotations=twice))
    nobody = [entry | {"track_id": -1} for entry in twice]
    labelled = read_pair("day", *coco(tmp_path, [result(11)], annotations=nobody), ReadOptions())
    assert labelled.annotations.identity.tolist() == [-1, -1]


def test_a_whole_number_is_a_track_however_written_and_frame_numbers_are_no_times_without_a_rate(tmp_path):
    def of_track(**keys):
        box = {"image_id": 11, "category_id": 1, "bbox": [1, 2, 30, 40], **keys}
        return read_truth(coco(tmp_path, [], annotations=[box])[0], ReadOptions())[0]

    for key, value in (("track_id", 4.0), ("instance_id", 4.0), *(("track_id", v) for v in (219012340.0, 219000000))):
        found = of_track(**{key: value})
        assert found.ids.identities == (int(value),) and found.annotations.identity.tolist() == [0]
    whole = r"annotations\[0\]: track_id must be a whole number or a text \(got"
    scientific = r"track_id is a number in scientific notation.*\(got 2.19e\+08\)"
    for track, said in ((2.19e8, scientific), (1.5, whole), (True, whole), ([4], whole)):
        with pytest.raises(InputError, match=said):
            of_track(track_id=track)
    mmsi = [219_012_352 + 16 * k for k in range(5)]
    assert are_rounded(mmsi) and not are_rounded([*mmsi, 219_012_345]) and not are_rounded(mmsi[:3])
    assert not are_rounded([219_000_000 + 2000 * k for k in range(9)])  # as many ships really have
    assert not are_rounded([*range(100), *map(str, mmsi), 10**400])
    (tmp_path / "gt.txt").write_text("1,4,10,20,30,40,1,1,1\n3,4,60,20,30,40,1,1,1\n")
    (tmp_path / "det.txt").write_text("1,-1,10,20,30,40,0.9,-1,-1,-1\n")
    mot, numbered = (tmp_path / "gt.txt", tmp_path / "det.txt"), {"video_id": 3, "frame_id": 5}
    for files, rate_hz, times in (
        (coco(tmp_path, [result(11)], images=numbered), 10, [0.5] * 3),
        (coco(tmp_path, [result(11)], images={"frame_index": 5}), 5, [1] * 3),
        (mot, 4, [0, 0.25, 0.5]),
    ):
        plain = read_pair("day", *files, ReadOptions(image_size_px=(640, 480)))
        assert np.isnan(plain.images.time_s).all() and any("--frame-rate" in note for note in plain.notes)
        timed = read_pair("day", *files, ReadOptions(image_size_px=(640, 480), frame_rate_hz=rate_hz))
        assert timed.images.time_s.tolist() == times and not any("--frame-rate" in note for note in timed.notes)


@pytest.fixture
def ultralytics(tmp_path):
    """A data set as ultralytics lays it out: an image of each size, one of them without labels."""
    for kind in ("images", "labels"):
        (tmp_path / "set" / kind / "val").mkdir(parents=True)
    (tmp_path / "set" / "data.yaml").write_text("nc: 2\nnames: ['kayak', 'ferry']\n")
    for name, size in (("a.jpg", (200, 100)), ("b.png", (400, 300)), ("empty.jpg", (640, 480))):
        Image.new("RGB", size).save(tmp_path / "set" / "images" / "val" / name)
    (tmp_path / "set" / "labels" / "val" / "a.txt").write_text("0 0.5 0.5 0.5 0.5\n")
    (tmp_path / "set" / "labels" / "val" / "b.txt").write_text("1 0.5 0.5 0.5 0.5\n")
    (tmp_path / "predict" / "labels").mkdir(parents=True)
    (tmp_path / "predict" / "labels" / "b.txt").write_text("1 0.5 0.5 0.5 0.5 0.91234\n")
    return tmp_path


def test_yolos_images_say_their_size_without_their_pixels_and_folders_not_meant_are_refused(ultralytics, monkeypatch):
    folders = ultralytics / "set" / "labels" / "val", ultralytics / "predict"
    labelled = read_pair("day", *folders, ReadOptions())
    assert labelled.images.names == ("a", "b", "empty")
    assert labelled.images.sizes_px.tolist() == [[200, 100], [400, 300], [640, 480]]
    assert labelled.labels == ("kayak", "ferry")
    assert labelled.annotations.boxes_px.tolist() == [[50, 25, 150, 75], [100, 75, 300, 225]]
    assert labelled.results.boxes_px.tolist() == [[100, 75, 300, 225]]
    photo = Image.new("RGB", (200, 100))  # one that is to be turned is as large as it is shown
    turned = photo.getexif()
    turned[274] = 6
    photo.save(ultralytics / "set" / "images" / "val" / "a.jpg", exif=turned)
    assert read_pair("day", *folders, ReadOptions()).images.sizes_px[0].tolist() == [100, 200]
    picture = ultralytics / "set" / "images" / "val" / "b.png"
    picture.write_bytes(picture.read_bytes()[:60])
    assert image_size_px(picture) == (400, 300)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100_000)
    assert image_size_px(picture) == (400, 300)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 50_000)
    with pytest.raises(InputError, match=r"image .*b.png:\n.*cannot be read: Image size \(120000 pixels\)"):
        image_size_px(picture)
    monkeypatch.undo()
    labels, predictions = ultralytics / "set" / "labels" / "val", ultralytics / "predict" / "labels"
    refused(r"has no labels itself; those below it have: .*val", ultralytics / "set", predictions, ReadOptions())
    (predictions / "c.txt").write_text("1 0.5 0.5 0.5 0.5 0.9\n")
    refused(r"c.txt: there is no image of this name", labels, predictions, ReadOptions())
    (predictions / "c.txt").unlink()
    (predictions / "b.txt").write_text("1 0.5 0.5 0.5 0.5\n")
    refused(r"b.txt line 1: has 5 numbers, must have 6.*\n.*save_conf=True", labels, predictions, ReadOptions())
    (predictions / "b.txt").unlink()
    assert len(read_pair("day", labels, predictions, ReadOptions()).results) == 0  # nothing was detected
    (ultralytics / "set" / "images" / "val" / "a.jpg").write_bytes(b"no image")
    refused(r"image .*a.jpg:\n.*cannot be read", labels, predictions, ReadOptions())
    refused(r"has no labels: no .txt file", ultralytics / "set" / "images" / "val", predictions, ReadOptions())
