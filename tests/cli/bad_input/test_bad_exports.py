"""What an export cannot do is told in a line, and nothing is written or lost."""

import errno
import sys
from pathlib import Path

import numpy as np
import pytest

import modsim3d
from modsim3d.formats.writing.mcap import FILES, Bag
from modsim3d.io.overwrite_guard import locked_file
from modsim3d.runs import pipeline
from modsim3d.runs.run import run_scene
from modsim3d.scene.reading import load_scene
from tests.cli.bad_input.builders import Call, content, refusal
from tests.cli.conftest import Modsim3d
from tests.formats.bags import LENS, OWN, VESSELS
from tests.scenes import crossing


def export(modsim3d: Modsim3d, run: Path, out: Path, *more: object) -> str:
    """Assert that an export is refused, and that what is in the folder stays; what it says."""
    before = content(out)
    said = modsim3d("export", run, "--out", out, *more)
    assert said.status == 2 and not said.out
    assert len(said.err.splitlines()) == 1 and "Traceback" not in said.err
    assert content(out) == before
    return said.err


def test_masks_go_with_coco_and_pixels_of_the_image_alone_and_cameras_and_folders_must_be_free(modsim3d, run, tmp_path):
    for name in ("mot", "yolo"):
        said = export(modsim3d, run, tmp_path, "--format", name, "--masks")
        assert f"--masks goes with --format coco, not with {name}" in said
    said = export(modsim3d, run, tmp_path, "--format", "coco", "--true-attitude")
    assert "--true-attitude goes with --format csv, not with coco" in said
    said = export(modsim3d, run, tmp_path, "--format", "coco", "--masks")
    assert "source is analytic: run the scene with --source rendered" in said
    run_scene(load_scene(crossing(tmp_path, 2), supersample=2), tmp_path / "run")
    said = export(modsim3d, tmp_path / "run", tmp_path / "out", "--format", "coco", "--masks")
    assert "supersample 2: run the scene with --set annotation.supersample=1" in said
    for name in ("coco", "mot", "yolo"):
        assert "has no camera 'C7'; it has: C0" in export(modsim3d, run, tmp_path, "--format", name, "--camera", "C7")
    with locked_file(tmp_path / "predictions"):
        assert "predictions is being written by" in export(modsim3d, run, tmp_path, "--format", "yolo")


@pytest.mark.parametrize(("name", "parts"), [
    ("labels/a.txt", ("labels exists: use --overwrite", None)),
    ("labels/a.jpg", ("labels holds other files than *.txt (a.jpg)",) * 2),
    ("labels", ("labels is a file, and a folder is to be written there",) * 2),
    ("images/deep/a.png", ("images holds other files than *.png (deep)",) * 2),
])  # fmt: skip
def test_a_folder_that_is_there_is_replaced_only_if_it_holds_nothing_else(modsim3d, run, tmp_path, name, parts):
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / name).write_text("mine")
    for part, more in zip(parts, ((), ("--overwrite",)), strict=True):
        if part is not None:
            assert part in export(modsim3d, run, tmp_path, "--format", "yolo", *more)
    if parts[1] is None:
        assert modsim3d("export", run, "--out", tmp_path, "--format", "yolo", "--overwrite").status == 0
        assert not (tmp_path / name).exists() and (tmp_path / "labels" / "C0_000000.txt").is_file()
        assert {path.name for path in tmp_path.iterdir()} == {"data.yaml", "images", "labels", "predictions"}


@pytest.mark.parametrize("set_", ["modsim3d-all", "modsim3d-class"])
def test_sequences_of_another_export_are_not_left_among_the_new_ones(modsim3d, run, tmp_path, set_):
    """A tracker or an evaluator that goes through the folders would take them for this run's."""
    assert modsim3d("export", run, "--out", tmp_path, "--format", "mot").status == 0
    old = tmp_path / set_ / "old" / "gt" / "gt.txt"
    old.parent.mkdir(parents=True)
    old.write_text("1,1,1,1,5,5,1,1,1\n")
    said = export(modsim3d, run, tmp_path, "--format", "mot", "--overwrite")
    assert f"{set_} holds another sequence (old): choose another folder" in said


