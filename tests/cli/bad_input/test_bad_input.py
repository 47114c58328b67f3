"""Mistakes in a scene's files get one clear error with their place, exit status 2 and no traceback."""

import copy
import json
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from modsim3d.cli.run_summary import run_warnings
from modsim3d.core.errors import InputError
from modsim3d.runs.run import run_scene
from modsim3d.scene.reading import load_scene
from tests.cli.bad_input.builders import ASHORE, CIRCULAR, DELETED, GOOD, Inputs, at, lens, places
from tests.command_line import call

CONFUSION, TURNED = "states/clear/confusion", [[0.9, 0.1], [0.2, 0.8]]
VESSEL, SHORE = GOOD["vessels"]["vehicle2"], lens(pose=ASHORE)
EXACTLY = "poses: give exactly one of file, circular, tracks, agents, traffic, stream, labels"
WRONG_VALUES: list[tuple[str, str, Any, str | tuple[str, ...]]] = [
    # unknown, missing and misspelt
    ("scene", "sed", 3, "sed: unknown key (did you mean 'seed'?)"),
    ("scene", "annotation/mod", 3, "annotation.mod: unknown key (did you mean 'mode'?)"),
    ("scene", "cameras/C0/focal_lenght_m", 1, ("C0.focal_lenght_m: unknown key", "did you mean 'focal_length_m'?")),
    ("scene", "cameras/C0/mount/pitch", 1, "C0.mount.pitch: unknown key (did you mean 'pitch_deg' or 'pitch_rad'?)"),
    ("scene", "detector", DELETED, "detector: missing"),
    ("scene", "cameras/shore/image_size_px", DELETED, "cameras.shore.image_size_px: missing"),
    ("vessels", "vehicle2/beam_m", DELETED, "vessels.json: vehicle2.beam_m: missing"),
    ("vessels", "vehicle2/lenght_m", 4, "vessels.json: vehicle2.lenght_m: unknown key (did you mean 'length_m'?)"),
    ("vessels", "vehicle2/label", "Vesel", ("vehicle2.label: 'Vesel' is not one of", "did you mean 'Vessel'?")),
    ("poses", "1.0/vehicle9", at(0, 0), "poses.json: 1.0.vehicle9: no vessel 'vehicle9' (did you mean 'vehicle"),
    ("poses", "1.0/vehicle2/heading_rad", DELETED, "1.0.vehicle2.heading_rad: missing"),
    ("poses", "1.0/vehicle2/heading", 1, "1.0.vehicle2.heading: unknown key (did you mean 'heading_rad'?)"),
    ("scene", "cameras/C0/mount/vessel", "vehicle9", ("cameras.C0.mount.vessel: no vessel 'vehicle9'", "did you mean")),
    ("scene", "ais", {"vessels": {"vehicle9": "A"}}, ("ais.vessels.vehicle9: no vessel 'vehicle9'", "did you mean")),
    ("scene", "ais", {"vessels": {"vehicle2": "C"}}, ("ais.vessels.vehicle2: ", "'A', 'B' or 'none'", "(got 'C')")),
    ("scene", "ais", {"drop_out": 1.5}, ("ais.drop_out: ", "(got 1.5)")),
    ("scene", "ais", {"position_noise_m": -1}, ("ais.position_noise_m: ", "(got -1)")),
    ("scene", "ais", {"noise": 1}, "ais.noise: unknown key"),
    ("scene", "origin", {"latitude_deg": 56}, "origin.longitude_deg: missing"),
    ("scene", "origin", {"latitude_deg": 91, "longitude_deg": 0}, ("origin.latitude_deg: ", "(got 91)")),
    ("scene", "origin", [56, 12], "origin: a mapping of keys is needed"),
    ("detector", "initial_state", "claer", ("detector.yaml: initial_state: unknown state 'claer'", "'clear'?")),
    # not numbers
    ("poses", "2.0/vehicle2/heading_rad", float("nan"), ("2.0.vehicle2.heading_rad: a finite number", "(got nan)")),
    ("poses", "2.0/vehicle2/center_position_m/1", float("inf"), "2.0.vehicle2.center_position_m: three finite"),
    ("poses", "2.0/vehicle2/center_position_m/0", 10**400, "2.0.vehicle2.center_position_m: three finite"),
    ("poses", "2.0/vehicle2/center_position_m/0", 1e300, ("is farther than 1e+09 m", "1e+300")),
    ("poses", "2.0/vehicle2/center_position_m", [1, 2], "three finite numbers in metres are needed (got [1, 2])"),
    ("poses", "2.0/vehicle2/heading_rad", True, ("2.0.vehicle2.heading_rad: a finite number", "(got true)")),
    ("poses", "2.0/vehicle2", None, "2.0.vehicle2: a mapping with center_position_m and heading_rad is needed"),
    ("poses", "2.0", [], "2.0: a mapping of vessel ID to pose is needed (got [])"),
    ("vessels", "vehicle2/beam_m", float("nan"), "vehicle2.beam_m: a finite number is needed (got nan)"),
    ("vessels", "vehicle2/beam_m", 0, ("vehicle2.beam_m: must be ", "(got 0)")),
    ("vessels", "vehicle2/length_m", -4.5, ("vehicle2.length_m: must be ", "(got -4.5)")),
    ("vessels", "vehicle2/air_draft_m", 1e200, ("vehicle2.air_draft_m: must be ", "(got 1e+200)")),
    ("vessels", "vehicle2/length_m", "8", "vehicle2.length_m: a number is needed (got '8')"),
    ("vessels", "vehicle2/length_m", True, "vehicle2.length_m: a number is needed (got true)"),
    ("vessels", "vehicle2", 5, "vehicle2: a mapping of keys is needed: length_m, beam_m, air_draft_m, label, mesh (go"),
    ("scene", "seed", "1", "seed: a whole number is needed (got '1')"),
    ("scene", "seed", True, "seed: a whole number is needed (got true)"),
    ("scene", "seed", -1, "seed: must be at least 0 (got -1)"),
    ("scene", "seed", 2**70, ("seed: must be ", "(got 1180591620717411303424)")),
    ("scene", "steps", 0, "steps: must be above 0 (got 0)"),
    ("scene", "steps", 2.5, ("steps: a whole number is needed", "(got 2.5)")),
    ("scene", "steps", 10**15, ("steps: must be at most", "(got 1000000000000000)")),
    ("scene", "annotation/mode", 3, "annotation.mode: must be at most 2 (got 3)"),
    ("scene", "annotation/mode", True, "annotation.mode: a whole number is needed (got true)"),
    ("scene", "annotation/source", "renderd", ("annotation.source: must be 'rendered'", "(got 'renderd')")),
    ("scene", "annotation/min_visible_fraction", 1.5, "annotation.min_visible_fraction: must be at most"),
    ("scene", "annotation", None, "annotation: a mapping of keys is needed: mode, source, supersample"),
    ("scene", "cameras/C0", None, "cameras.C0: a mapping of keys is needed: focal_length_m, pixel_size_m"),
    ("scene", "cameras/C0/image_size_px", [640, 0], "cameras.C0.image_size_px[1]: must be above 0"),
    ("scene", "cameras/C0/image_size_px", [640], "cameras.C0.image_size_px[1]: missing"),
    ("scene", "cameras/C0/image_size_px", [1, 2, 3], "cameras.C0.image_size_px: at most 2 may be given"),
    ("scene", "cameras/C0/image_size_px", 640, "cameras.C0.image_size_px: a list, as [a, b], is needed (got 640)"),
    ("scene", "cameras/C0/image_size_px", [10**6, 480], ("image_size_px[0]: must be ", "12000")),
    ("scene", "cameras/C0/focal_length_m", "0.05 m", "cameras.C0.focal_length_m: a number is needed"),
    ("scene", "cameras/C0/focal_length_m", 0, "cameras.C0.focal_length_m: must be "),
    ("scene", "cameras/C0/focal_length_m", float("inf"), "focal_length_m: a finite number is needed (got inf)"),
    ("scene", "cameras/C0/pixel_size_m", [-1e-5, 1e-5], "cameras.C0.pixel_size_m[0]: must be at least 1e-09"),
    ("scene", "cameras/C0/near_clip_m", 0, "cameras.C0.near_clip_m: must be "),
    ("scene", "cameras/C0/skew", True, "cameras.C0.skew: a number is needed (got true)"),
    ("scene", "vessels", [1], "vessels: a file or a mapping of vessel ID to vessel is needed (got [1])"),
    ("scene", "vessels", {1: GOOD["vessels"]["vehicle1"]}, "vessels: a vessel's ID must be text: put 1 in quotes"),
    ("scene", "cameras", {7: SHORE}, "cameras.7: a name must be text: put it in quotes"),
    # probabilities
    ("detector", "confidence_threshold", float("nan"), ("confidence_threshold:", "(got nan)")),
    ("detector", CONFUSION, [[1.5], [-0.5]], ("clear.confusion[0][0]: must be ", "confusion[1][0]")),
    ("detector", "transition_matrix", TURNED, ("its rows sum to one and its columns do not", "must be transposed")),
    # names
    ("vessels", "vehicle#2", VESSEL, "vehicle#2: a vessel's ID must not hold '#'"),
    ("vessels", "false_positive_1", VESSEL, "false_positive_1: a vessel's ID must not begin with 'false_positive_'"),
    ("vessels", "obstacle:quay", VESSEL, "must not begin with 'obstacle:'"),
    ("vessels", "", VESSEL, "a vessel's ID must not be empty"),
    ("vessels", "a\nb", VESSEL, "a vessel's ID must be printable text (got 'a\\nb')"),
    *(("scene", f"cameras/{name}", SHORE, "a camera's name goes into file names") for name in ("a\\b", "..")),
    ("scene", "cameras/" + "x" * 300, SHORE, "at most 100 letters"),
    # degrees
    ("scene", "cameras/C0/mount/pitch_rad", 10, "pitch_rad: 10 is more than a whole turn: angles are in radians"),
    ("scene", "cameras/shore/pose/yaw_rad", -180, "cameras.shore.pose.yaw_rad: -180 is more than a whole turn"),
    ("scene", "waves", {"spectrum": "jonswap", "direction_rad": 90}, "waves.direction_rad: 90 is more than"),
    ("scene", "obstacles", {"a": {"mesh": "ferry", "heading_rad": 45}}, "obstacles.a.heading_rad: 45 is more than"),
    ("scene", "cameras/C0/mount/roll_rad", 2, "a right angle: in degrees that is 115; for 2° give 0.03491"),
    ("scene", "cameras/shore/pose/pitch_rad", 1.6, "pitch_rad: 1.6 is more than a right angle: in degrees that is 92"),
    ("scene", "cameras/shore/pose/roll_rad", 3, "roll_rad: 3 is more than a right angle: in degrees that is 172"),
    ("scene", "imu", {"attitude_noise_rad": 2}, "imu.attitude_noise_rad: 2 is more than a right angle"),
    ("scene", "imu", {"heading_bias_rad": 5}, "imu.heading_bias_rad: 5 is more than a right angle"),
    ("scene", "waves", {"roll": {"start_rad": [0, 3]}}, "waves.roll.start_rad[1]: 3 is more than a right angle"),
    # what belongs together
    ("scene", "cameras/shore/mount", GOOD["scene"]["cameras"]["C0"]["mount"], "cameras.shore.mount: give exactly"),
    ("scene", "cameras/shore/pose", DELETED, "cameras.shore.mount: give exactly one of pose (ashore) and mount"),
    ("scene", "poses", {"file": "poses.json", **CIRCULAR}, f"{EXACTLY} (got circular, file)"),
    ("scene", "poses", {}, EXACTLY),
    ("scene", "poses", {"file": None}, EXACTLY),
    ("scene", "poses", {"circlar": {}}, ("poses.circlar: nothing is called", "did you mean 'circular'?")),
    ("scene", "poses", {"file": 5}, "poses.file: text is needed (got 5)"),
    ("scene", "poses", [], "poses: a mapping of keys is needed (got [])"),
    ("scene", "poses", {"agents": {"size_m": [150, 0]}}, "poses.agents.size_m[1]: must be above 0"),
    ("scene", "poses", {"agents": {"size_m": [9, 9], "speed_m_s": [3, 2]}}, "is [least, greatest], but 3.0 > 2.0"),
    ("scene", "poses", {"agents": {"size_m": [9, 9], "speed": [3, 2]}}, "poses.agents.speed: unknown key (did you"),
    ("scene", "steps", 9, "steps: 9 asked for, but the pose file has 4"),
    # nothing there
    ("scene", "cameras", {}, "cameras: no cameras; a scene needs at least one"),
    ("scene", "vessels", {}, "vessels: no vessels; a scene needs at least one"),
    # files
    ("scene", "vessels", "no/such.json", "no/such.json: no such file"),
    ("scene", "poses/file", "nothing.json", "nothing.json: no such file"),
    ("scene", "detector", "thesis.yaml", ("detector", "thesis.yaml: no such file")),
    *(("scene", path, ".", "this is a folder, a file was expected") for path in ("vessels", "poses/file", "detector")),
    ("scene", "detector", "a\0b", "is no valid file name"),
    ("scene", "detector", "x" * 5000, "cannot be read: File name too long"),
]


