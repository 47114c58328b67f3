"""A labelled video that a detector cannot work on, and options that do not fit, get one clear error."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from modsim3d.core.errors import ModsimError
from modsim3d.formats.labelled_video import targets
from modsim3d.formats.labelled_video.detect_truth import detect_truth
from modsim3d.runs.run import run_scene
from modsim3d.scene.reading import load_scene
from tests.cli.bad_input.builders import Call, places, refusal
from tests.cli.bad_input.test_bad_labelled_sets import TRUTH, WRONG, changed
from tests.detector_variants import variant

LINE = "1,3,10,20,30,40,1,1,0.5\n"
TWO = LINE + "2,4,10,20,30,40,1,2,1\n"
SIZE, RATE, THESIS = ("--image-size", "640,480"), ("--frame-rate", "10"), ("--detector", "thesis")
KNOWN = (*SIZE, *RATE, *THESIS)
Refuse = Callable[..., str]


@pytest.fixture
def refuse(call: Call, tmp_path: Path) -> Refuse:
    """A function that asserts that `detect --truth` refuses a file with some parts in a short message."""

    def look(truth: str | dict[str, Any] | Path, options: tuple[object, ...], *parts: str) -> str:
        path = truth if isinstance(truth, Path) else tmp_path / ("gt.txt" if isinstance(truth, str) else "gt.json")
        if not isinstance(truth, Path):
            path.write_text(truth if isinstance(truth, str) else json.dumps(truth))
        said = refusal(call, ("detect", "--truth", path, "--out", tmp_path / "out" / "new", *options), *parts)
        assert len(said) < 3000
        assert not (tmp_path / "out").exists()
        return said

    return look


MOT: dict[str, tuple[str, tuple[object, ...], str]] = {
    "no size": (LINE, (*RATE, *THESIS), "the size of the images is not known: give --image-size"),
    "no rate": (LINE, (*SIZE, *THESIS), "images have no time, the first is 'gt frame 1': give --frame-rate HZ"),
    "no rate above 0": (LINE, (*SIZE, *THESIS, "--frame-rate", 0), "--frame-rate:\n  must be above 0"),
    "half pixels": (LINE, (*RATE, *THESIS, "--image-size", "640.5,480"), "must be whole pixels, at most 100,000"),
    "huge images": (LINE, (*RATE, *THESIS, "--image-size", "640,1e6"), "must be whole pixels, at most 100,000"),
    "no frames": ("", KNOWN, "there are no images, nor does a seqLength in seqinfo.ini say how many"),
    "no track": (LINE.replace(",3,", ",-1,"), KNOWN, "1 of 1 boxes have no track, the first is in image 'gt frame 1'"),
    "a track twice": (LINE * 2, KNOWN, "gt.txt line 2: identity 3 is in frame 1 already"),
    "detections": ("1,-1,10,20,30,40,0.9\n", KNOWN, "have no track"),
    "some classes": (LINE + "2,3,10,20,30,40,1,-1,1\n", KNOWN, "line 2: has no class in its eighth column, but other"),
    "unknown classes": (TWO, KNOWN, "class 2 is not one of the detector's labels (known: Vessel)\n  give --labels A,B"),
    "how to name them": (TWO, KNOWN, "a label of the detector for each class from 1 to 2; - for one that is not to be"),
    "too few labels": (TWO, (*KNOWN, "--labels", "Vessel"), "--labels:\n  does not say what class 2 is"),
    "a label like one": (LINE, (*KNOWN, "--labels", "Vesel"), "'Vesel' is not one of the detector's labels (did you"),
    "a place without a label": (LINE, (*KNOWN, "--labels", "Vessel,,Vessel"), "'' is not one of the detector's labels"),
    "no detector": (LINE, (*SIZE, *RATE), "--detector:\n  is missing: give a detector file, or --state NAME --from"),
    "two detectors": (LINE, (*KNOWN, "--state", "foggy_cloudy", "--from", "conditions"), "so is --detector"),
    "no such state": (LINE, (*KNOWN, "--state", "goood"), "unknown state 'goood'"),
    "no such condition": (LINE, (*SIZE, *RATE, "--state", "x", "--from", "conditions"), "there is no 'x'"),
    "a key of no scene": (LINE, (*KNOWN, "--set", "waves.level=large"), "there is no scene: set keys below detector"),
    "a whole detector": (LINE, (*KNOWN, "--set", "detector=rich"), "there is no scene: set keys below detector"),
    "no such key": (LINE, (*KNOWN, "--set", "detector.gats=1"), "unknown key detector.gats (did you mean"),
    "a wrong value": (LINE, (*KNOWN, "--set", "detector.gates.min_box_px=-1"), "--set detector.gates.min_box_px: "),
    "a horizon of words": (LINE, (*KNOWN, "--horizon", "sea"), "--horizon:\n  must be ROW, or X1,Y1,X2,Y2, in pixels"),
    "half a horizon": (LINE, (*KNOWN, "--horizon", "1,2"), "or X1,Y1,X2,Y2, in pixels, as 400 (got '1, 2')"),
    "an endless horizon": (LINE, (*KNOWN, "--horizon", "inf"), "must be ROW, or X1,Y1,X2,Y2"),
    "a horizon far away": (LINE, (*KNOWN, "--horizon", "1e9"), "400 (got '1e+09'); no farther than 10,000,000"),
    "an upright horizon": (LINE, (*KNOWN, "--horizon", "9,1,9,2"), "is upright: give two points in different columns"),
    "no sea": (LINE, (*KNOWN, "--horizon", "480"), "lies below images of 640 × 480 px: they would show no sea"),
    "workers": (LINE, (*KNOWN, "--workers", 2), "--workers is for RUN"),
}


def test_a_mot_sequence_that_cannot_be_worked_on_is_refused(refuse):
    for truth, options, part in MOT.values():
        refuse(truth, options, part)


TWICE = {**TRUTH, "images": [TRUTH["images"][0], {**TRUTH["images"][0], "id": 2, "time_s": 0.6}]}
ALIKE = changed(changed(TWICE, ("images", 0, "sequence"), "a/b"), ("images", 1, "sequence"), "A_B")
SAME_TIME = "images 'a.png' and 'a.png' have the same time, 0.5 s: if they are of different videos, name these in seque"


LABEL = ("--labels", "Vessel", *THESIS)
COCO: dict[str, tuple[Any, tuple[object, ...], str]] = {
    "other labels": (TWICE, THESIS, "labels:\n  category 'boat' is not one of the detector's labels (known: Vessel)\n"),
    "how to name them": (TWICE, THESIS, "A,B,... with a label of the detector in the order of the file (boat); - for"),
    "too many labels": (TWICE, ("--labels", "Vessel,-", *THESIS), "names 2 categories, and the file has 1"),
    "equal times": (changed(TWICE, ("images", 1, "time_s"), 0.5), LABEL, SAME_TIME),
    "no time": (changed(TWICE, ("images", 1, "time_s"), None), LABEL, "1 of 2 images have no time"),
    "two sizes": (changed(TWICE, ("images", 1, "width"), 320), LABEL, "images are 640 × 480 and 320 × 480 px"),
    "no track": (changed(TWICE, ("annotations", 0, "track_id"), None), LABEL, "each needs a track_id in COCO"),
    "names alike": (ALIKE, LABEL, "sequences 'a/b' and 'A_B' would have files of one name: rename one of them"),
    "results": ([], LABEL, "a list: is it the results file?"),
}


def test_a_coco_file_that_cannot_be_worked_on_is_refused(refuse, tmp_path):
    for truth, options, part in COCO.values():
        (tmp_path / "gt.json").write_text(json.dumps(truth))
        refuse(tmp_path / "gt.json", options, part)


NEEDS: dict[str, tuple[str, str]] = {
    "gates": (
        "gates.max_range_m: needs the distance of every vessel, which 1 of 1 boxes",
        "detector.gates.max_range_m",
    ),
    "dropout by a table of distance": ("dropout.distance_m: needs the distance", "detector.dropout.model=confusion"),
    "band": ("false_positives.placement: horizon_band needs the horizon: give --horizon", "placement=uniform"),
    "far": ("false_positives.far_half_px: needs the horizon: give --horizon ROW", "false_positives.far_half_px=null"),
}


@pytest.mark.parametrize(("name", "parts"), NEEDS.items(), ids=NEEDS)
def test_what_a_detector_needs_is_asked_for_by_its_key_and_left_out_as_it_says(refuse, call, tmp_path, name, parts):
    false = {"band": {"placement": "horizon_band", "band_px": 50}, "far": {"far_half_px": 50}}.get(name)
    data = variant("plain") | {"false_positives": false} if false else variant(name)
    (tmp_path / "detector.yaml").write_text(json.dumps(data))
    options = (*SIZE, *RATE, "--detector", tmp_path / "detector.yaml")
    said = refuse(LINE, options, f"detector {tmp_path / 'detector.yaml'}:\n  ", *parts)
    without = said.split("leave it out with ")[1].split()
    status, said = call("detect", "--truth", tmp_path / "gt.txt", "--out", tmp_path / "out", *options, *without)
    assert status == 0, said


def test_either_a_run_or_a_truth_is_given_and_options_of_the_other_are_refused(inputs, call, tmp_path):
    run_scene(load_scene(inputs.write()), tmp_path / "run")
    (tmp_path / "gt.txt").write_text(LINE)
    out = ("--out", tmp_path / "out")
    for line in ((), (tmp_path / "run", "--truth", tmp_path / "gt.txt")):
        refusal(call, ("detect", *line, *out), "give either RUN, a finished run, or --truth FILE")
    for option in (("--labels", "a"), SIZE, RATE, ("--horizon", "4"), ("--skip-bad",)):
        refusal(call, ("detect", tmp_path / "run", *option, *out), f"{option[0]} is for --truth: a run says it itself")
    line = ("detect", "--truth", tmp_path / "run", *KNOWN, *out)
    refusal(call, line, "is a folder: a file with tracks is needed, MOT gt.txt or COCO JSON")
    line = ("detect", "--truth", tmp_path / "gt.txt", *KNOWN, "--out", tmp_path / "run", "--overwrite")
    refusal(call, line, "holds a run: choose another folder")
    assert not (tmp_path / "out").exists()


def test_the_truth_is_not_written_over(call: Call, tmp_path: Path) -> None:
    (tmp_path / "gt").mkdir()
    (tmp_path / "gt" / "gt.txt").write_text(LINE)
    line = ("detect", "--truth", tmp_path / "gt" / "gt.txt", *KNOWN, "--out", tmp_path, "--overwrite")
    refusal(call, line, f"{tmp_path / 'gt' / 'gt.txt'} is read by this command")
    assert [path.name for path in tmp_path.iterdir()] == ["gt"]


def test_an_image_of_very_many_boxes_is_refused(refuse: Refuse, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(targets, "MAX_BOXES", 3)
    text = "".join(f"2,{track},10,20,30,40,1,1,1\n" for track in range(4))
    refuse(text, KNOWN, "image 'gt frame 2' has 4 boxes, and at most 3 can be compared")


def test_an_empty_sea_has_false_alarms_only_and_needs_their_size(call: Call, refuse: Refuse, tmp_path: Path) -> None:
    (tmp_path / "seqinfo.ini").write_text("[Sequence]\nimWidth=640\nimHeight=480\nseqLength=50\nframeRate=10\n")
    (tmp_path / "gt.txt").write_text("")
    per_image = ("--set", "detector.false_positives.model=per_image", "--set", "detector.false_positives.rate=2")
    refuse(tmp_path / "gt.txt", (*THESIS, *per_image), "but there are none: give false_positives a size")
    size = ("--set", "detector.false_positives.size={model: fixed, px: [20, 10]}")
    line = ("detect", "--truth", tmp_path / "gt.txt", *THESIS, *per_image, *size, "--out", tmp_path / "out")
    status, said = call(*line)
    assert status == 0 and "no box of the truth is to be detected: there are only false alarms" in said
    assert len((tmp_path / "out" / "det" / "det.txt").read_text().splitlines()) > 50


def test_wrong_lines_are_left_out_with_skip_bad(call: Call, tmp_path: Path) -> None:
    (tmp_path / "gt.txt").write_text(LINE + "1,4,x\n")
    line = ("detect", "--truth", tmp_path / "gt.txt", *KNOWN, "--out", tmp_path / "out")
    assert call(*line)[0] == 2
    status, said = call(*line, "--skip-bad")
    assert status == 0 and "1 entries left out, the first because gt.txt line 2: must be numbers" in said


READ = ("id", "width", "height", "file_name", "time_s", "sequence", "bbox", "track_id", "visible_fraction")
READ += ("distance_m",)


@pytest.mark.parametrize("path", [path for path in places(TRUTH) if path[-1] in READ and len(path) == 3], ids=str)
def test_any_value_of_a_coco_file_is_worked_on_or_refused(tmp_path: Path, path: tuple[Any, ...]) -> None:
    for number, value in enumerate(WRONG):
        (tmp_path / "gt.json").write_text(json.dumps(changed(TWICE, path, value)))
        try:
            detect_truth(tmp_path / "gt.json", tmp_path / str(number), detector="thesis", labels=("Vessel",))
        except ModsimError as error:
            assert len(str(error)) < 5000 and str(error).replace("\n", "").isprintable()
