"""The JSON of a run, against a dictionary for each row; the file for a tracker has nothing of the truth."""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pytest

from modsim3d import Scene, load_scene, run_scene
from modsim3d.core.arrays import Indices
from modsim3d.core.boxes import centre_form
from modsim3d.detector.records import DUPLICATE, FRAGMENT, KINDS, Detections
from modsim3d.runs.blocks import Block, CameraBlock
from modsim3d.runs.files.block_files import annotation_lines, detection_lines, join_lines
from modsim3d.runs.files.run_file import ROWS_AT_ONCE, list_texts, number_texts, string_texts
from modsim3d.runs.pipeline import Simulation, scene_statistics, truth_block
from modsim3d.runs.tracker_view import TrackerDetections, anonymised, tracker_lines
from modsim3d.truth.record import annotation_boxes

Made = tuple[Scene, Block]


@pytest.fixture(scope="module", params=["strait", "simulation_3"])
def made(request: pytest.FixtureRequest) -> Made:
    """Two cameras and second boxes of a vessel; and frames without anything."""
    keys = {"duplicates": 0.5, "splits": 0.2, "split_aspect": 2, "merges": 0.5} if request.param == "strait" else {}
    settings = {f"detector.false_positives.{key}": value for key, value in keys.items()}
    scene = load_scene(request.param, steps=24, source="analytic", settings=settings)
    truth = truth_block(scene, 0, 24, None)
    return scene, Simulation(scene, scene_statistics(scene, [(truth, 0, 24)])).detect(truth, 0, 24)


def plain_annotations(block: Block, part: CameraBlock, scene: Scene) -> list[bytes]:
    truth, entries = part.truth, [{} for _ in part.steps]
    boxes = centre_form(annotation_boxes(truth, scene.annotation.mode)).tolist()
    for row in part.target_rows.tolist():
        vessel, frame = scene.vessels[truth.vessel[row]], part.steps.tolist().index(truth.step[row])
        box = {**plain_box(boxes[row]), "depth": float(truth.depth_m[row])}
        entries[frame][vessel.name] = {"label": vessel.label, "bbox": box}
    return plain_lines(block, part, entries)


def plain_detections(block: Block, part: CameraBlock, scene: Scene) -> list[bytes]:
    found, entries = part.detections, [{} for _ in part.steps]
    boxes, confidence = centre_form(found.boxes_px).tolist(), found.confidence.tolist()
    for row in np.argsort(np.isin(found.kind, (DUPLICATE, FRAGMENT)), kind="stable").tolist():
        entry, source = entries[found.frame[row]], part.truth_row[row]
        entry[free_key(entry, scene.vessel_names[part.truth.vessel[source]] if source >= 0 else None)] = {
            "label": scene.detector.labels[found.label[row]], "confidenceScore": confidence[row],
            "bbox": plain_box(boxes[row]),
        }  # fmt: skip
    return plain_lines(block, part, entries)


def plain_tracker_lines(block: Block, part: CameraBlock, scene: Scene) -> list[bytes]:
    told, labels, lines = TrackerDetections.of(part.detections), scene.detector.labels, []
    times_s = scene.times_s(block.first, block.stop)
    boxes, confidence = told.boxes_px.tolist(), told.confidence.tolist()
    for frame, step in enumerate(part.steps.tolist()):
        entries = [
            {"box_px": boxes[row], "label": labels[told.label[row]], "confidence": confidence[row]}
            for row in np.flatnonzero(told.frame == frame).tolist()
        ]
        time_s = float(times_s[step - block.first])
        lines.append(orjson.dumps({"time_s": time_s, "step": step, "detections": entries}) + b"\n")
    return lines


def free_key(entry: dict[str, Any], vessel: str | None) -> str:
    prefix, number = ("false_positive_", 1) if vessel is None else (f"{vessel}#", 2)
    if vessel is not None and vessel not in entry:
        return vessel
    while f"{prefix}{number}" in entry:
        number += 1
    return f"{prefix}{number}"