@pytest.mark.parametrize(
    ("file", "path", "value", "parts"),
    WRONG_VALUES,
    ids=[f"{i}-{file}-{path[:40]!a}" for i, (file, path, _, _) in enumerate(WRONG_VALUES)],
)
def test_wrong_value_is_told_with_its_place_and_what_would_be_right(inputs, refused, file, path, value, parts):
    inputs.set(file, path, value)
    refused(inputs.write(), *([parts] if isinstance(parts, str) else parts))


def test_camera_inside_a_vessel_names_both_and_the_time(inputs, refused, call) -> None:
    inputs.set("poses", "2.0/vehicle2", at(-61.0, 1.0))
    inputs.set("vessels", "vehicle2/air_draft_m", 6.0)
    part = "cameras.shore: is inside vessel 'vehicle2' at time 2.0 s: move one of them, or set annotation."
    refused(inputs.write(), part, "allow_camera_inside: true")
    refused(inputs.write(), part, options=("--steps", 3))
    inputs.set("scene", "steps", 2)
    assert call("check", "scene", inputs.write())[0] == 0
    inputs.set("scene", "steps", 3)
    inputs.set("scene", "annotation/allow_camera_inside", True)
    assert call("check", "scene", inputs.write())[0] == 0


def test_times_that_do_not_increase_are_told(inputs, refused) -> None:
    for times, part in (
        (["2.0", "1.0"], "1.0: timestamps must increase, but '1.0' comes after '2.0'"),
        (["1.0", "1.00"], "1.00: timestamps must increase, but '1.00' is the same time as '1.0'"),
        (["1e0", "1.0"], "'1.0' is the same time as '1e0'"),
        (["soon"], "soon: a timestamp must be a number of seconds (got 'soon')"),
        *([[text], f"{text}: a timestamp must be a number of seconds"] for text in ("nan", "inf", "1e999", "1_0")),
        ([""], "a timestamp must be a number of seconds (got '')"),
    ):
        inputs.data["poses"] = {time: {"vehicle1": at(0, 0)} for time in ("0.0", *times)}
        refused(inputs.write(), part)


