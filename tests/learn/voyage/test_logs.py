"""Logs of detections in every format that is read."""

import json
import shutil
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from modsim3d import InputError, LogOptions, Scene
from modsim3d.learn.voyage.log_to_scene import CameraLog, on_scene
from modsim3d.learn.voyage.logs.log import Clock, DetectionLog, Start, utc_s
from modsim3d.learn.voyage.logs.reading import read_log

HEAD = "time_s,left,top,width,height,label,score\n"
LOGS = {
    "run": "run", "parquet": "run/detections.parquet", "tracker input": "run/tracker_input_bow.jsonl",
    "thesis JSON": "run/detections_bow.json", "stream": "stream.jsonl", "CSV": "csv/detections_bow.csv",
    "COCO": "coco/dt.json", "MOT": "mot/modsim3d-all/bow/det/det.txt",
    "MCAP": "mcap/detections", "MCAP file": "mcap/detections/detections.mcap",
}  # fmt: skip
"""Where each export of the bow camera is."""


def options(voyage: Path, name: str) -> LogOptions:
    return LogOptions(images=voyage / "coco" / "gt.json" if name == "COCO" else None)


def log_of(voyage: Path, name: str) -> DetectionLog:
    return read_log(voyage / LOGS[name], options(voyage, name))


def columns(log: CameraLog) -> tuple[np.ndarray, np.ndarray]:
    """Frames and boxes with confidences, in an order that is the same for all formats."""
    order = np.lexsort((*log.boxes_px.round(3).T, log.frame))
    return log.frame[order], np.column_stack([log.boxes_px, log.confidence])[order]


@pytest.mark.parametrize("name", LOGS)
def test_every_format_gives_the_same_frames_and_detections(voyage: Path, strait: Scene, name: str) -> None:
    (found,) = on_scene(log_of(voyage, name), strait, "bow").cameras
    (run,) = on_scene(log_of(voyage, "run"), strait, "bow").cameras
    assert len(run.frame) > 80
    np.testing.assert_allclose(found.time_s, run.time_s, rtol=0, atol=1e-9)
    for mine, theirs in zip(columns(found), columns(run), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=6e-4)
    if name != "MOT":  # which has classes nowhere
        assert on_scene(log_of(voyage, name), strait, "bow").labels == strait.detector.labels


def test_logs_of_several_cameras_say_which(voyage: Path, strait: Scene) -> None:
    for name in ("run", "stream", "COCO", "MCAP"):
        assert [each.camera for each in on_scene(log_of(voyage, name), strait).cameras] == [0, 1]
    with pytest.raises(InputError, match=r"which camera .*bow, quay.*camera"):
        on_scene(log_of(voyage, "CSV"), strait)
    with pytest.raises(InputError, match="no camera 'mast'"):
        on_scene(log_of(voyage, "run"), strait, "mast")


def coco(folder: Path, images: list[dict[str, object]], found: Sequence[object] = (), **options) -> DetectionLog:
    """The log of a COCO file."""
    content = {"images": images, "annotations": found, "categories": [{"id": 3, "name": "boat"}]}
    (folder / "log.json").write_text(json.dumps(content))
    return read_log(folder / "log.json", LogOptions(**options))  # type: ignore[arg-type]


@pytest.mark.parametrize("captured", ["", 0, "2013-11-14 17:02:52", None])
@pytest.mark.parametrize(("numbers", "times"), [((10, 13, 11), [1, 1.1, 1.3]), ((None, None, None), [0, 0.1, 0.2])])
def test_images_that_date_captured_does_not_tell_apart_have_the_frame_rate(tmp_path: Path, captured, numbers, times):
    images = [{"id": k, "date_captured": captured, "frame_id": number} for k, number in enumerate(numbers)]
    log = coco(tmp_path, images, frame_rate_hz=10)
    np.testing.assert_allclose(log.time_s, times)
    assert log.clock is Clock.STEP
    said = " ".join(log.notes)
    assert captured is None or "date_captured is empty or the same in several images, so their" in said
    assert ("places in the file are taken, at 10 Hz" in said) == (numbers[0] is None)
    with pytest.raises(InputError, match=r"a time is needed: .*, or frame_rate_hz|another image has the time"):
        coco(tmp_path, images)


