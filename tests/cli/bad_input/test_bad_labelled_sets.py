"""Labelled sets and videos that are broken, fill the memory or do not fit get one clear error, and no traceback."""

import copy
import gzip
import io
import json
import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from modsim3d.core.errors import ModsimError
from modsim3d.formats import video_targets
from modsim3d.formats.detect_truth import detect_truth
from modsim3d.formats.reading import builder
from modsim3d.formats.reading.builder import ReadOptions
from modsim3d.formats.reading.pair import read_pair
from modsim3d.runs.run import run_scene
from modsim3d.scene.reading import load_scene
from tests.cli.bad_input.builders import Call, answer, places, refusal
from tests.detector_variants import variant

BOX_PX = [10, 20, 30, 40]
IMAGE = {"id": 1, "width": 640, "height": 480, "file_name": "a.png", "time_s": 0.5, "sequence": "s", "condition": "day"}
ENTRY = {"image_id": 1, "category_id": 1, "bbox": BOX_PX, "iscrowd": 0, "ignore": 0, "track_id": 3}
TRUTH: dict[str, Any] = {
    "images": [IMAGE | {"horizon": [200, 210.5]}],
    "categories": [{"id": 1, "name": "boat"}],
    "annotations": [ENTRY | {"visible_fraction": 0.5, "distance_m": 80}],
}
RESULTS = [{"image_id": 1, "category_id": 1, "bbox": BOX_PX, "score": 0.9, "probabilities": [1.0]}]
LINE, FOUND = "1,3,10,20,30,40,1,1,0.5\n", "1,-1,12,20,30,40,0.9\n"
BOX, SEEN = "0 .5 .5 .1 .1\n", "0 .5 .5 .1 .1 .9\n"
Refuse = Callable[..., str]


@pytest.fixture
def refuse(call: Call, tmp_path: Path) -> Refuse:
    """A function that asserts that `learn` refuses a pair of files with some parts in a short message."""

    def look(truth: Path, detections: Path, *parts: str, options: tuple[str, ...] = ()) -> str:
        out = tmp_path / "out" / "detector.yaml"
        said = refusal(call, ("learn", "--truth", truth, "--detections", detections, "--out", out, *options), *parts)
        assert len(said) < 10_000 and said.replace("\n", "").isprintable()
        assert not out.parent.exists()
        return said

    return look


def coco(folder: Path, truth: Any = TRUTH, results: Any = RESULTS) -> tuple[Path, Path]:
    for name, content in (("gt.json", truth), ("dt.json", results)):
        (folder / name).write_text(content if isinstance(content, str) else json.dumps(content))
    return folder / "gt.json", folder / "dt.json"


def mot(folder: Path, truth: str = LINE, found: str = FOUND) -> tuple[Path, Path]:
    (folder / "gt.txt").write_text(truth)
    (folder / "det.txt").write_text(found)
    return folder / "gt.txt", folder / "det.txt"


def yolo(folder: Path, truth: str = BOX, found: str = SEEN) -> tuple[Path, Path]:
    for name, text in (("truth", truth), ("found", found)):
        (folder / name).mkdir()
        (folder / name / "a.txt").write_text(text)
    return folder / "truth", folder / "found"


SIZE = ("--image-size", "640,480")


def test_a_frame_far_beyond_the_lines_is_refused_unless_seq_length_says_how_long_a_night_is(tmp_path, refuse) -> None:
    pair = mot(tmp_path, LINE + LINE.replace("1,3", "10000000,3", 1))
    said = "gt.txt line 2: frame must be a whole number from 1 to 103000 (got 10000000)"
    refuse(*pair, said, "seqLength in a seqinfo.ini", options=SIZE)
    pair = mot(tmp_path, LINE + LINE.replace("1,3", "360000,3", 1))
    (tmp_path / "seqinfo.ini").write_text("[Sequence]\nimWidth=640\nimHeight=480\nseqLength=360000\nframeRate=10\n")
    assert len(read_pair("night", *pair, ReadOptions()).images) == 360_000


