"""The recording for Rerun, read back with Rerun's own reader, holds the run."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from modsim3d import cli
from modsim3d.runs.outcomes import Outcome, detected_rows, frame_outcomes
from modsim3d.runs.run import run_scene
from modsim3d.runs.stored_run import open_run
from modsim3d.scene.reading import load_scene
from modsim3d.view.rerun_recording import write_recording
from tests.scenes import crossing, mistaken_strait

STEPS, EVERY = 14, 2


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("rerun")
    path = crossing(folder, STEPS)
    scene = json.loads(path.read_text())
    scene["obstacles"] = {"pier": {"polygon_m": [[900, 300], [950, 300], [950, 320], [900, 320]], "height_m": 5}}
    path.write_text(json.dumps(scene))
    run_scene(load_scene(str(path), source="analytic"), folder / "run")
    return folder / "run"


def call(monkeypatch, *arguments) -> int:
    monkeypatch.setattr(sys, "argv", ["modsim3d", *map(str, arguments)])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    return int(stopped.value.code)


def read(path: Path) -> dict[str, dict[int | None, dict[str, object]]]:
    """Entity → step (None for what never changes) → component → values."""
    found: dict[str, dict[int | None, dict[str, object]]] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        for row in batch.drop_columns([c for c in ("log_time", "time") if c in batch.schema.names]).to_pylist():
            step = row.get("step")
            found.setdefault(chunk.entity_path, {}).setdefault(step, {}).update(
                {name.rpartition(":")[2]: value for name, value in row.items() if value is not None}
            )
    return found


@pytest.fixture(scope="module")
def recording(run, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "new" / "run.rrd"
    with pytest.MonkeyPatch.context() as monkeypatch:
        assert call(monkeypatch, "rerun", run, "--out", out, "--every", EVERY) == 0
    return read(out)


def test_boxes_and_labels_of_every_shown_frame_are_in_it(run, recording):
    frames = {frame.step: frame for frame in open_run(run).frames()}
    truth = recording["/world/cameras/C0/image/truth"]
    found = recording["/world/cameras/C0/image/detections"]
    assert set(truth) == set(found) == set(range(0, STEPS, EVERY))
    for step, frame in frames.items():
        if step % EVERY:
            continue
        for entity, boxes in ((truth, frame.truth.full_boxes_px), (found, frame.detections.boxes_px)):
            centres = np.reshape(entity[step]["centers"], (-1, 2))
            halves = np.reshape(entity[step]["half_sizes"], (-1, 2))
            np.testing.assert_allclose(np.hstack([centres - halves, centres + halves]), boxes, rtol=1e-5, atol=1e-3)
        names = [text.removesuffix(" missed") for text in truth[step]["labels"]]
        assert names == list(frame.truth.vessels)


def test_detections_say_what_is_wrong_with_them(tmp_path):
    run_scene(load_scene(mistaken_strait(tmp_path)), tmp_path / "run")
    run = open_run(tmp_path / "run")
    write_recording(run, tmp_path / "run.rrd", 10)
    found = read(tmp_path / "run.rrd")
    said: set[str] = set()
    for frame in run.frames():
        if frame.step % 10:
            continue
        image, outcomes, rows = f"/world/cameras/{frame.camera}/image", frame_outcomes(frame), detected_rows(frame)
        off = [i for i, outcome in enumerate(outcomes) if outcome & Outcome.OFF_VESSEL]
        lines = np.reshape(found[f"{image}/off_vessel"][frame.step]["strips"] or [], (-1, 2, 2))
        assert len(lines) == len(off)
        for line, i in zip(lines, off, strict=True):
            box, true_box = frame.detections.boxes_px[i], frame.truth.boxes_px[rows[i]]
            np.testing.assert_allclose(line[0], (box[:2] + box[2:]) / 2, atol=1e-3)
            assert np.all((line[1] >= true_box[:2] - 1e-3) & (line[1] <= true_box[2:] + 1e-3))
        tags = found[f"{image}/detections"][frame.step]["labels"] or []
        for tag, outcome, row in zip(tags, outcomes, rows, strict=True):
            assert tag.startswith("false: ") == bool(outcome & Outcome.FALSE_POSITIVE)
            mislabelled = row is not None and f", is a {frame.truth.labels[row]}" in tag
            assert mislabelled == bool(outcome & Outcome.MISLABELLED)
            assert tag.endswith(", off its vessel") == bool(outcome & Outcome.OFF_VESSEL)
            assert tag.endswith(", IoU below 0.5") == (outcome & ~Outcome.MISLABELLED == Outcome.BELOW_HALF_IOU)
            said |= {flag.name for flag in outcome}
        for name, flag in (
            ("false", Outcome.FALSE_POSITIVE),
            ("wrong_class", Outcome.MISLABELLED),
            ("below_half_iou", Outcome.BELOW_HALF_IOU),
            ("off_vessel", Outcome.OFF_VESSEL),
        ):
            (value,) = found[f"/counts/{frame.camera}/{name}"][frame.step]["scalars"]
            assert value == sum(1 for outcome in outcomes if outcome & flag)
    assert said == {flag.name for flag in Outcome}


def test_vessels_move_and_vanish_as_in_the_scene(run, recording):
    scene = open_run(run).scene
    poses = scene.poses.poses(0, STEPS)
    for index, name in enumerate(scene.vessel_names):
        entity = recording[f"/world/vessels/{name}"]
        for step in range(0, STEPS, EVERY):
            moved = "translation" in entity.get(step, {})
            assert moved == poses.present[step, index]
            if moved:
                np.testing.assert_allclose(entity[step]["translation"][0], poses.positions_m[step, index], rtol=1e-5)
        vanished = [step for step, row in entity.items() if "is_recursive" in row]
        gone = [
            s for s in range(EVERY, STEPS, EVERY) if poses.present[s - EVERY, index] and not poses.present[s, index]
        ]
        assert vanished == gone
    assert any(
        "is_recursive" in row for name in scene.vessel_names for row in recording[f"/world/vessels/{name}"].values()
    )


def test_camera_is_a_pinhole_that_looks_where_it_does(run, recording):
    scene = open_run(run).scene
    (camera,) = scene.cameras
    lens = recording["/world/cameras/C0/image"][None]
    np.testing.assert_allclose(np.reshape(lens["image_from_camera"], (3, 3)).T, camera.intrinsics.matrix, rtol=1e-6)
    pose = recording["/world/cameras/C0"][0]
    camera_R_world = scene.sight(camera, np.array([0])).camera_poses.camera_R_world[0]
    # Rerun stores matrices column by column: read row by row, this is the transpose of world_R_camera.
    np.testing.assert_allclose(np.reshape(pose["mat3x3"], (3, 3)), camera_R_world, atol=1e-6)


def test_obstacles_stand_where_they_do(recording):
    corners = np.array(recording["/world/obstacles/pier"][None]["vertex_positions"]).reshape(-1, 3)
    assert len(corners) == 3 * 12  # a prism over a rectangle
    np.testing.assert_allclose((corners.min(axis=0), corners.max(axis=0)), ((900, 300, 0), (950, 320, 5)))


def test_without_the_sdk_the_error_names_the_extra_and_no_empty_bar_stands_before_it(
    monkeypatch, capsys, run, tmp_path
):
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert call(monkeypatch, "rerun", run, "--out", tmp_path / "x.rrd") == 2
    assert capsys.readouterr().err == "modsim3d: modsim3d rerun needs the Rerun SDK: pip install 'modsim3d[rerun]'\n"


def test_file_that_cannot_be_written_is_one_message(monkeypatch, capsys, run, tmp_path):
    (tmp_path / "file").touch()
    assert call(monkeypatch, "rerun", run, "--out", tmp_path / "file" / "x.rrd") == 2
    assert f"{tmp_path / 'file'} is a file, and x.rrd is to be written into a folder" in capsys.readouterr().err
