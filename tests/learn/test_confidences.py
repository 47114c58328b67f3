"""Detections whose boxes or confidences are meant otherwise than they are read, that match nothing or have none."""

import json
from pathlib import Path

import numpy as np
import pytest

from modsim3d import InputError, ModsimError, learn_detector, load_detector
from modsim3d.formats.matching import Rule, match
from modsim3d.formats.reading.builder import ReadOptions
from modsim3d.formats.reading.pair import read_pair
from modsim3d.formats.writing.coco import write_coco
from modsim3d.learn.self_check import simulated
from tests.formats.labelled_files import found, images, truth
from tests.learn import round_trip
from tests.learn.one_state import of_boats

FRAMES = 60


@pytest.fixture(scope="module")
def mot(tmp_path_factory):
    """A function that writes detections with given confidences beside the `gt.txt` of two boats."""
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

    return write


def _lines(frame, identity, boxes, last) -> str:
    rows = zip(frame, identity, boxes, last, strict=True)
    return "".join(f"{f},{i},{','.join(f'{x:.3f}' for x in box)},{c:g},-1,-1,-1\n" for f, i, box, c in rows)


def command(detections: Path, folder: Path, *parts):
    """The command on detections, with the truth that lies beside them."""
    words = ("learn", "--truth", detections.with_stem("gt"), "--detections", detections, "--out", folder / "d.yaml")
    return round_trip.command(*words, "--replicates", 20, "--no-check", *parts, "--overwrite")


def test_detections_without_confidences_give_all_but_what_needs_them(mot, tmp_path):
    path = mot("none", -1)
    result = command(path, tmp_path)
    assert result.exit_code == 0
    text, page = (tmp_path / "d.yaml").read_text(), (tmp_path / "d.html").read_text()
    for each in (result.output, text, page):
        assert "the detections have no confidences (-1): all of them count, average precision" in each
        assert "confidence: 1 for every detection" in each
    assert "optimal assignment, without confidences" in result.output and "cross-entropy" not in result.output
    assert "What average precision is lost to" not in page and "Precision against recall" not in page
    model = load_detector(tmp_path / "d.yaml")
    assert model.confidence_threshold == 0
    labelled = read_pair("usual", path.with_stem("gt"), path)
    again = simulated(labelled, np.zeros(len(labelled.images), dtype=np.int64), model, seed=1)
    assert len(again.results) > 50 and set(again.results.confidence.tolist()) == {1.0}
    said = json.loads(command(path, tmp_path, "--json").stdout)
    assert said["lost_average_precision"] is None and said["states"][0]["average_precision"] is None
    assert said["states"][0]["recall"]["value"] == pytest.approx(0.8, abs=0.15)
    # The nearest centres match first.
    boxes = [[100.0, 100, 160, 160], [130.0, 100, 190, 160]]
    first = [[120.0, 100, 180, 160], [131.0, 100, 191, 160]]  # the first is nearer to the second boat too
    labelled = of_boats(images(1), truth([0, 0], [0, 0], boxes), found([0, 0], [0, 0], first, [np.nan, np.nan]))
    assert match(labelled, Rule("centre"), 0.5).annotation.tolist() == [0, 1]


def test_options_that_need_confidences_and_scales_that_are_none_are_refused(mot, tmp_path):
    none, given = mot("none", -1), mot("all", 0.7)
    scales = ((given, "--confidence-scale", text, "must be LOW,HIGH, two numbers that rise, as 0,100")
              for text in ("5", "3,2", "1,1", "a,b", "0,inf"))  # fmt: skip
    for path, option, value, problem in (
        (none, "--match", "confidence", "needs confidences, and the detections have none .-1.: give --match optimal"),
        (none, "--confidence", "0.5", "--confidence 0.5 needs confidences"),
        (none, "--confidence-scale", "-2,5", "--confidence-scale: every confidence is -1, which means not given"),
        *scales,
    ):
        with pytest.raises(ModsimError, match=problem):
            command(path, tmp_path, option, value)
    with pytest.raises(InputError, match="confidence_scale: must be two numbers that rise"):
        learn_detector(truth=given.with_stem("gt"), detections=given, confidence_scale=(3.0, 2.0))


