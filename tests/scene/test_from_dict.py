"""A scene without files is the scene that its files would be; wrong keys and broken files are told."""

import copy
import gzip
import json
import struct
import tracemalloc
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import yaml

from modsim3d import InputError, Scene, load_detector, load_scene, open_run, run_scene, simulate_frames
from modsim3d.io.input_files import data_folder, read_text
from modsim3d.runs.run import settings_of
from modsim3d.scene.keys import PoseKeys
from tests.cli.bad_input.builders import ASHORE, GOOD, lens
from tests.run_folders import interrupt, run_files
from tests.scenes import camera_keys, write_scene

SCENES = data_folder("scenes")
THESIS = SCENES / "detectors" / "thesis.yaml"


def good(steps: int = 6) -> dict:
    """Two vessels of which one comes later, a camera on board and one ashore."""
    time = np.arange(steps)
    positions = np.stack([np.stack([time, 0.0 * time], 1), np.stack([40.0 - time, 6.0 + 0 * time], 1)], axis=1)
    headings = np.tile([0.0, 0.5], (steps, 1))
    positions[:2, 1], headings[:2, 1] = np.nan, np.nan
    return {
        "seed": 3,
        "vessels": copy.deepcopy(GOOD["vessels"]),
        "poses": {"positions_m": positions, "headings_rad": headings, "time_step_s": 0.1},
        "cameras": {
            "bow": lens(mount={"vessel": "vehicle1", "position_m": np.array([4.0, 0.0, 1.0])}),
            "shore": lens(pose=ASHORE),
        },
        "annotation": {"mode": 2, "source": "analytic"},
        "detector": copy.deepcopy(GOOD["detector"]),
    }


def inline(name: str, steps: int) -> dict:
    """A shipped scene with everything in it that its files hold."""
    scene, data = load_scene(name, steps=steps), yaml.safe_load((SCENES / f"{name}.yaml").read_text())
    if isinstance(data["vessels"], str):
        data["vessels"] = json.loads((SCENES / data["vessels"]).read_text())
    if "file" in data["poses"]:
        poses = scene.poses.poses(0, steps)
        absent = ~poses.present
        positions, headings = poses.positions_m.copy(), poses.headings_rad.copy()
        positions[absent], headings[absent] = np.nan, np.nan
        times = [float(text) for text in scene.timestamps(0, steps)]
        data["poses"] = {"positions_m": positions, "headings_rad": headings, "times_s": times}
    data["detector"] = yaml.safe_load((SCENES / data["detector"]).read_text())
    for vessel in data["vessels"].values():
        vessel["length_m"] = np.float64(vessel["length_m"])
    for camera in data["cameras"].values():
        camera["image_size_px"] = np.array(camera["image_size_px"])
    return {**data, "steps": np.int64(steps), "seed": np.uint32(data.get("seed", 0))}


@pytest.mark.parametrize("name", sorted(path.stem for path in SCENES.glob("*.yaml")))
def test_a_shipped_scene_given_as_a_mapping_gives_the_bytes_of_its_file(name, tmp_path):
    result = run_scene(load_scene(name, steps=5), tmp_path / "file")
    scene = Scene.from_dict(inline(name, 5), name=name)
    run_scene(scene, tmp_path / "mapping")
    of_file, of_mapping = (run_files(tmp_path / run, "run.json").items() for run in ("file", "mapping"))
    others = {path for path, _ in of_file ^ of_mapping}  # the copies of the scene have files of their own
    assert all(path.startswith("scene/") for path in others)
    assert len([*simulate_frames(scene)]) == result.counts.frames


