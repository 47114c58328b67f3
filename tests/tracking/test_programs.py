"""Programs and installed packages as trackers: exchange, failures, and pages with each setting and key of scores."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import fields
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any, get_args

import jsonschema
import numpy as np
import pyarrow.csv
import pyarrow.parquet as pq
import pytest

import modsim3d
from modsim3d import InputError, ModsimError, StoredRun, load_scene, track_run
from modsim3d.formats.writing.export_formats import FORMATS, ExportRequest
from modsim3d.tracking.scores.breakdown import Bin
from modsim3d.tracking.scores.occlusions import OcclusionEpisode
from modsim3d.tracking.scores.scoring import Part, SubsetScores
from modsim3d.tracking.trackers.names import BUILT_IN
from modsim3d.tracking.trackers.registry import command_tracker
from modsim3d.tracking.world.collision import MetVessel
from tests.plugin_site import site
from tests.run_folders import finished, wait_for

SCHEMA = json.loads((files("modsim3d.plugins") / "tracker_command.json").read_text(encoding="utf-8"))
RECORDER = """\
import json, sys
answers, tracks, log = sys.argv[1:]
with open(log, "w") as out:
    def say(content):
        line = json.dumps(content)
        out.write("< " + line + "\\n")
        print(line, flush=True)
    for number, line in enumerate(sys.stdin):
        out.write("> " + line)
        given = json.loads(line)
        if number == 0:
            say({"answers": answers, "tracks": tracks})
            continue
        told = []
        for frame in given.get("frames", [given]):
            for place, found in enumerate(frame["detections"]):
                camera = {"camera": frame["camera"]} if "frames" in given else {}
                if tracks == "image":
                    told.append({"track": place, "box_px": found["box_px"], "label": found["label"], **camera})
                elif found["position_m"]:
                    cov = found["position_covariance_m2"]
                    told.append({"track": len(told), "position_m": found["position_m"], "covariance": cov})
        say({"step": given["step"], **({} if "frames" in given else {"camera": given["camera"]}), "tracks": told})
