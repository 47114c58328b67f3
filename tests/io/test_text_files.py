"""Text is read alike whatever marks, line ends and accents other programs put into it."""

import gzip
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from modsim3d import InputError, load_scene
from modsim3d.formats.reading.builder import Problems, ReadOptions
from modsim3d.formats.reading.mot import number_lines, sequence_info
from modsim3d.formats.reading.pair import read_pair
from modsim3d.io.input_files import read_text
from modsim3d.io.misreadings import has_lost_digits, no_commas
from modsim3d.io.strict_text import load_json, load_yaml, parse_yaml
from modsim3d.world.poses.replay import load_poses

NAME = "b\u00e5t"
POSE = '{"%s": {"b\u00e5t": {"center_position_m": [0, 0, 0], "heading_rad": 0}}}\n'
LENS = "focal_length_m: 0.008, pixel_size_m: [5.0e-6, 5.0e-6], principal_point_px: [960, 540]"
CAMERA = f"{{{LENS}, image_size_px: [1920, 1080], pose: {{position_m: [-50, 0, 5]}}}}"
SCENE = (
    "steps: 2\ntime_step_s: 0.5\n"
    "vessels: {own: {length_m: 10, beam_m: 4, air_draft_m: 3, label: b\u00e5t}}\n"
    f"poses: {{tracks: {{own: [[0, 0, 0], [30, 30, 0]]}}}}\ncameras: {{bow: {CAMERA}}}\ndetector: detector.yaml\n"
)
SEQUENCE = f"[Sequence]\nname={NAME}\nimWidth=800\nimHeight=400\n"
DETECTOR = (Path(__file__).parents[2] / "scenes" / "detectors" / "thesis.yaml").read_text(encoding="utf-8")


def yolo(path: Path) -> tuple[str, ...]:
    folders = [path.parent / name for name in ("labels", "predictions")]
    for folder in folders:
        folder.mkdir(exist_ok=True)
    (folders[0] / "a.txt").write_text("0 0.5 0.5 0.25 0.5\n")
    (folders[0] / "classes.txt").write_bytes(path.read_bytes())
    return read_pair("day", *folders, ReadOptions((), (800, 400))).labels


def scene(path: Path) -> str:
    (path.parent / "detector.yaml").write_text(DETECTOR.replace("[Vessel]", f"[{NAME}]"), encoding="utf-8")
    return load_scene(path).vessels[0].label


READERS: dict[str, tuple[str, str, Callable[[Path], Any]]] = {
    "text": ("a.txt", f"{NAME}\nclear\n", lambda path: read_text(path, "text")),
    "YAML": ("a.yaml", f"{NAME}: [1,\n 2]\nb: {NAME}\n", lambda path: load_yaml(path, "file")),
    "JSON": ("a.json", f'{{"a": 1,\n"{NAME}": "{NAME}"}}\n', lambda path: load_json(path, "file")),
    "scene": ("scene.yaml", SCENE, scene),
    "poses": ("a.jsonl", POSE % "0.0" + POSE % "0.5", lambda path: load_poses(path, [NAME]).timestamps),
    "seqinfo": ("seqinfo.ini", SEQUENCE, lambda path: sequence_info(path.parent / "det.txt", None, "detections")),
    "numbers": ("det.txt", "1,-1,2\n2,-1,3\n", lambda path: [*number_lines(path, "a", ",", 3, Problems("a"))]),
    "classes": ("names.txt", f"{NAME}\nboat\n", yolo),
}
MARKS: dict[str, Callable[[bytes], bytes]] = {
    "mark": lambda text: b"\xef\xbb\xbf" + text,
    "CR LF": lambda text: text.replace(b"\n", b"\r\n"),
    "CR": lambda text: text.replace(b"\n", b"\r"),
    "NFD": lambda text: text.replace(NAME.encode(), "ba\u030at".encode()),
    "packed": lambda text: gzip.compress(b"\xef\xbb\xbf" + text),
}


@pytest.mark.parametrize("reader", READERS)
def test_every_reader_of_text_passes_over_marks(reader: str, tmp_path: Path) -> None:
    name, text, read = READERS[reader]
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    expected = read(path)
    for mark, change in MARKS.items():
        path.write_bytes(change(text.encode()))
        assert read(path) == expected, mark
    for codec in ("utf-16-le", "utf-16-be"):
        path.write_bytes(("\ufeff" + text).encode(codec))
        with pytest.raises(InputError, match="is UTF-16 text, must be UTF-8"):
            read(path)


def test_accents_are_those_of_the_text_and_lost_digits_and_commas_are_named(tmp_path):
    for folder, name, numbers in (("labels", NAME, ""), ("predictions", "ba\u030at", " 0.9")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / f"{name}.txt").write_text(f"0 0.5 0.5 0.25 0.5{numbers}\n")
    (tmp_path / "labels" / "images.txt").write_text(f"{NAME}.png\n", encoding="utf-8")
    found = read_pair("day", tmp_path / "labels", tmp_path / "predictions", ReadOptions((), (800, 400)))
    assert found.images.names == (NAME,)
    assert (found.annotations.image.tolist(), found.results.image.tolist()) == ([0], [0])
    (tmp_path / "dt.json").write_text("[]")
    for name in (NAME, "ba\u030at"):  # which JSON escapes
        images, classes = [{"id": 1, "file_name": "a", "width": 9, "height": 9}], [{"id": 1, "name": name}]
        (tmp_path / "gt.json").write_text(json.dumps({"images": images, "annotations": [], "categories": classes}))
        assert read_pair("day", tmp_path / "gt.json", tmp_path / "dt.json").labels == (NAME,)
    lines = {"sep=;": "spreadsheets", "SEP=,\n": "spreadsheets", "a;b;c": "semicolons", "a\tb": "tabs", "a|b|c": "bars"}
    for line, says in {**lines, "a,b": "", "a,b;c": "", "": ""}.items():
        assert says in no_commas(line) and bool(says) == bool(no_commas(line)), line
    lost = ("2.19E+08", "2e8", " 2.190e+8 ", "2,19E+08", "1e1")
    kept = ("219000111", "2.19000111E+08", "1.000000000000000000e+00", "5e-05", "1e0", "a1e9", "1e300", "e", "", "219e")
    assert [text for text in lost + kept if has_lost_digits(text)] == list(lost)
    text = "a: [1, {b: 2.5}]\nc: &x [true]\nd: *x\n"
    first = parse_yaml(text, "one")
    first["a"][1]["b"] = first["c"] = "changed"
    assert parse_yaml(text, "other") == {"a": [1, {"b": 2.5}], "c": [True], "d": [True]}
    for source in ("one", "other"):
        with pytest.raises(InputError, match=f"^{source}:\n  line 1, column 8"):
            parse_yaml("a: 1, b: 2", source)
