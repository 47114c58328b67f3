"""Poses that come in one line at a time."""

import io
import json
import re
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest
import yaml

from modsim3d import InputError, ModsimError, load_scene, open_run, run_scene, simulate_frames
from modsim3d.runs.files import tables
from modsim3d.world.poses.base import Poses
from modsim3d.world.poses.replay import LivePoses, follow, read_steps
from tests.cli.bad_input.builders import at, refusal
from tests.run_folders import wait_for
from tests.scenes import camera_keys, write_scene

ROOT = Path(__file__).resolve().parents[2]
STEPS = 40


def line(step, *names):
    """Own ship drives along w1 with a camera at its bow; the others are ahead of it."""
    places = {"own": (0.2 * step, 0.0, 0.1), "a": (70 + 0.3 * step, 4 - 0.1 * step, 1.0), "b": (90, 0.1 * step, -2.0)}
    entries = {name: at(*places[name][:2], places[name][2] + step / 7) for name in names}
    entries["own"]["heading_rad"] = 0.0
    return json.dumps({f"{step / 10}": entries}) + "\n"


def lines(steps=STEPS):
    """`a` comes and goes, `b` comes late and leaves."""
    there = {"own": lambda t: True, "a": lambda t: t % 9 < 6, "b": lambda t: 10 <= t < 28}
    return [line(t, *(name for name, at in there.items() if at(t))) for t in range(steps)]


def scene_of(folder, poses, source="analytic", **keys):
    boats = {name: ([8, 4, 2], []) for name in ("own", "a", "b")}
    cameras = {"C0": camera_keys(mount={"vessel": "own", "position_m": [4, 0, 2]})}
    cameras |= {"shore": camera_keys(pose={"position_m": [-30, 3, 9]})}
    waves = {"level": "large", "apply_to": "all"}
    usual = {"cameras": cameras, "annotation": {"mode": 2, "source": source}, "waves": waves}
    return write_scene(folder, boats, keys.pop("steps", None), time_step_s=None, poses=poses, **usual | keys)


def live_scene(folder, **keys):
    return load_scene(scene_of(folder, {"stream": "-"}, **keys))


@pytest.fixture
def stdin(monkeypatch):
    def give(text):
        content = text if isinstance(text, bytes) else text.encode()
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))

    return give


def content(folder, leave_out=("run.log", "run.json", "poses.jsonl")):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file() and path.name not in leave_out}


@pytest.mark.parametrize("source", ["rendered", "analytic"])
def test_a_live_run_writes_the_bytes_of_a_run_from_a_pose_file(tmp_path, stdin, source):
    text = lines()
    stdin("".join(text))
    assert run_scene(live_scene(tmp_path, source=source), tmp_path / "live").steps == STEPS
    whole = {time: places for each in text for time, places in json.loads(each).items()}
    (tmp_path / "poses.json").write_text(json.dumps(whole))
    for name, file in (("file", "poses.json"), ("again", "live/poses.jsonl")):
        run_scene(load_scene(scene_of(tmp_path, {"file": file}, source)), tmp_path / name)
    run_scene(open_run(tmp_path / "live").scene, tmp_path / "from_copy")
    for name in ("live", "again", "from_copy"):
        assert content(tmp_path / name) == content(tmp_path / "file"), name
    stdin((tmp_path / "live" / "poses.jsonl").read_text())
    run_scene(live_scene(tmp_path, source=source), tmp_path / "live_again")
    assert content(tmp_path / "live_again", ("run.log",)) == content(tmp_path / "live", ("run.log",))
    truth = json.loads((tmp_path / "live" / "annotations_shore.json").read_text())
    assert {frozenset(entries) for entries in truth.values()} >= {frozenset({"own"}), frozenset({"own", "a", "b"})}


def test_a_live_camera_has_its_own_frame_rate_and_run_json_tells_how_many_steps_came(tmp_path, stdin):
    slow = {"cameras.shore.frame_rate_hz": 3, "cameras.shore.start_offset_s": 0.2}
    stdin("".join(lines()))
    for name, poses in (("live", {"stream": "-"}), ("file", {"file": "live/poses.jsonl"})):
        run_scene(load_scene(scene_of(tmp_path, poses), settings=slow), tmp_path / name)
    assert content(tmp_path / "live") == content(tmp_path / "file")
    steps = [0.2, 0.6, 0.9, 1.2]
    assert [float(text) for text in json.loads((tmp_path / "live" / "detections_shore.json").read_text())][:4] == steps
    runs = []
    for name, count in (("first", 4), ("same", 4), ("other", 5)):
        stdin("".join(lines(count)))
        run_scene(live_scene(tmp_path), tmp_path / name)
        runs.append(json.loads((tmp_path / name / "run.json").read_text()))
    assert [run["steps"] for run in runs] == [4, 4, 5]
    assert runs[0]["poses_sha256"] == runs[1]["poses_sha256"] != runs[2]["poses_sha256"]