"""


@pytest.fixture(scope="module")
def two_cameras(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    """A run of a camera on board and one ashore, whose frames are half as many."""
    noise = {"imu": {"attitude_noise_rad": 0.002, "heading_noise_rad": 0.005}}
    scene = load_scene("strait", steps=60, source="rectangles", settings=noise)
    return finished(scene, tmp_path_factory.mktemp("strait") / "run")


def exchange(run: StoredRun, folder: Path, answers: str, tracks: str) -> tuple[list[Any], list[Any], Any]:
    """What a recorder was told, what it answered, and the result."""
    (folder / "recorder.py").write_text(RECORDER, encoding="utf-8")
    command = [sys.executable, "recorder.py", answers, tracks, "log.txt"]
    given = {"command": command, "settings": {"gate": 3.5}, "overwrite": True}
    result = modsim3d.track_run(run, folder / "tracks", **given)
    lines = (folder / "log.txt").read_text(encoding="utf-8").splitlines()
    told, said = ([line[2:] for line in lines if line.startswith(mark)] for mark in "><")
    return told, [json.loads(line) for line in said], result


@pytest.mark.parametrize("tracks", ["image", "world"])
@pytest.mark.parametrize("answers", ["frames", "steps"])
def test_every_line_is_of_the_schema_and_all_is_told_once_in_order(two_cameras, tmp_path, monkeypatch, answers, tracks):
    monkeypatch.chdir(tmp_path)
    lines, said, result = exchange(two_cameras, tmp_path, answers, tracks)
    told = [json.loads(line) for line in lines]
    kinds = ["header", *[answers[:-1]] * (len(told) - 1)], ["choice", *["answer"] * (len(said) - 1)]
    for each, kind in zip((*told, *said), (*kinds[0], *kinds[1]), strict=True):
        jsonschema.Draft202012Validator({**SCHEMA, "oneOf": [{"$ref": f"#/$defs/{kind}"}]}).validate(each)
    assert told[0]["settings"] == {"gate": 3.5} and list(told[0]["cameras"]) == ["bow", "quay"]
    frames = [(each["step"], frame["camera"]) for each in told[1:] for frame in each.get("frames", [each])]
    inputs = {
        (json.loads(line)["step"], name): line
        for name in ("bow", "quay")
        for line in (two_cameras.folder / f"tracker_input_{name}.jsonl").read_text().splitlines()
    }
    assert frames == sorted(inputs) and len(frames) > 60
    if (answers, tracks) == ("frames", "image"):  # the rest of a line is the line of the file, byte for byte
        assert [line[line.index('"time_s"') :] for line in lines[1:]] == [inputs[each][1:] for each in frames]
        assert [list(each)[:3] for each in told[1:3]] == [["camera", "frames_in_step", "attitude_rad"]] * 2
    detections = sum(len(frame["detections"]) for each in told[1:] for frame in each.get("frames", [each]))
    assert result.counts.detections == detections > 100
    with pytest.raises(ModsimError, match="nothing says which one made"):
        modsim3d.score_run(two_cameras, tmp_path / "tracks", seeds=3)
    if tracks == "image":
        assert result.counts.boxes == detections and (tmp_path / "tracks" / "tracks.parquet").is_file()
    else:
        assert 20 < result.counts.boxes < detections
        assert len(told) - 1 == (60 if answers == "steps" else len(frames))
        assert len(modsim3d.read_world_tracks(tmp_path / "tracks", two_cameras)) == result.counts.boxes
    assert result.counts.frames == len(frames) and result.frame_ms["max"] >= result.frame_ms["median"] > 0


def test_places_own_ship_and_ais_are_those_of_the_exports_and_nothing_comes_early(two_cameras, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines, _, _ = exchange(two_cameras, tmp_path, "steps", "world")
    steps = [json.loads(line) for line in lines[1:]]
    for name in ("csv", "ais"):
        FORMATS[name].write(ExportRequest(two_cameras, (0, 1)), tmp_path / name)
    for camera in ("bow", "quay"):
        table = pyarrow.csv.read_csv(tmp_path / "csv" / f"detections_{camera}.csv").to_pylist()
        found = [
            (each["step"], one["bearing_rad"], one["inverse_range_std_per_m"], (one["position_m"] or [None])[0])
            for each in steps
            for frame in each["frames"]
            if frame["camera"] == camera
            for one in frame["detections"]
        ]
        columns = ("step", "bearing_rad", "inverse_range_std_per_m", "w1_m")
        assert found == [tuple(row[name] for name in columns) for row in table]
    own = pyarrow.csv.read_csv(tmp_path / "csv" / "ownship.csv").to_pylist()
    assert [next(iter(each["own_ships"].values()))["attitude_rad"] for each in steps] == [
        [row["roll_rad"], row["pitch_rad"], row["heading_rad"]] for row in own
    ]
    log = (tmp_path / "ais" / "ais.nmea").read_text(encoding="utf-8").splitlines()
    others = [line for line in log if "!AIVDM" in line]
    reports = [(each["time_s"], report) for each in steps for report in each["ais"]]
    parts = [part.split(",") for _, report in reports for part in report["nmea"].splitlines()]
    assert sorted(part[5] for part in parts) == sorted(line.split(",")[5] for line in others) and len(others) > 2
    before = -1.0
    for now_s, report in reports:
        assert now_s - 0.5 < report["received_s"] <= now_s and before <= report["received_s"]
        before = report["received_s"]
        if "position_m" in report:
            assert 0.2 <= report["received_s"] - report["measured_s"] <= 1.2 + 1e-9
            step = round(report["measured_s"] / steps[1]["time_s"])
            centres = two_cameras.scene.at(step).vessel_poses.poses.positions_m[0, :, :2]
            away = np.hypot(*(centres - report["position_m"]).T).min()
            assert away < 60, "within the length of a vessel of a centre"


HEAD = 'read header\nprintf \'{"answers":"frames","tracks":"image"}\\n\'\n'
ANSWER = 'printf \'{"camera":"C0","step":%d,"tracks":[]}\\n\' $n'
LOOP = HEAD + "n=0\nwhile read line; do\n  [ $n = 3 ] && { FAULT; }\n  " + ANSWER + "\n  n=$((n+1))\ndone\n"
FAULTS = {
    "dies": ("echo about to die >&2; kill -SEGV $$", "camera 'C0' at 3 s: SIGSEGV ended it; .* error: about to die"),
    "ends": ("exit 0", "camera 'C0' at 3 s: it ended with status 0"),
    "stalls": ("sleep 99", "camera 'C0' at 3 s: no answer within 2 s"),
    "closes its output": ("exec 1>&-; sleep 99", "camera 'C0' at 3 s: it closed its output"),
    "writes rubbish": ("echo hello", "at 3 s: it answered 'hello': a line of JSON is needed"),
    "has other keys": ('echo "{\\"step\\":3,\\"track\\":[]}"', "track: unknown key .did you mean 'tracks'"),
    "writes without end": ("tr -d x </dev/zero", "at 3 s: a line of more than 0 MB"),
    "has a comma too many": (
        "echo '{\"step\":3,}'",
        r"at 3 s: it answered '\{\"step\":3,\}': this is no JSON: trailing comma at column 11",
    ),
    "writes its step as text": ("""echo '{"camera":"C0","step":"3","tracks":[]}'""", "whole number is needed .got '3'"),
    "has a camera that is none": (
        """echo '{"camera":"C0","step":3,"tracks":[{"track":1,"camera":"","box_px":[5,5,9,9]}]}'""",
        "track 1: its camera must be C0, not ''",
    ),
    "answers another frame": ("n=9", "it answered step 9 of camera 'C0', and was given step 3 of camera 'C0'"),
    "answers twice": (ANSWER, r"at 4 s: it answered step 3 of camera 'C0', and was given step 4 of camera 'C0'"),
    "has a box that is none": (
        'printf \'{"camera":"C0","step":3,"tracks":[{"track":1,"box_px":[5,5,2,9]}]}\\n\'; n=4; continue',
        "at 3 s: track 1: a box is x_min, y_min, x_max, y_max, with a positive width",
    ),
    "has a label that is none": (
        'printf \'{"camera":"C0","step":3,"tracks":[{"track":1,"box_px":[5,5,9,9],"label":"x"}]}\\n\'; n=4; continue',
        "track 1: there is no label 'x'",
    ),
}


@pytest.mark.parametrize(("fault", "said"), FAULTS.values(), ids=FAULTS)
def test_a_program_that_fails_is_one_error(run, tmp_path, monkeypatch, fault, said):
    monkeypatch.setattr("modsim3d.io.coprocess.MAX_LINE_BYTES", 1 << 16)
    (tmp_path / "bad.sh").write_text(LOOP.replace("FAULT", fault), encoding="utf-8")
    began = time.monotonic()
    with pytest.raises(ModsimError, match=said) as raised:
        timeout_s = 2 if fault == "sleep 99" else 50
        modsim3d.track_run(run, tmp_path / "t", command=["sh", str(tmp_path / "bad.sh")], timeout_s=timeout_s)
    assert str(raised.value).startswith("the tracker 'bad': ") and time.monotonic() - began < 20
    assert not (tmp_path / "t").exists()


@pytest.mark.parametrize(("after", "said"), [
    ("sleep 99", "did not end within 2 s after the end of its input"),
    ("echo more", "it wrote more than was asked: 'more'"),
    ("exit 3", "it ended with status 3 after the end of its input"),
])  # fmt: skip
def test_a_program_ends_with_its_input_and_without_a_word(run, tmp_path, after, said):
    (tmp_path / "late.sh").write_text(LOOP.replace("FAULT", "true") + after, encoding="utf-8")
    with pytest.raises(ModsimError, match=f"at its end: {said}"):
        modsim3d.track_run(run, tmp_path / "t", command=["sh", str(tmp_path / "late.sh")], timeout_s=2)


def test_tracks_have_the_name_of_the_program_and_one_that_is_none_is_named(tmp_path, run):
    for name in ("tool", "params.json"):
        shutil.copy(shutil.which("true"), tmp_path / name)
    for command, name in (
        (["./tool", "params.json"], "tool"),
        (["sh", "-e", "./tool", "params.json"], "tool"),
        (["sh", "-c", "./tool -x"], "sh"),
    ):
        assert command_tracker(command, {}, folder=tmp_path).name == name
    for command, said in (
        (["./nobody"], "'./nobody': there is no such program"),
        ([str(tmp_path)], "there is no such program|may be run"),
        ([], "there is no such program"),
    ):
        with pytest.raises(ModsimError, match=said):
            modsim3d.track_run(run, tmp_path / "t", command=command)


@pytest.fixture
def family(tmp_path: Path) -> Iterator[Path]:
    """A program that stalls at its first frame, with others that it started, and writes the numbers of all."""
    # A child, one in a group of its own, and a grandchild in another session whose parent has ended.
    started = "sleep 999 & a=$!; timeout 998 sleep 998 & b=$!; c=$(setsid sh -c 'sleep 997 >&- 2>&- & echo $!')\n"
    script = HEAD + "read line\n" + started + "echo $$ $a $b $c > family.new; mv family.new family\nwait\n"
    (tmp_path / "stall.sh").write_text(script, encoding="utf-8")
    yield tmp_path
    if (tmp_path / "family").exists():
        assert not [each for each in (tmp_path / "family").read_text().split() if Path("/proc", each).exists()]


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="processes are looked up in /proc")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_nothing_is_left_after_an_interrupt_or_a_kill(run: StoredRun, family: Path, number: signal.Signals) -> None:
    modsim3d_there = [sys.executable, "-m", "modsim3d", "track", str(run.folder), "--out", "t"]
    with subprocess.Popen([*modsim3d_there, "--command", "sh stall.sh", "-q"], cwd=family, env=os.environ) as process:
        wait_for((family / "family").exists)
        process.send_signal(number)
        assert process.wait(120) != 0
    numbers = (family / "family").read_text().split()
    wait_for(lambda: not any(Path("/proc", each).exists() for each in numbers))
    assert not (family / "t").exists() or number == signal.SIGKILL


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="processes are looked up in /proc")
def test_what_a_program_left_is_ended_with_its_run(run: StoredRun, tmp_path: Path) -> None:
    left = "for n in $(seq 40); do setsid sleep 996 & echo $! >> left; done\n"
    (tmp_path / "leaves.sh").write_text(left + LOOP.replace("FAULT", "true"), encoding="utf-8")
    with pytest.raises(ModsimError, match="did not end within 3 s after the end of its input"):
        modsim3d.track_run(run, tmp_path / "t", command=["sh", "-c", f"cd {tmp_path} && . ./leaves.sh"], timeout_s=3)
    numbers = (tmp_path / "left").read_text().split()
    wait_for(lambda: not any(Path("/proc", each).exists() for each in numbers))  # the system reaps them


@pytest.mark.skipif(shutil.which("g++") is None, reason="there is no compiler of C++")
def test_the_programs_of_the_page_are_short() -> None:
    page = (Path(__file__).parents[2] / "docs" / "tracker_command.md").read_text(encoding="utf-8")
    programs = re.findall(r"```(cpp|python|shell)\n(.*?)```", page, flags=re.DOTALL)
    assert [name for name, _ in programs] == ["cpp", "python", "shell"]
    assert all(len(text.splitlines()) <= most for (_, text), most in zip(programs, (60, 62, 17), strict=True))


ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "tests" / "tracker_example"
SECTION = (ROOT / "docs" / "plugins.md").read_text(encoding="utf-8").split("\n## A tracker\n")[1].split("\n## ")[0]
__all__ = ["site"]  # a fixture


def test_an_installed_tracker_runs_by_name_with_its_settings_as_the_page_quotes_it(run, site, tmp_path, call):
    for language, name in (("toml", "pyproject.toml"), ("python", "modsim3d_overlap.py")):
        blocks = re.findall(rf"```{language}\n(.*?)```", SECTION, flags=re.DOTALL)
        assert blocks == [(EXAMPLE / name).read_text(encoding="utf-8")]
    _, tracker = blocks[0].split("\n\n\n")
    assert len([line for line in tracker.splitlines() if line]) == 10
    project = site.add_project(EXAMPLE)
    status, text = call("track", run.folder, "--tracker", "overlap", "--json", "--out", tmp_path / "a")
    assert status == 0, text
    said = json.loads(text.splitlines()[0])
    assert said["package"] == f"{project['name']} {project['version']}"
    assert (said["name"], said["settings"], said["chosen"]) == ("overlap", {"least_iou": 0.3}, "the tracker's defaults")
    detections, tracks = run.folder / "detections.parquet", pq.read_table(tmp_path / "a" / "tracks.parquet")
    rows = pq.read_metadata(detections).num_rows
    assert len(tracks) == rows == said["counts"]["boxes"] == said["counts"]["detections"]
    assert 0 < said["counts"]["tracks"] < len(tracks)
    strict = track_run(run, tmp_path / "b", tracker="overlap", settings={"least_iou": 1.1})
    assert strict.counts.tracks == len(tracks), "no two boxes are the same"
    with pytest.raises(InputError, match=r"least: unknown key \(did you mean 'least_iou'\?\)"):
        track_run(run, tmp_path / "c", tracker="overlap", settings={"least": 1})
    assert not (tmp_path / "c").exists()


DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "trackers.md").read_text(encoding="utf-8")
LIBRARY = ("sort", "bytetrack", "ocsort")


def defaults(name: str) -> dict[str, str]:
    """Settings of a tracker with the defaults that the page tells; the library's own stand in brackets behind them."""
    (section,) = (part for part in PAGE.split("\n## ") if f"`{name}`" in part.split("\n")[0])
    found: dict[str, str] = {}
    for line in section.splitlines():
        if line.startswith("| `"):
            names, _, *columns = (re.sub(r"\(.*?\)|`", "", cell).strip() for cell in line.strip("|").split("|"))
            told = columns[LIBRARY.index(name) if name in LIBRARY else 0]
            found |= dict(zip(names.split(", "), told.split(", "), strict=True))
    return found


@pytest.mark.parametrize("name", BUILT_IN)
def test_the_page_of_trackers_has_each_setting_with_its_default(name: str) -> None:
    model = getattr(import_module(BUILT_IN[name].module), BUILT_IN[name].class_name)
    told = defaults(name)
    for setting, field in model.model_fields.items():
        kind = type(field.default)
        value = told[setting] == "true" if kind is bool else kind(told[setting])
        assert value == field.default, setting


def test_the_pages_have_each_key_of_scores() -> None:
    kinds = {"scores": get_args(Part), "json": (SubsetScores, Bin, OcclusionEpisode), "world_tracks": (MetVessel,)}
    for page, parts in kinds.items():
        text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
        assert [each.name for part in parts for each in fields(part) if f"`{each.name}`" not in text] == [], page
