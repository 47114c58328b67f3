"""`modsim3d track`, `score` and `detect --truth`: what they print, write and refuse."""

import json
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import modsim3d as package
from modsim3d.io.validation import conditions_in
from modsim3d.tracking.track_run import track_run
from modsim3d.tracking.trackers.names import BUILT_IN
from tests.cli.bad_input.builders import content
from tests.cli.conftest import Modsim3d
from tests.cli.test_json import documented, parsed
from tests.formats.labelled_video.videos import coco, mot, write

EVERY_BOX = """\
import json, sys
sys.stdin.readline()
print(json.dumps({"answers": "frames", "tracks": sys.argv[1] if sys.argv[1:] else "image"}), flush=True)
for line in sys.stdin:
    frame = json.loads(line)
    told = [{"track": k, "box_px": found["box_px"]} for k, found in enumerate(frame["detections"])]
    print(json.dumps({"camera": frame["camera"], "step": frame["step"], "tracks": told}), flush=True)
"""


@pytest.fixture
def tracks(run: Path, tmp_path: Path) -> Path:
    return track_run(run, tmp_path / "tracks").folder


def test_a_score_prints_trackers_beside_references_and_is_written_where_it_is_told(modsim3d, run, tracks, tmp_path):
    said = modsim3d("score", run, tracks, "--similarity", "centre:150", "--gospa", 70, "--seeds", 2, "-v")
    assert said.status == 0
    for part in (
        *("reference  ", "oracle association, smoothed", "oracle association, raw boxes", "occlusions survived"),
        *("1 - distance of centres / 150 px; a track follows a vessel from 0.5 on", "c = 70 px, p = 1, α = 2"),
        *("Where reference loses vessels", "2 seeds of the detector, 0 to 1", "says nothing about other traffic"),
        "reference follows vessels for ",
    ):
        assert part in said.out
    assert not (run / "score.json").exists()
    usage = modsim3d("score", "-h").out.split("Example")[0]
    assert usage.count("RUN") == usage.count("TRACKS") == 1
    said = modsim3d("score", run, tracks, "--by", "class", "--out", tmp_path / "out", "--json")
    found = json.loads(said.out)
    assert found.pop("written") == [str(tmp_path / "out" / name) for name in ("score.json", "score.html")]
    assert found.pop("command") == "score"
    assert found == json.loads((tmp_path / "out" / "score.json").read_text())
    assert set(found["trackers"][0]) > {"hota", "deta", "assa", "mota", "idf1", "id_switches", "gospa", "by_class"}


