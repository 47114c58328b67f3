"""The outcome of each detection, in rows, frames and counts; a camera that sees no vessel is warned of."""

import json
import re
from collections import Counter, defaultdict
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from modsim3d import RunDirectoryError, RunRows, Scene, load_scene, open_run, run_scene, simulate_frames
from modsim3d.cli.run_summary import run_warnings
from modsim3d.core.boxes import iou
from modsim3d.runs.camera_sequences import blind_at_first
from modsim3d.runs.counts import Outcome, frame_outcomes, having, outcomes
from modsim3d.runs.frames import detected_rows
from modsim3d.scene.reading import shipped_scenes
from tests.cli.bad_input.builders import at, lens
from tests.run_folders import edited_run
from tests.scenes import mistaken_strait

VESSEL = [100.0, 100.0, 120.0, 110.0]
BAD, OFF = Outcome.BELOW_HALF_IOU, Outcome.BELOW_HALF_IOU | Outcome.OFF_VESSEL


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    far_off = {f"detector.states.{state}.box_error.covariance": np.diag([4000.0] * 4) for state in ("clear", "haze")}
    return load_scene(mistaken_strait(tmp_path_factory.mktemp("scene")), settings=far_off)


@pytest.fixture(scope="module")
def result(scene, tmp_path_factory):
    return run_scene(scene, tmp_path_factory.mktemp("outcomes") / "run")


@pytest.fixture(scope="module")
def run(result):
    return open_run(result.folder)


def test_a_box_is_right_bad_or_off_its_vessel_by_iou_and_of_a_false_positive_nothing_else_is_said():
    for box, expected in (
        (VESSEL, 0),
        ([100, 100, 110, 110], 0),  # IoU is 0.5: not below it
        ([100, 100, 109.9, 110], BAD),
        ([119.9, 109.9, 140, 120], BAD),
        ([120, 100, 140, 110], OFF),  # the boxes share an edge only
        ([300, 100, 320, 110], OFF),
    ):
        for mislabelled, flag in ((False, 0), (True, Outcome.MISLABELLED)):
            (found,) = outcomes(np.array([False]), np.array([mislabelled]), np.array([box]), np.array([VESSEL]))
            assert found == expected | flag, box
    yes, nothing = np.array([True]), np.full((1, 4), np.nan)
    assert outcomes(yes, yes, np.array([VESSEL]), nothing).tolist() == [Outcome.FALSE_POSITIVE]


def test_rows_and_frames_agree_on_outcomes_of_every_kind_and_a_second_box_is_a_false_positive(run):
    rows = RunRows.of(run)
    assert [outcome for frame in run.frames() for outcome in frame_outcomes(frame)] == rows.outcomes.tolist()
    vessels = rows.truth_vessel[rows.detected_row[rows.detected_row >= 0]]
    of_frames = [frame.truth.vessels[row] for frame in run.frames() for row in detected_rows(frame) if row is not None]
    assert [run.scene.vessel_names[vessel] for vessel in vessels] == of_frames
    kinds = set(run.tables()["detections"]["kind"].to_pylist())
    assert kinds >= {"duplicate", "merged", "split", "fragment", "false_positive"}
    names = ("false_positives", "mislabelled", "below_half_iou", "off_vessel")
    sums = [having(rows.outcomes, flag).sum() for flag in Outcome]
    assert sums == [run.settings["counts"][name] for name in names] and min(sums) > 5
    seconds = 0
    for frame in run.frames():
        of_frame = zip(frame.detections.kinds, frame.detections.vessels, frame_outcomes(frame), strict=True)
        for kind, vessel, outcome in of_frame:
            if kind in ("duplicate", "fragment"):
                assert vessel is not None and outcome == Outcome.FALSE_POSITIVE
                seconds += 1
    assert seconds
    frame = next(frame for frame in run.frames() if "false_positive" in frame.detections.kinds)
    truth = replace(frame.truth, vessels=(), labels=())
    detections = replace(frame.detections, vessels=(None,) * len(frame.detections))
    assert set(frame_outcomes(replace(frame, truth=truth, detections=detections))) == {Outcome.FALSE_POSITIVE}