def test_confidences_of_some_detections_alone_are_refused(mot, tmp_path):
    every = mot("all", 0.7)
    some = np.full(len(every.read_text().splitlines()), 0.7)
    some[[3, 8]] = -1
    path = mot("some", some)
    with pytest.raises(InputError) as error:
        command(path, tmp_path)
    assert list(error.value.problems) == [
        f"some.txt line {line}: has no confidence (-1), but some.txt line 1 has 0.7: give one everywhere, or nowhere"
        for line in (4, 9)
    ]
    assert "2 entries left out" in command(path, tmp_path, "--skip-bad").output
    pairs = {"truth": [path.with_stem("gt")] * 2, "detections": [mot("none", -1), every], "conditions": ["fog", "day"]}
    with pytest.raises(ModsimError, match=r"the detections of fog have no confidences \(-1\), and those of day do"):
        learn_detector(**pairs)


@pytest.mark.parametrize(("low", "high", "example"), [(-1.871, 3.249, "-1.88,3.25"), (5.0, 98.0, "0,100")])
def test_a_range_that_is_not_from_0_to_1_is_named_with_the_option_that_maps_it(low, high, example, mot, tmp_path):
    scores = np.linspace(high, low, len(mot("all", 0.7).read_text().splitlines()))
    scores[scores.size // 2] = -1 if low < -1 else scores[scores.size // 2]  # on such a scale −1 is a confidence
    path = mot("other", scores)
    with pytest.raises(InputError, match=f"confidences are from {low:g} to {high:g} here: .* {example}$"):
        command(path, tmp_path)
    result = command(path, tmp_path, "--confidence-scale", example)
    ends = [float(part) for part in example.split(",")]
    for said in (result.output, (tmp_path / "d.yaml").read_text()):
        assert f"confidences from {ends[0]:g} to {ends[1]:g} were mapped onto 0 to 1" in said
    labelled = read_pair("usual", path.with_stem("gt"), path, ReadOptions(confidence_scale=tuple(ends)))
    expected = (np.round(scores, 5) - ends[0]) / (ends[1] - ends[0])
    np.testing.assert_allclose(labelled.results.confidence, expected, atol=1e-5)


WIDTH, HEIGHT = 1920, 1080


def write_sets(folder, box, seed=0, shift_px=0.0, noise_px=2.0, stray=4):
    """COCO: two vessels in each image, detected, with as many less confident false detections as asked for."""
    rng, image = np.random.default_rng(seed), np.repeat(np.arange(FRAMES), 2)
    corner = np.array([[570, 388], [1170, 488]]) + np.cumsum(rng.normal(0, 6, (FRAMES, 2, 2)), axis=0)
    true = np.concatenate([corner, corner + np.array([60, 24])], axis=2).reshape(-1, 4)
    low = rng.uniform(0, 900, (stray * FRAMES, 2))
    false = np.hstack([low, low + rng.uniform(10, 90, low.shape)])
    seen = np.concatenate([true + rng.normal(0, noise_px, true.shape) + shift_px, false])
    of, score = np.r_[image, np.repeat(np.arange(FRAMES), stray)], np.repeat([0.9, 0.3], [len(true), len(false)])
    shots, annotations = images(FRAMES, (float(WIDTH), float(HEIGHT))), truth(image, 0 * image, true)
    files = write_coco(of_boats(shots, annotations, found(of, 0 * of, seen, score)), folder)
    rows = [row | {"bbox": [float(n) for n in box(*row["bbox"])]} for row in json.loads(files[1].read_text())]
    files[1].write_text(json.dumps(rows))
    return files


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
    for learn in (lambda: command(detections, tmp_path), lambda: learn_detector(truth=truth, detections=detections)):
        with pytest.raises(ModsimError) as error:
            learn()
        assert f"detections {detections}:" in str(error.value) and what in str(error.value)
    assert not (tmp_path / "d.yaml").exists()


def test_right_boxes_are_read_as_they_are_and_a_pixel_off_is_remarked_where_that_is_clear(tmp_path):
    def notes(**keys):  # a real detector may have such a bias, which is learned
        return read_pair("day", *write_sets(tmp_path, lambda *box: box, **keys)).notes

    assert [notes(seed=seed) for seed in range(3)] == [()] * 3
    (note,) = notes(shift_px=1.0, noise_px=0.3)
    assert "pixels are counted from 1, must be counted from 0" in note and "such a bias" in note
    assert notes(shift_px=1.0, noise_px=5.0) == ()


SEQUENCE = ReadOptions(image_size_px=(WIDTH, HEIGHT), labels=("boat",))


def test_mot_pixels_from_zero_and_frames_that_are_one_off_are_named(tmp_path):
    rng = np.random.default_rng(1)
    corner = np.cumsum(rng.normal(0, 12, (60, 2)), axis=0) + 400

    def pair(shift_px, late, noise_px):
        seen = corner + shift_px + rng.normal(0, noise_px, corner.shape)
        files = {"gt": (corner, 2, 7, "1,1,1"), "det": (seen, 2 + late, -1, "0.9,-1,-1,-1")}
        for name, (places, first, identity, last) in files.items():
            rows = (f"{k + first},{identity},{x},{y},60,24,{last}\n" for k, (x, y) in enumerate(places))
            (tmp_path / f"{name}.txt").write_text("".join(rows))
        return read_pair("day", tmp_path / "gt.txt", tmp_path / "det.txt", SEQUENCE)

    assert any("pixels are counted from 0, must be counted from 1" in note for note in pair(-1, 0, 0).notes)
    for late, noise_px in ((1, 0), (1, 2.5), (-1, 2.5)):
        said = "frames are one too high" if late > 0 else "frames count from 0"
        with pytest.raises(ModsimError, match=said):
            pair(0, late, noise_px)


def test_corners_in_yolo_are_named(tmp_path):
    for name in ("set/labels", "found"):
        (tmp_path / name).mkdir(parents=True)
    corner = np.cumsum(np.random.default_rng(1).normal(0, 8, (60, 2)), axis=0) + 300
    size = np.array([WIDTH, HEIGHT])
    for k, place in enumerate(corner):
        low, high = place / size, (place + np.array([60, 24])) / size
        true = [*(low + high) / 2, 60 / WIDTH, 24 / HEIGHT]
        (tmp_path / f"set/labels/{k}.txt").write_text(f"0 {' '.join(map(str, true))}\n")
        (tmp_path / f"found/{k}.txt").write_text(f"0 {' '.join(map(str, [*low, *high]))} 0.9\n")
    with pytest.raises(ModsimError, match="are read as centre x, centre y, width, height, but are the corners"):
        read_pair("day", tmp_path / "set", tmp_path / "found", SEQUENCE)


def test_detections_of_which_none_matches_are_refused(tmp_path):
    rng = np.random.default_rng(4)
    _, away = write_sets(tmp_path / "away", lambda x, y, w, h: (*rng.uniform(0, 300, 2), 9, 9), stray=0)
    _, right = write_sets(tmp_path / "right", lambda *box: box)
    for path, confidence, said in (
        (away, 0.2, "none of 120 detections matches any of 120 annotations"),
        (right, 0.95, r"none of 360 detections .* 0 of them have a confidence of at least 0.95"),
    ):
        with pytest.raises(ModsimError, match=said):
            command(path, tmp_path, "--confidence", confidence)
    assert not (tmp_path / "d.yaml").exists()
