"""What a scene is called, and what its file may be called by."""

import shutil
from pathlib import Path

import pytest

from modsim3d import InputError, load_scene, run_scene
from modsim3d.io.input_files import data_folder

SIMULATION = data_folder("scenes") / "simulation_1.yaml"


def in_folder(folder: Path, name: str, detector: str = "thesis") -> Path:
    """Simulation 1 in a folder of its own, with a shipped detector."""
    folder.mkdir(parents=True)
    text = SIMULATION.read_text(encoding="utf-8").replace("detector: detectors/thesis.yaml", f"detector: {detector}")
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def test_a_scene_in_scene_yaml_is_called_as_its_folder_which_stands_for_it(tmp_path, monkeypatch):
    path, other = in_folder(tmp_path / "sound", "scene.yaml"), in_folder(tmp_path / "bay", "traffic.yaml")
    assert (load_scene(path).name, load_scene(other).name, load_scene(path.parent).path) == ("sound", "traffic", path)
    with pytest.raises(InputError, match="bay"):
        load_scene(other.parent)
    monkeypatch.chdir(path.parent)
    assert load_scene("scene.yaml").name == "sound"


def test_the_copy_in_a_run_is_called_as_the_scene_and_gives_the_same_scene(tmp_path):
    scene = load_scene(in_folder(tmp_path / "sound", "scene.yaml"), steps=2, source="analytic")
    run_scene(scene, tmp_path / "run")
    again = load_scene(tmp_path / "run" / "scene" / "sound.json")
    assert (again.name, again.sha256) == ("sound", scene.sha256)


def test_a_scene_names_a_shipped_detector_and_a_file_of_that_name_comes_first(tmp_path):
    path = in_folder(tmp_path / "sound", "scene.yaml", "three_labels")
    with pytest.raises(InputError, match="known: sailboat, motorboat, ferry"):
        load_scene(path)
    shutil.copy(data_folder("scenes") / "detectors" / "thesis.yaml", path.parent / "three_labels")
    assert load_scene(path).detector.labels == ("Vessel",)
    with pytest.raises(InputError, match="no_such"):
        load_scene(in_folder(tmp_path / "bay", "scene.yaml", "no_such"))
