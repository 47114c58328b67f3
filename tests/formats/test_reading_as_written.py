"""Files as ultralytics, detectron2, Roboflow and the MOT challenge really write them."""

import json

import numpy as np
import pytest
from PIL import Image

from modsim3d.core.errors import InputError
from modsim3d.formats.reading.builder import ReadOptions
from modsim3d.formats.reading.pair import read_pair, read_truth
from modsim3d.formats.reading.yolo import image_size_px
from modsim3d.io.misreadings import are_rounded
from tests.formats.labelled_files import refused

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
def yolo(tmp_path):
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


def test_yolos_images_say_how_large_they_are_without_their_pixels_and_folders_not_meant_are_refused(yolo, monkeypatch):
    folders = yolo / "set" / "labels" / "val", yolo / "predict"
    labelled = read_pair("day", *folders, ReadOptions())
    assert labelled.images.names == ("a", "b", "empty")
    assert labelled.images.sizes_px.tolist() == [[200, 100], [400, 300], [640, 480]]
    assert labelled.labels == ("kayak", "ferry")
    assert labelled.annotations.boxes_px.tolist() == [[50, 25, 150, 75], [100, 75, 300, 225]]
    assert labelled.results.boxes_px.tolist() == [[100, 75, 300, 225]]
    photo = Image.new("RGB", (200, 100))  # one that is to be turned is as large as it is shown
    turned = photo.getexif()
    turned[274] = 6
    photo.save(yolo / "set" / "images" / "val" / "a.jpg", exif=turned)
    assert read_pair("day", *folders, ReadOptions()).images.sizes_px[0].tolist() == [100, 200]
    picture = yolo / "set" / "images" / "val" / "b.png"
    picture.write_bytes(picture.read_bytes()[:60])
    assert image_size_px(picture) == (400, 300)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100_000)
    assert image_size_px(picture) == (400, 300)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 50_000)
    with pytest.raises(InputError, match=r"image .*b.png:\n.*cannot be read: Image size \(120000 pixels\)"):
        image_size_px(picture)
    monkeypatch.undo()
    labels, predictions = yolo / "set" / "labels" / "val", yolo / "predict" / "labels"
    refused(r"has no labels itself; those below it have: .*val", yolo / "set", predictions, ReadOptions())
    (predictions / "c.txt").write_text("1 0.5 0.5 0.5 0.5 0.9\n")
    refused(r"c.txt: there is no image of this name", labels, predictions, ReadOptions())
    (predictions / "c.txt").unlink()
    (predictions / "b.txt").write_text("1 0.5 0.5 0.5 0.5\n")
    refused(r"b.txt line 1: has 5 numbers, must have 6.*\n.*save_conf=True", labels, predictions, ReadOptions())
    (predictions / "b.txt").unlink()
    assert len(read_pair("day", labels, predictions, ReadOptions()).results) == 0  # nothing was detected
    (yolo / "set" / "images" / "val" / "a.jpg").write_bytes(b"no image")
    refused(r"image .*a.jpg:\n.*cannot be read", labels, predictions, ReadOptions())
    refused(r"has no labels: no .txt file", yolo / "set" / "images" / "val", predictions, ReadOptions())
