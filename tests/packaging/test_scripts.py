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
IN_BASH = [path for path in (*(REPOSITORY / "script").iterdir(), REPOSITORY / ".ci" / "run") if path.is_file()]
IN_BASH = [path for path in IN_BASH if path.read_text().startswith("#!/usr/bin/env bash\n")]


def copy_of_setup(folder: Path) -> Path:
    """A checkout's skeleton, so that no test touches the environment that it runs in."""
    (folder / "script").mkdir()
    shutil.copy(REPOSITORY / "pyproject.toml", folder)
    return Path(shutil.copy(REPOSITORY / "script" / "setup", folder / "script"))


@pytest.mark.parametrize("path", IN_BASH, ids=lambda path: path.name)
def test_script_is_executable_parses_and_stops_at_the_first_error(path: Path) -> None:
    assert os.access(path, os.X_OK)
    subprocess.run(["bash", "-n", path], check=True)
    assert "set -euo pipefail" in path.read_text().splitlines()


def test_test_runs_all_checks_and_lists_at_the_end_which_passed(tmp_path: Path) -> None:
    (tmp_path / "script").mkdir()
    script = Path(shutil.copy(REPOSITORY / "script" / "test", tmp_path / "script"))
    commands = tmp_path / ".venv" / "bin"
    commands.mkdir(parents=True)
    scripts = [tmp_path / "script" / name for name in ("setup", "docs")]
    for command in (*scripts, *(commands / name for name in CHECKS)):
        command.write_text(f"#!/bin/sh\necho {command.name} ran\n[ {command.name} != mypy ]\n")
        command.chmod(0o755)
    finished = subprocess.run([script], capture_output=True, text=True)
    assert finished.returncode == 1
    said = finished.stdout.splitlines()
    assert said[said.index("== mypy") + 1] == "mypy ran"
    passed = [f"passed  {name}" for name in ("ruff check", "ruff format", "import-linter", "pytest")]
    assert said[-6:] == [*passed, "FAILED  mypy", "passed  docs"]


def test_campaign_lists_the_campaigns_and_refuses_any_other() -> None:
    command = REPOSITORY / "script" / "campaign"
    listed = subprocess.run([command], capture_output=True, text=True, check=True).stdout
    names = [line.split(":")[0].strip() for line in listed.splitlines()[1:]]
    assert names == sorted(path.stem for path in (REPOSITORY / "benchmarks" / "campaigns").glob("*.py"))
    finished = subprocess.run([command, "nothing"], capture_output=True, text=True)
    assert (finished.returncode, finished.stderr) == (2, listed)


def test_campaign_sets_up_and_runs_the_one_that_is_named(tmp_path: Path) -> None:
    (tmp_path / "script").mkdir()
    script = Path(shutil.copy(REPOSITORY / "script" / "campaign", tmp_path / "script"))
    for command in (tmp_path / "script" / "setup", tmp_path / ".venv" / "bin" / "python"):
        command.parent.mkdir(parents=True, exist_ok=True)
        command.write_text('#!/bin/sh\necho "${0##*/} $@ in ${PYTHONPATH%%:*}"\n')
        command.chmod(0o755)
    campaign = tmp_path / "benchmarks" / "campaigns" / "short.py"
    campaign.parent.mkdir(parents=True)
    campaign.touch()
    environment = {**os.environ, "PYTHONPATH": "elsewhere"}
    line = [script, "short", "--scenes", "3"]
    finished = subprocess.run(line, capture_output=True, text=True, check=True, env=environment)
    assert finished.stdout == f"setup test in elsewhere\npython {campaign} --scenes 3 in {tmp_path}\n"


def test_setup_refuses_an_unknown_purpose(tmp_path: Path) -> None:
    finished = subprocess.run([copy_of_setup(tmp_path), "everything"], capture_output=True, text=True)
    assert finished.returncode == 2 and finished.stderr == "usage: script/setup [demo|test]\n"


def test_setup_refuses_an_unusable_python_in_one_line_and_leaves_nothing_behind(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHON": "/bin/false"}
    finished = subprocess.run([copy_of_setup(tmp_path)], env=environment, capture_output=True, text=True)
    assert finished.returncode == 1
    assert finished.stderr == ("script/setup: PYTHON=/bin/false does not run or is not Python 3.11 or newer\n")
    assert not (tmp_path / ".venv").exists()


def test_setup_accepts_the_pythons_that_the_package_and_its_classifiers_do() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    lowest, classifiers = project["requires-python"].removeprefix(">="), project["classifiers"]
    assert f"sys.version_info < ({lowest.replace('.', ', ')})" in SETUP.read_text()
    assert lowest == KNOWN_PYTHONS[-1]
    named = [text.rpartition(" ")[2] for text in classifiers if text.startswith("Programming Language :: Python :: 3.")]
    assert named == KNOWN_PYTHONS[::-1]


@pytest.mark.parametrize(
    ("there", "taken"),
    [
        (("python3.15", "python3.14", "python3.11", "python3"), "python3.14"),  # python3 is 3.15
        (("python3.15", "python3.12", "python3"), "python3.12"),
        (("python3.15", "python3"), "python3"),
        (("python3.10",), ""),
    ],
)
def test_setup_takes_the_newest_python_that_it_knows(there: tuple[str, ...], taken: str, tmp_path: Path) -> None:
    """A Python that is too new for the libraries is taken only where there is no other."""
    for name in there:
        python = tmp_path / name
        python.write_text(f"#!/bin/sh\n{'exit 1' if name == 'python3.10' else ''}\n")
        python.chmod(0o755)
    text = SETUP.read_text()
    parts = [re.search(r"^readonly known_pythons=.*$", text, re.MULTILINE)[0]]
    for function in ("right_version", "can_make_venv", "find_python"):
        parts.append(re.search(rf"^{function}\(\) {{.*?^}}", text, re.DOTALL | re.MULTILINE)[0])
    command = ["/bin/bash", "-c", "\n".join([*parts, "find_python"])]
    found = subprocess.run(command, env={"PATH": str(tmp_path)}, capture_output=True, text=True, check=False)
    assert found.stdout.strip() == (str(tmp_path / taken) if taken else "")
    assert (found.returncode == 0) == bool(taken)


def test_setup_looks_for_the_browsers_that_the_tests_do() -> None:
    assert f"${{CHROMIUM:-{' '.join(browser.NAMES)}}}" in (REPOSITORY / "script" / "setup").read_text()


def browsers_found(folder: Path, **environment: str) -> bool:
    """What setup's own `has_browser` says with nothing else on the path than a folder."""
    text = (REPOSITORY / "script" / "setup").read_text()
    function = re.search(r"^has_browser\(\) \{.*?^\}", text, re.DOTALL | re.MULTILINE)[0]
    command = ["/bin/bash", "-c", f"{function}\nhas_browser"]
    return subprocess.run(command, env={"PATH": str(folder), **environment}, check=False).returncode == 0


def test_setup_takes_a_browser_that_runs_and_no_stub(tmp_path: Path) -> None:
    assert not browsers_found(tmp_path)
    stub = tmp_path / "chromium"
    stub.write_text("#!/bin/sh\necho install the snap >&2; exit 1\n")
    stub.chmod(0o755)
    assert not browsers_found(tmp_path)
    other = tmp_path / "mine"
    other.write_text("#!/bin/sh\necho Chromium 100\n")
    other.chmod(0o755)
    assert browsers_found(tmp_path, CHROMIUM=str(other))
    stub.write_text(other.read_text())
    assert browsers_found(tmp_path)