@pytest.mark.parametrize("detector", ["inline", "read", "file"])
def test_its_run_is_a_run_like_any_other(detector, tmp_path, monkeypatch, call):
    monkeypatch.chdir(tmp_path)
    data = good()
    if detector != "inline":
        Path("mine.yaml").write_text(yaml.safe_dump(data["detector"]))
        data["detector"] = Path("mine.yaml") if detector == "file" else load_detector("mine.yaml")
    scene = Scene.from_dict(data, name="mine")
    run_scene(scene, Path("run"))
    assert {"scene/mine.json", "scene/poses.json", "scene/detector.yaml"} <= run_files(Path("run")).keys()
    Path("mine.yaml").unlink(missing_ok=True)
    for line in (["check", "repeat", "run"], ["run", "run/scene/mine.json", "--out", "again", "--no-sheet"]):
        status, said = call(*line)
        assert status == 0, said
    assert run_files(Path("again")) == run_files(Path("run")) and open_run(Path("run")).scene.sha256 == scene.sha256
    if detector != "file":
        run_scene(scene, Path("workers"), workers=2)
        assert run_files(Path("workers")) == run_files(Path("run"))


@pytest.mark.parametrize("dtype", [np.float32, np.int64, np.uint8])
def test_arrays_of_any_kind_of_number_will_do(dtype):
    data = good()
    data["poses"]["positions_m"] = np.ones((4, 2, 2), dtype=dtype) * np.array([[1, 2], [30, 4]], dtype=dtype)
    data["poses"]["headings_rad"] = np.ones((4, 2), dtype=dtype)
    scene = Scene.from_dict(data)
    assert scene.steps == 4 and scene.poses.poses(0, 4).positions_m[3].tolist() == [[1, 2, 0], [30, 4, 0]]


def test_columns_may_be_in_any_order_and_what_the_caller_sets_replaces_what_stands_there(tmp_path):
    scene = Scene.from_dict(good(), seed=9, steps=np.int64(2), mode=0, source="rectangles", detector=THESIS,
                            detector_seed=4)  # fmt: skip
    assert (scene.seed, scene.steps, scene.detector_seed, len(scene.detector.states)) == (9, 2, 4, 4)
    assert (scene.annotation.mode, scene.annotation.source) == (0, "rectangles")
    assert settings_of(scene, "none")["seed"] == 9
    with pytest.raises(InputError) as error:
        Scene.from_dict({**good(), "annotation": 7}, mode=1)
    assert error.value.problems[1].startswith("annotation: a mapping of keys is needed: mode, source, ")
    file = yaml.safe_load(load_scene("simulation_1").path.read_text()) | {"annotation": 7, "detector": "thesis"}
    (tmp_path / "traffic.json").write_text(json.dumps(file))
    with pytest.raises(InputError) as of_file:
        load_scene(tmp_path / "traffic.json", mode=1)
    assert error.value.problems == of_file.value.problems
    run_scene(Scene.from_dict(good()), tmp_path / "plain")
    poses = good()["poses"]
    flat, headings = poses["positions_m"][:, ::-1], poses["headings_rad"][:, ::-1].tolist()
    deep = np.concatenate([flat, np.where(np.isnan(flat[..., :1]), np.nan, 0.0)], axis=2).tolist()
    named = {"times_s": [round(0.1 * step, 1) for step in range(6)], "names": ["vehicle2", "vehicle1"]}
    data = good() | {"poses": {"positions_m": deep, "headings_rad": headings, **named}}
    run_scene(Scene.from_dict(data), tmp_path / "named")
    assert run_files(tmp_path / "named") == run_files(tmp_path / "plain")
    one = {key: poses[key][:, :1] for key in ("positions_m", "headings_rad")}
    named = {"time_step_s": np.float32(0.5), "names": np.array(["vehicle1"])}
    scene = Scene.from_dict(good() | {"poses": {**one, **named}})
    assert scene.poses.poses(0, 6).present.tolist() == [[True, False]] * 6
    assert scene.timestamps(0, 3) == ("0.0", "0.5", "1.0")
    rng, data = np.random.default_rng(0), good(50)
    data["vessels"] = {"vehicle1": data["vessels"]["vehicle1"], '"}},{"é': data["vessels"]["vehicle2"]}
    positions = rng.normal(0, 10.0 ** rng.integers(-8, 8, (50, 2, 3)))
    headings = rng.normal(size=(50, 2))
    positions[:2, 1], headings[:2, 1] = np.nan, np.nan
    moved = {"positions_m": positions, "headings_rad": headings, "times_s": np.cumsum(rng.random(50)) - 3.0}
    scene = Scene.from_dict(data | {"poses": moved})
    again = load_scene(scene.copy.write(tmp_path / "copy"))
    for poses in (scene.poses.poses(0, 50), again.poses.poses(0, 50)):
        np.testing.assert_array_equal(poses.present, ~np.isnan(headings))
        np.testing.assert_array_equal(poses.positions_m, np.nan_to_num(positions))
        np.testing.assert_array_equal(poses.headings_rad, np.nan_to_num(headings))
    np.testing.assert_array_equal(again.times_s(0, 50), scene.times_s(0, 50))
    assert again.timestamps(0, 50) == scene.timestamps(0, 50) and again.sha256 == scene.sha256


