"""`modsim3d export --format mcap`: what cannot be a bag is told in one line, and nothing is lost."""

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
from tests.cli.bad_input.builders import Call, content, refusal
from tests.formats.bags import LENS, OWN, VESSELS


def scene(timestamps=(0.0, 0.5), cameras=("bow",)) -> modsim3d.Scene:
    place = np.tile([[0.0, 0.0], [80.0, 10.0], [60.0, -5.0]], (len(timestamps), 1, 1))
    poses = {"positions_m": place, "headings_rad": np.zeros(place.shape[:2]), "times_s": list(timestamps)}
    mount = {"vessel": OWN, "position_m": [6, 0, 6]}
    keys = {"vessels": VESSELS, "poses": poses, "detector": "coastal", "annotation": {"source": "analytic"}}
    return modsim3d.Scene.from_dict(keys | {"cameras": {name: {**LENS, "mount": mount} for name in cameras}})


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mcap") / "run"
    run_scene(scene(), folder)
    return folder


def test_a_missing_library_is_named_with_the_command_that_installs_it(run, call: Call, tmp_path, monkeypatch) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "rosbags"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    said = refusal(call, ("export", run, "--format", "mcap", "--out", tmp_path / "out"), 'pip install "modsim3d[ros]"')
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"timestamps": (-0.5, 0.0)}, "time -0.5 s: ROS knows times from 0 to 2147483647 s"),
        ({"timestamps": (2147483647.0, 2147483648.0)}, "time 2147483648.0 s: ROS knows times from 0 to 2147483647 s"),
        ({"timestamps": (1e-11, 2e-11)}, "times 1e-11 s and 2e-11 s: ROS counts in nanoseconds"),
        ({"cameras": ("bow.1", "bow-1")}, "cameras 'bow.1' and 'bow-1' are both called 'bow_1' in ROS"),
    ],
)
def test_what_ros_cannot_say_is_told_before_anything_is_written(call: Call, tmp_path, changes, part) -> None:
    run_scene(scene(**changes), tmp_path / "run")
    refusal(call, ("export", tmp_path / "run", "--format", "mcap", "--out", tmp_path / "out"), part)
    assert not (tmp_path / "out").exists()
    if "cameras" in changes:  # one by one they are exported
        line = ("export", tmp_path / "run", "--format", "mcap", "--out", tmp_path / "out", "--camera", "bow-1")
        assert call(*line)[0] == 0


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_is_there_is_replaced_only_with_overwrite(run, call: Call, tmp_path, name) -> None:
    out = tmp_path / "out"
    line = ("export", run, "--format", "mcap", "--out", out)
    (out / name).parent.mkdir(parents=True)
    (out / name).write_bytes(b"mine")
    (out / "notes.txt").write_bytes(b"mine too")
    refusal(call, line, f"{out / name} exists: use --overwrite")
    assert content(out) == {name: b"mine", "notes.txt": b"mine too"}
    with locked_file(out / name):
        refusal(call, (*line, "--overwrite"), f"{out / name} is being written by ")
    assert call(*line, "--overwrite")[0] == 0
    assert content(out).keys() == {*FILES, "notes.txt"}
    assert content(out)[name] != b"mine" and content(out)["notes.txt"] == b"mine too"


def test_a_full_disk_leaves_the_bags_that_were_there(run, call: Call, tmp_path, monkeypatch) -> None:
    line = ("export", run, "--format", "mcap", "--out", tmp_path / "out", "--overwrite")
    assert call(*line)[0] == 0
    write = Bag.write

    def fail(self: Bag, topic: str, stamp_ns: int, message: object) -> None:
        if stamp_ns:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(self, topic, stamp_ns, message)

    monkeypatch.setattr(Bag, "write", fail)
    refusal(call, line, "cannot be written to: No space left on device", kept=tmp_path)


def test_what_a_killed_command_has_left_is_no_hindrance(run, call: Call, tmp_path) -> None:
    left = tmp_path / "out" / ".mcap.partial" / "detections"
    left.mkdir(parents=True)
    (left / "detections.mcap").write_bytes(b"half")
    assert call("export", run, "--format", "mcap", "--out", tmp_path / "out")[0] == 0
    assert content(tmp_path / "out").keys() == set(FILES)


def test_a_changed_table_is_told_though_it_is_read_in_parts(call: Call, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(pipeline, "MAX_BLOCK_STEPS", 1)
    run_scene(scene(), tmp_path / "run")
    table = tmp_path / "run" / "detections.parquet"
    table.write_bytes(table.read_bytes().replace(b"parquet-cpp-arrow", b"Parquet-cpp-arrow"))
    refusal(call, ("export", tmp_path / "run", "--format", "mcap", "--out", tmp_path / "out"), "detections.parquet")
    assert content(tmp_path / "out") == {}
