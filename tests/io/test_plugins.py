"""Plug-ins as packages on the path, with their metadata; tests/packaging installs one."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from modsim3d import InputError, ModsimError, load_scene, open_run, run_scene, simulate_frames
from modsim3d.io.plugins import POSE_SOURCES, SHAPES, WAVE_LEVELS, load_plugin, plugin_names
from modsim3d.world.second_order_waves import LEVELS, Axis, find_level, level_axes
from modsim3d.world.vessels import find_shape, shape_problem, shoebox, signed_volume
from tests.plugin_site import site
from tests.run_folders import interrupt, run_files
from tests.scenes import crossing, write_scene

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "tests" / "plugin_example"
MODULE = (EXAMPLE / "modsim3d_drift.py").read_text(encoding="utf-8")
DOCUMENT = (ROOT / "docs" / "plugins.md").read_text(encoding="utf-8").split("\n## A tracker\n")[0]
"""The sections before that of trackers, whose package tests/tracking/test_programs.py tests."""
DRIFT = {"drift": {"current_m_s": [0.5, 0.1], "gap_m": 30}}
__all__ = ["site"]  # a fixture


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", DOCUMENT, flags=re.DOTALL)


def scene_with(folder, poses=None, waves=None, steps=5):
    path = write_scene(folder, {"a": ([8, 4, 2], [[0, 100, 0], [9, 100, 9]]), "b": ([8, 4, 2], [])}, steps)
    data = json.loads(path.read_text())
    data["poses"] = poses or data["poses"]
    data["annotation"]["source"] = "analytic"
    if waves:
        data["waves"] = waves
        data["cameras"]["C0"]["mount"] = {"vessel": "a", "position_m": [4, 0, 2]}
        del data["cameras"]["C0"]["pose"]
    path.write_text(json.dumps(data))
    return path


def test_the_documents_package_is_the_tested_one_and_a_real_process_runs_it_with_workers(site, tmp_path):
    assert blocks("toml") == [(EXAMPLE / "pyproject.toml").read_text(encoding="utf-8")]
    assert blocks("python") == [MODULE]
    parts = MODULE.split("\n\n\n")[1:]
    assert [part.split("(")[0] for part in parts] == ["class Drift", "SWELL = ", "def barge"]
    assert max(len(part.strip().splitlines()) for part in parts) <= 10
    site.add_project(EXAMPLE)
    found, plugin = load_plugin(POSE_SOURCES, "drift", "poses.drift")
    assert (found.__name__, str(plugin)) == ("Drift", "the plug-in 'drift' of modsim3d-drift 1.0")
    scene = load_scene(scene_with(tmp_path, DRIFT))
    poses = scene.poses.poses(0, 5)
    assert poses.present.all()
    np.testing.assert_allclose(poses.positions_m[:, 0], [[0.5 * t, 0.1 * t, 0] for t in range(5)])
    np.testing.assert_allclose(poses.positions_m[:, 1], [[0.5 * t, 0.1 * t + 30, 0] for t in range(5)])
    assert scene.timestamps(0, 3) == ("0.0", "1.0", "2.0")
    path = scene_with(tmp_path, DRIFT, steps=600)
    run_scene(load_scene(path), tmp_path / "here")
    options = ["--out", str(tmp_path / "two"), "--no-sheet", "--workers", "2"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(site.folder), str(ROOT)])}
    line = [sys.executable, "-m", "modsim3d.cli.main", "run", str(path), *options]
    done = subprocess.run(line, env=environment, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    files = run_files(tmp_path / "two")
    assert files == run_files(tmp_path / "here")
    assert json.loads(files["run.json"])["plugins"] == {"modsim3d.pose_sources:drift": "modsim3d-drift 1.0"}


def test_another_version_or_another_file_of_the_same_version_does_not_continue_a_run(site, tmp_path):
    site.add_project(EXAMPLE)
    path, out = scene_with(tmp_path, DRIFT), tmp_path / "out"
    interrupt(load_scene(path), out)
    metadata, module = next(site.folder.glob("*.dist-info")) / "METADATA", site.folder / "modsim3d_drift.py"
    released = metadata.read_text()
    for version, edit in (("1.1", ""), ("1.0", "# edited\n")):
        metadata.write_text(released.replace("1.0", version))
        module.write_text(module.read_text() + edit)
        sys.modules.pop("modsim3d_drift", None)  # as in a new process
        with pytest.raises(ModsimError, match="another scene, seed, settings or version"):
            run_scene(load_scene(path), out, resume=True)
    scene = load_scene(path)
    run_scene(scene, out, overwrite=True)
    (digest,) = json.loads((out / "run.json").read_text())["plugins_sha256"].values()
    assert digest == scene.plugins[0].sha256


def problems_of(path):
    with pytest.raises(InputError) as caught:
        load_scene(path)
    return caught.value.problems


def test_wrong_keys_and_names_of_plugins_are_told_with_their_path_and_what_there_is(site, tmp_path):
    site.add_project(EXAMPLE)
    unknown = "poses.drift.gap: unknown key (did you mean 'gap_m'?)"
    assert problems_of(scene_with(tmp_path, {"drift": {"gap": 3}})) == ("poses.drift.current_m_s: missing", unknown)
    assert plugin_names(POSE_SOURCES) == ("drift",)
    twice = "poses.drift: modsim3d-drift 1.0 and other 2.0 both bring a plug-in 'drift'"
    for poses, waves, parts in (
        ({"drft": {}}, None, ("poses.drft: nothing is called 'drft' here", "did you mean 'drift'?")),
        ({"zzz": {}}, None, ("known: file, circular", "drift")),
        (None, {"level": "hugely"}, ("waves.level: ", "did you mean 'huge'?")),
        (DRIFT, None, (twice,)),
    ):
        if poses == DRIFT:
            site.add("other", "2.0", "other", "class Drift: ...", {POSE_SOURCES: {"drift": "other:Drift"}})
        (problem,) = problems_of(scene_with(tmp_path, poses, waves))
        assert all(part in problem for part in parts), problem


HEAD = "from modsim3d.plugins import Poses, PosesByTime, SourceKeys, Strict\nimport numpy as np\n"
AT = HEAD + "class Drift(PosesByTime):\n  def at(self, t, r): return "
BUILD = "class Drift(SourceKeys, Strict):\n  def build(self, request): return "
TIMES = HEAD + "class P:\n  timestamps = {}\n  def poses(self, f, s): ...\n" + BUILD + "P()"
WRONG_SHAPE = (
    HEAD + "class P:\n  timestamps = ['0', '1', '2', '3', '4']\n"
    "  def poses(self, f, s): return Poses(np.ones((s - f, 1), bool), np.zeros((s - f, 1, 3)), np.zeros((s - f, 1)))\n"
    + BUILD + "P()"
)  # fmt: skip
VALIDATOR = "from pydantic import model_validator\nclass Drift(PosesByTime):\n  @model_validator(mode='after')\n"
BAD_VALIDATOR = f"{HEAD}{VALIDATOR}  def look(self): return self.nothing"
BROKEN = {
    "missing_import": ("import no_such_module_here", "ModuleNotFoundError: No module named 'no_such_module_here'"),
    "syntax": ("class Drift(:\n", "SyntaxError"),
    "exit": ("import sys; sys.exit()", "cannot be loaded from broken_drift:Drift: SystemExit"),
    "nothing_there": ("Other = 1", "has no attribute 'Drift'"),
    "a_number": ("Drift = 3", "must be a class made from modsim3d.plugins.PosesByTime"),
    "another_class": ("class Drift: ...", "must be a class made from modsim3d.plugins.PosesByTime"),
    "a_model": ("from pydantic import BaseModel\nclass Drift(BaseModel): ...", "must be a class made from"),
    "no_build": (HEAD + "class Drift(SourceKeys, Strict): ...", "failed: NotImplementedError"),
    "bad_validator": (BAD_VALIDATOR, "'drift' of drift 0.1 failed: AttributeError"),
    "builds_nothing": (HEAD + BUILD + "None", "must return a pose"),
    "raises": (AT + "1 / 0", "ZeroDivisionError: division"),
    "not_a_mapping": (AT + "5", "'drift' of drift 0.1 failed"),
    "unknown_vessel": (AT + "{'zebra': ([0, 0, 0], 0)}", "at time 0.0 s: no vessel 'zebra'"),
    "two_coordinates": (AT + "{'a': ([0, 0], 0)}", "ValueError: could not broadcast"),
    "nan": (AT + "{'a': ([9, 0, float('nan')], 0)}", "positions_m must be finite"),
    "wrong_shape": (WRONG_SHAPE, "present must be an array of bool (5, 2), not bool (5, 1)"),
    "times": (TIMES.format("['0', '0.0']"), "timestamps must increase"),
    "few_times": (TIMES.format("['0', '1']"), "steps: 5 asked for, but poses.drift has 2"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_plugin_that_does_not_do_what_it_must_is_told_in_one_message(site, tmp_path, kind):
    source, part = BROKEN[kind]
    site.add("drift", "0.1", "broken_drift", source, {POSE_SOURCES: {"drift": "broken_drift:Drift"}})
    with pytest.raises(ModsimError) as caught:
        load_scene(scene_with(tmp_path, {"drift": {}}))
    said = str(caught.value)
    assert part in said and "drift" in said and len(said.splitlines()) <= 2


def test_wave_level_of_a_plugin_gives_its_axes_and_own_levels_need_no_plugin(site, tmp_path):
    assert [find_level(level) for level in LEVELS] == [(level_axes(level), None) for level in LEVELS]
    site.add("my-sea", "0.3", "my_sea", MODULE, {WAVE_LEVELS: {"swell": "my_sea:SWELL", "wrong": "my_sea:Axis"}})
    axes, plugin = find_level("swell")
    assert axes == (Axis(0.99, 0.995, 4e-5), Axis(0.99, 0.995, 6e-5), Axis(sigma_rad=1e-5))
    assert plugin.package == "my-sea 0.3"
    scene = load_scene(scene_with(tmp_path, waves={"level": "swell"}))
    assert scene.plugins == (plugin,)
    assert np.ptp(scene.waves.motion.angles("a", np.arange(5.0), np.arange(5))[:, 1]) > 0
    (problem,) = problems_of(scene_with(tmp_path, waves={"level": "wrong"}))
    assert "must be three modsim3d.plugins.Axis, for roll, pitch, yaw" in problem


def test_scene_with_a_shape_of_a_plugin_has_the_truth_of_that_closed_mesh_and_names_its_package(site, tmp_path):
    shapes = {name: f"yard:{name}" for name in ("barge", "launch", "sink")}
    site.add("yard", "1", "yard", MODULE + "\nlaunch = 3\ndef sink(): return 1 / 0\n", {SHAPES: shapes})
    path = crossing(tmp_path)
    plain, scene = load_scene(path), load_scene(path, settings={"vessels.boat.mesh": "barge"})
    assert [plugin.package for plugin in scene.plugins] == ["yard 1"]
    assert scene.vessels[0].has_mesh
    for one, other in zip(simulate_frames(scene), simulate_frames(plain), strict=True):
        np.testing.assert_array_equal(one.truth.visible_px, other.truth.visible_px)
        np.testing.assert_array_equal(one.truth.full_boxes_px, other.truth.full_boxes_px)
    with pytest.raises(InputError, match=r'vessels\.boat\.mesh"\]: nothing is called .bargee. here.*barge'):
        load_scene(path, settings={"vessels.boat.mesh": "bargee"})
    solid, plugin = find_shape("barge", "vessels.a.shape")
    np.testing.assert_array_equal(solid.vertices, shoebox().vertices)
    assert solid.convex and signed_volume(solid.vertices, solid.faces) == pytest.approx(1)
    assert not solid.vertices.flags.writeable
    assert plugin.package == "yard 1"
    for name, part in (
        ("launch", "must be a function"),
        ("sink", "failed: ZeroDivisionError: division by zero (yard.py, line"),
        ("bargee", "did you mean 'barge'?"),
        ("ferryy", "did you mean 'ferry'?"),
    ):
        with pytest.raises(InputError, match=rf"vessels\.a\.shape(.|\n)*{re.escape(part)}"):
            find_shape(name, "vessels.a.shape", ("ferry",))


def test_what_is_no_shape_of_a_vessel_is_told():
    vertices, faces = v, f = shoebox().vertices, shoebox().faces
    assert shape_problem(vertices, faces) is None
    numbers, closed = "faces must be vertex indices", "its surface is not closed"
    box = "it must fill the box from [-0.5, -0.5, 0.0] to [0.5, 0.5, 1.0]"
    for part, *shape in (
        ("vertices must be finite, of shape (K, 3)", v[:, :2], f),
        ("vertices must be finite", v * np.nan, f),
        ("faces must be vertex indices of shape (F, 3)", v, f[:, :2]),
        *((numbers, v, f.astype(float)), (numbers, v, f[:0])),
        ("faces name vertices 0 to 7 (got 1 to 8)", v, f + 1),
        *((box, 2 * v, f), ("it must fill the box", v * [1, 1, 0.5], f)),
        *((closed, v, f[1:]), (closed, v, np.concatenate([f, f[:1]]))),
        ("its faces point inwards", v, f[:, ::-1]),
    ):
        assert part in shape_problem(*shape), part


LIVE = """
from typing import ClassVar
import numpy as np
from modsim3d.plugins import LivePoses, Poses, SourceKeys, Strict

