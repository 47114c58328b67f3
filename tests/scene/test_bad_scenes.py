"""Files that are cut off, incomplete or no meshes: one clear error at the command line, exit status 2, no traceback.
Swapped latitudes and longitudes are in `ais/test_ais_command.py`, broken streams in `test_stream.py`."""

import gzip
import json
import struct
import tracemalloc
from itertools import product

import pytest

from modsim3d.io.input_files import read_text
from modsim3d.scene.keys import PoseKeys
from modsim3d.scene.reading import load_scene
from tests.scenes import camera_keys, write_scene

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
def test_poses_that_are_cut_off_are_told_and_whole_ones_are_unpacked_whatever_their_name(
    tmp_path, refused, form, packed
):
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
def test_poses_that_unpack_to_more_than_can_be_read_are_refused_and_a_short_text_takes_little_room(
    tmp_path, refused, monkeypatch, packed
):
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