def test_where_vessels_are_lost_and_detector_seeds_are_tables_at_80_columns(modsim3d, run, tracks, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert len(modsim3d("score", run, tracks).out.splitlines()) <= 32  # about a screen
    lines = modsim3d("score", run, tracks, "--seeds", 2, "-v").out.splitlines()
    first = lines.index("Where reference loses vessels")
    assert lines[first + 1].split() == ["by", "vessel-frames", "recall", "association"]
    table = lines[first + 2 : lines.index("", first)]
    assert table[0].split()[:3] == ["visible", "fraction", "1"] and all(len(line) <= 80 for line in table)
    first = lines.index("Detector seeds")
    header = next(place for place in range(first, len(lines)) if lines[place].startswith("tracker"))
    assert lines[header].split()[:4] == ["tracker", "score", "mean", "standard"]
    assert lines[header + 1].split()[0] == "deviation"


def test_a_rule_out_of_range_is_one_line(modsim3d, run, tracks):
    for options, said in (
        (("--threshold", 0), "--threshold must be above 0 and at most 1 (got 0)"),
        (("--gap", -1), "--gap must be 0 or more seconds (got -1)"),
        (("--gospa", "nan"), "--gospa C: must be above 0"),
        (("--gospa", "70:0.5"), "--gospa C:P: must have a power from 1 to 10 (got 0.5)"),
        (("--gospa", "70:a"), "--gospa 70:a: needs a cutoff"),
        (("--gate", 5), "--gate is for tracks in the world, and none are given"),
        (("--seeds", 1), "--seeds must be from 2 to 1000 (got 1)"),
    ):
        found = modsim3d("score", run, tracks, *options)
        assert (found.status, found.out) == (2, "")
        assert said in found.err and found.err.count("\n") == 1


def test_track_says_the_tracker_its_settings_the_counts_and_what_comes_next(modsim3d, run, tmp_path):
    out = tmp_path / "my tracks"
    said = modsim3d("track", run, "--set", "confirm_hits=1", "--out", out)
    assert said.status == 0
    lines = said.out.splitlines()
    assert lines[0].startswith("reference (confirm_hits=1): modsim3d ") and "confirm_hits" in lines[0].split(";")[1]
    header, row = lines[lines.index("tracks") + 1 :][:2]
    assert header.split() == ["camera", "frames", "detections", "tracks", "boxes", "median", "track"]
    assert row.split()[:2] == ["C0", "40"]
    assert f"  {out / 'tracks.parquet'}" in lines and f"  {out / 'tracks.json'}" in lines
    assert lines[-1] == f"  modsim3d score {run} '{out}'"
    said = modsim3d("track", run, "--set", "start_confidence=1.0", "--set", "confirm_hits=100", "--out", tmp_path / "t")
    assert said.status == 0
    row = next(line for line in said.out.splitlines() if line.startswith("C0 "))
    assert row.split()[3:] == ["0", "0", "-"]


def test_wrong_options_are_one_message_and_leave_nothing(modsim3d, run, tmp_path):
    for options, part in (
        (("--tracker", "nosuch"), f"known: {', '.join(BUILT_IN)}"),
        (("--set", "confirm_hits=many"), "confirm_hits: "),
        (("--set", "confirm_hits"), "--set confirm_hits:\n  a key and a value are needed, as in lost_s=2.5"),
        (("--set", "confirm_hits=[1"), "--set confirm_hits:"),
    ):
        said = modsim3d("track", run, *options, "--out", tmp_path / "out")
        assert (said.status, said.out) == (2, "")
        assert part in said.err and "Traceback" not in said.err
        assert not (tmp_path / "out").exists()


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


def test_detect_truth_says_what_python_says_and_its_object_has_the_keys_of_the_page(tmp_path, modsim3d):
    truth = write(tmp_path / "gt.json", coco({"left": 30, "right": 20}, categories=("ship", "buoy")))
    line = ("--truth", truth, "--detector", "thesis", "--detector-seed", 4, "--frame-rate", 5, "--labels", "Vessel,-")
    said = modsim3d("detect", *line, "--horizon", 150, "--out", tmp_path / "a")
    assert said.status == 0, said.err
    options = {"detector": "thesis", "seed": 4, "frame_rate_hz": 5, "labels": ("Vessel", "-"), "horizon": 150}
    result = package.detect_truth(truth, tmp_path / "b", **options)
    one, two = (content(tmp_path / name) for name in "ab")
    assert one.pop("run.log") and two.pop("run.log") and one == two
    words = said.out.split()
    assert words[words.index("missed") + 1] == str(result.counts.missed)
    assert "2 sequences, from COCO" in said.out and "\nright " in said.out
    assert all(f"Note: {note}." in said.out for note in result.notes)
    assert f"annotated vessels {result.counts.annotated}" in repr(result)
    assert str(result.counts.annotated) in result._repr_html_()
    line = ("detect", "--truth", mot(tmp_path / "bay"), "--detector", "thesis", "--out", tmp_path / "out")
    found = parsed(modsim3d(*line, "--json"))
    assert set(found) == documented("detect --truth")
    assert found["command"] == "detect" and found["format"] == 1
    stored = {k: v for n in ("run", "detect") for k, v in json.loads((tmp_path / f"out/{n}.json").read_text()).items()}
    for key in ("kind", "counts", "occlusion", "notes"):
        assert stored[key] == found[key], key
    assert {str(path) for path in (tmp_path / "out").rglob("*") if path.is_file()} == set(found["written"])


def test_a_tracker_and_scores_take_the_files_as_they_take_their_run(tmp_path: Path, modsim3d: Modsim3d) -> None:
    truth, folder, program = mot(tmp_path / "bay"), tmp_path / "sim", tmp_path / "every.py"
    program.write_text(EVERY_BOX, encoding="utf-8")
    run = ("detect", "--truth", truth, "--detector", "coastal", "--labels", "boat", "--horizon", 150, "--out", folder)
    assert modsim3d(*run).status == 0
    files = ("--truth", truth, "--detections", folder / "det" / "det.txt")
    for line in (
        ("detect", *files, "--out", tmp_path / "real"),
        ("track", tmp_path / "real", "--tracker", "sort", "--out", tmp_path / "of_run"),
        ("track", *files, "--tracker", "sort", "--out", tmp_path / "of_files"),
        ("track", *files, "--command", f"{sys.executable} {program}", "--out", tmp_path / "of_program"),
    ):
        assert modsim3d(*line).status == 0
    in_world = modsim3d("track", *files, "--command", f"{sys.executable} {program} world", "--out", tmp_path / "w")
    said = "at its start: scene 'bay': a tracker in the world needs places in the world, and labels of videos have none"
    assert in_world.status == 2 and said in in_world.err
    assert len(pq.read_table(tmp_path / "of_program" / "tracks.parquet")) > 0
    tracks = [(tmp_path / name / "tracks.parquet").read_bytes() for name in ("of_run", "of_files")]
    assert tracks[0] == tracks[1]
    scores = [
        json.loads(modsim3d("score", *line, tmp_path / "of_files", "--json").out)["trackers"][0]["hota"]
        for line in ((tmp_path / "real",), files)
    ]
    assert scores[0] == scores[1] > 0.2
    said = modsim3d("score", *files, tmp_path / "of_files", "--out", tmp_path / "scores", "--json").out
    assert json.loads(said)["run"] == str(truth)
    page = (tmp_path / "scores" / "score.html").read_text(encoding="utf-8")
    assert str(truth) in page and str(files[3]) in page and "modsim3d_" not in page
    alone = modsim3d("score", "--truth", truth, truth)
    assert alone.status == 0 and "1.000" in alone.out and "perfect association" not in alone.out
    for line, said in (
        (("track", *files[:2], "--out", tmp_path / "x"), "--truth needs --detections"),
        (("score", *files[:2], tmp_path / "of_files"), "--detections and --labels must be given as for `modsim3d"),
        (("score", tmp_path / "real"), "give TRACKS"),
        (("track", "--out", tmp_path / "x"), "give either RUN"),
        (("track", tmp_path / "real", "--frame-rate", 5, "--out", tmp_path / "x"), "--frame-rate is for --truth"),
        (("score", tmp_path / "real", tmp_path, "--first-frame", 0), "--first-frame is for --truth"),
    ):
        refused = modsim3d(*line)
        assert refused.status == 2 and said in refused.err
