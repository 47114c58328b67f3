"""Commands and Python of README and the pages of docs run as printed, in order, each page in an empty folder; and files
that they name are there."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
import typer

from modsim3d.cli.main import app

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FENCE = re.compile(r"^(?P<lead>[^\n]*)\n\n?```(?P<language>\w*)\n(?P<text>.*?)^```$", flags=re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"^(?:\w+ \| )?modsim3d (?!:)(.*)$", flags=re.MULTILINE)
SAVED = re.compile(r"[Ss]ave this as `([^`]+)`")
MAX_S = 240
SUMMARY = "frames "
"""How the summary of a run begins: what a page shows of one is what its commands print."""


def blocks(page):
    """Language, text and, where the line above says so, the file in which a reader saves it."""
    for found in FENCE.finditer(page.read_text(encoding="utf-8")):
        saved = SAVED.search(found["lead"])
        yield found["language"], found["text"], Path(saved[1]) if saved else None


def run_shell(text, folder, prepared):
    path = os.pathsep.join([str(prepared.parent), str(Path(sys.executable).parent), os.environ["PATH"]])
    options = {"cwd": folder, "env": {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT), "COLUMNS": "100"}}
    command = ["bash", "-euo", "pipefail", "-c", text]
    finished = subprocess.run(command, capture_output=True, text=True, timeout=MAX_S, **options)
    assert finished.returncode == 0, f"{text}\n{finished.stdout}\n{finished.stderr}"
    return finished.stdout


RUN = [page for page in PAGES if page.stem != "python"]  # which tests/api/test_names.py runs


@pytest.mark.parametrize("page", RUN, ids=lambda page: page.stem)
def test_a_page_runs_as_printed(page, tmp_path, monkeypatch, prepared):
    monkeypatch.chdir(tmp_path)
    names, said = {"__name__": "__main__"}, ""
    for language, text, file in blocks(page):
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
        elif language == "bash":
            said += run_shell(text, tmp_path, prepared)
        elif language == "text" and text.startswith(SUMMARY):
            shown, printed = ({" ".join(line.split()) for line in lines.splitlines()} for lines in (text, said))
            assert shown <= printed
        elif language == "python":
            exec(compile(text, str(page), "exec"), names)


def test_commands_that_are_shown_and_not_run_are_taken():
    known = typer.main.get_command(app).commands
    for page in (*PAGES, ROOT / "CONTRIBUTING.md"):
        for text in (text.replace("\\\n", " ") for language, text, _ in blocks(page) if language in ("text", "sh")):
            for name, *arguments in (shlex.split(found, comments=True) for found in COMMAND.findall(text)):
                assert name in known, page
                known[name].make_context(name, arguments)


def test_no_command_of_a_page_is_left_out():
    """Commands stand in bash fences; sh is for the scripts of the repository and for installing."""
    for page in PAGES:
        prose = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
        assert not re.findall(r"^(?: {4}|\t)(?:\S+ \| )?(?:modsim3d|pip|python) .*", prose, flags=re.MULTILINE), page
        for language, text, file in blocks(page):
            assert language or file, f"{page}: a fence without a language: {text[:60]}"
            if language == "sh":
                assert all(re.match(r"(script/|pip install |\s*#|$)", line) for line in text.splitlines()), text


def test_files_and_rooms_that_documents_name_are_there() -> None:
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *ROOT.glob("docs/*.md")]
    readme, contributing, *docs = (page.read_text(encoding="utf-8") for page in pages)
    named = set(re.findall(r"`((?:[a-z_]+/)+(?:[a-z_]+\.(?:py|md))?|[a-z_]+\.py)`", contributing))
    assert len(named) > 30
    named |= {*re.findall(r"\]\(([^)#:]+)\)", readme)}
    named |= {name for text in (readme, contributing, *docs) for name in re.findall(r"modsim3d/[\w/]+\.\w+", text)}
    missing = [name for name in named if not any((ROOT / top / name).exists() for top in ("", "modsim3d"))]
    assert not missing


def test_the_tables_of_rooms_are_those_of_the_contract() -> None:
    """What `script/make_rooms` writes is there already."""
    path = ROOT / "script" / "make_rooms"
    module = ModuleType("make_rooms")
    module.__file__ = str(path)
    exec(compile(path.read_text(encoding="utf-8"), path, "exec"), vars(module))
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert module.page(text) == text
    assert all(f"`{each.parent.name}/`" in text for each in (ROOT / "modsim3d").glob("*/__init__.py"))