def plain_box(box: Sequence[float]) -> dict[str, Any]:
    return {"centre": {"x": box[0], "y": box[1]}, "height": box[3], "width": box[2]}


def plain_lines(block: Block, part: CameraBlock, entries: list[dict[str, Any]]) -> list[bytes]:
    timestamps = [block.timestamps[step - block.first] for step in part.steps]
    return [orjson.dumps({timestamp: entry}) + b"\n" for timestamp, entry in zip(timestamps, entries, strict=True)]


@pytest.mark.parametrize("at_once", [1, 7, ROWS_AT_ONCE])
@pytest.mark.parametrize(("fast", "plain"), [
    (annotation_lines, plain_annotations), (detection_lines, plain_detections), (tracker_lines, plain_tracker_lines),
])  # fmt: skip
def test_lines_are_those_of_a_dictionary_for_each_row_however_many_at_once(made, fast, plain, at_once, monkeypatch):
    monkeypatch.setattr("modsim3d.runs.files.run_file.ROWS_AT_ONCE", at_once)
    scene, block = made
    for part in block.cameras:
        assert fast(block, part, scene) == b"".join(plain(block, part, scene))


def test_names_are_escaped_a_missing_depth_is_null_and_texts_of_numbers_are_the_shortest(made):
    scene, block = made
    text = b"".join(detection_lines(block, part, scene) for part in block.cameras)
    assert (b'#2":' in text and b'"false_positive_1":' in text) == (scene.name == "strait")
    assert (b":{}}" in text) == (scene.name == "simulation_3")  # and frames without anything
    odd = replace(scene, vessels=tuple(replace(vessel, name=f'"ø\n{vessel.name}') for vessel in scene.vessels))
    for part in block.cameras:
        shallow = replace(part, truth=replace(part.truth, depth_m=np.full(len(part.truth), np.nan)))
        assert annotation_lines(block, shallow, odd) == b"".join(plain_annotations(block, shallow, odd))
        assert detection_lines(block, shallow, odd) == b"".join(plain_detections(block, shallow, odd))
    numbers = [0.0, -0.0, 1e-7, 1e22, 0.1 + 0.2, 1800.0, 5e-324, float("nan")]
    assert number_texts(np.array(numbers)) == [orjson.dumps(number) for number in numbers]
    assert number_texts(np.empty(0)) == []
    assert list_texts(np.array([[1.5, 2.0], [1e-7, np.nan]])) == [b"1.5,2.0", b"1e-7,null"]
    assert list_texts(np.empty((0, 4))) == []
    for strings in ([], ["0.0"], ['a",\n  "b', "", ",\n  ", "\\", 'ø"', "[\n"]):
        assert string_texts(strings) == [orjson.dumps(string) for string in strings]


@pytest.mark.parametrize("at_a_time", [1, 2, 7, 1 << 22])
@pytest.mark.parametrize("entries", [[], [{}], [{}, {"a": {"b": "}\n{"}}, {}], [{"a": 1}] * 9])
def test_joined_lines_are_one_object(entries, at_a_time, tmp_path, monkeypatch):
    monkeypatch.setattr("modsim3d.runs.files.block_files.JOINED_BYTES", at_a_time)
    content = {str(number): entry for number, entry in enumerate(entries)}
    lines = tmp_path / "lines.jsonl"
    lines.write_bytes(b"".join(orjson.dumps({key: entry}) + b"\n" for key, entry in content.items()))
    with (tmp_path / "out.json").open("wb") as out:
        join_lines(lines, out)
    joined = (tmp_path / "out.json").read_bytes()
    assert orjson.loads(joined) == content
    between = b",\n".join(orjson.dumps({key: entry})[1:-1] for key, entry in content.items())
    assert joined == (b"{\n" + between + b"\n}\n" if content else b"{}\n")


