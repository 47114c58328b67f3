"""The counts of a run, in all and by camera, against a slow count of its frames."""

import json
from collections import Counter, defaultdict
from dataclasses import asdict

import numpy as np
import pytest

from modsim3d import Frame, RunDirectoryError, RunResult, Scene, load_scene, open_run, run_scene, simulate_frames
from modsim3d.core.boxes import iou
from tests.run_folders import edited_run
from tests.scenes import mistaken_strait

OF_A_VESSEL = ("true", "merged", "split")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    path = mistaken_strait(tmp_path_factory.mktemp("scene"), 60)
    far_off = {f"detector.states.{state}.box_error.covariance": np.diag([4000.0] * 4) for state in ("clear", "haze")}
    return load_scene(path, source="analytic", settings=far_off)


@pytest.fixture(scope="module")
def result(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    return run_scene(scene, tmp_path_factory.mktemp("runs") / "run")


def counted(frame: Frame) -> dict[str, int]:
    truth, found = frame.truth, frame.detections
    of_vessel = dict(zip(truth.vessels, range(len(truth)), strict=True))
    mine = [i for i in range(len(found)) if found.kinds[i] in OF_A_VESSEL]
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


def test_counts_of_each_camera_are_those_of_its_frames(scene: Scene, result: RunResult) -> None:
    by_camera: dict[str, Counter[str]] = defaultdict(Counter)
    for frame in simulate_frames(scene):
        by_camera[frame.camera].update(counted(frame))
    assert list(result.camera_counts) == list(by_camera) == ["bow", "quay"]
    for camera, slow in by_camera.items():
        fast = asdict(result.camera_counts[camera])
        assert {name: fast[name] for name in slow} == slow
        assert slow["detected"] > slow["below_half_iou"] > slow["off_vessel"] > 20


def test_run_json_has_the_counts_of_all_cameras_and_of_each(result: RunResult) -> None:
    data = json.loads((result.folder / "run.json").read_text())
    assert data["counts"] == asdict(result.counts)
    assert data["camera_counts"] == {name: asdict(counts) for name, counts in result.camera_counts.items()}
    for name in data["counts"].keys() - {"largest_curvature_px"}:
        assert data["counts"][name] == sum(counts[name] for counts in data["camera_counts"].values()), name


def test_a_camera_without_counts_is_refused_unless_the_run_is_of_the_format_before(result, tmp_path):
    for name, wrong in {"one": {"bow": asdict(result.camera_counts["bow"])}, "none": None}.items():
        with pytest.raises(RunDirectoryError, match="must have every count of every camera"):
            open_run(edited_run(result.folder, tmp_path / name, camera_counts=wrong))
    counts = {name: count for name, count in asdict(result.counts).items() if name != "off_vessel"}
    old = edited_run(result.folder, tmp_path / "old", format=1, counts=counts, camera_counts=None)
    assert open_run(old).tables()["truth"].equals(open_run(result.folder).tables()["truth"])
