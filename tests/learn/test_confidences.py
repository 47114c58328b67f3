"""Detections whose boxes or confidences are meant otherwise than they are read, that match nothing or have none."""

import json
from pathlib import Path

import numpy as np
import pytest

import modsim3d
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.detector.file.reading import load_detector
from modsim3d.formats.matching import Rule, match
from modsim3d.formats.reading.builder import ReadOptions
from modsim3d.formats.reading.pair import read_pair
from modsim3d.learn.learning import learn_detector
from modsim3d.learn.simulated_results import simulated
from tests.formats.labelled_sets import found, images, truth
from tests.learn import round_trip
from tests.learn.one_state import of_boats

FRAMES = 60


@pytest.fixture(scope="module")
def mot(tmp_path_factory):
    """A folder with `gt.txt` of two boats, and a function that writes detections with given confidences to it."""
    folder, rng = tmp_path_factory.mktemp("mot"), np.random.default_rng(5)
    boats, frame = np.array([[100.0, 100, 60, 50], [300.0, 200, 80, 60]]), np.repeat(np.arange(1, FRAMES + 1), 2)
    boxes = np.tile(boats, (FRAMES, 1))
    seen = rng.random(len(boxes)) < 0.8
    moved = boxes + rng.normal(0, 2, boxes.shape)
    (folder / "gt.txt").write_text(_lines(frame, np.tile([1, 2], FRAMES), boxes, np.ones(len(boxes))))
    (folder / "seqinfo.ini").write_text("[Sequence]\nimWidth=640\nimHeight=480\nframeRate=10\n")

    def write(name: str, confidence) -> Path:
        path = folder / f"{name}.txt"
        count = int(seen.sum())
        path.write_text(_lines(frame[seen], np.full(count, -1), moved[seen], np.broadcast_to(confidence, count)))
        return path

    return folder / "gt.txt", write


def _lines(frame, identity, boxes, last) -> str:
    rows = zip(frame, identity, boxes, last, strict=True)
    return "".join(f"{f},{i},{','.join(f'{x:.3f}' for x in box)},{c:g},-1,-1,-1\n" for f, i, box, c in rows)


def command(truth: Path, detections: Path, folder: Path, *parts):
    words = ("learn", "--truth", truth, "--detections", detections, "--out", folder / "d.yaml", "--replicates", 20)
    return round_trip.command(*words, *parts, "--overwrite")


def test_detections_without_confidences_give_all_but_what_needs_them(mot, tmp_path):
    gt, write = mot
    result = command(gt, write("none", -1), tmp_path)
    assert result.exit_code == 0
    text, page = (tmp_path / "d.yaml").read_text(), (tmp_path / "d.html").read_text()
    for each in (result.output, text, page):
        assert "the detections have no confidences (-1): all of them count, average precision" in each
        assert "confidence: 1 for every detection" in each
    assert "optimal assignment, without confidences" in result.output and "cross-entropy" not in result.output
    assert "What average precision is lost to" not in page and "Precision against recall" not in page
    model = load_detector(tmp_path / "d.yaml")
    assert model.confidence_threshold == 0
    labelled = read_pair("usual", gt, gt.parent / "none.txt")
    again = simulated(labelled, np.zeros(len(labelled.images), dtype=np.int64), model, seed=1)
    assert len(again.results) > 50 and set(again.results.confidence.tolist()) == {1.0}


def test_options_that_need_confidences_say_so_and_json_that_there_is_no_average_precision(mot, tmp_path):
    gt, write = mot
    for options, problem in (
        (("--match", "confidence"), "needs confidences, and the detections have none .-1.: give --match optimal"),
        (("--confidence", "0.5"), "--confidence 0.5 needs confidences"),
        (("--confidence-scale", "-2,5"), "--confidence-scale: every confidence is -1, which means not given"),
    ):
        with pytest.raises(ModsimError, match=problem):
            command(gt, write("none", -1), tmp_path, *options)
    said = json.loads(command(gt, write("none", -1), tmp_path, "--json").stdout)
    assert said["lost_average_precision"] is None and said["states"][0]["average_precision"] is None
    assert said["states"][0]["recall"]["value"] == pytest.approx(0.8, abs=0.15)


def test_confidences_of_some_detections_alone_are_refused(mot, tmp_path):
    gt, write = mot
    some = np.full(len(write("all", 0.7).read_text().splitlines()), 0.7)
    some[[3, 8]] = -1
    with pytest.raises(InputError) as error:
        command(gt, write("some", some), tmp_path)
    assert list(error.value.problems) == [
        f"some.txt line {line}: has no confidence (-1), but some.txt line 1 has 0.7: give one everywhere, or nowhere"
        for line in (4, 9)
    ]
    assert "2 entries left out" in command(gt, gt.parent / "some.txt", tmp_path, "--skip-bad").output
    pairs = {"truth": [gt, gt], "detections": [write("none", -1), write("all", 0.7)], "conditions": ["fog", "day"]}
    with pytest.raises(ModsimError, match=r"the detections of fog have no confidences \(-1\), and those of day do"):
        learn_detector(**pairs)