class Watched(io.BytesIO):
    """Counts the lines that are read."""

    read_lines = 0

    def readline(self, *size):
        self.read_lines += 1
        return super().readline(*size)


def test_each_frame_is_there_before_the_next_line_is_read(tmp_path, monkeypatch):
    """Where the scene has fewer steps, the next line stays unread."""
    for steps, given in ((6, {}), (2, {"steps": 2})):
        source = Watched("".join(lines(6)).encode())
        monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=source))
        scene = live_scene(tmp_path, **given)
        reads = [(frame.step, frame.camera, source.read_lines) for frame in simulate_frames(scene)]
        assert reads == [(step, camera, step + 1) for step in range(steps) for camera in ("C0", "shore")]
    assert source.read_lines == 2


def test_loading_and_checking_read_nothing_and_what_a_stream_cannot_do_is_one_message(call, tmp_path, monkeypatch):
    path = scene_of(tmp_path, {"stream": "-"})
    monkeypatch.setattr(sys, "stdin", object())  # there is nothing to be read from
    status, said = call("check", "scene", path)
    assert status == 0 and "as they come" in said and load_scene(path).live
    monkeypatch.chdir(tmp_path)
    for command, *options, part in (
        ("run", "--workers", "2", "leave --workers out"),
        ("run", "--resume", "--resume needs poses that can be read again"),
        ("check truth", "check truth needs a scene whose steps are known"),
    ):
        status, said = call(*command.split(), path, *options)
        assert status == 2 and part in said and not (tmp_path / "runs").exists()


def process(program, path, out):
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([program, "run", path, "--out", out, "--no-sheet"], **pipes)


def wait_for_lines(path, count):
    wait_for(lambda: path.exists() and path.read_bytes().count(b"\n") >= count)
    return path.read_bytes()


def test_a_real_process_answers_each_line_with_a_line(prepared, tmp_path):
    out = tmp_path / "out"
    with process(prepared, scene_of(tmp_path, {"stream": "-"}, "rendered"), out) as running:
        for step in range(4):
            running.stdin.write(line(step, "own", "a").encode())
            running.stdin.flush()
            for name in ("detections_C0", "annotations_C0", "detections_shore", "poses"):
                text = wait_for_lines(out / "unfinished" / f"{name}.jsonl", step + 1)
                assert [list(json.loads(given)) for given in text.splitlines()][step:] == [[f"{step / 10}"]]
            text = wait_for_lines(out / "unfinished" / "tracker_input_C0.jsonl", step + 1)
            assert [json.loads(given)["step"] for given in text.splitlines()] == list(range(step + 1))
        _, errors = running.communicate(timeout=240)
        assert running.returncode == 0, errors.decode()
    assert len(json.loads((out / "detections_C0.json").read_text())) == 4 and not (out / "unfinished").exists()


def test_a_file_is_followed_while_it_is_written(prepared, tmp_path):
    path, out = tmp_path / "live.jsonl", tmp_path / "out"
    path.write_text(line(0, "own"))
    with process(prepared, scene_of(tmp_path, {"stream": {"file": "live.jsonl", "timeout_s": 60.0}}), out) as running:
        detections = out / "unfinished" / "detections_C0.jsonl"
        wait_for_lines(detections, 1)
        half = line(1, "own", "a")
        with path.open("a") as file:
            file.write(half[:25])
            file.flush()
            time.sleep(0.1)  # half a line is no line, however long it takes
            assert detections.read_bytes().count(b"\n") == 1
            file.write(half[25:] + line(2, "own"))
            file.flush()
            wait_for_lines(detections, 3)
            file.write("\n")
        _, errors = running.communicate(timeout=240)
        assert running.returncode == 0, errors.decode()
    assert list(json.loads((out / "detections_C0.json").read_text())) == ["0.0", "0.1", "0.2"]


@pytest.mark.parametrize("timeout_s", [0.0, 0.05])
def test_a_file_that_does_not_grow_ends_after_the_timeout(tmp_path, timeout_s):
    (tmp_path / "live.jsonl").write_text("".join(lines(3)).removesuffix("\n"))
    scene = load_scene(scene_of(tmp_path, {"stream": {"file": "live.jsonl", "timeout_s": timeout_s}}))
    assert [frame.timestamp for frame in simulate_frames(scene)][::2] == ["0.0", "0.1", "0.2"]