def test_lines_of_mot_and_a_seqinfo_that_are_none_are_refused(tmp_path, refuse):
    for truth, found, part in (
        (LINE.replace(",3,", ",1e300,"), FOUND, "gt.txt line 1: identity must be at most 1e+15 (got 1e+300)"),
        (LINE.replace("1,1,0.5", "1,1e18,0.5"), FOUND.strip() + ",1e18\n", "class must be at most 10000 (got 1e+18)"),
        (LINE + "1," * 50_000, FOUND, "gt.txt line 2: has 100,000 characters, must have at most 10,000"),
        (LINE + "1,\0\x1b[31m\n", FOUND, r"gt.txt line 2: must be numbers (got '1,\x00\x1b[31m')"),
        (LINE + "1,1,1\n" * 20_000, FOUND, "10,000 in all so far; the rest was not read"),
    ):
        refuse(*mot(tmp_path, truth, found), part, options=SIZE)
    for text, part in (
        ("root:x:0:0:secret\n", "needs imWidth and imHeight under [Sequence]"),
        (SIDES.replace("640", "%(imWidth)s"), "imWidth: must be above 0, and at most 1e+07"),
        (f"{SIDES}seqLength=10000000\n", "seqLength: must be from 0 to 1e+06"),
        (f"{SIDES}seqLength={'1' * 5000}", "seqLength: must be from 0 to 1e+06"),
        (SIDES.replace("640", "1" * 400), "imWidth: must be above 0, and at most 1e+07"),
        (SIDES.replace("640", "0"), "imWidth: must be above 0"),
        (SIDES.replace("480", "-5"), "imHeight: must be above 0"),
        *((f"{SIDES}frameRate={rate}", "frameRate: must be above 0") for rate in (0, "nan")),
        (f"{SIDES}seqLength=-1", "seqLength: must be from 0"),
    ):
        (tmp_path / "seqinfo.ini").write_text(text)
        assert "secret" not in refuse(*mot(tmp_path), "seqinfo.ini", part)


SIDES = "[Sequence]\nimWidth=640\nimHeight=480\n"


def test_a_class_far_beyond_the_others_costs_one_class_and_many_problems_are_not_kept(tmp_path: Path) -> None:
    labelled = read_pair("day", *yolo(tmp_path, BOX + "9999 .5 .5 .1 .1\n"), ReadOptions(image_size_px=(640, 480)))
    assert labelled.labels == ("class_0", "class_9999")
    assert labelled.annotations.label.tolist() == [0, 1] and labelled.results.label.tolist() == [0]
    problems = builder.Problems("file", skip=True)
    for _ in range(50_000):
        problems.add("line")
    assert len(problems.lines) == builder.MAX_PROBLEMS
    assert problems.settle() == ["file: 50000 entries left out, the first because line"]


def test_more_classes_than_the_tables_have_room_for_are_refused(tmp_path: Path, refuse: Refuse) -> None:
    many = {**TRUTH, "categories": [{"id": k, "name": f"c{k}"} for k in range(2000)]}
    plain = [{key: value for key, value in RESULTS[0].items() if key != "probabilities"}]
    refuse(*coco(tmp_path, many, plain), "2,000 classes in 1 states with 300 replicates", "--replicates")
    pair = yolo(tmp_path)
    (pair[0] / "data.yaml").write_text("names: {9999: last}\n")
    refuse(*pair, "10,000 classes in 1 states", options=SIZE)


