"""The scripts for the checkout: they set it up, check it, and run what takes long."""

import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from tests.view.report import browser

REPOSITORY = Path(__file__).resolve().parents[2]
SETUP = REPOSITORY / "script" / "setup"
KNOWN_PYTHONS = re.search(r"known_pythons=\((.*)\)", SETUP.read_text())[1].split()
CHECKS = ("ruff", "mypy", "lint-imports", "pytest")
FILES = (path for path in (*(REPOSITORY / "script").iterdir(), REPOSITORY / ".ci" / "run") if path.is_file())
IN_BASH = [path for path in FILES if path.read_text().startswith("#!/usr/bin/env bash\n")]


def copy_of(name: str, folder: Path) -> Path:
    """A script in a checkout's skeleton, so that no test touches the environment that it runs in."""
    (folder / "script").mkdir()
    shutil.copy(REPOSITORY / "pyproject.toml", folder)
    return Path(shutil.copy(REPOSITORY / "script" / name, folder / "script"))


def write_program(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


@pytest.mark.parametrize("path", IN_BASH, ids=lambda path: path.name)
def test_script_is_executable_parses_and_stops_at_the_first_error(path: Path) -> None:
    assert os.access(path, os.X_OK)
    subprocess.run(["bash", "-n", path], check=True)
    assert "set -euo pipefail" in path.read_text().splitlines()


def test_test_runs_all_checks_and_lists_at_the_end_which_passed(tmp_path: Path) -> None:
    script = copy_of("test", tmp_path)
    for name in ("script/setup", "script/docs", *(f".venv/bin/{check}" for check in CHECKS)):
        command = tmp_path / name
        write_program(command, f"echo {command.name} ran\n[ {command.name} != mypy ]")
    finished = subprocess.run([script], capture_output=True, text=True)
    said = finished.stdout.splitlines()
    assert finished.returncode == 1 and said[said.index("== mypy") + 1] == "mypy ran"
    passed = [f"passed  {name}" for name in ("ruff check", "ruff format", "import-linter", "pytest")]
    assert said[-6:] == [*passed, "FAILED  mypy", "passed  docs"]


def test_campaign_lists_the_campaigns_refuses_any_other_and_sets_up_and_runs_the_one_that_is_named(tmp_path) -> None:
    command = REPOSITORY / "script" / "campaign"
    listed = subprocess.run([command], capture_output=True, text=True, check=True).stdout
    names = [line.split(":")[0].strip() for line in listed.splitlines()[1:]]
    assert names == sorted(path.stem for path in (REPOSITORY / "benchmarks" / "campaigns").glob("*.py"))
    finished = subprocess.run([command, "nothing"], capture_output=True, text=True)
    assert (finished.returncode, finished.stderr) == (2, listed)
    script = copy_of("campaign", tmp_path)
    for command in (tmp_path / "script" / "setup", tmp_path / ".venv" / "bin" / "python"):
        write_program(command, 'echo "${0##*/} $@ in ${PYTHONPATH%%:*}"')
    campaign = tmp_path / "benchmarks" / "campaigns" / "short.py"
    campaign.parent.mkdir(parents=True)
    campaign.touch()
    environment = {**os.environ, "PYTHONPATH": "elsewhere"}
    line = [script, "short", "--scenes", "3"]
    finished = subprocess.run(line, capture_output=True, text=True, check=True, env=environment)
    assert finished.stdout == f"setup test in elsewhere\npython {campaign} --scenes 3 in {tmp_path}\n"


def test_setup_refuses_an_unknown_purpose_and_an_unusable_python_in_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    script, environment = copy_of("setup", tmp_path), {**os.environ, "PYTHON": "/bin/false"}
    unusable = "script/setup: PYTHON=/bin/false does not run or is not Python 3.11 or newer\n"
    for purpose, answer in (("everything", (2, "usage: script/setup [demo|test]\n")), ("demo", (1, unusable))):
        finished = subprocess.run([script, purpose], env=environment, capture_output=True, text=True)
        assert (finished.returncode, finished.stderr) == answer
    assert not (tmp_path / ".venv").exists()


def test_setup_accepts_the_pythons_that_the_package_and_its_classifiers_do() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    lowest, classifiers = project["requires-python"].removeprefix(">="), project["classifiers"]
    assert f"sys.version_info < ({lowest.replace('.', ', ')})" in SETUP.read_text()
    assert lowest == KNOWN_PYTHONS[-1]
    named = [text.rpartition(" ")[2] for text in classifiers if text.startswith("Programming Language :: Python :: 3.")]
    assert named == KNOWN_PYTHONS[::-1]


def called(folder: Path, *functions: str, **environment: str) -> tuple[bool, str]:
    """Whether the last of setup's own functions succeeds, with nothing on the path but a folder, and what it says."""
    text = SETUP.read_text()
    parts = [re.search(r"^readonly known_pythons=.*$", text, re.MULTILINE)[0]]
    parts += [re.search(rf"^{name}\(\) {{.*?^}}", text, re.DOTALL | re.MULTILINE)[0] for name in functions]
    command = ["/bin/bash", "-c", "\n".join([*parts, functions[-1]])]
    environment["PATH"] = str(folder)
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    return done.returncode == 0, done.stdout.strip()


PYTHONS = [  # which there are, and which of them is taken; python3 is 3.15
    (("python3.15", "python3.14", "python3.11", "python3"), "python3.14"),
    (("python3.15", "python3.12", "python3"), "python3.12"),
    (("python3.15", "python3"), "python3"),
    (("python3.10",), ""),
]


@pytest.mark.parametrize(("there", "taken"), PYTHONS)
def test_setup_takes_the_newest_python_that_it_knows(there: tuple[str, ...], taken: str, tmp_path: Path) -> None:
    """A Python that is too new for the libraries is taken only where there is no other."""
    for name in there:
        write_program(tmp_path / name, "exit 1" if name == "python3.10" else "")
    found = called(tmp_path, "right_version", "can_make_venv", "find_python")
    assert found == (bool(taken), str(tmp_path / taken) if taken else "")


def test_setup_takes_a_browser_that_runs_and_no_stub_of_those_that_the_tests_look_for(tmp_path: Path) -> None:
    assert f"${{CHROMIUM:-{' '.join(browser.NAMES)}}}" in SETUP.read_text()
    assert not called(tmp_path, "has_browser")[0]
    write_program(tmp_path / "chromium", "echo install the snap >&2; exit 1")
    assert not called(tmp_path, "has_browser")[0]
    write_program(tmp_path / "mine", "echo Chromium 100")
    assert called(tmp_path, "has_browser", CHROMIUM=str(tmp_path / "mine"))[0]
    write_program(tmp_path / "chromium", "echo Chromium 100")
    assert called(tmp_path, "has_browser")[0]