def test_repeated_json_keys_are_told_and_a_mistake_in_every_line_does_not_fill_the_screen(inputs, refused) -> None:
    scene = inputs.write()
    pose = json.dumps(at(0, 0))
    later = f'"1.0": {{"vehicle1": {pose}, "vehicle1": {pose}}}'
    inputs.path("poses").write_text(f'{{"0.0": {{"vehicle1": {pose}}}, {later}, "0.0": {{}}}}')
    refused(scene, "1.0.vehicle1: the key 'vehicle1' appears twice", "0.0: the key '0.0' appears twice")
    inputs.data["poses"] = {f"{t}.0": {"vehicle1": at(t, 0), "vehicel2": at(0, 9)} for t in range(1000)}
    said = refused(inputs.write(), "0.0.vehicel2: no vessel 'vehicel2'", "the rest was not checked")
    assert said.count("\n") < 30


WRONG_TEXTS: list[tuple[str, bytes, str | tuple[str, ...]]] = [
    ("scene", b"", ("scene.yaml:", "the file is empty")),
    ("scene", b"# nothing but a comment\n", "the file is empty"),
    ("scene", b"- 1\n- 2\n", "a mapping of keys is needed"),
    ("scene", b"seed: 1\ncameras: {C0: [1, 2}\n", ("line 2, column 20:", "expected ',' or ']', but got '}'")),
    ("scene", b"seed: 1\n\tsteps: 2\n", "line 2, column 1:"),
    ("scene", b"seed: 1\nseed: 2\n", "line 2, column 1: key 'seed' appears twice"),
    ("scene", b"seed: 1\n---\nseed: 2\n", "line 2, column 1: expected a single document"),
    ("scene", b"seed: !!bool x\n", "line 1, column 7: 'x' cannot be read as bool"),
    ("scene", b"seed: !!timestamp x\n", "line 1, column 7: the tag !!timestamp is not read"),
    ("scene", b"seed: " + b"1" * 5000, ("line 1, column 7:", "cannot be read as int")),
    ("scene", b"seed: &a [*a]\n", ("line 1, column 7:", "recursive")),
    ("scene", b"seed: " + b"[" * 700, "is nested too deeply"),
    ("scene", b"seed: 1\nx: \x00\n", "line 2, column 4: character '\\x00' is not allowed in YAML"),
    ("scene", b"seed: 1\n# \xff\n", "is not UTF-8 text (byte 10)"),
    ("scene", b"[1]: 2\n", "line 1, column 1: a key must be plain text"),
    ("detector", b"", "detector.yaml: must be a mapping with the keys labels"),
    ("detector", b"labels: [Vessel\nstates: {}", "detector.yaml: line 2, column 7:"),
    ("detector", "labels: [Båt]".encode("latin-1"), "detector.yaml: is not UTF-8 text (byte 10)"),
    ("vessels", b"", "vessels.json: the file is empty"),
    ("vessels", b"{}", "vessels.json: top level: no vessels; a scene needs at least one"),
    ("vessels", b"[]", "vessels.json: top level: a mapping of vessel ID to vessel is needed"),
    ("vessels", b"null", "vessels.json: top level: a mapping of vessel ID to vessel is needed"),
    ("vessels", b'{"vehicle1": {"beam_m" 4}}', ("vessels.json: line 1, column 24:", "Expecting ':' delimiter")),
    ("vessels", b"\xfe{", "vessels.json: is not UTF-8 text (byte 0)"),
    ("vessels", b"\xff\xfe{", "vessels.json: is UTF-16 text, must be UTF-8"),
    ("poses", b"", "poses.json: the file is empty"),
    ("poses", b"{}", "poses.json: a mapping of timestamp to vessels is needed, with at least one timestamp"),
    ("poses", b'{"0.0": {"vehicle1": {"center_pos', "poses.json: line 1, column 23: Unterminated string"),
    ("poses", b'{"0.0": {"vehicle1":\n {}}', ("poses.json: line 2, column 5:", "the file ends here: is it cut off?")),
    ("poses", b"[" * 100_000, "poses.json: is nested too deeply"),
    ("poses", b'{"0.0": ' + b"1" * 5000 + b"}", "poses.json: a value cannot be read:"),
]


