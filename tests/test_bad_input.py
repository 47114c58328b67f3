"""Bad input gets one clear error, exit status 2 and no traceback, and costs nothing that was written before."""

from __future__ import annotations

import copy
import json
import os
import re
import resource
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from modsim3d import cli
from modsim3d.errors import InputError
from modsim3d.render import context
from modsim3d.scene_reader import load_scene

DELETED = object()
COVARIANCE = [[100.0, 5, 0, 0], [5, 90, 0, 0], [0, 0, 120, 8], [0, 0, 8, 80]]
FILES = {"scene": "scene.yaml", "vessels": "vessels.json", "poses": "poses.json", "detector": "detector.yaml"}


def at(w1: float, w2: float, heading_rad: float = 0.0) -> dict[str, Any]:
    return {"center_position_m": [w1, w2, 0.0], "heading_rad": heading_rad}


def lens(**place: Any) -> dict[str, Any]:
    return {
        "focal_length_m": 0.0237,
        "pixel_size_m": [1.0e-5, 1.0e-5],
        "principal_point_px": [320, 240],
        "image_size_px": [640, 480],
        **place,
    }


ASHORE = {"position_m": [-60.0, 0.0, 4.0]}
GOOD: dict[str, Any] = {
    "scene": {
        "seed": 1,
        "vessels": "vessels.json",
        "poses": {"file": "poses.json"},
        "cameras": {
            "C0": lens(mount={"vessel": "vehicle1", "position_m": [4.0, 0.0, 1.0]}),
            "shore": lens(pose=ASHORE),
        },
        "annotation": {"mode": 2, "source": "rendered"},
        "detector": "detector.yaml",
    },
    "vessels": {
        "vehicle1": {"length_m": 8.0, "beam_m": 4.0, "air_draft_m": 1.0, "label": "Vessel"},
        "vehicle2": {"length_m": 8.0, "beam_m": 4.0, "air_draft_m": 2.0, "label": "Vessel"},
    },
    "poses": {f"{t}.0": {"vehicle1": at(t, 0.0), "vehicle2": at(40.0 - t, 6.0)} for t in range(4)},
    "detector": {
        "labels": ["Vessel"],
        "confidence_threshold": 0.2,
        "initial_state": "clear",
        "transition_matrix": [[0.9, 0.2], [0.1, 0.8]],
        "false_positives": {"model": "calibrated"},
        "states": {
            name: {
                "confusion": [[recall], [1 - recall]],
                "false_positive_labels": [1.0],
                "false_discovery_rate": 0.1,
                "box_error": {"unit": "px", "mean": [0.0, 0, 0, 0], "covariance": COVARIANCE},
                "confidence": {"mean": 0.67, "std": 0.1},
            }
            for name, recall in (("clear", 0.875), ("fog", 0.5))
        },
    },
}
CIRCULAR = {"circular": {"centre_m": [200, 0], "radius_m": [5, 90], "rotation_rate_rad_s": [0.01, 0.02]}}


@dataclass
class Inputs:
    """A good scene of four files, for a test to spoil."""

    folder: Path
    data: dict[str, Any]

    def set(self, file: str, path: str, value: Any) -> None:
        """Put a value at a path; `/` between the keys, which may hold dots."""
        *sections, last = path.split("/")
        section = self.data[file]
        for name in sections:
            section = section[int(name) if isinstance(section, list) else name]
        if value is DELETED:
            del section[last]
        else:
            section[int(last) if isinstance(section, list) else last] = value

    def path(self, file: str) -> Path:
        return self.folder / FILES[file]

    def write(self) -> Path:
        self.folder.mkdir(exist_ok=True)
        for file, content in self.data.items():
            text = json.dumps(content, indent=1) if FILES[file].endswith("json") else yaml.safe_dump(content)
            self.path(file).write_text(text, encoding="utf-8")
        return self.path("scene")


@pytest.fixture
def inputs(tmp_path: Path) -> Inputs:
    return Inputs(tmp_path / "in", copy.deepcopy(GOOD))


Call = Callable[..., tuple[int, str]]
Refused = Callable[..., str]


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Call:
    """Runs the command line in this process and gives exit status and what it said."""

    def run(*arguments: object) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["modsim3d", *map(str, arguments)])
        with pytest.raises(SystemExit) as stopped:
            cli.main()
        said = capsys.readouterr()
        return int(stopped.value.code or 0), said.out + said.err

    return run


@pytest.fixture
def refused(call: Call, tmp_path: Path) -> Refused:
    """Has `check` and `run` refuse a scene file, looks for parts of what they say, and for a folder left behind."""

    def look(scene: object, *parts: str, options: tuple[object, ...] = ()) -> str:
        out = tmp_path / "out" / "run"
        commands = [("run", scene, "--out", out, "--no-sheet", *options)]
        if not options:
            commands.append(("check", scene))
        for command in commands:
            status, said = call(*command)
            assert status == 2, said
            assert "Traceback" not in said
            for part in parts:
                assert part in said, f"{part!r} not in:\n{said}"
        assert not out.parent.exists()
        return said

    return look