def test_an_empty_line_ends_a_stream_and_live_poses_keep_what_came_and_refuse_what_never_came():
    given = [line(0, "own").encode(), b" \r\n", b"not json\n"]
    assert [timestamp for timestamp, _ in read_steps(given, "it", ["own"])] == ["0.0"]
    given = [b"a\n", b"x" * 100_000 + b"\n", b"\n", b"last"]
    assert list(follow(io.BytesIO(b"".join(given)), None)) == given

    def step(number):
        return f"{number}.0", Poses(np.array([[number % 2 == 0]]), np.full((1, 1, 3), number), np.full((1, 1), -number))

    live = LivePoses((step(number) for number in range(200)), 1, "it")
    assert live.wait(150) and len(live.timestamps) == 151
    poses = live.poses(3, 160)
    assert len(live.timestamps) == 160
    np.testing.assert_array_equal(poses.present[:, 0], np.arange(3, 160) % 2 == 0)
    np.testing.assert_array_equal(poses.positions_m[:, 0, 2], np.arange(3, 160))
    np.testing.assert_array_equal(poses.headings_rad[:, 0], -np.arange(3, 160))
    assert not live.wait(200)
    with pytest.raises(ModsimError, match="it: ended after 200 steps; step 201 was asked for"):
        live.poses(199, 201)


BAD = {
    "cut off": (b'{"0.2": {"own": {"center_pos', "line 3, column 18: Unterminated string", "is it cut off?"),
    "cut off earlier": (b'{"0.2": {', "line 3, column 10:", "the line ends here: is it cut off?"),
    "no json": (b"hello\n", "line 3, column 1: Expecting value"),
    "a list": (b"[1]\n", "line 3: one time step is needed", "(got [1])"),
    "two steps": (b'{"0.2": {}, "0.3": {}}\n', "line 3: one time step is needed", "(got 2 keys)"),
    "key twice": (b'{"0.2": {"own": 1, "own": 1}}\n', "line 3: 0.2.own: the key 'own' appears twice"),
    "unknown vessel": (line(2, "own").replace("own", "owl").encode(), "line 3: 0.2.owl: no vessel 'owl'", "'own'?"),
    "no heading": (b'{"0.2": {"own": {"center_position_m": [0, 0, 0]}}}\n', "line 3: 0.2.own.heading_rad: missing"),
    "not finite": (b'{"0.2": {"own": {"center_position_m": [0, NaN, 0], "heading_rad": 0}}}\n',
                   "line 3: 0.2.own.center_position_m: three finite numbers"),
    "no time": (b'{"soon": {}}\n', "line 3: soon: a timestamp must be a number of seconds"),
    "time again": (line(1, "own").encode(), "line 3: 0.1: timestamps must increase, but '0.1' is the same time as"),
    "not utf-8": (b'{"0.2\xff": {}}\n', "line 3: is not UTF-8 text (byte 5)"),
    "too deep": (b"[" * 100_000 + b"\n", "line 3: is nested too deeply"),
    "own ship missing": (line(2, "own").replace('"own"', '"a"').encode(), "cameras.C0.mount.vessel: 'own' has no pose"),
}  # fmt: skip


@pytest.mark.parametrize("fault", BAD)
def test_a_bad_line_is_told_with_its_number_and_what_is_finished_is_kept(call, tmp_path, stdin, fault):
    bad, *parts = BAD[fault]
    stdin("".join(lines(2)).encode() + bad)
    out = tmp_path / "out"
    advice = "the 2 steps before are kept as complete lines in"
    refusal(call, ("run", scene_of(tmp_path, {"stream": "-"}), "--out", out, "--no-sheet"), *parts, advice)
    for name in ("detections_C0", "annotations_shore", "poses"):
        kept = (out / "unfinished" / f"{name}.jsonl").read_text().splitlines()
        assert [list(json.loads(each)) for each in kept] == [["0.0"], ["0.1"]]


def test_an_interrupted_live_run_says_how_to_make_a_finished_one_of_it(call, tmp_path, monkeypatch, stdin):
    stdin("".join(lines(2)) + "{")
    path, out = scene_of(tmp_path, {"stream": "-"}), tmp_path / "out"
    with pytest.raises(InputError):
        run_scene(load_scene(path), out)
    monkeypatch.chdir(tmp_path)
    for line in (["detect", out, "--out", "again"], ["check", "run", out], ["view", "frame", out, "0.1"]):
        _, said = call(*line)
        (advice,) = re.findall(r"`modsim3d run (\S+) --out DIR` makes a finished run", said)
    run_scene(load_scene(advice), tmp_path / "finished")
    assert open_run(tmp_path / "finished").steps == 2