@pytest.mark.parametrize(
    ("file", "text", "parts"), WRONG_TEXTS, ids=[f"{i}-{row[0]}" for i, row in enumerate(WRONG_TEXTS)]
)
def test_text_that_cannot_be_read_is_told_with_its_place(inputs, refused, file, text, parts):
    scene = inputs.write()
    inputs.path(file).write_bytes(text)
    refused(scene, *([parts] if isinstance(parts, str) else parts))


def test_the_scene_that_these_tests_spoil_is_good_and_its_yaml_that_of_1_2(inputs, call, refused) -> None:
    scene = inputs.write()
    text = scene.read_text()
    scene.write_text(re.sub(r"1\.0e-05", "1e-5", text))
    status, said = call("check", "scene", scene)
    assert "1e-5" in scene.read_text() and (status, "no problems found" in said) == (0, True), said
    scene.write_text(text.replace("annotation:", "annotation:\n  allow_camera_inside: no"))
    refused(scene, "annotation.allow_camera_inside: true or false is needed (got 'no')")


def test_mistakes_in_every_file_are_told_at_once(inputs, refused) -> None:
    both = {"vessel": "vehicle1", "position_m": [0, 0, 0]}
    mistakes: list[tuple[str, str, Any, str]] = [
        ("scene", "sed", 1, "sed: unknown key"),
        ("scene", "cameras/C0/mount/vessel", "vehicle9", "cameras.C0.mount.vessel: no vessel 'vehicle9'"),
        ("scene", "cameras/shore/mount", both, "cameras.shore.mount: give exactly one"),
        ("vessels", "vehicle2/beam_m", -1, "vessels.json: vehicle2.beam_m: must be"),
        ("poses", "3.0/vehicle2/heading_rad", "east", "poses.json: 3.0.vehicle2.heading_rad: a finite number"),
        ("poses", "3.0/vehicle7", at(0, 0), "poses.json: 3.0.vehicle7: no vessel 'vehicle7'"),
        ("detector", "confidence_threshold", 7, "detector.yaml: confidence_threshold: must be"),
        ("detector", "states/fog/confusion", [[0.5], [0.4]], "detector.yaml: states.fog.confusion: column 'Vessel' su"),
    ]
    for file, path, value, _ in mistakes:
        inputs.set(file, path, value)
    assert "vehicle1.heading" not in refused(inputs.write(), *(part for *_, part in mistakes))