def counted(frame):
    truth, found = frame.truth, frame.detections
    of_vessel = dict(zip(truth.vessels, range(len(truth)), strict=True))
    mine = [i for i in range(len(found)) if found.kinds[i] in ("true", "merged", "split")]
    rows = [of_vessel[found.vessels[i]] for i in mine]
    overlaps = [float(iou(found.boxes_px[i], truth.boxes_px[row])) for i, row in zip(mine, rows, strict=True)]
    return {
        "frames": 1,
        "annotated": int(truth.annotated.sum()),
        "detected": int(truth.detected.sum()),
        "false_positives": len(found) - len(mine),
        "mislabelled": sum(found.labels[i] != truth.labels[row] for i, row in zip(mine, rows, strict=True)),
        "below_half_iou": sum(overlap < 0.5 for overlap in overlaps),
        "off_vessel": sum(overlap == 0 for overlap in overlaps),
    }


def test_counts_of_each_camera_are_those_of_its_frames_and_must_be_in_a_run_of_this_format(scene, result, tmp_path):
    by_camera = defaultdict(Counter)
    for frame in simulate_frames(scene):
        by_camera[frame.camera].update(counted(frame))
    assert list(result.camera_counts) == list(by_camera) == ["bow", "quay"]
    for camera, slow in by_camera.items():
        fast = asdict(result.camera_counts[camera])
        assert {name: fast[name] for name in slow} == slow
        assert slow["detected"] > slow["below_half_iou"] > slow["off_vessel"] > 20
    data = json.loads((result.folder / "run.json").read_text())
    assert data["counts"] == asdict(result.counts)
    assert data["camera_counts"] == {name: asdict(counts) for name, counts in result.camera_counts.items()}
    for name in data["counts"].keys() - {"largest_curvature_px"}:
        assert data["counts"][name] == sum(counts[name] for counts in data["camera_counts"].values()), name
    for name, wrong in {"one": {"bow": asdict(result.camera_counts["bow"])}, "none": None}.items():
        with pytest.raises(RunDirectoryError, match="must have every count of every camera"):
            open_run(edited_run(result.folder, tmp_path / name, camera_counts=wrong))
    counts = {name: count for name, count in asdict(result.counts).items() if name != "off_vessel"}
    old = edited_run(result.folder, tmp_path / "old", format=1, counts=counts, camera_counts=None)
    assert open_run(old).tables()["truth"].equals(open_run(result.folder).tables()["truth"])


SIZE = {"length_m": 12.0, "beam_m": 4.0, "air_draft_m": 3.0, "label": "Vessel"}
BOATS = {"one": (100.0, 5.0), "two": (150.0, -8.0)}
Keys, Boats = dict[str, Any], dict[str, tuple[float, float]]


def scene_of(folder: Path, mount: Keys, boats: Boats | None = None, **more: Any) -> Scene:
    """A vessel that carries a camera 4 m above the sea and looks along w1, and boats that lie still."""
    boats = BOATS if boats is None else boats
    tracks = {name: [[0, w1, w2], [6, w1, w2 + 1]] for name, (w1, w2) in boats.items()}
    content = {
        "steps": 12, "time_step_s": 0.5, "vessels": dict.fromkeys(("own", *boats), SIZE),
        "poses": {"tracks": {"own": [[0, 0, 0], [6, 6, 0]], **tracks}},
        "cameras": {"bow": lens(mount={"vessel": "own", "position_m": [4.0, 0.0, 4.0], **mount})},
        "annotation": {"mode": 2, "source": "analytic"}, "detector": "thesis", **more,
    }  # fmt: skip
    (folder / "scene.yaml").write_text(yaml.dump({key: value for key, value in content.items() if value is not None}))
    return load_scene(folder / "scene.yaml")


BLIND: dict[str, tuple[Keys, Boats | None, str]] = {
    "the sign of the pitch": (
        {"pitch_rad": -0.6}, None, r"looks 34\.4° above the horizon, towards heading 0\.0° .* positive pitch_rad looks "
        "down.*vessels: 2 ahead of it but below the picture",
    ),
    "down": ({"pitch_rad": 0.9}, None, r"51\.6° below the horizon.* 2 ahead of it but above the picture"),
    "to port": ({"yaw_rad": 1.0}, None, r"along the horizon, towards heading 57\.3°.* 2 ahead of it but right of"),
    "to starboard": ({"yaw_rad": -1.0}, None, r"towards heading -57\.3°.* 2 ahead of it but left of the picture"),
    "astern": ({"yaw_rad": np.pi}, None, r"towards heading (-)?180\.0°.* 2 behind it"),
    "far away": ({}, {"far": (30_000.0, 0.0)}, "1 in the picture but smaller than a pixel"),
    "nobody there": ({}, {}, "there is no vessel but the one that carries it"),
}  # fmt: skip


