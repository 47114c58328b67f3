"""Every budget of the files of a scene refuses small files that stand for enormous values, before the values exist."""

import gzip
import json
import os
import socket
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from modsim3d.core.errors import InputError
from modsim3d.io import input_files
from modsim3d.io.input_files import open_input, read_text
from modsim3d.io.strict_text import load_json, load_yaml
from modsim3d.world.poses.replay import load_poses, read_steps
from tests.cli.bad_input.builders import GOOD, Call, Inputs, Refused, at, refusal

NINE = "a{i}: &a{i} [*a{k}, *a{k}, *a{k}, *a{k}, *a{k}, *a{k}, *a{k}, *a{k}, *a{k}]\n"
ALIASES = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(NINE.format(i=i, k=i - 1) for i in range(1, 30))
MERGES = "a0: &a0 {x: 1}\n" + "".join(f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 9)}]}}\n" for i in range(1, 11))
TOP_ALIASES = "- &a0 [x, x]\n" + "".join(f"- &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 60))
LONG_ALIAS = f"a: &a {'x' * 100_000}\nb: [{', '.join(['*a'] * 1000)}]\n"


@cache
def zeros(count: int) -> bytes:
    """A gzip file of line breaks, made in pieces."""
    packer = zlib.compressobj(9, wbits=31)
    pieces = [packer.compress(b"\n" * input_files.PIECE_BYTES) for _ in range(count // input_files.PIECE_BYTES)]
    return b"".join([*pieces, packer.flush()])


Content = Callable[[], bytes]
BUDGETS: dict[str, tuple[str, Content, str]] = {
    "aliases": ("detector", lambda: ALIASES.encode(), "200,000 values once its aliases (*) and merge keys (<<)"),
    "aliases at the top": ("detector", lambda: TOP_ALIASES.encode(), "200,000 values once its aliases (*) and merge"),
    "a list": ("detector", lambda: b"&a [*a]", "must be a mapping with the keys labels,"),
    "merge keys": ("detector", lambda: MERGES.encode(), "200,000 values once its aliases (*) and merge keys (<<)"),
    "long text": ("scene", lambda: LONG_ALIAS.encode(), "200,000 values once its aliases (*) and merge keys (<<)"),
    "many values": ("scene", lambda: b"a: [" + b"a," * 200_001 + b"]", "more than 200,000 values; give large tables"),
    "10 MB of YAML": ("detector", lambda: b"a: 1\n" * 2_000_000, "has more than 1,048,576 bytes: give a part of it"),
    "packed YAML": ("scene", lambda: gzip.compress(b"# a\n" * 500_000), "unpacks to more than 1,048,576 bytes"),
    "packed lists": ("vessels", lambda: gzip.compress(b"[" + b"[]," * 10_000_000 + b"[]]"), "unpacks to more than 100"),
    "lists": ("vessels", lambda: b"[" + b"[]," * 1_000_000 + b"[]]", "(commas and brackets) in 3,000,004 characters"),
    "lists of poses": ("poses", lambda: b'{"0": [' + b"[]," * 2_000_000 + b"[]]}", "values (commas and brackets)"),
    "packed blanks": ("poses", lambda: zeros(1 << 27), "unpacks to more than 100 times its own size"),
}


@pytest.mark.parametrize(("file", "content", "part"), BUDGETS.values(), ids=BUDGETS)
def test_each_budget_is_told(inputs: Inputs, refused: Refused, file: str, content: Content, part: str) -> None:
    scene = inputs.write()
    inputs.path(file).write_bytes(content())
    assert len(refused(scene, part)) < 2000


def test_a_packed_file_is_refused_after_a_few_megabytes_and_poses_packed_twenty_fold_are_read(tmp_path: Path) -> None:
    path = tmp_path / "blank.gz"
    path.write_bytes(zeros(1 << 27))
    count = 0
    with pytest.raises(InputError, match="unpacks to more than 100 times"), open_input(path, "log") as file:
        while piece := file.read(input_files.PIECE_BYTES):
            count += len(piece)
    assert input_files.FREE_UNPACKED_BYTES - input_files.PIECE_BYTES <= count < 4 * input_files.FREE_UNPACKED_BYTES
    path = tmp_path / "poses.json.gz"
    steps = {f"{t}.0": {f"v{k}": at(k + t / 8, 2.0 * k) for k in range(200)} for t in range(600)}
    content = json.dumps(steps).encode()
    path.write_bytes(gzip.compress(content))
    assert path.stat().st_size < len(content) / 15 and len(load_poses(path, None).timestamps) == 600


def test_a_scene_of_a_thousand_vessels_and_a_hundred_thousand_poses_is_within_the_budgets(tmp_path: Path) -> None:
    vessels = {f"vessel_{k}": GOOD["vessels"]["vehicle1"] for k in range(1000)}
    tracks = {name: [[10.0 * t, 100.5 + t, 200.25 - t] for t in range(20)] for name in vessels}
    lines = [f"  {name}: {json.dumps(vessel)}" for name, vessel in vessels.items()]
    lines += ["tracks:", *(f"  {name}: {json.dumps(track)}" for name, track in tracks.items())]
    path = tmp_path / "scene.yaml"
    path.write_text("\n".join(["vessels:", *lines]))
    assert load_yaml(path, "scene") == {"vessels": vessels, "tracks": tracks}
    path = tmp_path / "poses.json"
    path.write_text(json.dumps({f"{t}.0": dict.fromkeys(vessels, at(1, 2)) for t in range(100)}))
    assert len(load_json(path, "pose file", input_files.POSE_BYTES_PER_VALUE)) == 100


def test_pipes_and_devices_are_not_waited_for_and_lines_of_a_stream_have_a_budget(inputs, refused, monkeypatch):
    line = b'{"0.0": [' + b"[]," * 1_000_000 + b"[]]}\n"
    with pytest.raises(InputError, match=r"line 1: has 2,000,003 values \(commas and brackets\)"):
        list(read_steps([line], "poses from standard input", ["v"]))
    monkeypatch.setattr(input_files, "MAX_POSES", 7)
    refused(inputs.write(), "4 steps of 2 vessels are more than 7 poses: use fewer of either")
    monkeypatch.undo()
    for file in ("scene", "vessels", "poses", "detector"):
        scene = inputs.write()
        inputs.path(file).unlink()
        os.mkfifo(inputs.path(file))
        refused(scene, f"{inputs.path(file).name}:", "this is a pipe, a file was expected")
        inputs.path(file).unlink()
    inputs.set("vessels", "vehicle2/mesh", "hull.stl")
    os.mkfifo(inputs.folder / "hull.stl")
    refused(inputs.write(), "vehicle2.mesh: 'hull.stl' is no ordinary file")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(inputs.folder / "s"))
        for path, part in (("/dev/zero", "this is a device"), (inputs.folder / "s", "cannot be read")):
            with pytest.raises(InputError, match=part):
                read_text(Path(path), "file")


@pytest.mark.parametrize("file", ["scene", "detector"])
def test_yaml_has_the_types_of_its_core_schema_only(inputs, refused, file):
    scene = inputs.write()
    tags = {"!!binary": "aGk=", "!!set": "{a, b}", "!!omap": "[a: 1]", "!!timestamp": "2001-01-01", "!mine": "[a]"}
    for tag, text in {**tags, "!!python/name:os.system": ""}.items():
        inputs.path(file).write_text(f"a: 1\nlabel: {tag} {text}\n")
        refused(scene, f"line 2, column 8: the tag {tag} is not read")
    inputs.path(file).write_text("a: 1\nlabel: !!map [a]\n")
    refused(scene, "line 2, column 8: a mapping is expected, but found a sequence")


@pytest.mark.parametrize("number", ["1e400", "-1e400", "1" * 400, "Infinity", "NaN"])
def test_numbers_beyond_all_floats_are_told(inputs: Inputs, refused: Refused, number: str) -> None:
    for file, place in (("vessels", "vehicle2/length_m"), ("poses", "2.0/vehicle2/heading_rad")):
        spoilt = Inputs(inputs.folder / file, json.loads(json.dumps(inputs.data)))
        spoilt.folder.mkdir(parents=True)
        spoilt.set(file, place, "PLACE")
        scene = spoilt.write()
        spoilt.path(file).write_text(spoilt.path(file).read_text().replace('"PLACE"', number))
        said = refused(scene, place.replace("/", ".") + ": ", "number")
        assert len(said) < 1000


def test_mistakes_are_told_once_not_all_of_thousands_and_long_names_without_their_middle(inputs, refused) -> None:
    inputs.set("vessels", "vehicle2/mesh", {"file": 5})
    said = refused(inputs.write(), "vehicle2.mesh: the name of a shipped mesh, a file, or a mapping of file")
    assert "dict" not in said and said.count("vehicle2.mesh") == 1  # no word of Python
    inputs.data["scene"]["x" * 500_000] = 1
    inputs.set("vessels", "vehicle1/label", "Vessel" * 50_000)
    assert len(refused(inputs.write(), ": unknown key", "is not one of the detector's labels (known: Vessel)")) < 20_000
    inputs.data["scene"]["cameras"] |= {f"c{k}": {"mount": {"vessel": f"w{k}"}} for k in range(2000)}
    inputs.data["vessels"] |= {f"v{k}": {"label": "x"} for k in range(2000)}
    inputs.data["poses"]["1.0"] = {f"u{k}": {} for k in range(2000)}
    inputs.data["detector"] |= {f"key_{k}": 1 for k in range(2000)}
    said = refused(inputs.write(), "more problems in", "no vessel 'w0'", "(the rest was not checked)", "no vessel 'u0'")
    assert said.count("\n") < 400


@pytest.mark.parametrize("file", ["scene", "vessels", "poses", "detector"])
def test_a_file_of_another_kind_is_not_repeated(inputs: Inputs, refused: Refused, file: str) -> None:
    scene = inputs.write()
    for text in ("root:secret:0:0\nother:secret", '"secret"', "- secret", "secret", "[secret]"):
        inputs.path(file).write_text(text)
        assert "secret" not in refused(scene)


def test_nor_is_one_that_is_given_as_a_sequence(call: Call, inputs: Inputs, tmp_path: Path) -> None:
    call("run", inputs.write(), "--out", tmp_path / "run", "--no-sheet")
    (tmp_path / "file").write_text("root:secret:0:0\nother:secret\n")
    line = ("learn", tmp_path / "run", "--out", tmp_path / "o.yaml", "--sequence", tmp_path / "file", "--time-step", 1)
    assert "secret" not in refusal(call, line, "--sequence:\n  names no state in any line")