def test_labels_and_poses_are_looked_at_though_vessels_are_wrong_or_missing(inputs, refused) -> None:
    inputs.set("vessels", "vehicle2/beam_m", -1)
    inputs.set("vessels", "vehicle1/label", "Boat")
    inputs.set("poses", "3.0/vehicle2/heading_rad", "east")
    heading = "3.0.vehicle2.heading_rad: a finite number"
    refused(inputs.write(), "vehicle2.beam_m: must be", "vehicle1.label: 'Boat' is not one of the detector's", heading)
    inputs.set("scene", "vessels", "gone.json")
    refused(inputs.write(), "gone.json: no such file", heading)


LANE = {"waypoints_m": [[-400, 0], [400, 0]], "width_m": 120, "per_hour": 60, "kinds": ["motorboat"]}
OWN = {"own": {"waypoints_m": [[0, -300], [0, 300]], "speed_m_s": 4}}
SCENE: dict[str, Any] = {
    "steps": 3,
    "time_step_s": 1.0,
    "vessels": {"own": {"length_m": 10, "beam_m": 4, "air_draft_m": 3, "label": "Vessel"}},
    "poses": {"traffic": {"own": OWN, "lanes": {"west": LANE}, "labels": "Vessel"}},
    "cameras": {"shore": lens(pose=ASHORE)},
    "annotation": {"mode": 2, "source": "analytic"},
    "detector": "detector.yaml",
}
ON_BOARD = lens(mount={"vessel": "west_1", "position_m": [2.0, 0.0, 2.0]})