def test_many_boxes_on_one_place_are_refused(tmp_path: Path, refuse: Refuse, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("modsim3d.formats.matching.MAX_PAIRS", 1000)
    refuse(*yolo(tmp_path, BOX * 40, SEEN * 40), "image 'a'", "more than 1,000 pairs of boxes", options=SIZE)


HUGE = 10**400
WRONG = [None, True, "", "x", "\x1b[31m", "\ud800", [], {}, [[None]], {"x": 1}, -1, 0, 1.5, 10**25, HUGE]
WRONG += [1e300, -1e308, float("nan"), float("inf"), "9" * 5000, [1, 2, 3, 4], [HUGE] * 4, "x" * 100_000]


def changed(content: Any, path: tuple[Any, ...], value: Any) -> Any:
    """A copy of nested mappings and lists with another value at a path."""
    section = copy_of = copy.deepcopy(content)
    for key in path[:-1]:
        section = section[key]
    section[path[-1]] = value
    return copy_of


@pytest.mark.parametrize("path", [("gt", *p) for p in places(TRUTH)] + [("dt", *p) for p in places(RESULTS)], ids=str)
def test_any_value_anywhere_in_coco_is_read_or_refused(tmp_path: Path, path: tuple[Any, ...]) -> None:
    for value in WRONG:
        content = changed({"gt": TRUTH, "dt": RESULTS}, path, value)
        pair = coco(tmp_path, content["gt"], content["dt"])
        for rate_hz in (None, 5.0):
            try:
                read_pair("day", *pair, ReadOptions(frame_rate_hz=rate_hz))
            except ModsimError as error:
                assert len(str(error)) < 5000 and str(error).replace("\n", "").isprintable()


def test_a_file_name_of_5000_digits_is_read_and_names_that_no_file_can_hold_are_refused(tmp_path, refuse) -> None:
    truth = changed(TRUTH, ("images", 0, "file_name"), "9" * 5000 + ".png")
    assert len(read_pair("day", *coco(tmp_path, truth), ReadOptions()).images) == 1
    refuse(*coco(tmp_path, changed(truth, ("categories", 0, "name"), "\ud800")), "half a character")
    refuse(*coco(tmp_path, TRUTH, [{**RESULTS[0], "image_id": "x" * 1_000_000}]), "[0]: unknown image_id 'xxx")


@pytest.mark.parametrize("form", [coco, mot])
def test_pipes_and_bombs_are_refused(tmp_path: Path, refuse: Refuse, form: Callable[[Path], tuple[Path, Path]]) -> None:
    truth, found = form(tmp_path)
    truth.write_bytes(gzip.compress(b"\n" * 20_000_000, 1))
    refuse(truth, found, "unpacks to more than 100 times its own size", options=SIZE)
    truth.unlink()
    os.mkfifo(truth)
    refuse(truth, found, "this is a pipe, a file was expected", options=SIZE)


@pytest.mark.parametrize("name", ["gt.txt", "gt.json", "gt.csv"])
def test_what_is_no_labelled_set_is_refused_without_its_content(tmp_path: Path, refuse: Refuse, name: str) -> None:
    path = tmp_path / name
    path.write_text("root:x:0:0:secret:/root:/bin/bash\n" * 40)
    assert "secret" not in refuse(path, path, options=SIZE)
    path.write_bytes(bytes(range(256)) * 40)
    refuse(path, path, options=SIZE)


def picture(kind: str) -> bytes:
    stream = io.BytesIO()
    Image.new("RGB", (64, 48)).save(stream, kind)
    return stream.getvalue()


def chunk(name: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))


def png(width: int, height: int, *chunks: bytes) -> bytes:
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + b"".join(chunks) + chunk(b"IDAT", b"")


IMAGES = {
    "cut.png": picture("PNG")[:20],
    "cut.jpg": picture("JPEG")[:30],
    "empty.png": b"",
    "none.png": png(0, 0),
    "endless.png": png(2**31 - 1, 2**31 - 1),
    "bomb.png": png(64, 48, chunk(b"zTXt", b"a\0\0" + zlib.compress(b"x" * 80_000_000, 1))),
    "text.png": b"root:x:0:0:secret",
}