def test_the_scene_that_these_tests_spoil_is_good(inputs: Inputs, call: Call) -> None:
    status, said = call("check", inputs.write())
    assert (status, "no problems found" in said) == (0, True), said


# ---- one wrong value --------------------------------------------------------------------------------------------


def state(path: str) -> str:
    return f"states/clear/{path}"


WRONG_VALUES: list[tuple[str, str, Any, tuple[str, ...]]] = [
    # unknown, missing and misspelt
    ("scene", "sed", 3, ("sed: unknown key (did you mean 'seed'?)",)),
    ("scene", "annotation/mod", 3, ("annotation.mod: unknown key (did you mean 'mode'?)",)),
    (
        "scene",
        "cameras/C0/focal_lenght_m",
        1,
        ("cameras.C0.focal_lenght_m: unknown key", "did you mean 'focal_length_m'?"),
    ),
    ("scene", "cameras/C0/mount/pitch", 1, ("cameras.C0.mount.pitch: unknown key (did you mean 'pitch_rad'?)",)),
    ("scene", "detector", DELETED, ("detector: missing",)),
    ("scene", "cameras/shore/image_size_px", DELETED, ("cameras.shore.image_size_px: missing",)),
    ("vessels", "vehicle2/beam_m", DELETED, ("vessels.json: vehicle2.beam_m: missing",)),
    ("vessels", "vehicle2/lenght_m", 4, ("vessels.json: vehicle2.lenght_m: unknown key (did you mean 'length_m'?)",)),
    ("vessels", "vehicle2/label", "Vesel", ("vehicle2.label: 'Vesel' is not one of", "did you mean 'Vessel'?")),
    ("poses", "1.0/vehicle9", at(0, 0), ("poses.json: 1.0.vehicle9: no vessel 'vehicle9' (did you mean 'vehicle",)),
    ("poses", "1.0/vehicle2/heading_rad", DELETED, ("1.0.vehicle2.heading_rad: missing",)),
    ("poses", "1.0/vehicle2/heading", 1, ("1.0.vehicle2.heading: unknown key (did you mean 'heading_rad'?)",)),
    ("scene", "cameras/C0/mount/vessel", "vehicle9", ("cameras.C0.mount.vessel: no vessel 'vehicle9'", "did you mean")),
    ("detector", "initial_state", "claer", ("detector.yaml: initial_state: unknown state 'claer'", "'clear'?")),
    ("detector", "false_positives/model", "thesys", ("false_positives.model: unknown model 'thesys'", "'thesis'?")),
    # not numbers
    ("poses", "2.0/vehicle2/heading_rad", float("nan"), ("2.0.vehicle2.heading_rad: a finite number", "(got nan)")),
    ("poses", "2.0/vehicle2/center_position_m/1", float("inf"), ("2.0.vehicle2.center_position_m: three finite",)),
    ("poses", "2.0/vehicle2/center_position_m/0", 10**400, ("2.0.vehicle2.center_position_m: three finite",)),
    ("poses", "2.0/vehicle2/center_position_m/0", 1e300, ("is farther than 1e+09 m", "1e+300")),
    ("poses", "2.0/vehicle2/center_position_m", [1, 2], ("three finite numbers in metres are needed (got [1, 2])",)),
    ("poses", "2.0/vehicle2/heading_rad", True, ("2.0.vehicle2.heading_rad: a finite number", "(got True)")),
    ("poses", "2.0/vehicle2", None, ("2.0.vehicle2: a mapping with center_position_m and heading_rad is needed",)),
    ("poses", "2.0", [], ("2.0: a mapping of vessel ID to pose is needed (got [])",)),
    ("vessels", "vehicle2/beam_m", float("nan"), ("vehicle2.beam_m: a finite number is needed (got nan)",)),
    ("vessels", "vehicle2/beam_m", 0, ("vehicle2.beam_m: Input should be greater than", "(got 0)")),
    ("vessels", "vehicle2/length_m", -4.5, ("vehicle2.length_m: Input should be greater than", "(got -4.5)")),
    ("vessels", "vehicle2/air_draft_m", 1e200, ("vehicle2.air_draft_m: Input should be less than", "(got 1e+200)")),
    ("vessels", "vehicle2/length_m", "8", ("vehicle2.length_m: Input should be a valid number (got '8')",)),
    ("vessels", "vehicle2/length_m", True, ("vehicle2.length_m: Input should be a valid number (got True)",)),
    ("vessels", "vehicle2", 5, ("vehicle2: a mapping of keys is needed (got 5)",)),
    ("scene", "seed", "1", ("seed: Input should be a valid integer (got '1')",)),
    ("scene", "seed", True, ("seed: Input should be a valid integer (got True)",)),
    ("scene", "seed", -1, ("seed: Input should be greater than or equal to 0 (got -1)",)),
    ("scene", "seed", 2**70, ("seed: Input should be less than", "(got 1180591620717411303424)")),
    ("scene", "steps", 0, ("steps: Input should be greater than 0 (got 0)",)),
    ("scene", "steps", 2.5, ("steps: Input should be a valid integer", "(got 2.5)")),
    ("scene", "steps", 10**15, ("steps: Input should be less than or equal to", "(got 1000000000000000)")),
    ("scene", "annotation/mode", 3, ("annotation.mode: Input should be less than or equal to 2 (got 3)",)),
    ("scene", "annotation/mode", True, ("annotation.mode: Input should be a valid integer (got True)",)),
    ("scene", "annotation/source", "renderd", ("annotation.source: Input should be 'rendered'", "(got 'renderd')")),
    ("scene", "annotation/min_visible_fraction", 1.5, ("annotation.min_visible_fraction: Input should be less",)),
    ("scene", "annotation", None, ("annotation: a mapping of keys is needed (got None)",)),
    ("scene", "cameras/C0", None, ("cameras.C0: a mapping of keys is needed (got None)",)),
    ("scene", "cameras/C0/image_size_px", [640, 0], ("cameras.C0.image_size_px[1]: Input should be greater than 0",)),
    ("scene", "cameras/C0/image_size_px", [640], ("cameras.C0.image_size_px[1]: missing",)),
    ("scene", "cameras/C0/image_size_px", [1, 2, 3], ("cameras.C0.image_size_px: a list of 2 is needed",)),
    ("scene", "cameras/C0/image_size_px", 640, ("cameras.C0.image_size_px: a list is needed (got 640)",)),
    ("scene", "cameras/C0/image_size_px", [10**6, 480], ("image_size_px[0]: Input should be less than", "12000")),
    ("scene", "cameras/C0/focal_length_m", "0.05 m", ("cameras.C0.focal_length_m: Input should be a valid number",)),
    ("scene", "cameras/C0/focal_length_m", 0, ("cameras.C0.focal_length_m: Input should be greater than",)),
    ("scene", "cameras/C0/focal_length_m", float("inf"), ("focal_length_m: a finite number is needed (got inf)",)),
    ("scene", "cameras/C0/pixel_size_m", [-1e-5, 1e-5], ("cameras.C0.pixel_size_m[0]: Input should be greater",)),
    ("scene", "cameras/C0/near_clip_m", 0, ("cameras.C0.near_clip_m: Input should be greater than",)),
    ("scene", "cameras/C0/skew", True, ("cameras.C0.skew: Input should be a valid number (got True)",)),
    ("scene", "vessels", [1], ("vessels: a file or a mapping of vessel ID to vessel is needed (got [1])",)),
    ("scene", "vessels", {1: GOOD["vessels"]["vehicle1"]}, ("vessels: a vessel's ID must be text: put 1 in quotes",)),
    ("scene", "cameras", {7: lens(pose=ASHORE)}, ("cameras.7: a name must be text: put it in quotes",)),
    # probabilities
    ("detector", "confidence_threshold", 1.2, ("confidence_threshold: Input should be less than or equal to 1",)),
    ("detector", "confidence_threshold", float("nan"), ("confidence_threshold:", "(got nan)")),
    (
        "detector",
        state("confusion"),
        [[0.9], [0.2]],
        ("detector.yaml: states.clear.confusion: column 'Vessel' sums to 1.1, must sum to 1",),
    ),
    (
        "detector",
        state("confusion"),
        [[1.5], [-0.5]],
        ("states.clear.confusion[0][0]: Input should be less than or equal to 1 (got 1.5)", "confusion[1][0]"),
    ),
    ("detector", state("confusion"), [[0.9, 0.1]], ("confusion: is 1 × 2, must be 2 × 1", "must be transposed")),
    (
        "detector",
        "transition_matrix",
        [[0.9, 0.1], [0.2, 0.8]],
        ("transition_matrix: its rows sum to one and its columns do not", "must be transposed"),
    ),
    ("detector", "transition_matrix", [[0.9, 0.3], [0.1, 0.8]], ("column 'fog' sums to 1.1, must sum to 1",)),
    ("detector", state("false_discovery_rate"), 1, ("states.clear.false_discovery_rate: is 1, must be below 1",)),
    ("detector", state("false_discovery_rate"), -0.1, ("false_discovery_rate: is -0.1, must be from 0 to 0.99",)),
    ("detector", state("false_positive_labels"), [0.7], ("states.clear.false_positive_labels: sums to 0.7",)),
    # covariance
    (
        "detector",
        state("box_error/covariance"),
        [[100.0, 7, 0, 0], *COVARIANCE[1:]],
        ("states.clear.box_error.covariance: is not symmetric: row e_x, column e_y is 7, row e_y, column e_x is 5",),
    ),
    (
        "detector",
        state("box_error/covariance"),
        [[4.0, 5, 0, 0], [5, 4, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
        ("covariance: is not positive semi-definite", "its smallest eigenvalue is -1, must be at least 0"),
    ),
    # names
    ("vessels", "vehicle#2", GOOD["vessels"]["vehicle2"], ("vehicle#2: a vessel's ID must not hold '#'",)),
    (
        "vessels",
        "false_positive_1",
        GOOD["vessels"]["vehicle2"],
        ("false_positive_1: a vessel's ID must not begin with 'false_positive_'",),
    ),
    ("vessels", "obstacle:quay", GOOD["vessels"]["vehicle2"], ("must not begin with 'obstacle:'",)),
    ("vessels", "", GOOD["vessels"]["vehicle2"], ("a vessel's ID must not be empty",)),
    ("vessels", "a\nb", GOOD["vessels"]["vehicle2"], ("a vessel's ID must be printable text (got 'a\\nb')",)),
    ("scene", "cameras/a\\b", lens(pose=ASHORE), ("cameras.a\\b: a camera's name goes into file names",)),
    ("scene", "cameras/..", lens(pose=ASHORE), ("a camera's name goes into file names",)),
    ("scene", "cameras/" + "x" * 300, lens(pose=ASHORE), ("at most 100 letters",)),
    # degrees
    ("scene", "cameras/C0/mount/pitch_rad", 10, ("pitch_rad: 10 is more than a whole turn: angles are in radians",)),
    ("scene", "cameras/shore/pose/yaw_rad", -180, ("cameras.shore.pose.yaw_rad: -180 is more than a whole turn",)),
    ("scene", "waves", {"spectrum": "jonswap", "direction_rad": 90}, ("waves.direction_rad: 90 is more than",)),
    ("scene", "obstacles", {"a": {"mesh": "ferry", "heading_rad": 45}}, ("obstacles.a.heading_rad: 45 is more than",)),
    # what belongs together
    ("scene", "cameras/shore/mount", GOOD["scene"]["cameras"]["C0"]["mount"], ("cameras.shore.mount: give exactly",)),
    ("scene", "cameras/shore/pose", DELETED, ("cameras.shore.mount: give exactly one of pose (ashore) and mount",)),
    ("scene", "poses", CIRCULAR, ("poses: circular has no times of its own: give steps and time_step_s",)),
    (
        "scene",
        "poses",
        {"file": "poses.json", **CIRCULAR},
        ("poses: give exactly one of file, circular, tracks, agents, stream (got circular, file)",),
    ),
    ("scene", "poses", {}, ("poses: give exactly one of file, circular, tracks, agents, stream",)),
    ("scene", "poses", {"file": None}, ("poses: give exactly one of file, circular, tracks, agents, stream",)),
    ("scene", "poses", {"circlar": {}}, ("poses.circlar: nothing is called", "did you mean 'circular'?")),
    ("scene", "poses", {"file": 5}, ("poses.file: Input should be a valid string (got 5)",)),
    ("scene", "poses", [], ("poses: a mapping of keys is needed (got [])",)),
    ("scene", "poses", {"agents": {"size_m": [150, 0]}}, ("poses.agents.size_m[1]: Input should be greater than 0",)),
    ("scene", "poses", {"agents": {"size_m": [9, 9], "speed_m_s": [3, 2]}}, ("is [least, greatest], but 3.0 > 2.0",)),
    ("scene", "poses", {"agents": {"size_m": [9, 9], "speed": [3, 2]}}, ("poses.agents.speed: unknown key (did you",)),
    ("scene", "steps", 5, ("steps: 5 asked for, but the pose file has 4",)),
    # nothing there
    ("scene", "cameras", {}, ("cameras: no cameras; a scene needs at least one",)),
    ("scene", "vessels", {}, ("vessels: no vessels; a scene needs at least one",)),
    # files
    ("scene", "vessels", "no/such.json", ("no/such.json: no such file",)),
    ("scene", "poses/file", "nothing.json", ("nothing.json: no such file",)),
    ("scene", "detector", "thesis.yaml", ("detector", "thesis.yaml: no such file")),
    ("scene", "vessels", ".", ("this is a folder, a file was expected",)),
    ("scene", "poses/file", ".", ("this is a folder, a file was expected",)),
    ("scene", "detector", ".", ("this is a folder, a file was expected",)),
    ("scene", "detector", "a\0b", ("is no valid file name",)),
    ("scene", "detector", "x" * 5000, ("cannot be read: File name too long",)),
    # places
    ("poses", "2.0/vehicle1", DELETED, ("cameras.C0.mount.vessel: 'vehicle1' has no pose at time 2.0 s",)),
]


@pytest.mark.parametrize(
    ("file", "path", "value", "parts"),
    WRONG_VALUES,
    ids=[f"{i}-{file}-{path[:40]!a}" for i, (file, path, _, _) in enumerate(WRONG_VALUES)],
)
def test_wrong_value_is_told_with_its_place_and_what_would_be_right(
    inputs: Inputs, refused: Refused, file: str, path: str, value: Any, parts: tuple[str, ...]
) -> None:
    inputs.set(file, path, value)
    refused(inputs.write(), *parts)


def test_camera_inside_a_vessel_names_both_and_the_time(inputs: Inputs, refused: Refused, call: Call) -> None:
    inputs.set("poses", "2.0/vehicle2", at(-61.0, 1.0))
    inputs.set("vessels", "vehicle2/air_draft_m", 6.0)
    part = "cameras.shore: is inside vessel 'vehicle2' at time 2.0 s: move one of them, or set annotation."
    refused(inputs.write(), part, "allow_camera_inside: true")
    refused(inputs.write(), part, options=("--steps", 3))
    inputs.set("scene", "steps", 2)
    assert call("check", inputs.write())[0] == 0
    inputs.set("scene", "steps", 3)
    inputs.set("scene", "annotation/allow_camera_inside", True)
    assert call("check", inputs.write())[0] == 0


def test_rings_that_do_not_fit_name_the_vessel_and_its_size(inputs: Inputs, refused: Refused) -> None:
    inputs.data["scene"].update(poses={"circular": {"radius_m": [5, 9], "rotation_rate_rad_s": [0, 1]}}, time_step_s=1)
    inputs.data["scene"].update(steps=5)
    refused(inputs.write(), "poses.circular: no free ring for vessel 'vehicle2' (8.0 m × 4.0 m) between radii 5.0 and")


# ---- times ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("times", "part"),
    [
        (["0.0", "2.0", "1.0"], "1.0: timestamps must increase, but '1.0' comes after '2.0'"),
        (["0.0", "1.0", "1.00"], "1.00: timestamps must increase, but '1.00' is the same time as '1.0'"),
        (["0.0", "1e0", "1.0"], "'1.0' is the same time as '1e0'"),
        (["0.0", "soon"], "soon: a timestamp must be a number of seconds (got 'soon')"),
        (["0.0", "nan"], "nan: a timestamp must be a number of seconds"),
        (["0.0", "inf"], "inf: a timestamp must be a number of seconds"),
        (["0.0", "1e999"], "1e999: a timestamp must be a number of seconds"),
        (["0.0", "1_0"], "1_0: a timestamp must be a number of seconds"),
        (["0.0", ""], "a timestamp must be a number of seconds (got '')"),
    ],
)
def test_times_that_do_not_increase_are_told(inputs: Inputs, refused: Refused, times: list[str], part: str) -> None:
    inputs.data["poses"] = {time: {"vehicle1": at(0, 0)} for time in times}
    refused(inputs.write(), part)


def test_repeated_json_keys_are_told_with_their_place(inputs: Inputs, refused: Refused) -> None:
    scene = inputs.write()
    pose = json.dumps(at(0, 0))
    inputs.path("poses").write_text(
        f'{{"0.0": {{"vehicle1": {pose}}}, "1.0": {{"vehicle1": {pose}, "vehicle1": {pose}}}, "0.0": {{}}}}'
    )
    refused(scene, "1.0.vehicle1: the key 'vehicle1' appears twice", "0.0: the key '0.0' appears twice")


def test_a_mistake_in_every_line_does_not_fill_the_screen(inputs: Inputs, refused: Refused) -> None:
    inputs.data["poses"] = {f"{t}.0": {"vehicle1": at(t, 0), "vehicel2": at(0, 9)} for t in range(1000)}
    said = refused(inputs.write(), "0.0.vehicel2: no vessel 'vehicel2'", "the rest was not checked")
    assert said.count("\n") < 30


def test_more_steps_than_the_pose_file_has_are_told(inputs: Inputs, refused: Refused) -> None:
    refused(inputs.write(), "steps: 9 asked for, but the pose file has 4", options=("--steps", 9))


# ---- texts ------------------------------------------------------------------------------------------------------

WRONG_TEXTS: list[tuple[str, bytes, tuple[str, ...]]] = [
    ("scene", b"", ("scene.yaml:", "the file is empty")),
    ("scene", b"# nothing but a comment\n", ("the file is empty",)),
    ("scene", b"- 1\n- 2\n", ("a mapping of keys is needed",)),
    ("scene", b"seed: 1\ncameras: {C0: [1, 2}\n", ("line 2, column 20:", "expected ',' or ']', but got '}'")),
    ("scene", b"seed: 1\n\tsteps: 2\n", ("line 2, column 1:",)),
    ("scene", b"seed: 1\nseed: 2\n", ("line 2, column 1: key 'seed' appears twice",)),
    ("scene", b"seed: 1\n---\nseed: 2\n", ("line 2, column 1: expected a single document",)),
    ("scene", b"seed: !!bool x\n", ("line 1, column 7: 'x' cannot be read as bool",)),
    ("scene", b"seed: !!timestamp x\n", ("line 1, column 7: 'x' cannot be read as timestamp",)),
    ("scene", b"seed: " + b"1" * 5000, ("line 1, column 7:", "cannot be read as int")),
    ("scene", b"seed: &a [*a]\n", ("line 1, column 7:", "recursive")),
    ("scene", b"seed: " + b"[" * 2000, ("is nested too deeply",)),
    ("scene", b"seed: 1\nx: \x00\n", ("line 2, column 4: character '\\x00' is not allowed in YAML",)),
    ("scene", b"seed: 1\n# \xff\n", ("is not UTF-8 text (byte 10)",)),
    ("scene", b"[1]: 2\n", ("line 1, column 1: a key must be plain text",)),
    ("detector", b"", ("detector.yaml: must be a mapping with the keys labels",)),
    ("detector", b"labels: [Vessel\nstates: {}", ("detector.yaml: line 2, column 7:",)),
    ("detector", "labels: [Båt]".encode("latin-1"), ("detector.yaml: is not UTF-8 text (byte 10)",)),
    ("vessels", b"", ("vessels.json: the file is empty",)),
    ("vessels", b"{}", ("vessels.json: top level: no vessels; a scene needs at least one",)),
    ("vessels", b"[]", ("vessels.json: top level: a mapping of vessel ID to vessel is needed",)),
    ("vessels", b"null", ("vessels.json: top level: a mapping of vessel ID to vessel is needed",)),
    ("vessels", b'{"vehicle1": {"beam_m": 4,}}', ("vessels.json: line 1, column 27:", "property name")),
    ("vessels", b"\xff\xfe{", ("vessels.json: is not UTF-8 text (byte 0)",)),
    ("poses", b"", ("poses.json: the file is empty",)),
    ("poses", b"{}", ("poses.json: a mapping of timestamp to vessels is needed, with at least one timestamp",)),
    ("poses", b'{"0.0": {"vehicle1": {"center_pos', ("poses.json: line 1, column 23: Unterminated string",)),
    ("poses", b'{"0.0": {"vehicle1":\n {}}', ("poses.json: line 2, column 5:", "the file ends here: is it cut off?")),
    ("poses", b"[" * 100_000, ("poses.json: is nested too deeply",)),
    ("poses", b'{"0.0": ' + b"1" * 5000 + b"}", ("poses.json: a value cannot be read:",)),
]


@pytest.mark.parametrize(
    ("file", "text", "parts"), WRONG_TEXTS, ids=[f"{i}-{file}" for i, (file, _, _) in enumerate(WRONG_TEXTS)]
)
def test_text_that_cannot_be_read_is_told_with_its_place(
    inputs: Inputs, refused: Refused, file: str, text: bytes, parts: tuple[str, ...]
) -> None:
    scene = inputs.write()
    inputs.path(file).write_bytes(text)
    refused(scene, *parts)


def test_numbers_and_booleans_are_those_of_yaml_1_2(inputs: Inputs, call: Call, refused: Refused) -> None:
    scene = inputs.write()
    text = scene.read_text()
    scene.write_text(re.sub(r"1\.0e-05", "1e-5", text))
    assert "1e-5" in scene.read_text()
    assert call("check", scene)[0] == 0
    scene.write_text(text.replace("annotation:", "annotation:\n  allow_camera_inside: no"))
    refused(scene, "annotation.allow_camera_inside: Input should be a valid boolean (got 'no')")


def test_enormous_aliases_are_told_without_being_written_out(inputs: Inputs, refused: Refused) -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 30)]
    scene = inputs.write()
    scene.write_text("\n".join([*lines, "seed: *a29", "vessels: *a29"]))
    assert len(refused(scene, "seed: Input should be a valid integer (got [[", "vessels: a file or")) < 10_000