class Radio(SourceKeys, Strict):
    generated: ClassVar[bool] = False
    fault: str = ""

    def build(self, request):
        return LivePoses(self.steps(len(request.names)), len(request.names), "radio")

    def steps(self, count):
        for step in range(4):
            if step == 2 and self.fault == "raises":
                raise OSError("no signal")
            wide = count + (step == 2 and self.fault == "shape")
            positions = np.full((1, wide, 3), 50.0 + step) + 20 * np.arange(wide)[None, :, None]
            positions[..., 2] = 0
            time = "0.5" if step == 2 and self.fault == "time" else f"{step}.0"
            yield time, Poses(np.ones((1, wide), bool), positions, np.zeros((1, wide)))
"""


def test_live_source_of_a_plugin_runs_and_its_faults_are_told(site, tmp_path):
    site.add("my-radio", "2", "my_radio", LIVE, {POSE_SOURCES: {"radio": "my_radio:Radio"}})
    scene = load_scene(scene_with(tmp_path, {"radio": {}}, steps=9))
    assert scene.live
    assert [frame.timestamp for frame in simulate_frames(scene)] == ["0.0", "1.0", "2.0", "3.0"]
    of_radio = "the plug-in 'radio' of my-radio 2"
    for fault, part in (
        ("raises", f"{of_radio} failed: OSError: no signal (my_radio.py, line"),
        ("shape", f"{of_radio}: present must be an array of bool (1, 2), not bool (1, 3)"),
        ("time", "radio:\n  step 3: 0.5: timestamps must increase"),
    ):
        frames = simulate_frames(load_scene(scene_with(tmp_path, {"radio": {"fault": fault}}, steps=9)))
        assert [next(frames).step, next(frames).step] == [0, 1]
        with pytest.raises(ModsimError, match=re.escape(part)):
            next(frames)


LOGGED = """
from typing import ClassVar
from pydantic import BaseModel
from modsim3d.plugins import SourceKeys, load_poses