@pytest.mark.parametrize("why", BLIND)
def test_a_blind_camera_is_warned_of_with_the_reason(tmp_path: Path, why: str) -> None:
    mount, boats, said = BLIND[why]
    scene = scene_of(tmp_path, mount, boats)
    (at_first,) = blind_at_first(scene)
    assert at_first.startswith("camera 'bow' sees no vessel in the 12 frames looked at: it looks ")
    assert re.search(said, at_first), at_first
    result = run_scene(scene, tmp_path / "run")
    if why == "far away":  # exact geometry sees it: less than a pixel of it
        assert result.counts.seen == 12
    else:
        assert run_warnings(scene, result)[0] == at_first.replace("the 12 frames looked at", "its 12 frames")


WALLS = {
    "analytic": {"polygon_m": [[50, -100], [52, -100], [52, 100], [50, 100]], "height_m": 80},
    "rendered": {"mesh": "ferry", "size_m": [200, 2, 80], "position_m": [50, 0, 0], "heading_rad": 1.5708},
}


@pytest.mark.parametrize("source", WALLS)
def test_a_camera_behind_a_wall_is_told_that_vessels_are_hidden(tmp_path: Path, source: str) -> None:
    scene = scene_of(tmp_path, {}, obstacles={"wall": WALLS[source]}, annotation={"mode": 2, "source": source})
    for (warning,) in (blind_at_first(scene), run_warnings(scene, run_scene(scene, tmp_path / "run"))):
        assert warning.endswith("vessels: 2 in the picture but hidden")


def test_of_a_run_without_a_vessel_that_is_said_first_and_a_late_vessel_is_no_reason_to_warn(tmp_path):
    away = lens(pose={"position_m": [-60.0, 0.0, 4.0], "yaw_rad": 3.0})
    up = lens(mount={"vessel": "own", "position_m": [4.0, 0.0, 4.0], "pitch_rad": -0.6})
    scene = scene_of(tmp_path, {}, cameras={"bow": up, "shore": away})
    said = run_warnings(scene, run_scene(scene, tmp_path / "run"))
    blind = [f"camera '{name}' sees no vessel in its 12 frames" for name in ("bow", "shore")]
    assert [line.split(":")[0] for line in said] == ["no camera sees a vessel in this run", *blind]
    assert said[2].endswith("vessels: 3 behind it")
    late = [[0, -50, 5], [200, -51, 5], [290, 100, 5], [300, 101, 5]]
    poses = {"tracks": {"own": [[0, 0, 0], [300, 1, 0]], "late": late}}
    scene = scene_of(tmp_path, {}, {"late": (0.0, 0.0)}, poses=poses, steps=600)
    assert blind_at_first(scene) == []
    assert "sees no vessel" not in " ".join(run_warnings(scene, run_scene(scene, tmp_path / "late")))


def test_of_a_live_scene_it_is_said_after_the_run(tmp_path: Path) -> None:
    with (tmp_path / "live.jsonl").open("w") as file:
        for step in range(4):
            places = {name: at(*place) for name, place in {"own": (step, 0.0), **BOATS}.items()}
            file.write(json.dumps({f"{step}.0": places}) + "\n")
    poses = {"stream": {"file": "live.jsonl", "timeout_s": 0}}
    scene = scene_of(tmp_path, {"pitch_rad": -0.6}, poses=poses, steps=9, time_step_s=None)
    assert blind_at_first(scene) == []
    (warning,) = run_warnings(scene, run_scene(scene, tmp_path / "run"))
    assert warning.startswith("camera 'bow' sees no vessel in its 4 frames: it looks 34.4° above the horizon")
    assert warning.endswith("vessels: 2 ahead of it but below the picture")


@pytest.mark.parametrize("name", shipped_scenes())
def test_every_camera_of_the_shipped_scenes_sees_vessels(name: str) -> None:
    assert blind_at_first(load_scene(name)) == []
