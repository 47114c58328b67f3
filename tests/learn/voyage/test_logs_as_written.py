"""Logs as other programs write them: marks at their beginning, line ends, accents, units of time, old ROS messages."""

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from benchmarks.voyages.wrong_camera import Voyage
from modsim3d import InputError, LogOptions, Scene, load_scene
from modsim3d.io.ros_bag import DETECTIONS_2D, VISION_MSGS
from modsim3d.learn.voyage.clock import SceneClock
from modsim3d.learn.voyage.labelled_voyage import labelled_voyage
from modsim3d.learn.voyage.log_to_scene import on_scene
from modsim3d.learn.voyage.logs.reading import read_log
from tests.learn.voyage.strait_logs import strait_scene, written

BOX = [100.0, 500.0, 30.0, 40.0]
NAME = "b\u00e5t"


def csv_text(times: list[float]) -> str:
    rows = [f"{time:.12g},100,500,30,40,{NAME},0.5\n" for time in times]
    return "".join(["time_s,left,top,width,height,label,score\n", *rows])


def lines_text(times: list[float]) -> str:
    found = [{"box_px": [100, 500, 130, 540], "label": NAME, "confidence": 0.5}]
    return "".join(json.dumps({"time_s": time, "detections": found}, ensure_ascii=False) + "\n" for time in times)


def thesis_text(times: list[float]) -> str:
    box = {"centre": {"x": 115, "y": 520}, "width": 30, "height": 40}
    entry = {"a": {"label": NAME, "confidenceScore": 0.5, "bbox": box}}
    return json.dumps({f"{time:.12g}": entry for time in times}, ensure_ascii=False, indent=1)


def coco_text(times: list[float]) -> str:
    images = [{"id": k, "file_name": f"{k}.png", "time_s": time} for k, time in enumerate(times)]
    found = [{"image_id": k, "category_id": 1, "bbox": BOX, "score": 0.5} for k in range(len(times))]
    content = {"images": images, "annotations": found, "categories": [{"id": 1, "name": NAME}]}
    return json.dumps(content, ensure_ascii=False, indent=1)


LOGS: dict[str, tuple[str, Callable[[list[float]], str]]] = {
    "CSV": ("log.csv", csv_text),
    "lines": ("log.jsonl", lines_text),
    "thesis JSON": ("log.json", thesis_text),
    "COCO": ("log.json", coco_text),
    "MOT": ("log.txt", lambda times: "".join(f"{k + 1},-1,101,501,30,40,0.5,1\n" for k in range(len(times)))),
}
MARKS: dict[str, Callable[[str], bytes]] = {
    "mark": lambda text: b"\xef\xbb\xbf" + text.encode(),
    "CR LF": lambda text: text.replace("\n", "\r\n").encode(),
    "CR": lambda text: text.replace("\n", "\r").encode(),
    "mark and CR": lambda text: b"\xef\xbb\xbf" + text.replace("\n", "\r").encode(),
    "escaped NFD": lambda text: text.replace("\u00e5", "a\\u030a" if text.startswith("{") else "\u00e5").encode(),
    "NFD": lambda text: text.replace("\u00e5", "a\u030a").encode(),
}
TIMES = [0.0, 0.2, 0.4]
OPTIONS = LogOptions(frame_rate_hz=5, labels=(NAME,))


@pytest.mark.parametrize("log", LOGS)
def test_marks_line_ends_and_accents_change_nothing_and_utf_16_is_named(tmp_path: Path, log: str) -> None:
    path, text = tmp_path / LOGS[log][0], LOGS[log][1](TIMES)
    for mark, change in MARKS.items():
        path.write_bytes(change(text))
        found = read_log(path, OPTIONS)
        assert (found.time_s.tolist(), found.labels) == (TIMES, (NAME,)), mark
        np.testing.assert_array_equal(found.boxes_px, [[100, 500, 130, 540]] * 3, mark)
    for codec in ("utf-16-le", "utf-16-be"):
        path.write_bytes(("\ufeff" + text).encode(codec))
        with pytest.raises(InputError, match="is UTF-16 text, must be UTF-8"):
            read_log(path, OPTIONS)


UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}


@pytest.mark.parametrize(("log", "unit"), [(log, unit) for log in LOGS if log != "MOT" for unit in UNITS])
def test_times_in_another_unit_are_refused(tmp_path: Path, strait: Scene, log: str, unit: str) -> None:
    name, text = LOGS[log]
    times = [time * UNITS[unit] for time in np.arange(0, 4.6, 0.2).round(1).tolist()]
    (tmp_path / name).write_text(text(times).replace(NAME, "boat"))
    seem = f"22 of 23 frames are before or after the scene: they seem to be {unit}, must be seconds"
    with pytest.raises(InputError, match="are these nanoseconds" if unit == "nanoseconds" else seem):
        on_scene(read_log(tmp_path / name), strait, "bow")


@pytest.mark.parametrize("start_s", [None, 1.7e9])
def test_nanoseconds_that_would_be_in_the_future_are_named(tmp_path, strait, monkeypatch, start_s) -> None:
    monkeypatch.setattr(SceneClock, "of", lambda scene: SceneClock(10.0, 0.0, start_s))
    path = tmp_path / "log.csv"
    for scale, says in ((1e9, "they seem to be nanoseconds, must be seconds"), (1e10, "they are in the future")):
        path.write_text(csv_text([(time * scale) for time in (5.0, 5.2, 5.4)]).replace(NAME, "boat"))
        with pytest.raises(InputError, match=says):
            on_scene(read_log(path), strait, "bow")