# ---- all at once ------------------------------------------------------------------------------------------------


def test_mistakes_in_every_file_are_told_at_once(inputs: Inputs, refused: Refused) -> None:
    for file, path, value in [
        ("scene", "sed", 1),
        ("scene", "cameras/C0/mount/vessel", "vehicle9"),
        ("scene", "cameras/shore/mount", {"vessel": "vehicle1", "position_m": [0, 0, 0]}),
        ("vessels", "vehicle2/beam_m", -1),
        ("vessels", "vehicle1/label", "Boat"),
        ("poses", "3.0/vehicle2/heading_rad", "east"),
        ("poses", "3.0/vehicle7", at(0, 0)),
        ("detector", "confidence_threshold", 7),
        ("detector", "states/fog/confusion", [[0.5], [0.4]]),
    ]:
        inputs.set(file, path, value)
    said = refused(
        inputs.write(),
        "sed: unknown key",
        "cameras.C0.mount.vessel: no vessel 'vehicle9'",
        "cameras.shore.mount: give exactly one",
        "vessels.json: vehicle2.beam_m: Input",
        "poses.json: 3.0.vehicle2.heading_rad: a finite number",
        "poses.json: 3.0.vehicle7: no vessel 'vehicle7'",
        "detector.yaml: confidence_threshold: Input",
        "detector.yaml: states.fog.confusion: column 'Vessel' sums to 0.9",
    )
    assert "vehicle1.heading" not in said


