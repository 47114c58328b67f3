"""`--json`: one object on standard output and nothing else, as docs/json.md has it; `-q` and `-v`: less and more."""

import json
import math
import re
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modsim3d.cli import terminal
from modsim3d.detector.file.reading import shipped_detectors
from modsim3d.runs.counts import Counts
from modsim3d.runs.run import RunResult
from tests.cli.conftest import WITHOUT_OVERWRITE, Modsim3d, Said
from tests.cli.test_help import LEAVES, OPTIONS

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