@pytest.mark.parametrize("name", [*IMAGES, "folder.png", "pipe.png", "large.webp"])
def test_an_image_whose_size_cannot_be_known_is_refused(tmp_path: Path, refuse: Refuse, name: str) -> None:
    truth, found = yolo(tmp_path)
    path = truth / name
    for folder in (truth, found):
        (folder / "a.txt").rename(folder / f"{path.stem}.txt")
    if name == "folder.png":
        path.mkdir()
    elif name == "pipe.png":
        os.mkfifo(path)
    else:
        path.write_bytes(IMAGES.get(name, b""))
    if name == "large.webp":
        os.truncate(path, 1 << 34)
    assert "secret" not in refuse(truth, found, f"image {path}")


def test_a_matching_rule_that_is_not_clear_is_refused(inputs, call, tmp_path):
    run_scene(load_scene(inputs.write()), tmp_path / "run")
    both = "--truth gt.json --detections dt.json"
    for options, part in (
        (both, "runs and files are matched differently unless a rule is named: give"),
        ("--match provenance:0.3", "--match provenance:0.3: needs confidence or optimal, with a least IoU"),
        ("--match near", "--match near: needs confidence or optimal"),
        ("--match centre:far", "--match centre:far: needs confidence or optimal"),
    ):
        said = refusal(call, ("learn", tmp_path / "run", *options.split(), "--out", tmp_path / "d.yaml"), part)
        assert len(said.splitlines()) == 1
        assert not (tmp_path / "d.yaml").exists()


TWO = LINE + "2,4,10,20,30,40,1,2,1\n"
RATE, THESIS = ("--frame-rate", "10"), ("--detector", "thesis")
KNOWN = (*SIZE, *RATE, *THESIS)


@pytest.fixture
def refuse_truth(call: Call, tmp_path: Path) -> Refuse:
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


TWICE = {**TRUTH, "images": [TRUTH["images"][0], {**TRUTH["images"][0], "id": 2, "time_s": 0.6}]}
ALIKE = changed(changed(TWICE, ("images", 0, "sequence"), "a/b"), ("images", 1, "sequence"), "A_B")
SAME_TIME = "images 'a.png' and 'a.png' have the same time, 0.5 s: if they are of different videos, name these in seque"


LABEL = ("--labels", "Vessel", *THESIS)
COCO: dict[str, tuple[Any, tuple[object, ...], str]] = {
    "other labels": (TWICE, THESIS, "labels:\n  category 'boat' is not one of the detector's labels (known: Vessel)\n"),
    "how to name them": (TWICE, THESIS, "A,B,... with a label of the detector in the order of the file (boat); - for"),
    "equal times": (changed(TWICE, ("images", 1, "time_s"), 0.5), LABEL, SAME_TIME),
    "no time": (changed(TWICE, ("images", 1, "time_s"), None), LABEL, "1 of 2 images have no time"),
    "two sizes": (changed(TWICE, ("images", 1, "width"), 320), LABEL, "images are 640 × 480 and 320 × 480 px"),
    "no track": (changed(TWICE, ("annotations", 0, "track_id"), None), LABEL, "each needs a track_id in COCO"),
    "names alike": (ALIKE, LABEL, "sequences 'a/b' and 'A_B' would have files of one name: rename one of them"),
    "results": ([], LABEL, "a list: is it the results file?"),
}


def test_a_truth_that_cannot_be_worked_on_is_refused_and_so_is_an_image_of_very_many_boxes(refuse_truth, monkeypatch):
    for truth, options, part in (*MOT.values(), *COCO.values()):
        refuse_truth(truth, options, part)
    monkeypatch.setattr(video_targets, "MAX_BOXES", 3)
    text = "".join(f"2,{track},10,20,30,40,1,1,1\n" for track in range(4))
    refuse_truth(text, KNOWN, "image 'gt frame 2' has 4 boxes, and at most 3 can be compared")


NEEDS: dict[str, tuple[str, str]] = {
    "gates": ("gates.max_range_m: needs the distance of every vessel, which 1 of 1 b", "detector.gates.max_range_m"),
    "dropout by a table of distance": ("dropout.distance_m: needs the distance", "detector.dropout.model=confusion"),
    "band": ("false_positives.placement: horizon_band needs the horizon: give --horizon", "placement=uniform"),
    "far": ("false_positives.far_half_px: needs the horizon: give --horizon ROW", "false_positives.far_half_px=null"),
}