def frames_of_results(folder: Path, files: list[str], given: list[object], **keys: object) -> DetectionLog:
    """The log of a result for each `image_id`; the images have the IDs 0, 1, ... and are a second apart."""
    images = [{"id": k, "file_name": name, "time_s": k} for k, name in enumerate(files)]
    (folder / "gt.json").write_text(json.dumps({"images": images, "categories": [{"id": 1, "name": "boat"}]}))
    entry = {"category_id": 1, "bbox": [1, 2, 30, 40], "score": 0.5} | keys
    (folder / "dt.json").write_text(json.dumps([entry | {"image_id": each} for each in given]))
    return read_log(folder / "dt.json", LogOptions(images=folder / "gt.json"))


DAY_FILES = [f"day/{k:04d}.png" for k in range(3)]
TWO_SIDES = ["left/0001.jpg", "right/0001.jpg", "left/0002.jpg"]
NUMBERED = ["000001.jpg", "000002.jpg", "000003.jpg"]
BY_NAME = "its image_id are taken for the names of the images' files"


def test_images_without_detections_are_frames_and_results_name_images_by_ids_or_files(tmp_path: Path) -> None:
    entry = {"id": 7, "file_name": "a.png", "width": 640, "height": 480, "date_captured": "2024-01-04 10:00:00"}
    later = entry | {"id": 8, "date_captured": "2024-01-04T12:00:01.5+02:00"}
    log = coco(tmp_path, [entry, later], [{"image_id": 8, "category_id": 3, "bbox": [1, 2, 3, 4]}])
    assert (log.clock, log.span) == (Clock.UTC, "2024-01-04T10:00:00Z to 2024-01-04T10:00:01.500Z")
    assert (log.frame.tolist(), log.boxes_px.tolist()) == ([1], [[1, 2, 4, 6]])
    assert np.isnan(log.confidence).all() and log.size_px.tolist() == [[640, 480]] * 2
    images = [{"id": k, "frame_id": k, "date_captured": f"2024-01-04 10:00:0{k}"} for k in range(3)]
    log = coco(tmp_path, images, frame_rate_hz=10)
    assert (log.span, log.notes) == ("2024-01-04T10:00:00Z to 2024-01-04T10:00:02Z", ())
    # As detectors write them that do not know the IDs. Of numbered files the other reading moves all by one frame.
    for files, given, frames, said in (
        (DAY_FILES, ["0002"], [2], BY_NAME),
        (DAY_FILES, ["0002.png"], [2], BY_NAME),
        (DAY_FILES, ["day/0002.png"], [2], BY_NAME),
        (TWO_SIDES, ["right/0001.jpg", "0002"], [1, 2], BY_NAME),
        (NUMBERED, [1, 2, 3], [0, 1, 2], BY_NAME),
        (NUMBERED, [1.0, 2.0, 3.0], [0, 1, 2], BY_NAME),
        (NUMBERED, [0, 1, 2], [0, 1, 2], ""),
        (NUMBERED, [1, 2], [1, 2], "and the name of another's file too: taken for the id"),
    ):
        log = frames_of_results(tmp_path, files, given)
        assert log.frame.tolist() == frames and said in " ".join(log.notes) and bool(said) == bool(log.notes), given
    # Not for the last of several: both cameras' boxes would be on its images
    for files, given, said in (
        (DAY_FILES, ["other"], "unknown image_id 'other'"),
        (TWO_SIDES, ["0001", "0002"], r"\[0\]: unknown image_id '0001'"),
    ):
        with pytest.raises(InputError, match=said):
            frames_of_results(tmp_path, files, given)
    log = frames_of_results(tmp_path, NUMBERED, [1], file_name="000001.jpg")
    assert (log.frame.tolist(), log.notes) == ([0], ())


def table(folder: Path, *rows: str, head: str = HEAD) -> Path:
    path = folder / "log.csv"
    path.write_text(head + "".join(f"{row}\n" for row in rows))
    return path


def boat_at(*times: float) -> list[str]:
    return [f"{time},1,2,3,4,boat,0.5" for time in times]