@pytest.mark.parametrize(
    ("low", "high", "example"), [(-1.871, 3.249, "-1.88,3.25"), (5.0, 98.0, "0,100")], ids=["DPM", "percent"]
)
def test_a_range_that_is_not_from_0_to_1_is_named_with_the_option_that_maps_it(low, high, example, mot, tmp_path):
    gt, write = mot
    scores = np.linspace(high, low, len(write("all", 0.7).read_text().splitlines()))
    scores[scores.size // 2] = -1 if low < -1 else scores[scores.size // 2]  # on such a scale −1 is a confidence
    path = write("other", scores)
    with pytest.raises(InputError, match=f"confidences are from {low:g} to {high:g} here: .* {example}$"):
        command(gt, path, tmp_path)
    result = command(gt, path, tmp_path, "--confidence-scale", example)
    ends = [float(part) for part in example.split(",")]
    for said in (result.output, (tmp_path / "d.yaml").read_text()):
        assert f"confidences from {ends[0]:g} to {ends[1]:g} were mapped onto 0 to 1" in said
    labelled = read_pair("usual", gt, path, ReadOptions(confidence_scale=tuple(ends)))
    expected = (np.round(scores, 5) - ends[0]) / (ends[1] - ends[0])
    np.testing.assert_allclose(labelled.results.confidence, expected, atol=1e-5)


def test_a_scale_that_is_none_is_refused(mot, tmp_path):
    gt, write = mot
    for text in ("5", "3,2", "1,1", "a,b", "0,inf"):
        with pytest.raises(InputError, match="must be LOW,HIGH, two numbers that rise, as 0,100"):
            command(gt, write("all", 0.7), tmp_path, "--confidence-scale", text)
    with pytest.raises(InputError, match="confidence_scale: must be two numbers that rise"):
        learn_detector(truth=gt, detections=write("all", 0.7), confidence_scale=(3.0, 2.0))


def test_without_confidences_the_nearest_centres_match_first():
    boxes = [[100.0, 100, 160, 160], [130.0, 100, 190, 160]]
    first = [[120.0, 100, 180, 160], [131.0, 100, 191, 160]]  # the first is nearer to the second boat too
    seen = found([0, 0], [0, 0], first, [np.nan, np.nan])
    labelled = of_boats(images(1), truth([0, 0], [0, 0], boxes), seen)
    assert match(labelled, Rule("centre"), 0.5).annotation.tolist() == [0, 1]


WIDTH, HEIGHT = 1920, 1080


def write_sets(folder, box, seed=0, shift_px=0.0, images=60, noise_px=2.0, stray=4):
    """COCO: two vessels in each image, detected, with as many less confident false detections as asked for."""
    rng = np.random.default_rng(seed)
    centre = np.array([[600, 400], [1200, 500]]) + np.cumsum(rng.normal(0, 6, (images, 2, 2)), axis=0)
    true = np.concatenate([centre - [30, 12], np.broadcast_to([60.0, 24.0], centre.shape)], axis=2)
    detected = true + rng.normal(0, noise_px, true.shape) + [shift_px, shift_px, 0, 0]
    false = np.concatenate([rng.uniform(0, 900, (images, stray, 2)), rng.uniform(10, 90, (images, stray, 2))], axis=2)
    entry = {"category_id": 1, "iscrowd": 0}
    truth = {
        "images": [{"id": k, "width": WIDTH, "height": HEIGHT, "file_name": f"{k}.jpg"} for k in range(images)],
        "categories": [{"id": 1, "name": "boat"}],
        "annotations": [
            {"id": n, "image_id": n // 2, "bbox": true[n // 2, n % 2].tolist(), **entry} for n in range(2 * images)
        ],
    }
    results = [
        {"image_id": k, "category_id": 1, "bbox": [float(n) for n in box(*each)], "score": score}
        for k in range(images)
        for each, score in [*((b, 0.9) for b in detected[k]), *((b, 0.3) for b in false[k])]
    ]
    folder.mkdir(exist_ok=True)
    (folder / "gt.json").write_text(json.dumps(truth))
    (folder / "dt.json").write_text(json.dumps(results))
    return folder / "gt.json", folder / "dt.json"


WRONG = {
    "corners": (lambda x, y, w, h: (x, y, x + w, y + h), "but are the corners x_min, y_min, x_max, y_max"),
    "centres": (lambda x, y, w, h: (x + w / 2, y + h / 2, w, h), "but are centre x, centre y, width, height"),
    "shares": (lambda x, y, w, h: (x / WIDTH, y / HEIGHT, w / WIDTH, h / HEIGHT), "the boxes are shares of the image"),
    "scaled": (lambda x, y, w, h: (x / 3, y / 3, w / 3, h / 3), "are those of an image of 640 x 360 px"),
    "exchanged": (lambda x, y, w, h: (y, x, h, w), "x and y of the boxes are exchanged"),
    "from below": (lambda x, y, w, h: (x, HEIGHT - y - h, w, h), "y is counted from the lower edge of the image"),
}


@pytest.mark.parametrize(("box", "what"), WRONG.values(), ids=WRONG)
def test_boxes_in_another_form_are_named_and_nothing_is_written(tmp_path, box, what):
    truth, detections = write_sets(tmp_path, box)
    for learn in (command, lambda truth, detections, _: modsim3d.learn_detector(truth=truth, detections=detections)):
        with pytest.raises(ModsimError) as error:
            learn(truth, detections, tmp_path)
        assert f"detections {detections}:" in str(error.value) and what in str(error.value)
    assert not (tmp_path / "d.yaml").exists()


def test_right_boxes_are_read_as_they_are_and_a_pixel_off_is_remarked_where_that_is_clear(tmp_path):
    def notes(**keys):  # a real detector may have such a bias, which is learned
        return read_pair("day", *write_sets(tmp_path, lambda *box: box, **keys)).notes

    assert [notes(seed=seed) for seed in range(3)] == [()] * 3
    (note,) = notes(shift_px=1.0, noise_px=0.3)
    assert "pixels are counted from 1, must be counted from 0" in note and "such a bias" in note
    assert notes(shift_px=1.0, noise_px=5.0) == ()


def test_mot_pixels_from_zero_and_yolo_corners_are_named(tmp_path):
    rng = np.random.default_rng(1)
    corner = np.cumsum(rng.normal(0, 8, (60, 2)), axis=0) + 300
    options = ReadOptions(image_size_px=(WIDTH, HEIGHT), labels=("boat",))

    def lines(first_px, first_frame, tail):
        rows = (f"{k + first_frame},%d,{x + first_px},{y + first_px},60,24,{tail}" for k, (x, y) in enumerate(corner))
        return "".join(f"{row}\n" for row in rows)

    (tmp_path / "gt.txt").write_text(lines(1, 1, "1,1,1") % ((7,) * 60))
    (tmp_path / "det.txt").write_text(lines(0, 1, "0.9,-1,-1,-1") % ((-1,) * 60))
    notes = read_pair("day", tmp_path / "gt.txt", tmp_path / "det.txt", options).notes
    assert any("pixels are counted from 0, must be counted from 1" in note for note in notes)
    (tmp_path / "det.txt").write_text(lines(1, 2, "0.9,-1,-1,-1") % ((-1,) * 60))
    with pytest.raises(ModsimError, match="frames are one too high"):
        read_pair("day", tmp_path / "gt.txt", tmp_path / "det.txt", options)
    for name in ("set/labels", "found"):
        (tmp_path / name).mkdir(parents=True)
    for k, (x, y) in enumerate(corner):
        box = np.array([x / WIDTH, y / HEIGHT, (x + 60) / WIDTH, (y + 24) / HEIGHT])
        true = [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2, 60 / WIDTH, 24 / HEIGHT]
        (tmp_path / f"set/labels/{k}.txt").write_text(f"0 {' '.join(map(str, true))}\n")
        (tmp_path / f"found/{k}.txt").write_text(f"0 {' '.join(map(str, box))} 0.9\n")
    with pytest.raises(ModsimError, match="are read as centre x, centre y, width, height, but are the corners"):
        read_pair("day", tmp_path / "set", tmp_path / "found", options)


@pytest.mark.parametrize(("shift", "what"), [(1, "frames are one too high"), (-1, "frames are one too low")])
def test_frames_of_noisy_detections_one_off_are_named(tmp_path, shift, what):
    rng = np.random.default_rng(1)
    corner = np.cumsum(rng.normal(0, 12, (60, 2)), axis=0) + 400
    found = corner + rng.normal(0, 2.5, corner.shape)
    options = ReadOptions(image_size_px=(WIDTH, HEIGHT), labels=("boat",))
    (tmp_path / "gt.txt").write_text("".join(f"{k + 2},7,{x},{y},60,24,1,1,1\n" for k, (x, y) in enumerate(corner)))
    lines = (f"{k + 2 + shift},-1,{x},{y},60,24,0.9,-1,-1,-1\n" for k, (x, y) in enumerate(found))
    (tmp_path / "det.txt").write_text("".join(lines))
    with pytest.raises(ModsimError, match=what if shift > 0 else "frames count from 0"):
        read_pair("day", tmp_path / "gt.txt", tmp_path / "det.txt", options)


def test_detections_of_which_none_matches_are_refused(tmp_path):
    rng = np.random.default_rng(4)
    away = write_sets(tmp_path, lambda x, y, w, h: (*rng.uniform(0, 300, 2), 9, 9), stray=0)
    with pytest.raises(ModsimError, match="none of 120 detections matches any of 120 annotations"):
        modsim3d.learn_detector(truth=away[0], detections=away[1], replicates=20)
    with pytest.raises(ModsimError, match=r"none of 360 detections .* 0 of them have a confidence of at least 0.95"):
        files = write_sets(tmp_path, lambda *box: box)
        modsim3d.learn_detector(truth=files[0], detections=files[1], confidence=0.95, replicates=20)
