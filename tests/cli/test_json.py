"""What commands print: objects with --json, and tables of a run at the terminal."""

import io
import itertools
import json
import math
import os
import pty
import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.voyages.cases import SHOEBOXES
from modsim3d.cli import terminal
from modsim3d.cli.run_summary import camera_rows, print_summary, run_warnings, summary_rows
from modsim3d.cli.shared import print_path
from modsim3d.cli.terminal import open_console
from modsim3d.cli.terminal_tables import print_prose, print_table
from modsim3d.detector.file.reading import shipped_detectors
from modsim3d.runs.counts import Counts
from modsim3d.runs.run import RunResult, run_scene
from modsim3d.runs.stored_run import open_run
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene
from tests.cli.conftest import WITHOUT_OVERWRITE, Modsim3d, Said
from tests.cli.test_help import LEAVES, OPTIONS
from tests.command_line import call

COMMANDS = ("run", "detect", "check scene", "scenes", "check run", "check repeat", "check truth", "learn", "track")
COMMANDS += ("score",)
PAGE = Path(__file__).parents[2] / "docs" / "json.md"


def parsed(said: Said) -> dict[str, Any]:
    assert said.out.count("\n") == 1 and said.out.endswith("\n")
    found = json.loads(said.out, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert isinstance(found, dict)
    return found


def numbers(value: Any) -> Iterator[float]:
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        for each in value:
            yield from numbers(each)
    elif isinstance(value, int | float):
        yield value


def documented(command: str) -> set[str]:
    """The first column of a command's table in docs/json.md."""
    text = PAGE.read_text(encoding="utf-8")
    section = text.split(f"## {command}\n")[1].split("\n## ")[0]
    return {key for row in re.findall(r"^\| (`.*?`) \|", section, re.M) for key in re.findall(r"`(\w+)`", row)}


@pytest.mark.parametrize("command", COMMANDS)
def test_standard_output_is_one_object_with_the_documented_keys(modsim3d, lines, command):
    plain = modsim3d(*lines[command])
    overwrite = () if command in WITHOUT_OVERWRITE else ("--overwrite",)
    said = modsim3d(*lines[command], *overwrite, "--json")
    found = parsed(said)
    assert said.status == plain.status
    assert found["command"] == command and found["format"] == 1
    assert set(found) == documented(command)
    assert all(math.isfinite(number) for number in numbers(found))
    quiet = modsim3d(*lines[command], *overwrite, "--json", *(() if command == "scenes" else ("-q",)))
    assert set(parsed(quiet)) == set(found)
    assert quiet.err == "" or found.get("warnings")


@pytest.mark.parametrize("command", [command for command in COMMANDS if command != "scenes"])
def test_an_error_is_text_on_standard_error(modsim3d: Modsim3d, tmp_path: Path, command: str) -> None:
    nowhere = tmp_path / "nowhere"
    out = {"run": nowhere, "detect": nowhere, "learn": nowhere, "track": tmp_path / "out"}
    more = (nowhere,) if command == "score" else ("--out", out[command]) if command in out else ()
    said = modsim3d(*command.split(), nowhere, *more, "--json")
    assert (said.status, said.out) == (2, "") and said.err.startswith("modsim3d: ")


def test_warnings_are_in_the_object_and_on_standard_error(modsim3d, monkeypatch, lines, tmp_path: Path) -> None:
    text = shipped_detectors()["coastal"].read_text(encoding="utf-8")
    file = tmp_path / "detector.yaml"
    file.write_text(text.replace("    box_error:", "    false_discovery_rate: 0.1\n    box_error:", 1))
    key, reason = "states.clear.false_discovery_rate", "model per_image does not read it"
    wanted = f"nothing reads {key} in the detector file: {reason}: set detector.false_positives.rate"
    run = ("run", "strait", "--detector", file, "--steps", 2, "--source", "analytic", "--out", tmp_path / "strait")
    for line in (("check", "scene", "strait", "--set", f"detector={file}"), run):
        said = modsim3d(*line, "--json")
        assert said.status == 0 and wanted in parsed(said)["warnings"]
        assert "warning: nothing reads states.clear.false_discovery_rate" in said.err
    monkeypatch.setattr("modsim3d.runs.counts.WORTH_A_WARNING_PX", 1e-9)
    said = modsim3d(*lines["run"], "--json", "-q")
    assert any("the sea is flat" in warning for warning in parsed(said)["warnings"])
    assert "warning: the sea is flat" in said.err


def test_the_objects_say_what_the_text_says_and_what_a_run_counts(modsim3d, lines, run, tmp_path):
    verified = parsed(modsim3d(*lines["check run"], "--json"))
    stored = json.loads((tmp_path / "verify" / "verify.json").read_text())
    assert {key: verified[key] for key in stored} == stored
    assert verified["written"] == [str(tmp_path / "verify" / name) for name in ("verify.json", "verify.html")]
    repeated = parsed(modsim3d(*lines["check repeat"], "--json"))
    assert repeated["same"] and all(not file["stored"] and not file["repeated"] for file in repeated["files"])
    compared = parsed(modsim3d(*lines["check truth"], "--json"))
    assert compared["frames"] == 2 and compared["unexplained"] == 0
    checked = parsed(modsim3d(*lines["check scene"], "--json"))
    assert checked["steps"] == 40 and sum(checked["stationary_shares"].values()) == pytest.approx(1)
    scenes = {entry["name"]: entry["path"] for entry in parsed(modsim3d("scenes", "--json"))["scenes"]}
    assert Path(scenes["harbour"]).is_file()
    found = parsed(modsim3d(*lines["run"], "--json"))
    assert {field.name for field in fields(RunResult)} <= set(found)
    assert {field.name for field in fields(Counts)} == set(found["counts"])
    assert all(set(counts) == set(found["counts"]) for counts in found["camera_counts"].values())
    stored = json.loads((tmp_path / "run" / "run.json").read_text())
    assert found["counts"] == stored["counts"]
    assert found["contact_sheet"] == str(tmp_path / "run" / "contact_sheet.png")


def test_text_of_an_input_cannot_command_the_terminal_and_what_is_no_number_is_null(capsysbinary) -> None:
    hostile = "a\x1b[2J\x9b1m\u202eb\x7fø\U000e0041"
    terminal.ask_json(True)
    terminal.say_json({"name": hostile, "a": math.nan, "b": -math.inf, "c": np.float64(1.5), "d": Path("x/y")})
    terminal.start_afresh()
    line = capsysbinary.readouterr().out.decode("utf-8")
    assert json.loads(line) == {"name": hostile, "a": None, "b": None, "c": 1.5, "d": "x/y"}
    assert not re.search("[\x00-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e\U000e0000-\U000e007f]", line)
    assert "ø" in line


TRIED = ("run", "detect", "check scene", "check run", "check repeat", "check truth", "learn", "export", "report")
TRIED += ("view frame", "track")


@pytest.mark.parametrize("command", TRIED)
def test_verbose_tells_versions_files_and_times_and_quiet_prints_nothing_and_does_the_same(modsim3d, lines, command):
    line = (*lines[command], *(() if command in WITHOUT_OVERWRITE else ("--overwrite",)))
    verbose = modsim3d(*line, "--verbose")
    first, *rest = verbose.err.splitlines()
    assert first.startswith("versions  modsim3d ")
    read = [line.removeprefix("read      ") for line in rest if line.startswith("read ")]
    assert read and all(Path(path).exists() for path in read)
    assert any(line.startswith("time ") for line in rest)
    assert not any(line.startswith(("versions ", "read ", "time  ")) for line in verbose.out.splitlines())
    said = modsim3d(*line)
    assert said.out
    assert "versions  modsim3d" not in said.err, "an earlier command's -v"
    warnings = [line for line in said.err.splitlines() if line.startswith("warning: ")]
    quiet = modsim3d(*line, "-q")
    assert (quiet.status, quiet.out, quiet.err.splitlines()) == (said.status, "", warnings)


@pytest.mark.parametrize("command", ["run", "check truth"])
def test_verbose_names_the_opengl_that_draws(modsim3d, lines, command):
    arguments = [argument for argument in lines[command] if argument not in ("--source", "analytic")]
    assert "\nOpenGL    " in modsim3d(*arguments, "-v").err


def test_every_command_with_something_to_tell_has_both_options_but_not_at_once(modsim3d: Modsim3d, run: Path) -> None:
    for flags in (("-q", "-v"), ("-v", "-q"), ("-qv",)):
        said = modsim3d("check", "run", run, *flags)
        assert said.status == 2
        assert said.err.endswith("modsim3d: --quiet and --verbose contradict each other: leave one out\n")
    said = modsim3d("check", "scene", "nowhere.yaml", "-q")
    assert (said.status, said.out) == (2, "") and "no such file" in said.err
    have = {name for name, parameter in OPTIONS if parameter.name in ("quiet", "verbose")}
    assert have == LEAVES.keys() - {"scenes"}
    for name in have:
        opts = [opt for parameter in LEAVES[name].params for opt in parameter.opts]
        assert {"-q", "--quiet", "-v", "--verbose"} <= set(opts)


CELLS = st.text("ab1/._-é漢 ", max_size=30).map(lambda text: " ".join(text.split()))


def printed(width: int, *arguments: object, **options: object) -> list[str]:
    file = io.StringIO()
    print_table(open_console(file=file, width=width), *arguments, **options)  # type: ignore[arg-type]
    return file.getvalue().splitlines()


@given(
    st.integers(2, 4).flatmap(lambda count: st.lists(st.tuples(*[CELLS] * count), min_size=1, max_size=4)),
    st.integers(10, 120),
    st.booleans(),
)
def test_every_word_of_every_cell_is_printed_whole_and_in_order(rows, width, with_header):
    header = tuple(f"n{place}" for place in range(len(rows[0]))) if with_header else ()
    lines = printed(width, "", rows, header=header)
    words = "\n".join(lines).split()
    for row in rows:
        for cell in row:
            for word in cell.split():
                assert word in words
    assert not any(line.endswith(" ") for line in lines)


def test_names_numbers_and_paths_are_not_broken_and_what_does_not_fit_stands_below_its_row():
    name = "/a/very/long/path/" + "x" * 90 + "/scene.yaml"
    rows = [(name, "0.2111 … 1", "some words that explain what this is about, at length"), ("b", "2", "c")]
    for width, header in itertools.product((40, 60, 80, 120, 200), ((), ("file", "interval", "meaning"))):
        text = "\n".join(printed(width, "title", rows, header=header))
        assert name in text and "0.2111 … 1" in text, (width, header)
    file, path = io.StringIO(), Path("a_folder/" * 8)
    console = open_console(file=file, width=60)
    print_path(console, "run directory", Path("runs/first"))
    print_path(console, "run directory", path)
    print_prose(open_console(file=file, width=20), "the file /a/b/c/d/e/f/g/h.yaml is well", indent=2)
    prose = "  the file\n  /a/b/c/d/e/f/g/h.yaml\n  is well\n"
    assert file.getvalue() == f"run directory  runs/first\nrun directory\n{path}\n{prose}"
    lines = printed(40, "title", [("a", "1"), ("long", "22")], header=("name", "number"), right=(1,))
    assert lines == ["", "title", "name  number", "a          1", "long      22"]
    rows = [("parameter_with_a_name", "0.99", "0.2 … 1", "obeys"), ("other", "1", "–", "DIFFERS")]
    lines = printed(36, "", rows, header=("parameter", "asked", "interval", "verdict"), at_edge=3)
    assert lines[:2] == ["parameter_with_a_name          obeys", "    asked 0.99  interval 0.2 … 1"]
    assert lines[2:] == ["other                        DIFFERS", "    asked 1"]
    header = ("camera", "frames", "false\nalarms")  # whose lines stand on one below a row
    lines = printed(22, "", [("bow", "40", "10")], header=header)
    assert lines == ["camera  frames  false", "                alarms", "bow     40      10"]
    lines = printed(22, "", [("a_long_name", "40", "10")], header=header)
    assert lines == ["a_long_name", "    frames 40", "    false alarms 10"]
    rows = [("visible", "all", "10"), ("", "half", "2")]  # neither a line nor a space for what has no name
    lines = printed(16, "", rows, header=("by", "", "recall of boxes"))
    assert lines == ["visible", "    all", "    recall of", "    boxes 10", "    half", "    recall of", "    boxes 2"]
    rows = [("state", "0.5 [0.1, 0.9]", "0.6 [0.2, 0.8]")]  # cells are broken where they may be before rows are
    lines = printed(29, "", rows, header=("", "recall", "F1"), breaks=[lambda cell: cell.replace(" [", "\n[")])
    assert lines == ["       recall      F1", "state  0.5         0.6", "       [0.1, 0.9]  [0.2, 0.8]"]


@pytest.mark.parametrize("width", [60, 80, 120, None])
def test_verify_has_every_number_at_any_width(modsim3d, monkeypatch, run, tmp_path, width):
    if width:
        monkeypatch.setenv("COLUMNS", str(width))
    out = modsim3d("check", "run", run, "--out", tmp_path, "-v").out
    monkeypatch.delenv("COLUMNS", raising=False)
    table = modsim3d("check", "run", run, "--out", tmp_path, "--overwrite", "-v").out
    assert re.search(r"parameter +asked +measured +interval +noticed from +verdict", table)
    for word in table.split("\n\nwritten")[0].split():
        assert word in out or word in ("–", "parameter", "verdict")  # the verdict itself stands at the edge
    if width:
        assert max(len(line) for line in out.split("\nwritten")[0].splitlines()) <= width
    else:
        assert out == table


def test_an_error_is_broken_between_words_on_a_terminal_and_not_in_a_pipe(prepared, modsim3d, monkeypatch) -> None:
    command = [prepared, "check", "scene", "nowhere/at_all/in_this_folder.yaml"]
    for width in (40, 70):
        ours, theirs = pty.openpty()
        environment = {**os.environ, "COLUMNS": str(width), "TERM": "xterm"}
        done = subprocess.run(command, stderr=theirs, timeout=240, check=False, env=environment)
        os.close(theirs)
        said = os.read(ours, 10_000).decode().replace("\r\n", "\n")
        os.close(ours)
        lines = said.splitlines()
        assert done.returncode == 2 and max(map(len, lines)) <= width and len(lines) > 2
        for word in ("nowhere/at_all/in_this_folder.yaml:", "simulation_1,", "simulation_2,", "strait)"):
            assert word in said.split()
    monkeypatch.setenv("COLUMNS", "40")
    assert modsim3d("check", "scene", "nowhere.yaml").err.count("\n") == 2


COUNTS = Counts(
    **{"frames": 1500, "vessel_frames": 7500, "seen": 7458, "partly_hidden": 330, "fully_hidden": 42},
    **{"annotated": 7458, "detected": 5933, "missed": 1525, "missed_by_gate": 61, "merged": 33, "mislabelled": 596},
    **{"false_positives": 846, "clipped": 12, "redrawn": 2911, "below_half_iou": 5868, "off_vessel": 2635},
)


@pytest.fixture(scope="module")
def strait() -> Scene:
    return load_scene("strait", steps=40, source="analytic", settings=SHOEBOXES)


@pytest.fixture(scope="module")
def result(strait: Scene, tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    return run_scene(strait, tmp_path_factory.mktemp("runs") / "run")


def with_counts(result: RunResult, **counts: Counts) -> RunResult:
    return replace(result, camera_counts=counts)


def test_every_share_is_of_a_number_that_is_printed(strait: Scene, result: RunResult) -> None:
    rows = {
        name: [cell.replace(",", "") for cell in cells]
        for name, *cells in summary_rows(strait, with_counts(result, bow=COUNTS))
    }
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
        "false positives": "detections",
        **dict.fromkeys(("wrong class", "IoU below 0.5", "off their vessel", "box resampled"), "true detections"),
        "merged": "true detections",
    }
    for name, (whole, of, share) in found.items():
        assert whole == printed[of], name
        assert share == f"{100 * printed[name] / whole:.1f}"
    assert not any("%" in said for _, _, said in summary_rows(strait, with_counts(result, bow=Counts())))  # of nothing


def test_counts_of_files_and_cameras_are_printed_unbroken_and_bad_boxes_warned_of(strait, result, monkeypatch, capsys):
    tables = open_run(result.folder).tables()
    rows = {name: value for name, value, _ in summary_rows(strait, result)}
    kept = {name: sum(tables["truth"][name].to_pylist()) for name in ("annotated", "detected")}
    assert {name: int(rows[name].replace(",", "")) for name in (*kept, "detections")} == kept | {
        "detections": len(tables["detections"])
    }
    monkeypatch.setenv("COLUMNS", "80")
    both = with_counts(result, bow=COUNTS, quay=COUNTS, the_quay_camera=COUNTS)
    print_summary(strait, both, sheet=False)
    words = set(capsys.readouterr().out.split())
    for row in summary_rows(strait, both) + camera_rows(both):
        assert set(" ".join(row).split()) <= words, row
    header, *rows = camera_rows(with_counts(result, bow=COUNTS, stern=Counts(frames=3)))
    assert dict(zip([" ".join(name.split()) for name in header], rows[0], strict=True)) == {
        **{"camera": "bow", "frames": "1,500", "annotated": "7,458", "detected": "5,933", "false positives": "846"},
        **{"wrong class": "596", "IoU < 0.5": "5,868", "off vessel": "2,635"},
    }
    assert rows[1][:3] == ("stern", "3", "0")
    few = replace(COUNTS, below_half_iou=100)
    said = [run_warnings(strait, with_counts(result, bow=some, quay=some)) for some in (COUNTS, few)]
    assert [["IoU below 0.5" in line for line in lines] for lines in said] == [[True], []]
    assert said[0][0].startswith("11,736 of 11,800 true detections have IoU below 0.5")


def test_check_warns_of_the_sign_of_the_pitch(tmp_path, monkeypatch, capsys):
    scenes = Path(shutil.copytree(load_scene("simulation_2").path.parent, tmp_path / "scenes"))
    text = (scenes / "simulation_2.yaml").read_text()
    (scenes / "simulation_2.yaml").write_text(re.sub(r"pitch_rad: 0\.0157\d*", "pitch_rad: -0.4157", text))
    assert call(monkeypatch, "check", "scene", scenes / "simulation_2.yaml") == 0
    out, said = capsys.readouterr()
    assert "no errors, 1 warning" in out
    assert "camera 'C0' sees no vessel in the 29 frames looked at: it looks 23.8° above the horizon" in said
    assert "positive pitch_rad looks down" in said and "ahead of it but below the picture" in said