def _traffic(**sections: Any) -> dict[str, Any]:
    return {"poses": {"traffic": sections}}


def written(folder: Path, **changes: Any) -> Path:
    scene = folder / "scene.json"
    scene.write_text(json.dumps(SCENE | changes), encoding="utf-8")
    (folder / "detector.yaml").write_text(json.dumps(GOOD["detector"]), encoding="utf-8")
    return scene


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "labels": (_traffic(lanes={"west": LANE}), "poses.traffic: draws vessels with the label 'boat' ("),
    "how to label": (_traffic(lanes={"west": LANE}), "set poses.traffic.labels"),
    "no own ship": ({"vessels": {}}, "poses.traffic.own.own: no vessel 'own'"),
    "mount": ({"cameras": {"bow": ON_BOARD}}, "cameras.bow.mount.vessel: no vessel 'west_1'"),
}


@pytest.mark.parametrize(("changes", "message"), WRONG.values(), ids=WRONG)
def test_wrong_traffic_is_one_error_that_names_its_key(tmp_path, refused, changes, message: str) -> None:
    refused(written(tmp_path, **changes), message)


def test_a_wrong_setting_of_the_section_names_the_option(tmp_path: Path, refused) -> None:
    missing = "poses.traffic.lanes has no 'est' (did you mean 'west'?)"
    for lane, value, said in (("west", -1, "must be"), ("est", 1, missing)):
        key = f"poses.traffic.lanes.{lane}.per_hour"
        refused(written(tmp_path), f"--set {key}: {said}", options=("--set", f"{key}={value}"))


