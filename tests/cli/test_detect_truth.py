"""`modsim3d detect --truth` on the command line."""

import json
from pathlib import Path

import numpy as np

import modsim3d as package
from modsim3d.io.validation import conditions_in
from tests.cli.bad_input.builders import content
from tests.cli.conftest import Modsim3d
from tests.cli.test_json import documented, parsed
from tests.formats.labelled_video.videos import coco, mot, write


def test_in_fog_more_is_missed_and_one_option_says_so(tmp_path: Path, modsim3d: Modsim3d) -> None:
    truth, missed = mot(tmp_path / "bay", frames=200), {}
    for state in ("noon_clear", "foggy_cloudy"):
        line = ("--truth", truth, "--state", state, "--from", "conditions", "--detector-seed", 1)
        found = parsed(modsim3d("detect", *line, "--out", tmp_path / state, "--json"))
        assert found["counts"]["annotated"] == 600
        missed[state] = found["counts"]["missed"]
        asked = package.load_detector(conditions_in()[state]).states[0].confusion[-1][0]
        assert abs(missed[state] - 600 * asked) < 6 * np.sqrt(600 * asked * (1 - asked))
    assert missed["foggy_cloudy"] > missed["noon_clear"]


def test_the_command_says_what_python_says(tmp_path: Path, modsim3d: Modsim3d) -> None:
    truth = write(tmp_path / "gt.json", coco({"left": 30, "right": 20}, categories=("ship", "buoy")))
    line = ("--truth", truth, "--detector", "thesis", "--detector-seed", 4, "--frame-rate", 5, "--labels", "Vessel,-")
    said = modsim3d("detect", *line, "--horizon", 150, "--out", tmp_path / "a")
    assert said.status == 0, said.err
    options = {"detector": "thesis", "seed": 4, "frame_rate_hz": 5, "labels": ("Vessel", "-"), "horizon": 150}
    result = package.detect_truth(truth, tmp_path / "b", **options)
    assert content(tmp_path / "a") == content(tmp_path / "b")
    words = said.out.split()
    assert words[words.index("missed") + 1] == str(result.counts.missed)
    assert "2 sequences, from COCO" in said.out and "\nright " in said.out
    assert all(f"Note: {note}." in said.out for note in result.notes)
    assert f"annotated vessels {result.counts.annotated}" in repr(result)
    assert str(result.counts.annotated) in result._repr_html_()


def test_the_keys_of_its_object_are_those_of_the_page(tmp_path: Path, modsim3d: Modsim3d) -> None:
    line = ("detect", "--truth", mot(tmp_path / "bay"), "--detector", "thesis", "--out", tmp_path / "out")
    found = parsed(modsim3d(*line, "--json"))
    assert set(found) == documented("detect --truth")
    assert found["command"] == "detect" and found["format"] == 1
    stored = json.loads((tmp_path / "out" / "detect.json").read_text())
    for key in ("kind", "counts", "sequence_counts", "occlusion", "notes"):
        assert stored[key] == found[key], key
    assert {str(path) for path in (tmp_path / "out").rglob("*") if path.is_file()} == set(found["written"])