def changed(**values: object) -> dict:
    data = good()
    data["poses"] = {key: value for key, value in {**data["poses"], **values}.items() if value is not None}
    return data


def spoiled(key: str, place: tuple[int, ...], value: float) -> dict:
    data = good()
    data["poses"][key][place] = value
    return data


def scene_with(**keys: object) -> dict:
    return {key: value for key, value in (good() | keys).items() if value is not None}


NONE = changed(positions_m=np.zeros((0, 2, 2)), headings_rad=np.zeros((0, 2)))
WRONG = [
    (changed(positions_m=None), "poses.positions_m: missing; an array of shape (T, N, 2) or (T, N, 3) is needed"),
    (changed(headings_rad=None), "poses.headings_rad: missing; an array of shape (T, N) is needed"),
    (changed(positions_m=np.zeros((6, 3, 2))), "poses.positions_m: shape (T, 2, 2) or (T, 2, 3) is needed, a column "
     "for each of the 2 vessels named (got (6, 3, 2))"),
    (changed(positions_m=np.zeros((6, 2, 4))), "poses.positions_m: shape (T, 2, 2) or (T, 2, 3) is needed"),
    (changed(headings_rad=np.zeros((6, 3))), "poses.headings_rad: shape (6, 2) is needed, that of positions_m (got "),
    (NONE, "poses.positions_m: at least one step is needed (got none)"),
    (changed(positions_m=np.full((6, 2, 2), "1")), "poses.positions_m: numbers are needed (got an array of <U1)"),
    (changed(headings_rad=np.zeros((6, 2), dtype=bool)), "poses.headings_rad: numbers are needed (got an array of "),
    (changed(positions_m=[[[0, 0], [1]]]), "poses.positions_m: an array of shape (T, N, 2) or (T, N, 3) is needed, and "
     "its rows differ in length"),
    (spoiled("positions_m", (3, 1), np.nan), "poses.positions_m[3]: 'vehicle2' is NaN, but its heading is not; both "
     "are finite, or both NaN where a vessel is absent"),
    (spoiled("positions_m", (3, 1, 0), np.nan), "poses.positions_m[3]: 'vehicle2' is a place of which only a part is"),
    (spoiled("headings_rad", (4, 0), np.nan), "poses.headings_rad[4]: 'vehicle1' is NaN, but its position is not; "),
    (spoiled("headings_rad", (4, 0), np.inf), "poses.headings_rad[4]: 'vehicle1' is infinite; both are finite, or"),
    (spoiled("positions_m", (slice(2, 5), 1, 1), -np.inf), "poses.positions_m[2]: 'vehicle2' is more than 1e+09 m "
     "away, and so in 2 more places; both are finite, or both NaN where a vessel is absent"),
    (changed(time_step_s=None), "poses: give exactly one of time_step_s and times_s"),
    (changed(times_s=np.arange(6)), "poses: give exactly one of time_step_s and times_s"),
    (changed(time_step_s=0), "poses.time_step_s: a number of seconds from 1e-09 to 1e+09 is needed (got 0)"),
    (changed(time_step_s="0.1"), "poses.time_step_s: a number of seconds from 1e-09 to 1e+09 is needed (got '0.1')"),
    (changed(time_step_s=None, times_s=[0, 1, 2, 2, 3, 4]), "poses.times_s[3]: times must increase, but 2 s comes"),
    (changed(time_step_s=None, times_s=[0, 1]), "poses.times_s: shape (6,) is needed, a time for each step (got "),
    (changed(time_step_s=None, times_s=[0, 1, 2, np.nan, 3, 4]), "poses.times_s: finite numbers of seconds are"),
    (changed(names=["vehicle1", "vehicle3"]), "poses.names: no vessel 'vehicle3' (did you mean 'vehicle2'?)"),
    (changed(names=["vehicle1", "vehicle1"]), "poses.names: 'vehicle1' appears twice"),
    (changed(names=[1, 2]), "poses.names: a list of vessel IDs is needed (got [1, 2])"),
    (changed(position_m=1), "poses.position_m: unknown key (did you mean 'positions_m'?)"),
    (scene_with(colour=1), "colour: unknown key (known: "),
    (scene_with(poses=None), "poses: missing"),
    (scene_with(vessels=None), "vessels: missing"),
    (scene_with(detector=7), "detector: must be a mapping with the keys labels"),
    (scene_with(poses=np.zeros((6, 2, 2))), "poses: a mapping of keys is needed"),
    (scene_with(cameras={"bow": object()}), "cameras.bow: a mapping of keys is needed: focal_length_m, pixel_size_m, "),
    (scene_with(seed={1, 2}), "seed: "),
]  # fmt: skip


