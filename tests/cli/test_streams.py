"""A reader that goes away changes nothing: no traceback, no other exit status, and the work is done."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = f"{sys.executable} -m modsim3d"


def bash(line: str, *arguments: object, program: object = PROGRAM) -> subprocess.CompletedProcess[str]:
    """Run a line of bash, in which MODSIM3D is the program and $1, $2 … are the arguments."""
    command = ["bash", "-c", line.replace("MODSIM3D", str(program)), "bash", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)


@pytest.mark.parametrize("options", ["", "--json"])
@pytest.mark.parametrize("obeys", [True, False])
@pytest.mark.parametrize("reader", ["head -1", "true"])
def test_the_status_of_verify_is_its_verdict_whoever_reads(run, prepared, tmp_path, reader, obeys, options):
    detector = next((run / "scene").glob("detector.*"))
    if not obeys:
        text, detector = detector.read_text(), tmp_path / "other.yaml"
        detector.write_text(text.replace("mean: 0.67", "mean: 0.2"))
        assert detector.read_text() != text
    line = f'MODSIM3D check run "$1" --detector "$2" --out "$3" {options} | {reader} >/dev/null'
    done = bash(f"{line}; echo ${{PIPESTATUS[0]}}", run, detector, tmp_path / "out", program=prepared)
    assert done.stdout == f"{0 if obeys else 1}\n" and done.stderr == ""
    assert json.loads((tmp_path / "out" / "verify.json").read_text())["obeys"] is obeys


@pytest.mark.parametrize(
    "arguments",
    ["scenes", "-h", "run -h", "check scene harbour", "scenes --json", "check scene harbour --json", "--version"],
)
def test_no_command_minds_a_reader_that_goes_away(arguments: str, prepared: Path) -> None:
    done = bash(f"MODSIM3D {arguments} | true; echo ${{PIPESTATUS[0]}}", program=prepared)
    assert (done.stdout, done.stderr) == ("0\n", "")


@pytest.mark.parametrize("arguments", ["-h", "check scene harbour", "scenes --json"])
@pytest.mark.parametrize("unbuffered", ["", "PYTHONUNBUFFERED=1"])
def test_no_program_minds_a_reader_that_goes_away(arguments: str, unbuffered: str) -> None:
    """In a Python of its own: help, which is printed before all else, a text and an object."""
    done = bash(f"{unbuffered} MODSIM3D {arguments} | true; echo ${{PIPESTATUS[0]}}")
    assert (done.stdout, done.stderr) == ("0\n", "")


def test_a_command_does_its_work_and_errors_keep_their_status_whoever_reads(scene, run, prepared, tmp_path) -> None:
    line = 'MODSIM3D run "$1" --source analytic --no-sheet --out "$2" 2>&1 | true; echo ${PIPESTATUS[0]}'
    assert bash(line, scene, tmp_path / "run", program=prepared).stdout == "0\n"
    assert (tmp_path / "run" / "run.json").exists()
    done = bash('MODSIM3D check run "$1" --out "$2" --json | head -1', run, tmp_path / "json", program=prepared)
    assert json.loads(done.stdout)["command"] == "check run"
    done = bash('MODSIM3D check run "$1" --out "$2" >&-', run, tmp_path / "closed")
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "closed" / "verify.json").exists()
    done = bash("MODSIM3D check scene nowhere.yaml 2>&1 | true; echo ${PIPESTATUS[0]}")
    assert done.stdout == "2\n"
    done = bash("MODSIM3D scenes > /dev/full")
    full = "modsim3d: standard output cannot be written to: No space left on device\n"
    assert (done.returncode, done.stderr) == (2, full)