def told_to_a_tracker(path: Path) -> tuple[list[float], dict[int, list[dict[str, Any]]]]:
    """Times in seconds, and step → detections, from one line after another, as a tracker would take them."""
    frames = [json.loads(line) for line in path.read_bytes().splitlines()]
    assert all(list(frame) == ["time_s", "step", "detections"] for frame in frames)
    times_s = [frame["time_s"] for frame in frames]
    assert (np.diff(times_s) > 0).all()
    return times_s, {frame["step"]: frame["detections"] for frame in frames}


@pytest.mark.parametrize("camera", ["bow", "quay"])
def test_a_tracker_gets_every_detection_of_every_frame_and_nothing_of_the_truth(strait_run, camera):
    path = strait_run.folder / f"tracker_input_{camera}.jsonl"
    times_s, seen = told_to_a_tracker(path)
    frames = [frame for frame in strait_run.frames() if frame.camera == camera]
    assert list(seen) == [frame.step for frame in frames]
    np.testing.assert_allclose(times_s, [float(frame.timestamp) for frame in frames])
    assert sum(map(len, seen.values())) > 50
    for frame in frames:
        found, given = frame.detections, seen[frame.step]
        boxes, confidence = np.round(found.boxes_px, 3).tolist(), np.round(found.confidence, 6).tolist()
        expected = [repr(entry) for entry in zip(boxes, found.labels, confidence, strict=True)]
        told = [repr((entry["box_px"], entry["label"], entry["confidence"])) for entry in given]
        assert Counter(told) == Counter(expected)
    text, names = path.read_text(), set(strait_run.scene.vessel_names) - set(strait_run.scene.detector.labels)
    assert not [word for word in (*names, *KINDS[1:], "vessel", "kind") if f'"{word}' in text]
    for entries in seen.values():
        assert all(list(entry) == ["box_px", "label", "confidence"] for entry in entries)
        keys = [(-entry["confidence"], entry["box_px"], entry["label"]) for entry in entries]
        assert keys == sorted(keys)
        assert all(edge == round(edge, 3) for entry in entries for edge in entry["box_px"])  # no last bits


def test_frames_without_detections_are_there_and_lines_do_not_depend_on_where_they_came_from(tmp_path, strait_run):
    run_scene(load_scene("simulation_3", steps=20, source="analytic"), tmp_path / "run")
    assert told_to_a_tracker(tmp_path / "run" / "tracker_input_C1.jsonl")[1] == {step: [] for step in range(20)}
    scene, steps = strait_run.scene, strait_run.steps
    truth = truth_block(scene, 0, steps, None)
    block = Simulation(scene, scene_statistics(scene, [(truth, 0, steps)])).detect(truth, 0, steps)
    for part in block.cameras:
        found = part.detections
        by_origin = permuted(found, np.lexsort((found.target, found.kind, found.frame)))
        by_size = permuted(found, np.lexsort((found.boxes_px[:, 0], found.frame)))
        nobody = np.full(len(found), -1)
        unknown = replace(found, target=nobody, partner=nobody, kind=np.ones_like(found.kind))
        expected = tracker_lines(block, part, scene)
        for other in (by_origin, by_size, unknown):
            assert tracker_lines(block, replace(part, detections=other), scene) == expected


def permuted(detections: Detections, order: Indices) -> Detections:
    columns = ("frame", "target", "partner", "kind", "label", "confidence", "boxes_px", "errors_px", "redrawn")
    return replace(detections, **{name: getattr(detections, name)[order] for name in columns})


@pytest.mark.parametrize("count", [0, 1, 300])
def test_detections_are_told_by_frame_confidence_box_and_label(count: int) -> None:
    rng = np.random.default_rng(count)
    frame, label = np.sort(rng.integers(0, 9, count)), rng.integers(0, 3, count)
    boxes, confidence = rng.integers(0, 2, (count, 4)) / 1.0, rng.integers(0, 3, count) / 2
    found = anonymised(frame, label, boxes, confidence)
    given = frame, -confidence, boxes, label
    told = found.frame, -found.confidence, found.boxes_px, found.label
    rows, expected = (list(zip(*map(np.ndarray.tolist, columns), strict=True)) for columns in (told, given))
    assert rows == sorted(expected)