def test_frames_without_detections_come_from_the_usual_gap_and_parquet_is_read_as_csv_is(tmp_path: Path) -> None:
    log = read_log(table(tmp_path, *boat_at(0, 0.5, 1, 1.51, 2, 4, 4.5)))
    np.testing.assert_allclose(log.time_s, [0, 0.5, 1, 1.51, 2, 2.5, 3, 3.5, 4, 4.5])
    said = "usual gap between its times, 2 Hz: 3 without detections were added to 7, in gaps of up to 2 s"
    assert said in log.frames_from
    log = read_log(table(tmp_path, *boat_at(0, 0.5, 1)), LogOptions(frame_rate_hz=4))
    np.testing.assert_allclose(log.time_s, [0, 0.25, 0.5, 0.75, 1])
    log = read_log(table(tmp_path, *boat_at(0), "1.3,,,,,,", *boat_at(9)))
    assert (log.time_s.tolist(), log.frame.tolist()) == ([0, 1.3, 9], [0, 2]) and "empty boxes" in log.frames_from
    with pytest.raises(InputError, match=r"cannot be known: the usual gap .* give frame_rate_hz"):
        read_log(table(tmp_path, *boat_at(0, 1, 2.5, 3.2, 7, 8.45)))
    with pytest.raises(InputError, match=r"0.5 s apart after 0 s do not fit frame_rate_hz=3"):
        read_log(table(tmp_path, *boat_at(0, 0.5, 1)), LogOptions(frame_rate_hz=3))
    seconds = pa.array([1704362400, 1704362401], pa.int64()).cast(pa.timestamp("s", tz="Europe/Oslo"))
    boxes = {"left": [1.5, 2.0], "top": [2.0, 3.0], "right": [4.0, 5.0], "bottom": [6.0, 7.0], "score": [0.5, 0.25]}
    named = {"camera": ["bow", "bow"], "label": ["ba\u030at", "b\u00e5t"]}
    for utc in (["2024-01-04T10:00:00Z", "2024-01-04T10:00:01Z"], seconds):
        pq.write_table(pa.table({"utc": utc} | named | boxes), tmp_path / "log.parquet")
        log = read_log(tmp_path / "log.parquet")
        assert (log.clock, log.cameras, log.labels) == (Clock.UTC, ("bow",), ("b\u00e5t",))
        assert log.time_s.tolist() == [1704362400, 1704362401]
        assert log.boxes_px.tolist() == [[1.5, 2, 4, 6], [2, 3, 5, 7]] and log.confidence.tolist() == [0.5, 0.25]


def test_corners_have_the_names_that_detectors_give_them_and_mot_begins_at_the_start(tmp_path: Path) -> None:
    for names in ("left,top,right,bottom", "x1,y1,x2,y2", "xmin,ymin,xmax,ymax", "x_min,y_min,x_max,y_max"):
        log = read_log(table(tmp_path, "0,1,2,30,40", head=f"time_s,{names}\n"))
        assert log.boxes_px.tolist() == [[1, 2, 30, 40]], names
    path = table(tmp_path, "0,1,2,3,4,boat,50", "1,1,2,3,4,boat,75")
    with pytest.raises(InputError, match="confidence_scale"):
        read_log(path)
    assert read_log(path, LogOptions(confidence_scale=(0, 100))).confidence.tolist() == [0.5, 0.75]
    (tmp_path / "det.txt").write_text("1,-1,11,21,30,40,0.9,2\n4,-1,11,21,30,40,0.8,1\n")
    start = Start(5.0, Clock.STEP)
    log = read_log(tmp_path / "det.txt", LogOptions(frame_rate_hz=2, start=start, labels=("boat", "ship")))
    assert log.time_s.tolist() == [5, 5.5, 6, 6.5] and [log.labels[k] for k in log.label] == ["ship", "boat"]
    assert log.boxes_px.tolist() == [[10, 20, 40, 60]] * 2


def test_a_time_without_a_zone_is_utc_wherever_the_log_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as elsewhere:
        elsewhere.setenv("TZ", "Asia/Tokyo")
        time.tzset()
        found = [utc_s(text) for text in ("1970-01-02T00:00:00", "1970/01/02 09:00:00+09:00", "1970-01-02", "noon")]
        exif = utc_s("1970:01:02 00:00:00")
    time.tzset()
    assert [*found[:3], exif] == [86400] * 4 and np.isnan(found[3])


ROW = "0,1,2,3,4,boat,0.5"
DAY = {"date_captured": "2024-01-04"}


