"""Frames: time, classes, tables and what `supervision` takes; a user's code passes `mypy --strict`."""

import importlib.util
import os
import subprocess
import sys
import types
import warnings
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

import modsim3d
from modsim3d.core.errors import ModsimError
from modsim3d.detector.file.reading import shipped_detectors
from tests.scenes import write_scene


@dataclass
class Detections:
    """The fields of `supervision.Detections`, version 0.31, and what it checks of them."""

    xyxy: Any
    mask: Any = None
    confidence: Any = None
    class_id: Any = None
    tracker_id: Any = None
    data: Any = None

    def __post_init__(self) -> None:
        n = len(self.xyxy)
        assert self.xyxy.shape == (n, 4)
        for values in (self.confidence, self.class_id, self.tracker_id, *self.data.values()):
            assert values is None or (isinstance(values, np.ndarray) and values.shape == (n,))


@pytest.fixture
def supervision(monkeypatch):
    """The library where it is installed (it is large), else a stand-in with the same fields."""
    if importlib.util.find_spec("supervision"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it says that OpenCV is missing
            import supervision

        return supervision
    module = types.ModuleType("supervision")
    module.Detections = Detections
    monkeypatch.setitem(sys.modules, "supervision", module)
    return module


@pytest.fixture(scope="module")
def frames(scene):
    return list(modsim3d.simulate_frames(scene))


def test_time_is_counted_in_seconds_from_the_first_step_and_read_back_like_classes(scene, frames, folder):
    assert frames[0].time_s == 0
    for made, read in zip(frames, modsim3d.open_run(folder).frames(), strict=True):
        assert made.time_s == pytest.approx(float(made.timestamp) - float(frames[0].timestamp))
        assert made.time_s == read.time_s == scene.times_s(made.step, made.step + 1)[0]
        assert made.camera in ("bow", "quay")
        np.testing.assert_array_equal(made.truth.class_id, read.truth.class_id)
        np.testing.assert_array_equal(made.detections.class_id, read.detections.class_id)


def test_class_id_is_the_place_of_the_label_in_the_detectors(tmp_path):
    """Of a scene with a vessel of each of three labels, whose detector confuses them."""
    labels = modsim3d.load_detector("three_labels").labels
    vessels = {f"v{i}": {"length_m": 10, "beam_m": 4, "air_draft_m": 5, "label": labels[i]} for i in range(3)}
    tracks = {f"v{i}": [[0, 100, 20 * (i - 1)], [100, 120, 20 * (i - 1)]] for i in range(3)}
    keys = {"vessels": vessels, "poses": {"tracks": tracks}, "detector": str(shipped_detectors()["three_labels"])}
    scene = modsim3d.load_scene(write_scene(tmp_path, {}, 100, **keys), source="analytic")
    frames = list(modsim3d.simulate_frames(scene))
    assert {tuple(frame.truth.class_id) for frame in frames} == {(0, 1, 2)}
    assert {i for frame in frames for i in frame.detections.class_id} == {0, 1, 2}
    for frame in frames:
        for part in (frame.truth, frame.detections):
            assert part.class_id.shape == (len(part),) and part.class_id.dtype == np.int64
            assert tuple(scene.detector.labels[i] for i in part.class_id) == part.labels


def test_the_tables_of_all_frames_are_those_of_the_run_and_one_that_is_not_there_is_named(frames, folder):
    for name in ("frames", "truth", "detections"):
        table = modsim3d.open_run(folder).table(name)
        assert isinstance(table, pa.Table) and len(table) > len(frames) - 1, name
        assert pa.concat_tables([frame.table(name) for frame in frames]).equals(table), name
    run = modsim3d.open_run(folder)
    for part in (frames[0], run):
        with pytest.raises(ModsimError, match=r"there is no table 'truths'.* \(did you mean 'truth'\?\)"):
            part.table("truths")
    assert len(run.table("ownship")) == 30
    for camera, step, said in (
        ("bough", 3, "there is no camera 'bough'"),
        ("bow", 30, "there is no step 30; it has steps 0 to 29"),
        ("bow", -1, "there is no step -1"),
        ("quay", 0, "camera 'quay' took no frame at step 0"),
    ):
        with pytest.raises(ModsimError, match=said):
            run.frame(camera, step)
    assert (run.frame("quay", 1).camera, run.frame("quay", 1).step) == ("quay", 1)


def test_supervision_gets_a_copy_of_the_detections_and_of_the_truth_that_is_annotated(frames, supervision):
    assert any(len(frame.detections) > 2 for frame in frames)
    one = frames[0].detections
    nothing = replace(one, **{field.name: getattr(one, field.name)[:0] for field in fields(one)})
    for frame in (*frames, replace(frames[0], detections=nothing)):
        truth, boxes_px = frame.truth, frame.detections.boxes_px.copy()
        found, true = frame.to_supervision(), frame.truth_to_supervision()
        assert isinstance(found, supervision.Detections) and isinstance(true, supervision.Detections)
        np.testing.assert_array_equal(found.xyxy, boxes_px)
        np.testing.assert_array_equal(found.confidence, frame.detections.confidence)
        np.testing.assert_array_equal(found.class_id, frame.detections.class_id)
        assert tuple(found.data["class_name"]) == frame.detections.labels
        assert found.tracker_id is None and "vessel" not in found.data  # a tracker must not read it
        found.xyxy[:] = 0
        np.testing.assert_array_equal(frame.detections.boxes_px, boxes_px)
        np.testing.assert_array_equal(true.xyxy, truth.boxes_px[truth.annotated])
        vessels = [name for name, kept in zip(truth.vessels, truth.annotated, strict=True) if kept]
        assert [frame.scene_vessels[i] for i in true.tracker_id] == vessels == list(true.data["vessel"])
        assert np.isfinite(true.xyxy).all() and true.confidence is None and len(true.class_id) == len(vessels)


@pytest.mark.parametrize("name", ["to_supervision", "truth_to_supervision"])
def test_without_supervision_one_is_told_what_to_install(frames, monkeypatch, name):
    monkeypatch.setitem(sys.modules, "supervision", None)
    with pytest.raises(ModsimError, match=r"pip install 'modsim3d\[supervision\]'"):
        getattr(frames[0], name)()


USER = """
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import modsim3d


def boxes(name: str) -> list[NDArray[np.float64]]:
    scene: modsim3d.Scene = modsim3d.load_scene(name, steps=2, detector=Path("thesis"))
    return [frame.detections.boxes_px for frame in modsim3d.simulate_frames(scene)]


def detected(scene: modsim3d.Scene) -> int:
    result = modsim3d.run_scene(scene, "runs/a")
    run = modsim3d.open_run(result.folder)
    other = modsim3d.detect_run(run, Path("runs/b"), detector="thesis", seed=7)
    good: bool = modsim3d.verify_run("runs/b").obeys and modsim3d.verify_run(run).obeys
    labels: tuple[str, ...] = modsim3d.load_detector("thesis").labels
    learned = modsim3d.learn_detector(truth="gt.json", detections=["dt.json"], match="centre")
    learned.write(Path("learned.yaml"), overwrite=good)
    seconds: float = next(run.frames()).time_s + len(labels) + len(modsim3d.__version__)
    return result.counts.detected + other.counts.detected + int(seconds)
"""
WRONG = {
    "modsim3d.load_scen('strait')\n": 'Module has no attribute "load_scen"',
    "modsim3d.load_scene(3)\n": 'has incompatible type "int"',
    "modsim3d.learn_detector(run='runs/a', match='iou')\n": "has incompatible type \"Literal['iou']\"",
}
SETTINGS = """
[mypy]
strict = true
follow_imports = skip
[mypy-modsim3d.*,numpy.*]
follow_imports = silent
"""
"""The package's own modules are not reported on, as those of an installed one. Its other dependencies, most of what
there is to read, are left out: nothing that a user writes here has a type of theirs."""


def test_strict_types_hold_for_a_user(tmp_path: Path) -> None:
    wrong = "import modsim3d\n\n" + "".join(WRONG)
    for name, text in (("user.py", USER), ("wrong.py", wrong), ("mypy.ini", SETTINGS)):
        (tmp_path / name).write_text(text)
    paths = {**os.environ, "MYPYPATH": str(Path(modsim3d.__file__).parents[1])}
    command = [sys.executable, "-m", "mypy", "--config-file", "mypy.ini", "--cache-dir", "cache", "user.py", "wrong.py"]
    said = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path, env=paths).stdout
    found = [line for line in said.splitlines() if ": error:" in line]
    assert [line for line in found if "wrong.py" not in line] == []
    for number, words in enumerate(WRONG.values(), 3):
        assert any(f"wrong.py:{number}:" in line and words in line for line in found), said