def test_misspelt_label_is_told_beside_another_mistake_in_the_vessels(inputs: Inputs, refused: Refused) -> None:
    inputs.set("vessels", "vehicle2/beam_m", -1)
    inputs.set("vessels", "vehicle1/label", "Boat")
    refused(inputs.write(), "vehicle2.beam_m: Input", "vehicle1.label: 'Boat' is not one of the detector's labels")


def test_pose_file_is_looked_at_when_the_vessels_are_missing(inputs: Inputs, refused: Refused) -> None:
    inputs.set("scene", "vessels", "gone.json")
    inputs.set("poses", "3.0/vehicle2/heading_rad", "east")
    refused(inputs.write(), "gone.json: no such file", "3.0.vehicle2.heading_rad: a finite number")


# ---- the command line -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["run", "simulation_1", "--mode", "3"], "--mode"),
        (["run", "simulation_1", "--steps", "0"], "--steps"),
        (["run", "simulation_1", "--seed", "-1"], "--seed"),
        (["run", "simulation_1", "--source", "guessed"], "--source"),
        (["run", "simulation_1", "--frobnicate"], "--frobnicate"),
        (["run"], "SCENE"),
        (["fly"], "fly"),
        (["run", "simulation_1", "--seed", str(2**70)], "seed: Input should be less than"),
        (["check", "simulaton_1"], "no shipped scene has this name (did you mean 'simulation_1'?)"),
        (["check", "."], "this is a folder"),
        (["check", "x" * 5000], "File name too long"),
        (["check", "/dev/null"], "the file is empty"),
    ],
    ids=lambda value: "-".join(value)[:40] if isinstance(value, list) else "",
)
def test_wrong_arguments_exit_with_two(
    call: Call, arguments: list[str], part: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    status, said = call(*arguments)
    assert status == 2
    assert part in re.sub(r"\x1b\[[0-9;]*m", "", said)
    assert "Traceback" not in said
    assert not list(tmp_path.iterdir())


def test_a_folder_with_a_shipped_scenes_name_does_not_hide_it(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "simulation_1").mkdir()
    assert call("check", "simulation_1")[0] == 0


# ---- output folders ---------------------------------------------------------------------------------------------


def content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def finished(inputs: Inputs, call: Call, tmp_path: Path) -> Path:
    """A run directory that must not be lost."""
    status, said = call("run", inputs.write(), "--out", tmp_path / "kept", "--no-sheet")
    assert status == 0, said
    return tmp_path / "kept"


@pytest.mark.parametrize("place", ["file/run", "file", "/proc/modsim3d/run", "x" * 300])
def test_folder_that_cannot_be_written_to_is_told(inputs: Inputs, call: Call, tmp_path: Path, place: str) -> None:
    (tmp_path / "file").write_text("mine")
    status, said = call("run", inputs.write(), "--out", tmp_path / place)
    assert status == 2
    assert "cannot be written to" in said or "is not a run directory" in said
    assert "Traceback" not in said
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize("options", [(), ("--overwrite",), ("--resume",), ("--overwrite", "--resume")])
@pytest.mark.parametrize(
    "name", ["notes.txt", "run.json", "unfinished/settings.json", "unfinished/chapter.txt", "truth.parquet"]
)
def test_a_folder_that_is_no_run_directory_keeps_all_it_holds(
    inputs: Inputs, call: Call, tmp_path: Path, options: tuple[str, ...], name: str
) -> None:
    precious = tmp_path / "precious"
    (precious / name).parent.mkdir(parents=True)
    (precious / name).write_text('{"mine": true}')
    (precious / "photo.jpg").write_text("mine too")
    before = content(precious)
    status, said = call("run", inputs.write(), "--out", precious, *options)
    assert status == 2
    assert f"{precious} exists and is not a run directory: choose another folder" in said
    assert content(precious) == before


@pytest.mark.parametrize("options", [(), ("--resume",)])
def test_a_run_is_not_replaced_unasked(inputs: Inputs, finished: Path, call: Call, options: tuple[str, ...]) -> None:
    before = content(finished)
    status, said = call("run", inputs.path("scene"), "--out", finished, *options)
    assert status == 2
    assert "holds a run: use --overwrite" in said
    assert content(finished) == before


def test_bad_input_with_overwrite_keeps_the_run_that_is_there(inputs: Inputs, finished: Path, call: Call) -> None:
    before = content(finished)
    inputs.set("poses", "2.0/vehicle1", DELETED)
    assert call("run", inputs.write(), "--out", finished, "--overwrite")[0] == 2
    assert content(finished) == before


def test_a_run_that_is_replaced_stays_until_the_new_one_is_finished(
    inputs: Inputs, finished: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = content(finished)
    inputs.data["scene"]["cameras"].pop("shore")

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("modsim3d.formats.run_directory.RunDirectory.write", interrupt)
        assert call("run", inputs.write(), "--out", finished, "--overwrite")[0] == 130
    assert content(finished).items() >= before.items()
    assert call("run", inputs.write(), "--out", finished, "--resume", "--no-sheet")[0] == 0
    after = content(finished)
    assert not any("shore" in name or "unfinished" in name for name in after)
    assert json.loads(after["run.json"])["cameras"] == ["C0"]


@pytest.mark.parametrize("leftover", ["settings.json.partial", ""])
def test_a_run_killed_at_its_very_start_can_be_begun_again(
    inputs: Inputs, call: Call, tmp_path: Path, leftover: str
) -> None:
    work = tmp_path / "killed" / "unfinished"
    work.mkdir(parents=True)
    if leftover:
        (work / leftover).write_text('{"form')
    status, said = call("run", inputs.write(), "--out", work.parent, "--resume", "--no-sheet")
    assert status == 0, said


# ---- no renderer ------------------------------------------------------------------------------------------------


def test_without_an_opengl_library_the_package_to_install_is_named(
    inputs: Inputs, call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("MODSIM3D_GL", raising=False)
    monkeypatch.setattr(context, "_open_here", None)  # another test's context must not serve here
    monkeypatch.setattr(context, "library_found", lambda backend: False)
    status, said = call("run", inputs.write(), "--out", tmp_path / "out")
    assert status == 2
    for part in ("no OpenGL software renderer was found", "libosmesa6", "mesa-libEGL", "--source analytic"):
        assert part in said
    assert not (tmp_path / "out").exists()


# ---- as its own process -----------------------------------------------------------------------------------------


def process(*arguments: object, **options: Any) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "modsim3d.cli", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, **options)


def test_unknown_backend_is_told_by_a_real_process(inputs: Inputs, tmp_path: Path) -> None:
    done = process("run", inputs.write(), "--out", tmp_path / "out", env={**os.environ, "MODSIM3D_GL": "nonsense"})
    assert done.returncode == 2
    assert "MODSIM3D_GL='nonsense': use one of osmesa, egl, auto" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_real_process_says_it_on_standard_error_only(inputs: Inputs) -> None:
    inputs.set("vessels", "\ud800", GOOD["vessels"]["vehicle2"])
    inputs.set("scene", "sed", 1)
    done = process("check", inputs.write())
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("modsim3d: scene ")
    assert "sed: unknown key" in done.stderr
    assert "printable" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_full_disk_is_told_and_the_run_can_go_on(inputs: Inputs, tmp_path: Path) -> None:
    inputs.data["poses"] = {f"{t}.0": {"vehicle1": at(t, 0.0), "vehicle2": at(t + 40.0, 6.0)} for t in range(200)}
    out = tmp_path / "out"
    arguments = ("run", inputs.write(), "--out", out, "--no-sheet")

    def small_files() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    done = process(*arguments, preexec_fn=small_files)
    assert done.returncode == 2, done.stderr
    assert f"{out} cannot be written to" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (out / "run.json").exists()
    assert process(*arguments, "--resume").returncode == 0


# ---- anything ---------------------------------------------------------------------------------------------------


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths of all values in nested mappings and lists."""
    entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in entries:
        yield (*path, key)
        yield from places(inner, (*path, key))


PLACES = [(file, *path) for file in FILES for path in places(GOOD[file])]
SPOILERS = st.one_of(
    st.just(DELETED),
    st.sampled_from([None, True, "", "x", [], {}, [None], {"x": 1}, 0, -1, 1.5, 10**18, 10**400, 1e300, -1e308]),
    st.sampled_from([float("nan"), float("inf"), 5e-324, "vehicle1", "1e5", "\u2028", "a/b", "a\0", ".", "poses.json"]),
    st.floats(),
    st.integers(),
    st.text(max_size=8).filter(lambda text: text.isprintable()),
)


@settings(max_examples=150, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(st.lists(st.tuples(st.sampled_from(PLACES), SPOILERS), min_size=1, max_size=3), st.booleans())
def test_any_mapping_is_read_or_refused_with_an_input_error(
    tmp_path_factory: pytest.TempPathFactory, changes: list[tuple[tuple[Any, ...], Any]], circular: bool
) -> None:
    data = copy.deepcopy(GOOD)
    if circular:
        data["scene"].update(copy.deepcopy({"poses": CIRCULAR, "steps": 5, "time_step_s": 0.5}))
        data["scene"]["cameras"].pop("shore")
    for (file, *path), value in changes:
        section = data[file]
        try:
            for key in path[:-1]:
                section = section[key]
            if value is DELETED:
                del section[path[-1]]
            else:
                section[path[-1]] = copy.deepcopy(value)
        except (KeyError, IndexError, TypeError):
            continue  # an earlier change took this place away
    scene = Inputs(tmp_path_factory.mktemp("any"), data).write()
    try:
        loaded = load_scene(scene)
    except InputError as error:
        assert error.problems
        assert all(re.match(r"[^:]", problem) for problem in error.problems)
    else:
        assert loaded.steps > 0