@pytest.mark.parametrize(("data", "problem"), WRONG)
def test_what_is_wrong_is_said_in_a_line(data, problem):
    with pytest.raises(InputError) as error:
        Scene.from_dict(data)
    problems = error.value.problems
    assert error.value.source == "scene" and [found for found in problems if found.startswith(problem)]
    assert len(problems) == 1 or problem == "vessels: missing", problems  # which causes others


def test_every_problem_is_said_at_once_with_its_path_and_what_no_file_could_give_is_refused():
    data = good()
    data["cameras"]["bow"]["focal_length_m"] = np.float64(-1.0)
    data["cameras"]["shore"]["pose"] = {"position_m": np.zeros(2)}
    data["vessels"]["vehicle2"]["beam_m"] = "wide"
    data["detector"]["confidence_threshold"] = 3
    data["obstacles"] = {"pier": {"mesh": "no_such_mesh.glb", "size_m": [1, 1, 1]}}
    data["poses"]["names"] = ["one", "two"]
    with pytest.raises(InputError) as error:
        Scene.from_dict(data)
    said = "\n".join(error.value.problems)
    parts = ["cameras.bow.focal_length_m: ", "cameras.shore.pose.position_m[2]: missing", "vessels.vehicle2.beam_m: "]
    parts += ["detector: confidence_threshold: ", "poses.names: no vessel 'one'"]
    assert [part for part in parts if part not in said] == [] and "scene scene" not in said
    assert str(error.value).startswith("scene:\n")
    nested = good()
    nested["waves"] = nested
    detector = replace(load_detector(THESIS), confidence_threshold=0.5)
    for data, said in (
        ([1], "a mapping of keys is needed"),
        (nested, "nested too deeply"),
        (good() | {"detector": detector}, "detector: was changed, or was not made by load_detector"),
    ):
        with pytest.raises(InputError, match=said):
            Scene.from_dict(data)
    for name in ("", "a/b", "a.b", "../a", 7, "a" * 101):
        with pytest.raises(InputError, match="name: it goes into file names"):
            Scene.from_dict(good(), name=name)


