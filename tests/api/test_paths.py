"""Paths are text or path objects everywhere, and what is neither is refused by name."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import modsim3d
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.detector.file.reading import shipped_detectors
from modsim3d.io.input_files import data_folder

DETECTORS = data_folder("scenes") / "detectors"


class Plain(os.PathLike[str]):
    """A path object that is no `Path`."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __fspath__(self) -> str:
        return self.text


@pytest.mark.parametrize("of_text", [str, Path, Plain])
def test_every_kind_of_path_is_taken(of_text, tmp_path):
    def kind(path: object) -> object:
        return of_text(str(path))

    assert modsim3d.load_detector(kind(DETECTORS / "thesis.yaml")).labels == ("Vessel",)
    scene = modsim3d.load_scene(kind("simulation_1"), steps=2, source="analytic", detector=kind("thesis"))
    result = modsim3d.run_scene(scene, kind(tmp_path / "a"))
    assert result.folder == tmp_path / "a" and (tmp_path / "a/run.json").is_file()
    assert modsim3d.open_run(kind(tmp_path / "a")).steps == 2
    modsim3d.detect_run(kind(tmp_path / "a"), kind(tmp_path / "b"), detector=kind(DETECTORS / "thesis.yaml"), seed=7)
    (tmp_path / "gt.txt").write_text("1,1,2,3,40,30,1,1,1")
    options = {"image_size_px": (640, 480), "frame_rate_hz": 10}
    modsim3d.detect_truth(kind(tmp_path / "gt.txt"), kind(tmp_path / "c"), detector=kind("thesis"), **options)
    verified = modsim3d.verify_run(kind(tmp_path / "a"), detector=kind("thesis"))
    written = verified.write(kind(tmp_path / "checked"))
    assert written == (tmp_path / "checked/verify.json", tmp_path / "checked/verify.html")
    learned = modsim3d.learn_detector(run=kind(tmp_path / "a"), replicates=20, check=False)
    assert learned.write(kind(tmp_path / "learned.yaml"))[0].is_file()
    assert scene.copy.write(kind(tmp_path / "copy")).is_file()


def wrong_calls() -> dict[str, tuple[Callable[[object], object], str]]:
    """Calls with one wrong argument, and what the message must name."""
    scene = modsim3d.load_scene("simulation_1", steps=2, source="analytic")
    detector, run = "detector: a path or the name of a shipped detector", "run: a run directory or a StoredRun"
    load_scene, learn, detect_truth = modsim3d.load_scene, modsim3d.learn_detector, modsim3d.detect_truth
    paths = "a path or a list of paths"
    return {
        "load_scene": (load_scene, "scene: a path or the name of a shipped scene"),
        "load_scene, detector": (lambda wrong: load_scene("strait", detector=wrong), detector),
        "load_scene, state_from": (lambda it: load_scene("strait", state="haze", state_from=it), "state_from: a path"),
        "load_detector": (modsim3d.load_detector, detector),
        "run_scene": (lambda wrong: modsim3d.run_scene(scene, wrong), "folder: a path"),
        "open_run": (modsim3d.open_run, "folder: a run directory"),
        "detect_run": (lambda wrong: modsim3d.detect_run(wrong, "b"), run),
        "detect_truth": (lambda wrong: detect_truth(wrong, "b", detector="thesis"), "truth: a path"),
        "detect_truth, folder": (lambda wrong: detect_truth("a", wrong, detector="thesis"), "folder: a path"),
        "detect_truth, detector": (lambda wrong: detect_truth("a", "b", detector=wrong), detector),
        "verify_run": (modsim3d.verify_run, run),
        "learn_detector": (lambda wrong: learn(truth=wrong, detections="dt.json"), f"truth: {paths}"),
        "learn_voyage": (lambda wrong: modsim3d.learn_voyage("strait", wrong), "log: a path"),
        "learn_detector, a list": (lambda wrong: learn(truth="gt.json", detections=[wrong]), f"detections: {paths}"),
    }


@pytest.mark.parametrize(("name", "call_and_said"), wrong_calls().items())
def test_what_is_no_path_or_no_files_name_is_refused_by_the_arguments_name(name, call_and_said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call, said = call_and_said
    for wrong in (3, b"runs/a", 2.5, object()):
        with pytest.raises(TypeError) as raised:
            call(wrong)
        assert str(raised.value) == f"{said} is needed (got {type(wrong).__name__})"
    for wrong in ("", "a\0b"):
        with pytest.raises(ModsimError) as raised:
            call(wrong)
        assert str(raised.value).startswith(said.split(":")[0] + ": "), wrong
    assert list(tmp_path.iterdir()) == []


def test_a_name_in_place_of_a_scene_is_refused_at_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for function, *more in ((modsim3d.simulate_frames,), (modsim3d.run_scene, "a")):
        with pytest.raises(TypeError, match=r"scene: a Scene is needed, from modsim3d\.load_scene \(got str\)"):
            function("strait", *more)
    assert list(tmp_path.iterdir()) == []


def test_a_shipped_detector_goes_by_its_name_and_numbers_of_numpy_replace_those_of_a_scene():
    assert {"thesis", "rich", "conditions/foggy_cloudy"} <= set(shipped_detectors())
    for name, path in shipped_detectors().items():
        assert modsim3d.load_detector(name).labels == modsim3d.load_detector(path).labels
    scene = modsim3d.load_scene("simulation_1", detector="conditions/foggy_cloudy")
    assert [state.name for state in scene.detector.states] == ["foggy_cloudy"]
    scene = modsim3d.load_scene("simulation_1", seed=np.int64(4), steps=np.int32(5), mode=np.uint8(2))
    assert (scene.seed, scene.steps, scene.annotation.mode) == (4, 5, 2)
    assert scene.sha256 == modsim3d.load_scene("simulation_1", seed=4, steps=5, mode=2).sha256


def test_a_file_comes_before_the_shipped_detector_of_its_name_and_unknown_ones_get_the_nearest(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("thesis").write_text((DETECTORS / "conditions/foggy_cloudy.yaml").read_text())
    assert [state.name for state in modsim3d.load_detector("thesis").states] == ["foggy_cloudy"]
    Path("thesis").unlink()
    Path("thesis").mkdir()
    assert len(modsim3d.load_detector("thesis").states) == 4
    with pytest.raises(InputError, match=r"no shipped detector has this name \(did you mean 'thesis'\?\)"):
        modsim3d.load_detector("thesi")
    with pytest.raises(InputError, match=r"detector my\.yaml:\n  no such file$"):
        modsim3d.load_detector("my.yaml")
