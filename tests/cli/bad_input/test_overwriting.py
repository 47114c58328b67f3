"""A run replaces files of runs and what was made of them, and nothing else; and never what it reads."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from modsim3d.core.errors import RunDirectoryError
from modsim3d.runs.files.overwrite import remove_files
from modsim3d.runs.run import detect_run, run_scene
from modsim3d.runs.stored_run import open_run
from modsim3d.scene.reading import load_scene
from modsim3d.verify.sources import compare
from tests.cli.bad_input.builders import answer, refusal
from tests.cli.bad_input.writers import scene_file
from tests.run_folders import interrupt, run_files

SMALL = ("--camera", "C0", "--width", "160")
NOTES = {"notes.txt": "mine", "scene/notes.txt": "mine too", "report_parts/a": "mine", "mine/frame_000001.png": "mine"}


def write(folder: Path, files: dict[str, str]) -> dict[str, bytes]:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return {name: text.encode() for name, text in files.items()}


def test_what_no_run_has_written_stays_the_scene_that_is_run_included(inputs, call):
    scene, project = inputs.write(), inputs.folder
    run_scene(load_scene(scene), project / "out")
    for path in (project / "out").iterdir():
        path.rename(project / path.name)
    (project / "out").rmdir()
    notes = write(project, NOTES)
    before = run_files(project)
    answer(call, ("run", scene, "--out", project, "--overwrite", "--seed", 7, "--no-sheet"))
    after = run_files(project)
    assert after.keys() == before.keys() and notes.items() <= after.items()
    run = json.loads(after["run.json"])
    assert run["seed"] == 7
    assert {name for name in after if after[name] != before[name]} <= {"run.json", *run["files"]}


def test_nothing_of_the_old_run_stays_beside_the_new_one(inputs, call, tmp_path, monkeypatch):
    monkeypatch.setattr(compare, "WORST", 1)  # drawing them is most of the time
    out, other, scene = tmp_path / "run", tmp_path / "other", inputs.write()
    assert call("run", scene, "--out", out, "--no-sheet")[0] == 0
    for command in (
        *(("check", "run", out), ("view", "sheet", out), ("view", "map", out)),
        *(("report", out, "--parts"), ("detect", out, "--out", other), ("report", out, other, "--parts")),
        *(("view", "film", out, "--kind", kind, *SMALL) for kind in ("detections", "ids", "map", "all")),
        *(("view", "film", out, "--kind", kind, *SMALL, "--format", "png") for kind in ("corners", "map")),
        *(("view", "frame", out, "1", "--kind", kind, "--camera", "C0") for kind in ("detections", "scene")),
        ("view", "film", out, "--kind", "corners", "--format", "gif", *SMALL),
        ("check", "truth", scene, "--out", out),
    ):
        assert call(*command)[0] in (0, 1), command
    notes = write(out, NOTES)
    inputs.data["scene"]["cameras"].pop("shore")
    assert call("run", inputs.write(), "--out", out, "--overwrite", "--no-sheet")[0] == 0
    run_scene(load_scene(scene), tmp_path / "new")
    assert run_files(out) == run_files(tmp_path / "new") | notes


def test_a_run_of_a_version_without_a_list_of_files_is_replaced_too(inputs, tmp_path):
    out, beside, scene = tmp_path / "run", tmp_path / "beside", inputs.write()
    for folder in (out, beside):
        run_scene(load_scene(scene), folder)
        run = json.loads((folder / "run.json").read_text())
        del run["files"]
        for later in folder.glob("tracker_input_*"):
            later.unlink()
        (folder / "run.json").write_text(json.dumps(run))
    notes = write(beside, {"scene/vessels.json": "mine", "scene/notes.txt": "mine"})  # beside the copy of its scene
    run_scene(load_scene(scene), beside, overwrite=True)
    assert notes.items() <= run_files(beside).items()
    notes = write(out, {"notes.txt": "mine"})
    assert open_run(out).finished
    inputs.data["scene"]["cameras"].pop("shore")
    shutil.copy(inputs.path("detector"), inputs.folder / "detector.yml")
    inputs.data["scene"]["detector"] = "detector.yml"
    run_scene(load_scene(inputs.write()), out, overwrite=True)
    run_scene(load_scene(scene), tmp_path / "new")
    assert run_files(out) == run_files(tmp_path / "new") | notes


@pytest.mark.parametrize("file", ["scene", "poses.json", "detector.yaml"])
def test_a_run_does_not_replace_what_it_reads(inputs, tmp_path, call, file):
    out = tmp_path / "run"
    run_scene(load_scene(inputs.write()), out)
    if file == "poses.json":
        inputs.data["scene"]["poses"] = {"file": f"../run/scene/{file}"}
    elif file == "detector.yaml":
        (inputs.folder / file).unlink()
        (inputs.folder / "link.yaml").symlink_to(out / "scene" / file)
        inputs.data["scene"]["detector"] = "link.yaml"
        inputs.data.pop("detector")
    scene = scene_file(out) if file == "scene" else inputs.write()
    file = scene.name if file == "scene" else file
    named = str(inputs.folder / "link.yaml" if file == "detector.yaml" else file)
    refusal(call, ("run", scene, "--out", out, "--overwrite"), named, "this run reads it", kept=out)


@pytest.mark.parametrize("name", ["truth.parquet", "scene/detector.yaml", "scene"])
def test_an_interrupted_run_is_replaced_neither_by_its_own_copy_nor_over_files_of_others(inputs, tmp_path, call, name):
    out = interrupt(load_scene(inputs.write()), tmp_path / "run")
    scene = scene_file(out / "unfinished")
    for option in ("--overwrite", "--resume"):
        refusal(call, ("run", scene, "--out", out, option), f"{scene} belongs to the run in", kept=out)
    write(out, {name: "mine"})
    line = ("run", inputs.path("scene"), "--out", out, "--resume")
    refusal(call, line, f"{out / name} is in the way", kept=out)


def test_detect_does_not_write_into_the_run_that_it_reads(inputs, tmp_path):
    run_scene(load_scene(inputs.write()), tmp_path / "run")
    before = run_files(tmp_path / "run")
    (tmp_path / "link").symlink_to(tmp_path / "run")
    for inside in ("", "second", "scene/second"):
        with pytest.raises(RunDirectoryError, match="the truth is read from"):
            detect_run(open_run(tmp_path / "run"), tmp_path / "link" / inside, overwrite=True)
        assert run_files(tmp_path / "run") == before


@pytest.mark.parametrize("calls", range(1, 11))
def test_killed_while_files_are_put_in_place_it_becomes_the_new_run_or_another(inputs, tmp_path, monkeypatch, calls):
    """Killed before any of the renames of the end, and then either resumed or replaced by a third run."""
    scene = inputs.write()
    run_scene(load_scene("strait", steps=2, source="analytic"), tmp_path / "run")  # other cameras, other files
    notes = write(tmp_path / "run", {"notes.txt": "mine"})
    real, left = Path.replace, [calls]

    def replace(path: Path, to: Path) -> Path:
        if path.parent.name == "unfinished" and to.parent == tmp_path / "run":
            left[0] -= 1
            if not left[0]:
                raise KeyboardInterrupt
        return real(path, to)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", replace)
        with pytest.raises(KeyboardInterrupt):
            run_scene(load_scene(scene), tmp_path / "run", overwrite=True)
    shutil.copytree(tmp_path / "run", tmp_path / "other")
    run_scene(load_scene(scene), tmp_path / "run", resume=True)
    run_scene(load_scene(scene), tmp_path / "new")
    assert run_files(tmp_path / "run") == run_files(tmp_path / "new") | notes
    inputs.data["scene"]["cameras"] = {"third": inputs.data["scene"]["cameras"]["shore"]}
    run_scene(load_scene(inputs.write()), tmp_path / "other", overwrite=True)
    run_scene(load_scene(scene), tmp_path / "new", overwrite=True)
    assert run_files(tmp_path / "other") == run_files(tmp_path / "new") | notes


def test_no_file_outside_a_folder_is_removed_whatever_a_list_names(tmp_path):
    for name in ("in/own.json", "outside.json", "elsewhere/linked.json"):
        write(tmp_path, {name: "mine"})
    (tmp_path / "in" / "link").symlink_to(tmp_path / "elsewhere")
    names = ("own.json", "../outside.json", "link/linked.json", "link/../../outside.json")
    remove_files(tmp_path / "in", [*names, str(tmp_path / "outside.json")])
    assert run_files(tmp_path).keys() == {"outside.json", "elsewhere/linked.json"}


def test_a_list_of_files_that_no_run_has_written_does_not_hinder_the_new_run(inputs, tmp_path):
    out, scene = tmp_path / "run", inputs.write()
    run_scene(load_scene(scene), out)
    before, run = run_files(out), json.loads((out / "run.json").read_text())
    for name in ("a\0b/c", "unfinished/truth.parquet", "a" * 300):
        listed = run["files"] | {name: {"bytes": 0, "sha256": "0" * 64}}
        (out / "run.json").write_text(json.dumps(run | {"files": listed}))
        run_scene(load_scene(scene), out, overwrite=True)
        assert run_files(out) == before, name


def test_a_run_whose_scene_folder_also_holds_other_files_is_opened_and_replaced(inputs, tmp_path, call):
    out, scene = tmp_path / "run", inputs.write()
    assert call("run", scene, "--out", out)[0] == 0
    notes = write(out, {"scene/notes.txt": "mine", "scene/.DS_Store": "the system's"})
    for arguments in (("check", "repeat", out), ("run", scene, "--out", out, "--overwrite"), ("report", out)):
        answer(call, arguments)
    assert notes.items() <= run_files(out).items()


@pytest.mark.parametrize("name", ["run.json", "unfinished/settings.json"])
def test_a_pipe_in_place_of_a_file_is_not_waited_for(inputs, prepared, tmp_path, name):
    out, scene = tmp_path / "run", inputs.write()
    (out / name).parent.mkdir(parents=True)
    os.mkfifo(out / name)
    command = (prepared, "run", scene, "--out", out, "--overwrite")
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.returncode == 2 and "is not a run directory" in done.stderr