def coco_of(*images: dict[str, object]) -> str:
    numbered = [{"id": k + 1} | image for k, image in enumerate(images)]
    return json.dumps({"images": numbered, "annotations": [], "categories": []})


WRONG = {
    "no time": ("log.csv", "left,top,width,height\n", "a column with the time is missing (got 'left', 'top'"),
    "for spreadsheets": ("log.csv", f"sep=,\n{HEAD}{ROW}\n", "line 1 is for spreadsheets alone"),
    "no columns": ("log.csv", "utc;left;top\n1;2;3\n", "its cells have semicolons between them, must have commas)"),
    "seconds as UTC": (
        *("log.csv", "utc,left,top,width,height\n55,1,2,30,40\n"),
        "line 2: utc must be a time such as 2024-01-04T10:00:00.250Z, or Unix time (got '55'): seconds since the",
    ),
    "no content": ("log.csv", "\n", "the file is empty"),
    "shares": ("log.csv", f"{HEAD}0,0.1,0.2,0.3,0.4,boat,0.5\n", "give pixels, not shares of the image"),
    "no box": ("log.csv", "time_s,left\n0,1\n", "line 1: columns of the box are missing"),
    "a time": ("log.csv", f"{HEAD}noon,1,2,3,4,boat,0.5\n", "line 2: time_s must be seconds, or a time such as"),
    "milliseconds": ("log.csv", f"{HEAD}1704362396300,1,2,3,4,boat,0.5\n", "which may be milliseconds)"),
    "two clocks": ("log.csv", f"{HEAD}{ROW}\n2024-01-04,1,2,3,4,boat,1\n", "some times are UTC and others are not"),
    "half a box": ("log.csv", f"{HEAD}0,1,,3,4,boat,0.5\n", "line 2: left, top, width, height must be numbers"),
    "no area": ("log.csv", f"{HEAD}{ROW}\n1,1,2,0,4,boat,0.5\n", "line 3: bbox has no area"),
    "some labels": ("log.csv", f"{HEAD}{ROW}\n1,1,2,3,4,,0.5\n", "line 2 has a class, and line 3 has none: give one"),
    "some scores": ("log.csv", f"{HEAD}{ROW}\n1,1,2,3,4,boat,\n", "line 3: has no score (-1), but line 2 has 0.5"),
    "a score in words": ("log.csv", f"{HEAD}{ROW}\n1,1,2,3,4,boat,x\n", "line 3: score must be from 0 to 1 (got 'x')"),
    "nothing": ("log.csv", HEAD, "holds no frame: it needs the times"),
    "MOT without a rate": ("log.txt", "1,-1,1,2,3,4,0.5\n", "the frame rate is not known: give frame_rate_hz"),
    "a MOT frame": ("log.txt", "900000,-1,1,2,3,4,0.5\n", "frame must be a whole number from 1 to 101000"),
    "COCO without images": ("log.json", "[]", "give the COCO file of these with images"),
    "COCO without times": (
        *("log.json", coco_of({})),
        "images[0]: a time is needed: time_s, utc, date_captured, or frame_rate_hz, for their frame_id",
    ),
    "COCO twice at a time": ("log.json", coco_of(*[{"time_s": 1}] * 2), "images[1]: another image has the time 1 s"),
    "COCO all at one time": (
        *("log.json", coco_of(DAY, DAY, DAY)),
        "images[1]: another image has the time 2024-01-04T00:00:00Z, and 1 more; where cameras take images at one "
        "time, each image must name its camera; where times are too coarse, frame_rate_hz takes their places in "
        "the file",
    ),
    "COCO at no time": (
        *("log.json", coco_of({"date_captured": "noon"})),
        "images[0]: date_captured must be seconds, or a time such as 2024-01-04T10:00:00.250Z (got 'noon')",
    ),
    "half of COCO": ("log.json", '{"images": []}', "annotations: missing"),
    "a line": ("log.jsonl", '{"time_s": 1, "boxes": []}\n', "line 1: must be a frame such as"),
    "a line's box": ("log.jsonl", '{"time_s": 1, "detections": [{"box_px": 3}]}\n', "line 1: detections[0]: box_px"),
    "the thesis's": ("log.json", '{"0.0": {"a": {"label": "boat"}}}', "0.0.a: must be a detection as in"),
    "a bag": ("log.mcap", "no bag", "cannot be read as a ROS 2 bag"),
    "Parquet": ("log.parquet", "no Parquet", "cannot be read as Parquet"),
    "its name": ("log.xml", "", "its name does not say what it is"),
}