def test_what_has_come_can_be_simulated_again_and_a_camera_inside_a_vessel_is_told_when_it_happens(tmp_path, stdin):
    inside = json.loads(line(1, "own", "a"))
    inside["0.1"]["a"]["center_position_m"] = [4.2, 0, 0]
    stdin(line(0, "own", "a") + json.dumps(inside) + "\n")
    frames = simulate_frames(live_scene(tmp_path))
    assert next(frames).step == 0
    with pytest.raises(InputError, match=r"cameras\.C0: is inside vessel 'a' at time 0\.1 s"):
        list(frames)
    stdin("".join(lines(5)))
    scene = live_scene(tmp_path)
    first, second = ([frame.detections.boxes_px for frame in simulate_frames(scene)] for _ in range(2))
    assert len(first) == 10
    np.testing.assert_equal(first, second)
    stdin("")
    with pytest.raises(InputError, match="ended before the first time step"):
        run_scene(live_scene(tmp_path), tmp_path / "out")


@pytest.mark.parametrize(("stream", "part"), [
    ("nothing.jsonl", "nothing.jsonl: no such file: it must exist before the run begins"), (".", "this is a folder"),
    ("a\0b", "no such file"), (5, "poses.stream: a file, '-' for standard input, or a mapping of keys is needed"),
    ({"file": "-", "timeout_s": -1}, r"poses.stream.timeout_s: must be at least"),
    ({"fil": "-"}, r"poses.stream.fil: unknown key \(did you mean 'file'\?\)"),
])  # fmt: skip
def test_wrong_keys_of_a_stream_are_told(tmp_path, stream, part):
    with pytest.raises(InputError, match=part):
        load_scene(scene_of(tmp_path, {"stream": stream}))


def test_a_stream_takes_no_sea_and_no_rates_that_need_steps_to_come(tmp_path):
    sea = {"spectrum": "jonswap", "significant_height_m": 1.0, "peak_period_s": 5.5, "direction_rad": 2.6}
    thesis = yaml.safe_load((ROOT / "scenes/detectors/thesis.yaml").read_text())
    dropout = {"model": "logistic", "anchor": "state_rate", "distance_m": {"per_doubling": 1, "reference": 50}}
    anchored = thesis | {"dropout": dropout, "false_positives": {"model": "per_image", "rate": 1}}
    (tmp_path / "anchored.json").write_text(json.dumps(anchored))
    with pytest.raises(InputError) as caught:
        live_scene(tmp_path, waves=sea, detector="anchored.json")
    parts = "waves.spectrum: the sea needs the velocities of vessels", "give false_positives a size"
    for part in (*parts, "detector: holds rates over the whole scene (anchor: state_rate)"):
        assert part in str(caught.value)


@pytest.mark.parametrize(("text", "part"), [
    (line(0, "own") + "\n" + line(1, "own"), "line 2: is empty"), ("", "line 1: is empty"),
    (line(0, "own") + line(0, "own"), "line 2: '0.0' appears twice"),
    (line(0, "own") + line(1, "own")[:-9], "line 2, column"),
    (line(1, "own") + line(0, "own"), "timestamps must increase"),
])  # fmt: skip
def test_bad_lines_of_a_pose_file_are_told(tmp_path, text, part):
    (tmp_path / "poses.jsonl").write_text(text)
    with pytest.raises(InputError, match=part):
        load_scene(scene_of(tmp_path, {"file": "poses.jsonl"}))


@pytest.mark.parametrize("torn", [line(3, "own")[:-9], "\0" * 40, "{", "", "\n"])
def test_lines_are_a_pose_file_and_half_a_line_at_the_end_of_an_interrupted_runs_is_left_out(tmp_path, torn):
    folder = tmp_path if torn == "\n" else tmp_path / "unfinished"  # a whole line may be empty in any pose file
    (folder / "scene").mkdir(parents=True)
    (folder / "poses.jsonl").write_text("".join(lines(3)) + torn)
    scene = load_scene(scene_of(folder / "scene", {"file": "../poses.jsonl"}))
    assert (scene.steps, scene.timestamps(0, 3), scene.live) == (3, ("0.0", "0.1", "0.2"), False)


def test_table_bytes_do_not_depend_on_how_rows_arrive(tmp_path, monkeypatch):
    """Long texts that are all different: where a page or a dictionary ends depends on the pieces it is made from."""
    monkeypatch.setattr(tables, "ROW_GROUP_ROWS", 30_000)
    schema = pa.schema([("timestamp", pa.string()), ("x", pa.float64())])
    whole = pa.table({"timestamp": [f"{t:060d}" for t in range(70_000)], "x": np.arange(70_000.0)}, schema=schema)
    files = []
    for size in (7, 977, 70_000):
        writer = tables.TableWriter(tmp_path / "table", schema)
        for first in range(0, len(whole), size):
            writer.write(whole.slice(first, size))
        writer.close()
        files.append((tmp_path / "table").read_bytes())
    assert files[0] == files[1] == files[2]