def test_an_interrupted_run_of_it_goes_on_and_errors_of_the_run_name_the_scene(tmp_path):
    data = good()
    run_scene(Scene.from_dict(good()), tmp_path / "before")
    scene = Scene.from_dict(data)
    for array in (data["poses"]["positions_m"], data["poses"]["headings_rad"]):
        array[:] = 7.0
    data["vessels"]["vehicle1"]["length_m"] = 99.0
    data["detector"]["states"]["clear"]["confusion"][0][0] = 0.0
    data["cameras"]["bow"]["mount"]["position_m"][:] = 0.0
    run_scene(scene, tmp_path / "after")
    assert run_files(tmp_path / "after") == run_files(tmp_path / "before")
    with pytest.raises(ValueError, match="read-only"):
        scene.poses.poses(0, 1).positions_m[:] = 0.0
    interrupt(Scene.from_dict(good()), tmp_path / "run")
    assert run_scene(Scene.from_dict(good()), tmp_path / "run", resume=True).resumed_steps
    run_scene(Scene.from_dict(good()), tmp_path / "whole")
    assert run_files(tmp_path / "run") == run_files(tmp_path / "whole")
    data = spoiled("positions_m", (3, 0), np.nan)
    data["poses"]["headings_rad"][3, 0] = np.nan
    with pytest.raises(InputError) as error:
        run_scene(Scene.from_dict(data), tmp_path / "failed")
    assert str(error.value).startswith("scene:\n  cameras.bow.mount.vessel: 'vehicle1' has no pose at time 0.3 s")
    with pytest.raises(InputError) as error:
        run_scene(Scene.from_dict(data, name="mine"), tmp_path / "failed")
    assert error.value.source == "scene mine"


def test_files_of_the_mapping_are_relative_to_the_working_directory_but_not_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("in").mkdir()
    for name in ("vessels", "poses", "detector"):
        Path(f"in/{name}.json").write_text(json.dumps(GOOD[name]))
    files = {"vessels": Path("in/vessels.json"), "poses": {"file": Path("in/poses.json")}}
    data = good() | files | {"detector": "in/detector.json"}
    assert Scene.from_dict(data).steps == 4
    Path("in/vessels.json").unlink()
    with pytest.raises(InputError, match="no such file") as error:
        Scene.from_dict(data)
    assert error.value.source == "scene"
    run_scene(Scene.from_dict(good()), tmp_path / "run")
    monkeypatch.chdir(tmp_path / "run" / "scene")
    scene = Scene.from_dict(good())
    assert scene.copy.read == ()
    run_scene(scene, tmp_path / "run", overwrite=True)


STEPS = 5
BOATS = {"own": ([8, 4, 2], []), "other": ([20, 6, 9], [])}
WEDGE = "v 0 0 0\nv 4 0 0\nv 0 2 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


@pytest.fixture
def refused(call, tmp_path):
    """Has `check` and `run` refuse a scene, and gives the one problem that they say."""

    def look(scene):
        first, second = call("check", "scene", scene), call("run", scene, "--out", tmp_path / "out", "--no-sheet")
        assert first == second and first[0] == 2 and not (tmp_path / "out").exists()
        head, problem = first[1].splitlines()
        assert head == f"modsim3d: scene {scene}:"
        return problem.strip()

    return look


def scene_of(folder, file, **keys):
    cameras = {"C0": camera_keys(mount={"vessel": "own", "position_m": [4, 0, 2.5]})}
    return write_scene(folder, BOATS, None, time_step_s=None, poses={"file": file}, cameras=cameras, **keys)


def whole(form, absent=()):
    """A pose file of five steps, but for what is absent at some: steps and vessels."""
    places = {name: [60.0 * place, 0, 0] for place, name in enumerate(BOATS)}
    poses = {f"{step}.0": {} for step in range(STEPS)}
    for (step, entries), name in product(enumerate(poses.values()), BOATS):
        if (step, name) not in absent:
            entries[name] = {"center_position_m": [places[name][0] + step, 0, 0], "heading_rad": 0.0}
    if form == "json":
        return json.dumps(poses, indent=1).encode()
    return "".join(json.dumps({time: entries}) + "\n" for time, entries in poses.items()).encode()