def test_a_log_of_which_most_is_outside_of_the_scene_is_refused(tmp_path: Path, strait: Scene) -> None:
    path = tmp_path / "log.csv"
    for start, stop, says in ((-3.0, 3.2, ""), (-4.0, 3.4, "20 of 38"), (2.0, 9.0, "22 of 36")):
        times = np.arange(start, stop + 0.1, 0.2).round(1).tolist()
        path.write_text(csv_text(times).replace(NAME, "boat"))
        said = f"{says} frames are before or after the scene; give a part of the log"
        with pytest.raises(InputError, match=said) if says else nullcontext():
            assert len(on_scene(read_log(path), strait, "bow").time_s) == len(times)


Frames = Mapping[float, Sequence[tuple[Any, ...]]]
FRAMES = {time: [(115.0, 520.0, 30.0, 40.0, "boat", 0.5)] for time in TIMES}


def bag(folder: Path, topics: tuple[str, ...], *, old=False, theta=0.0, sqlite=False, frames: Frames = FRAMES) -> Path:
    """A bag of the detections at each time on each topic, with the vision_msgs 4 of Humble or those of Foxy."""
    types = dict(VISION_MSGS)
    if old:
        types["vision_msgs/msg/BoundingBox2D"] = "geometry_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n"
        result = "vision_msgs/msg/ObjectHypothesisWithPose"
        types[result] = "string id\nfloat64 score\ngeometry_msgs/PoseWithCovariance pose\n"
        for name in ("ObjectHypothesis", "Pose2D", "Point2D"):
            del types[f"vision_msgs/msg/{name}"]
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in types.items():
        store.register(get_types_from_msg(text, name))

    def make(name: str, *values: Any) -> Any:
        return store.types[name.replace("/", "/msg/")](*values)

    zero = make("geometry_msgs/Point", 0.0, 0.0, 0.0), make("geometry_msgs/Quaternion", 0.0, 0.0, 0.0, 1.0)
    pose = make("geometry_msgs/PoseWithCovariance", make("geometry_msgs/Pose", *zero), np.zeros(36))

    def detection(header: Any, x: float, y: float, width: float, height: float, label: str, score: float) -> Any:
        if old:
            centre, kind = make("geometry_msgs/Pose2D", x, y, theta), (label, score)
        else:
            centre = make("vision_msgs/Pose2D", make("vision_msgs/Point2D", x, y), theta)
            kind = (make("vision_msgs/ObjectHypothesis", label, score),)
        box = make("vision_msgs/BoundingBox2D", centre, width, height)
        results = [make("vision_msgs/ObjectHypothesisWithPose", *kind, pose)]
        return make("vision_msgs/Detection2D", header, results, box, "")

    plugin = StoragePlugin.SQLITE3 if sqlite else StoragePlugin.MCAP
    with Writer(folder, version=8, storage_plugin=plugin) as writer:
        for topic in topics:
            connection = writer.add_connection(topic, DETECTIONS_2D, typestore=store)
            for time, found in frames.items():
                stamp = make("builtin_interfaces/Time", int(time), round(time % 1 * 1e9))
                header = make("std_msgs/Header", stamp, "bow")
                message = make("vision_msgs/Detection2DArray", header, [detection(header, *each) for each in found])
                writer.write(connection, round(time * 1e9), store.serialize_cdr(message, DETECTIONS_2D))
    return folder


@pytest.mark.parametrize("old", [False, True])
def test_results_of_old_and_new_vision_msgs_are_read_and_turned_boxes_refused(tmp_path: Path, old: bool) -> None:
    found = read_log(bag(tmp_path / "upright", ("/bow/detections",), old=old))
    assert (found.time_s.tolist(), found.labels, found.confidence.tolist()) == (TIMES, ("boat",), [0.5] * 3)
    np.testing.assert_array_equal(found.boxes_px, [[100, 500, 130, 540]] * 3)
    with pytest.raises(InputError, match=r"/bow/detections at 0 s, \[0\]: bbox.center.theta must be 0, .*\(got 0.3\)"):
        read_log(bag(tmp_path / "bag", ("/bow/detections",), old=old, theta=0.3))
    assert len(read_log(bag(tmp_path / "half turn", ("/bow/detections",), old=old, theta=np.pi)).frame) == 3


def test_two_topics_of_one_camera_and_boxes_whose_rows_are_counted_from_below_are_named(tmp_path: Path) -> None:
    for topics, camera in ((("/bow/detections", "/bow/filtered"), "'bow'"), (("/detections", "/filtered"), "null")):
        said = f"{topics[0]} and {topics[1]} are both of camera {camera}: give a bag with one"
        with pytest.raises(InputError, match=said):
            read_log(bag(tmp_path / topics[1][1:5], topics))
    folder = bag(tmp_path / "bag", ("/bow/detections",), sqlite=True)
    assert len(read_log(folder / "bag.db3").frame) == 3
    (folder / "metadata.yaml").unlink()
    with pytest.raises(InputError, match=r"metadata\.yaml is missing beside it: give the whole folder of the bag"):
        read_log(folder / "bag.db3")
    scene = load_scene(strait_scene(tmp_path / "scene"))
    found = Voyage.of(scene, "bow", {"clock_s": 0.0, "pitch_deg": 0.0, "yaw_deg": 0.0}).detections(0)
    x_min, y_min, x_max, y_max = found.boxes_px.T
    height = scene.cameras[0].intrinsics.image_size_px[1]
    below_px = np.column_stack([x_min, height - y_max, x_max, height - y_min])
    right, below = (
        on_scene(read_log(written(tmp_path / name, found.times_s[found.frame], px)), scene, "bow")
        for name, px in (("right.csv", found.boxes_px), ("below.csv", below_px))
    )
    assert not [note for note in labelled_voyage(right).labelled.notes if "half of them lie" in note]
    with pytest.raises(InputError, match="y is counted from the lower edge"):
        labelled_voyage(below)