class Logged(SourceKeys, BaseModel):
    generated: ClassVar[bool] = False
    log: str
    notes: list[str] = []

    @property
    def files(self):
        return (self.log, *self.notes)

    def build(self, request):
        return load_poses(request.folder / self.log, request.names)
"""


def test_files_that_a_source_names_are_in_the_scenes_copy_and_checksum(site, tmp_path):
    site.add("logged", "1.0", "logged", LOGGED, {POSE_SOURCES: {"logged": "logged:Logged"}})
    source, sums = tmp_path / "source", []
    (source / "logs").mkdir(parents=True)
    path = scene_with(source, {"logged": {"log": "logs/monday.jsonl"}})
    step = '{"%d.0": {"a": {"center_position_m": [%d, 0, 0], "heading_rad": 0}}}\n'
    for place in (100, 90):
        (source / "logs" / "monday.jsonl").write_text("".join(step % (i, place) for i in range(5)))
        sums.append(load_scene(path).sha256)
    assert sums[0] != sums[1]
    run_scene(load_scene(path), tmp_path / "run")
    lying = scene_with(source, {"logged": {"log": "logs/monday.jsonl", "notes": ["notes.txt"]}})
    with pytest.raises(InputError, match=r"logged 1\.0: files names 'notes\.txt', which is no file"):
        load_scene(lying)
    shutil.rmtree(source)
    again = open_run(tmp_path / "run").scene
    assert again.sha256 == sums[1]
    assert again.poses.poses(0, 1).positions_m[0, 0, 0] == 90
