"""The summary of a run: every share is of a number that is printed, and nothing is cut at 80 columns."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from modsim3d.cli.run_summary import camera_rows, print_summary, run_warnings, summary_rows
from modsim3d.runs.counts import Counts
from modsim3d.runs.run import RunResult, run_scene
from modsim3d.runs.stored_run import open_run
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene
from tests.command_line import call

COUNTS = Counts(
    **{"frames": 1500, "vessel_frames": 7500, "seen": 7458, "partly_hidden": 330, "fully_hidden": 42},
    **{"annotated": 7458, "detected": 5933, "missed": 1525, "missed_by_gate": 61, "merged": 33, "mislabelled": 596},
    **{"false_positives": 846, "clipped": 12, "redrawn": 2911, "below_half_iou": 5868, "off_vessel": 2635},
)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("strait", steps=40, source="analytic")


@pytest.fixture(scope="module")
def result(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    return run_scene(scene, tmp_path_factory.mktemp("runs") / "run")


def with_counts(result: RunResult, **counts: Counts) -> RunResult:
    return replace(result, camera_counts=counts)


def test_every_share_is_of_a_number_that_is_printed(scene: Scene, result: RunResult) -> None:
    rows = {name: (value, meaning) for name, value, meaning in summary_rows(scene, with_counts(result, bow=COUNTS))}
    true = re.fullmatch(r"in the files: (\d+) true \+ (\d+) false", rows["detections"][1])
    assert true is not None
    assert int(rows["detections"][0]) == int(true[1]) + int(true[2]) == 5900 + 846
    printed = {"true detections": int(true[1])} | {n: int(v) for n, (v, _) in rows.items() if v.isdigit()}
    printed["seen"] = printed["vessels seen"]
    shares = {name: re.match(r"of (\d+) ([a-z ]+)[^(]* \(([\d.]+) %\)", said) for name, (_, said) in rows.items()}
    found = {name: (int(m[1]), m[2], m[3]) for name, m in shares.items() if m}
    assert {name: of for name, (_, of, _) in found.items()} == {
        "partly hidden": "seen",
        "detected": "annotated",
        "missed": "annotated",
        "gated": "missed",
        "false alarms": "detections",
        **dict.fromkeys(("wrong class", "IoU below 0.5", "off their vessel", "box resampled"), "true detections"),
        "merged": "true detections",
    }
    for name, (whole, of, share) in found.items():
        assert whole == printed[of], name
        assert share == f"{100 * printed[name] / whole:.1f}"
    assert not any("%" in said for _, _, said in summary_rows(scene, with_counts(result, bow=Counts())))  # of nothing


def test_the_counts_of_the_files_are_those_that_are_printed(scene: Scene, result: RunResult) -> None:
    tables = open_run(result.folder).tables()
    rows = {name: value for name, value, _ in summary_rows(scene, result)}
    kept = {name: sum(tables["truth"][name].to_pylist()) for name in ("annotated", "detected")}
    kept["detections"] = len(tables["detections"])
    assert {name: int(rows[name]) for name in kept} == kept


def test_each_camera_has_its_counts(result: RunResult) -> None:
    header, *rows = camera_rows(with_counts(result, bow=COUNTS, stern=Counts(frames=3)))
    assert dict(zip([" ".join(name.split()) for name in header], rows[0], strict=True)) == {
        **{"camera": "bow", "frames": "1500", "annotated": "7458", "detected": "5933", "false alarms": "846"},
        **{"wrong class": "596", "IoU < 0.5": "5868", "off vessel": "2635"},
    }
    assert rows[1][:3] == ("stern", "3", "0")


def test_boxes_that_an_evaluation_would_not_match_are_warned_of(scene: Scene, result: RunResult) -> None:
    few = replace(COUNTS, below_half_iou=100)
    said = [run_warnings(scene, with_counts(result, bow=some, quay=some)) for some in (COUNTS, few)]
    assert [["IoU below 0.5" in line for line in lines] for lines in said] == [[True], []]
    assert said[0][0].startswith("11736 of 11800 true detections have IoU below 0.5")


def test_no_word_is_broken_at_80_columns(scene, result, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    both = with_counts(result, bow=COUNTS, quay=COUNTS, the_quay_camera=COUNTS)
    print_summary(scene, both, sheet=False)
    words = set(capsys.readouterr().out.split())
    for row in summary_rows(scene, both) + camera_rows(both):
        assert set(" ".join(row).split()) <= words, row


def test_check_warns_of_the_sign_of_the_pitch(tmp_path, monkeypatch, capsys):
    scenes = Path(shutil.copytree(load_scene("simulation_2").path.parent, tmp_path / "scenes"))
    text = (scenes / "simulation_2.yaml").read_text()
    (scenes / "simulation_2.yaml").write_text(re.sub(r"pitch_rad: 0\.0157\d*", "pitch_rad: -0.4157", text))
    assert call(monkeypatch, "check", "scene", scenes / "simulation_2.yaml") == 0
    out, said = capsys.readouterr()
    assert "no errors, 1 warning" in out
    assert "camera 'C0' sees no vessel in the 29 frames looked at: it looks 23.8° above the horizon" in said
    assert "positive pitch_rad looks down" in said and "ahead of it but below the picture" in said