def scene(timestamps=(0.0, 0.5), cameras=("bow",)) -> modsim3d.Scene:
    place = np.tile([[0.0, 0.0], [80.0, 10.0], [60.0, -5.0]], (len(timestamps), 1, 1))
    poses = {"positions_m": place, "headings_rad": np.zeros(place.shape[:2]), "times_s": list(timestamps)}
    mount = {"vessel": OWN, "position_m": [6, 0, 6]}
    keys = {"vessels": VESSELS, "poses": poses, "detector": "coastal", "annotation": {"source": "analytic"}}
    return modsim3d.Scene.from_dict(keys | {"cameras": {name: {**LENS, "mount": mount} for name in cameras}})


@pytest.fixture(scope="module")
def ros_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mcap") / "run"
    run_scene(scene(), folder)
    return folder


def to_mcap(run: Path, folder: Path, *options: object) -> tuple[object, ...]:
    return ("export", run, "--format", "mcap", "--out", folder / "out", *options)


def test_a_missing_library_and_what_ros_cannot_say_are_told_before_any_writing(ros_run, call, tmp_path, monkeypatch):
    for name in [name for name in sys.modules if name.partition(".")[0] == "rosbags"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    assert len(refusal(call, to_mcap(ros_run, tmp_path), 'pip install "modsim3d[ros]"').splitlines()) == 1
    assert not (tmp_path / "out").exists()
    monkeypatch.undo()
    for number, (changes, part) in enumerate(
        (
            ({"timestamps": (-0.5, 0.0)}, "time -0.5 s: ROS knows times from 0 to 2147483647 s"),
            ({"timestamps": (2147483647.0, 2147483648.0)}, "time 2147483648.0 s: ROS knows times from 0 to 2147483647"),
            ({"timestamps": (1e-11, 2e-11)}, "times 1e-11 s and 2e-11 s: ROS counts in nanoseconds"),
            ({"cameras": ("bow.1", "bow-1")}, "cameras 'bow.1' and 'bow-1' are both called 'bow_1' in ROS"),
        )
    ):
        run = tmp_path / f"run_{number}"
        run_scene(scene(**changes), run)
        refusal(call, to_mcap(run, tmp_path), part)
        assert not (tmp_path / "out").exists()
    assert call(*to_mcap(run, tmp_path, "--camera", "bow-1"))[0] == 0  # of the last, one by one


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_is_there_is_replaced_only_with_overwrite(ros_run, call: Call, tmp_path, name) -> None:
    out, line = tmp_path / "out", to_mcap(ros_run, tmp_path)
    (out / name).parent.mkdir(parents=True)
    (out / name).write_bytes(b"mine")
    (out / "notes.txt").write_bytes(b"mine too")
    refusal(call, line, f"{out / name} exists: use --overwrite")
    assert content(out) == {name: b"mine", "notes.txt": b"mine too"}
    with locked_file(out / name):
        refusal(call, (*line, "--overwrite"), f"{out / name} is being written by ")
    left = out / ".mcap.partial" / "detections" / "detections.mcap"  # by a killed command
    left.parent.mkdir(parents=True)
    left.write_bytes(b"half")
    assert call(*line, "--overwrite")[0] == 0
    assert content(out).keys() == {*FILES, "notes.txt"}
    assert content(out)[name] != b"mine" and content(out)["notes.txt"] == b"mine too"


def test_a_full_disk_leaves_the_bags_that_were_there(ros_run, call: Call, tmp_path, monkeypatch) -> None:
    line = to_mcap(ros_run, tmp_path, "--overwrite")
    assert call(*line)[0] == 0
    write = Bag.write

    def fail(self: Bag, topic: str, stamp_ns: int, message: object) -> None:
        if stamp_ns:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(self, topic, stamp_ns, message)

    monkeypatch.setattr(Bag, "write", fail)
    refusal(call, line, "cannot be written to: No space left on device", kept=tmp_path)


def test_a_changed_table_is_told_though_it_is_read_in_parts(call: Call, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(pipeline, "MAX_BLOCK_STEPS", 1)
    run_scene(scene(), tmp_path / "run")
    table = tmp_path / "run" / "detections.parquet"
    table.write_bytes(table.read_bytes().replace(b"parquet-cpp-arrow", b"Parquet-cpp-arrow"))
    refusal(call, to_mcap(tmp_path / "run", tmp_path), "detections.parquet")
    assert content(tmp_path / "out") == {}
