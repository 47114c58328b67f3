"""Files that are cut off, incomplete or no meshes: one clear error at the command line, exit status 2, no traceback.

Swapped latitudes and longitudes are in `ais/test_ais_command.py`, broken streams in `test_stream.py`.
"""

import gzip
import json
import struct
import tracemalloc

import pytest

from modsim3d.io.input_files import read_text
from modsim3d.scene.keys import PoseKeys
from modsim3d.scene.reading import load_scene
from tests.scenes import camera_keys, write_scene

BOATS = {"own": ([8, 4, 2], []), "other": ([20, 6, 9], [])}
WEDGE = "v 0 0 0\nv 4 0 0\nv 0 2 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


@pytest.fixture
def refused(call, tmp_path):
    """Has `check` and `run` refuse a scene, and gives the one problem that they say."""

    def look(scene):
        first, second = call("check", "scene", scene), call("run", scene, "--out", tmp_path / "out", "--no-sheet")
        assert first == second and first[0] == 2
        assert not (tmp_path / "out").exists()
        head, problem = first[1].splitlines()
        assert head == f"modsim3d: scene {scene}:"
        return problem.strip()

    return look


def poses(steps=5, absent=()):
    return [
        {
            f"{step}.0": {
                name: {"center_position_m": [60.0 * place + step, 0, 0], "heading_rad": 0.0}
                for place, name in enumerate(BOATS)
                if (step, name) not in absent
            }
        }
        for step in range(steps)
    ]


def scene_of(folder, file, **keys):
    cameras = {"C0": camera_keys(mount={"vessel": "own", "position_m": [4, 0, 2.5]})}
    return write_scene(folder, BOATS, None, time_step_s=None, poses={"file": file}, cameras=cameras, **keys)


def whole(form):
    if form == "json":
        return json.dumps({time: entry for step in poses() for time, entry in step.items()}, indent=1).encode()
    return "".join(json.dumps(step) + "\n" for step in poses()).encode()


@pytest.mark.parametrize("form", ["json", "jsonl"])
@pytest.mark.parametrize("packed", [False, True])
def test_poses_that_are_cut_off_are_told_and_whole_ones_are_unpacked_whatever_their_name(
    tmp_path, refused, form, packed
):
    lines = whole(form).splitlines(keepends=True)
    last = len(lines) * 2 // 3
    cut = b"".join(lines[:last]) + lines[last][: len(lines[last]) // 2]
    name = f"poses.{form}.gz" if packed else f"poses.{form}"
    (tmp_path / name).write_bytes(gzip.compress(cut) if packed else cut)
    said = refused(scene_of(tmp_path, name))
    assert name in said and f"line {last + 1}" in said
    content = gzip.compress(whole(form)) if packed else whole(form)
    if packed:
        (tmp_path / name).write_bytes(content[: len(content) * 2 // 3])
        said = refused(scene_of(tmp_path, name))
        assert name in said and "not a complete gzip file" in said
    other = f"poses.{form}" if packed else f"poses.{form}.gz"
    (tmp_path / other).write_bytes(content)
    assert load_scene(scene_of(tmp_path, other)).steps == len(poses())


@pytest.mark.parametrize("packed", [False, True])
def test_poses_that_unpack_to_more_than_can_be_read_are_refused(tmp_path, refused, monkeypatch, packed):
    monkeypatch.setattr("modsim3d.io.input_files.MAX_TEXT_BYTES", 100_000)
    long = whole("json") + b" " * 100_000
    (tmp_path / "poses.json").write_bytes(gzip.compress(long) if packed else long)
    said = refused(scene_of(tmp_path, "poses.json"))
    assert ("unpacks to more than" if packed else "has more than") in said


@pytest.mark.parametrize("packed", [False, True])
def test_a_short_text_takes_little_room(tmp_path, packed):
    path = tmp_path / "short.txt"
    path.write_bytes(gzip.compress(b"short") if packed else b"short")
    tracemalloc.start()
    try:
        assert read_text(path, "text") == "short"
        assert tracemalloc.get_traced_memory()[1] < 5e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("form", ["json", "jsonl"])
def test_own_ship_missing_at_a_step_names_camera_vessel_and_time(tmp_path, refused, form):
    steps = poses(absent={(3, "own"), (4, "own"), (1, "other")})
    text = json.dumps({time: entry for step in steps for time, entry in step.items()})
    (tmp_path / f"poses.{form}").write_text(text if form == "json" else "\n".join(map(json.dumps, steps)))
    said = refused(scene_of(tmp_path, f"poses.{form}"))
    assert said == "cameras.C0.mount.vessel: 'own' has no pose at time 3.0 s"


def five_million(path):
    with path.open("wb") as file:
        file.write(b"\0" * 80 + struct.pack("<I", 5_000_000))
        file.truncate(84 + 50 * 5_000_000)  # sparse: takes no room


MESHES = {
    "five million faces": ("hull.stl", five_million, "has 5000000 faces; a mesh may have at most 50000: simplify it"),
    "NaN": ("hull.obj", lambda path: path.write_text(WEDGE.replace("v 0 2 0", "v nan 2 0")), "vertices that are NaN"),
    "no mesh": ("hull.glb", lambda path: path.write_bytes(b"%PDF-1.7\n" * 40), "is not a GLB file"),
    "cut off": ("hull.stl", lambda path: path.write_bytes(b"\0" * 80 + struct.pack("<I", 9) + b"\0" * 70), "hull.stl"),
    "empty": ("hull.ply", lambda path: path.write_bytes(b""), "hull.ply"),
}


@pytest.mark.parametrize("whose", ["vessel", "obstacle"])
@pytest.mark.parametrize("fault", MESHES)
def test_a_bad_mesh_is_told_with_whose_it_is_and_why(tmp_path, refused, whose, fault):
    name, write, reason = MESHES[fault]
    write(tmp_path / name)
    (tmp_path / "poses.json").write_bytes(whole("json"))
    rock = {"rock": {"mesh": name, "size_m": [9, 9, 9], "position_m": [200, 30, 0]}} if whose == "obstacle" else {}
    path = scene_of(tmp_path, "poses.json", **({"obstacles": rock} if rock else {}))
    if whose == "vessel":
        data = json.loads(path.read_text())
        data["vessels"]["other"]["mesh"] = name
        path.write_text(json.dumps(data))
    said = refused(path)
    assert said.startswith("obstacles.rock.mesh: " if rock else "vessels.other.mesh: ")
    assert reason in said


@pytest.mark.parametrize(
    "angles",
    [
        {"yaw_rad": 3.141592653589793},  # astern
        {"yaw_rad": -4.7},
        {"pitch_rad": 1.5708},  # straight down, as from a mast or a drone
        {"roll_rad": -1.5708},  # on its side
        {"roll_rad": 3.14159},  # upside down
    ],
)
def test_angles_that_cameras_have_are_taken(angles: dict[str, float]) -> None:
    assert PoseKeys.model_validate({"position_m": (0, 0, 9), **angles}).model_dump(include=set(angles)) == angles