@pytest.mark.parametrize("form", ["json", "jsonl"])
@pytest.mark.parametrize("packed", [False, True])
def test_poses_that_are_cut_off_are_told_and_whole_ones_read_whatever_their_name(tmp_path, refused, form, packed):
    lines, pack = whole(form).splitlines(keepends=True), gzip.compress if packed else bytes
    last = len(lines) * 2 // 3
    cut = b"".join(lines[:last]) + lines[last][: len(lines[last]) // 2]
    name, other = (f"poses.{form}{ending}" for ending in ((".gz", "") if packed else ("", ".gz")))
    content, faults = pack(whole(form)), [(pack(cut), f"line {last + 1}")]
    if packed:
        faults.append((content[: len(content) * 2 // 3], "not a complete gzip file"))
    for fault, words in faults:
        (tmp_path / name).write_bytes(fault)
        said = refused(scene_of(tmp_path, name))
        assert name in said and words in said
    (tmp_path / other).write_bytes(content)
    assert load_scene(scene_of(tmp_path, other)).steps == STEPS


@pytest.mark.parametrize("packed", [False, True])
def test_poses_that_unpack_to_too_much_are_refused_and_short_text_takes_little(tmp_path, refused, monkeypatch, packed):
    pack = gzip.compress if packed else bytes
    (tmp_path / "short.txt").write_bytes(pack(b"short"))
    tracemalloc.start()
    try:
        assert read_text(tmp_path / "short.txt", "text") == "short"
        assert tracemalloc.get_traced_memory()[1] < 5e6
    finally:
        tracemalloc.stop()
    monkeypatch.setattr("modsim3d.io.input_files.MAX_TEXT_BYTES", 100_000)
    (tmp_path / "poses.json").write_bytes(pack(whole("json") + b" " * 100_000))
    assert ("unpacks to more than" if packed else "has more than") in refused(scene_of(tmp_path, "poses.json"))


@pytest.mark.parametrize("form", ["json", "jsonl"])
def test_own_ship_missing_at_a_step_names_camera_vessel_and_time(tmp_path, refused, form):
    (tmp_path / f"poses.{form}").write_bytes(whole(form, absent={(3, "own"), (4, "own"), (1, "other")}))
    assert refused(scene_of(tmp_path, f"poses.{form}")) == "cameras.C0.mount.vessel: 'own' has no pose at time 3.0 s"


MESHES = {
    "NaN": ("hull.obj", lambda path: path.write_text(WEDGE.replace("v 0 2 0", "v nan 2 0")), "vertices that are NaN"),
    "no mesh": ("hull.glb", lambda path: path.write_bytes(b"%PDF-1.7\n" * 40), "is not a GLB file"),
    "cut off": ("hull.stl", lambda path: path.write_bytes(b"\0" * 80 + struct.pack("<I", 9) + b"\0" * 70), "hull.stl"),
    "empty": ("hull.ply", lambda path: path.write_bytes(b""), "hull.ply"),
}


@pytest.mark.parametrize("whose", ["vessels.other", "obstacles.rock"])
@pytest.mark.parametrize("fault", MESHES)
def test_a_bad_mesh_is_told_with_whose_it_is_and_why(tmp_path, refused, whose, fault):
    name, write, reason = MESHES[fault]
    write(tmp_path / name)
    (tmp_path / "poses.json").write_bytes(whole("json"))
    path = scene_of(tmp_path, "poses.json")
    data = json.loads(path.read_text())
    if whose == "vessels.other":
        data["vessels"]["other"]["mesh"] = name
    else:
        data["obstacles"] = {"rock": {"mesh": name, "size_m": [9, 9, 9], "position_m": [200, 30, 0]}}
    path.write_text(json.dumps(data))
    said = refused(path)
    assert said.startswith(f"{whose}.mesh: ") and reason in said


def test_angles_that_cameras_have_are_taken():
    """Astern, straight down, as from a mast or a drone, on its side, and upside down."""
    angles = {"yaw_rad": (3.141592653589793, -4.7), "pitch_rad": (1.5708,), "roll_rad": (-1.5708, 3.14159)}
    for name, angle in ((name, angle) for name, values in angles.items() for angle in values):
        assert getattr(PoseKeys.model_validate({"position_m": (0, 0, 9), name: angle}), name) == angle
