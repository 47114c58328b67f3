"""Detections without confidences, and with confidences on another scale."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

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
    some = np.full(_detections(write), 0.7)
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


def _detections(write) -> int:
    return len(write("all", 0.7).read_text().splitlines())


@pytest.mark.parametrize(
    ("low", "high", "example"), [(-1.871, 3.249, "-1.88,3.25"), (5.0, 98.0, "0,100")], ids=["DPM", "percent"]
)
def test_a_range_that_is_not_from_0_to_1_is_named_with_the_option_that_maps_it(low, high, example, mot, tmp_path):
    gt, write = mot
    scores = np.linspace(high, low, _detections(write))
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