@pytest.mark.parametrize(("name", "text", "said"), WRONG.values(), ids=WRONG)
def test_a_wrong_log_is_refused_with_its_place(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text)
    options = LogOptions(frame_rate_hz=2 if "frame must" in said else None)
    with pytest.raises(InputError) as error:
        read_log(tmp_path / name, options)
    assert said in str(error.value) and str(tmp_path / name) in str(error.value)


def test_images_of_another_size_and_boxes_that_no_image_has_are_refused(voyage, strait: Scene, tmp_path: Path) -> None:
    shutil.copytree(voyage / "mot" / "modsim3d-all" / "bow", tmp_path / "bow")
    info = tmp_path / "bow" / "seqinfo.ini"
    info.write_text(info.read_text().replace("imWidth=1920", "imWidth=1280"))
    outside = r"1 of 2 boxes lie outside the images of camera 'bow', of 1920 × 1080 px \(first at 0 s: 2000, 900 to"
    for path, said in (
        (tmp_path / "bow/det/det.txt", "has images of 1280 × 1080 px, and camera 'bow' of the scene 1920 × 1080 px"),
        (table(tmp_path, ROW, "0,2000,900,30,40,boat,0.5"), outside),
    ):
        with pytest.raises(InputError, match=said):
            on_scene(read_log(path), strait, "bow")
    few = table(tmp_path, "0,-50,9,30,40,boat,0.5", *(f"{k / 100},100,900,30,40,boat,0.5" for k in range(200)))
    assert len(on_scene(read_log(few), strait, "bow").cameras[0].boxes_px) == 201


def test_a_row_that_is_there_twice_counts_once(tmp_path: Path) -> None:
    rows = ROW, "1,5,6,30,40,boat,0.5", "1,5,6,30,40,boat,0.25", "1,5,6,30,40,ship,0.5"
    log = read_log(table(tmp_path, *rows, *rows[1:], rows[0]))
    assert log.frame.tolist() == [0, 1, 1, 1] and log.confidence.tolist() == [0.5, 0.5, 0.25, 0.5]
    said = "4 detections are there a second time (first at 0 s), with the same time, box, class and confidence"
    assert any(said in note for note in log.notes) and not read_log(table(tmp_path, *rows)).notes


UTC_ROW = "2024-01-04T10:00Z,1,2,3,4,boat,1"


def test_frames_that_lack_a_detection_and_a_log_that_does_not_fit_the_scene_are_refused(tmp_path, strait):
    path = table(tmp_path, "1,2,3,40,50,boat,0.9,bow", "2,2,3,40,50,boat,0.9,", head=HEAD.strip() + ",camera\n")
    with pytest.raises(InputError, match="some frames or detections name a camera and others do not"):
        on_scene(read_log(path), strait, "bow")
    log = tmp_path / "detections.csv"
    log.write_text(HEAD + "1,2,3,40,50,boat,0.9\n2.0001,2,3,40,50,boat,0.9\n")
    (tmp_path / "frames.csv").write_text("time_s\n1\n2\n")
    with pytest.raises(InputError, match=r"lacks the time of 1 detection \(first 2.0001\)"):
        read_log(log)
    for row, given, said in (
        ("0,1,2,3,4,boats,1", {}, r"no label 'boats' \(did you mean 'boat'\?\)"),
        (UTC_ROW, {}, r"its times are UTC .* does not say when it starts"),
        (ROW, {"images": Path("gt.json")}, r"images:\n +is for COCO results, and .*log.csv says itself"),
        (UTC_ROW, {"start": Start(0, Clock.STEP)}, "leave start out"),  # for logs that count from zero
    ):
        with pytest.raises(InputError, match=said):
            on_scene(read_log(table(tmp_path, row), LogOptions(**given)), strait, "bow")
    for name, said in ((".", "is a folder, and neither a run nor a ROS 2 bag"), ("x.csv", "no such file or folder")):
        with pytest.raises(InputError, match=said):
            read_log(tmp_path / name)