@pytest.mark.parametrize(("name", "parts"), NEEDS.items(), ids=NEEDS)
def test_what_a_detector_needs_is_asked_for_by_its_key_and_left_out_as_said(refuse_truth, call, tmp_path, name, parts):
    false = {"band": {"placement": "horizon_band", "band_px": 50}, "far": {"far_half_px": 50}}.get(name)
    data = variant("plain") | {"false_positives": false} if false else variant(name)
    (tmp_path / "detector.yaml").write_text(json.dumps(data))
    options = (*SIZE, *RATE, "--detector", tmp_path / "detector.yaml")
    said = refuse_truth(LINE, options, f"detector {tmp_path / 'detector.yaml'}:\n  ", *parts)
    without = said.split("leave it out with ")[1].split()
    answer(call, ("detect", "--truth", tmp_path / "gt.txt", "--out", tmp_path / "out", *options, *without))


def test_either_a_run_or_a_truth_is_given_and_options_of_the_other_are_refused(inputs, call, tmp_path):
    run_scene(load_scene(inputs.write()), tmp_path / "run")
    (tmp_path / "gt.txt").write_text(LINE)
    out = ("--out", tmp_path / "out")
    for line in ((), (tmp_path / "run", "--truth", tmp_path / "gt.txt")):
        refusal(call, ("detect", *line, *out), "give either RUN, a finished run, or --truth FILE")
    for option in (("--labels", "a"), SIZE, RATE, ("--horizon", "4"), ("--skip-bad",)):
        refusal(call, ("detect", tmp_path / "run", *option, *out), f"{option[0]} is for --truth: a run says it itself")
    line = ("detect", "--truth", tmp_path / "run", *KNOWN, *out)
    refusal(call, line, "has no labels: no .txt file")
    line = ("detect", "--truth", tmp_path / "gt.txt", *KNOWN, "--out", tmp_path / "run")
    refusal(call, line, "holds a run: use --overwrite, or choose another folder")
    assert not (tmp_path / "out").exists()


def test_the_truth_is_not_written_over_and_wrong_lines_are_left_out_with_skip_bad(call, tmp_path):
    (tmp_path / "gt").mkdir()
    (tmp_path / "gt" / "gt.txt").write_text(LINE)
    line = ("detect", "--truth", tmp_path / "gt" / "gt.txt", *KNOWN, "--out", tmp_path, "--overwrite")
    refusal(call, line, "gt.txt is read by this command, so it is not written over")
    assert [path.name for path in tmp_path.iterdir()] == ["gt"]
    (tmp_path / "gt.txt").write_text(LINE + "1,4,x\n")
    line = ("detect", "--truth", tmp_path / "gt.txt", *KNOWN, "--out", tmp_path / "out")
    refusal(call, line)
    answer(call, (*line, "--skip-bad"), "1 entries left out, the first because gt.txt line 2: must be numbers")


def test_an_empty_sea_has_false_alarms_only_and_needs_their_size(call, refuse_truth, tmp_path) -> None:
    (tmp_path / "seqinfo.ini").write_text("[Sequence]\nimWidth=640\nimHeight=480\nseqLength=50\nframeRate=10\n")
    (tmp_path / "gt.txt").write_text("")
    per_image = ("--set", "detector.false_positives.model=per_image", "--set", "detector.false_positives.rate=2")
    refuse_truth(tmp_path / "gt.txt", (*THESIS, *per_image), "but there are none: give false_positives a size")
    size = ("--set", "detector.false_positives.size={model: fixed, px: [20, 10]}")
    line = ("detect", "--truth", tmp_path / "gt.txt", *THESIS, *per_image, *size, "--out", tmp_path / "out")
    answer(call, line, "no box of the truth is to be detected: there are only false positives")
    assert len((tmp_path / "out" / "det" / "det.txt").read_text().splitlines()) > 50


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