def test_vessels_without_room_are_warned_of(tmp_path, monkeypatch, capsys):
    pond = {"polygon_m": [[-30, 30], [30, 30], [30, 90], [-30, 90]], "per_km2": 5000, "kinds": "kayak"}
    scene = written(tmp_path, **_traffic(own=OWN, leisure={"pond": pond}, labels="Vessel"))
    loaded = load_scene(scene)
    left_out = loaded.poses.left_out["leisure.pond"]  # type: ignore[attr-defined]
    said = f"poses.traffic: {left_out} of the vessels that were drawn found no room and are left out: {left_out} of"
    assert left_out > 0
    result = run_scene(loaded, tmp_path / "run")
    assert any(warning.startswith(said) for warning in run_warnings(loaded, result))
    assert call(monkeypatch, "check", "scene", scene, "--json") == 0
    assert any(warning.startswith(said) for warning in json.loads(capsys.readouterr().out)["warnings"])


PLACES = [(file, *path) for file in GOOD for path in places(GOOD[file])]
SPOILERS = st.one_of(
    st.sampled_from([DELETED, None, True, "", "x", [], {}, [None], {"x": 1}, 0, -1, 1.5, 10**18, 10**400, 1e300, -1e9]),
    st.sampled_from([float("nan"), float("inf"), 5e-324, "vehicle1", "1e5", "\u2028", "a/b", "a\0", ".", "poses.json"]),
    *(st.just(DELETED), st.floats(), st.integers(), st.text(max_size=8).filter(lambda text: text.isprintable())),
)


@settings(max_examples=150, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(st.lists(st.tuples(st.sampled_from(PLACES), SPOILERS), min_size=1, max_size=3), st.booleans())
def test_any_mapping_is_read_or_refused_with_an_input_error(tmp_path_factory, changes, circular):
    inputs = Inputs(tmp_path_factory.mktemp("any"), copy.deepcopy(GOOD))
    if circular:
        inputs.data["scene"].update(copy.deepcopy({"poses": CIRCULAR, "steps": 5, "time_step_s": 0.5}))
        inputs.data["scene"]["cameras"].pop("shore")
    for (file, *path), value in changes:
        with suppress(KeyError, IndexError, TypeError, ValueError):  # an earlier change took this place away
            inputs.set(file, "/".join(map(str, path)), value if value is DELETED else copy.deepcopy(value))
    try:
        assert load_scene(inputs.write()).steps > 0
    except InputError as error:
        assert error.problems and all(re.match(r"[^:]", problem) for problem in error.problems)
