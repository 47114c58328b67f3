"""Shells complete commands, options, values and scenes; everything else they complete as files."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.commands.test_help import HEAVY

SCRIPT = f"""import sys; sys.argv = ['modsim3d']
from modsim3d.cli import main
try: main()
except SystemExit: pass
print(*(name for name in {HEAVY!r} if name in sys.modules), file=sys.stderr)"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("strange.yaml", "simple.json", "sea.txt"):
        (tmp_path / name).touch()
    (tmp_path / "scenes").mkdir()
    return tmp_path


def complete(folder: Path, shell: str, *words: str) -> list[str]:
    """What a shell is told to offer for the last of some words, through the protocol of its script."""
    line = " ".join(words)
    environment = {
        **os.environ,
        "_MODSIM3D_COMPLETE": f"complete_{shell}",
        "COMP_WORDS": "\n".join(words),
        "COMP_CWORD": str(len(words) - 1),
        "_TYPER_COMPLETE_ARGS": line,
        "_TYPER_COMPLETE_FISH_ACTION": "get-args",
    }
    command = [sys.executable, "-c", SCRIPT]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True, cwd=folder, env=environment)
    assert done.stderr.strip() == "", "loaded for a completion"
    return done.stdout.split("\n") if done.stdout.strip() else []


def test_scene_completes_shipped_names_and_scene_files(folder: Path) -> None:
    offered = [word for word in complete(folder, "bash", "modsim3d", "run", "s") if word]
    assert offered == ["simulation_1", "simulation_2", "simulation_3", "strait", "simple.json", "strange.yaml"]


@pytest.mark.parametrize("words", [("run", "sc"), ("run", "scenes/"), ("verify", ""), ("run", "x", "--out", "")])
def test_the_shell_itself_completes_files_and_folders(folder: Path, words: tuple[str, ...]) -> None:
    assert complete(folder, "bash", "modsim3d", *words) == []
    assert complete(folder, "zsh", "modsim3d", *words)[0] == "_files"
    assert complete(folder, "fish", "modsim3d", *words) == []


def test_commands_options_and_values_are_completed(folder: Path) -> None:
    assert {"run", "learn", "scenes"} <= set(complete(folder, "bash", "modsim3d", ""))
    assert "--detector-seed" in complete(folder, "bash", "modsim3d", "run", "strait", "--det")
    assert "rectangles" in complete(folder, "bash", "modsim3d", "run", "strait", "--source", "r")
    assert any("strait" in line for line in complete(folder, "zsh", "modsim3d", "run", "st"))
    assert "strait" in complete(folder, "fish", "modsim3d", "run", "st")


def test_names_of_trackers_are_completed(folder: Path) -> None:
    offered = complete(folder, "bash", "modsim3d", "track", "run", "--tracker", "s")
    assert [word for word in offered if word] == ["sort", "stonesoup_gnn", "stonesoup_jpda"]


SHELL_IS_NAMED = {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1", "PYTHONPATH": str(Path(__file__).parents[2])}
"""Options that show and install completion take the shell's name, in place of the shell that they were started from."""


def test_bash_completes_with_the_script_that_is_shown(folder: Path) -> None:
    program = folder / "modsim3d"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m modsim3d "$@"\n')
    program.chmod(0o755)
    lines = """
        source <("$0" --show-completion bash)
        COMP_WORDS=(modsim3d run simulation) COMP_CWORD=2
        _modsim3d_completion "$0"
        echo "${COMPREPLY[@]}"
        complete -p modsim3d
    """
    done = subprocess.run(
        ["bash", "--norc", "-c", lines, str(program)],
        capture_output=True,
        text=True,
        timeout=240,
        check=True,
        cwd=folder,
        env={**os.environ, **SHELL_IS_NAMED},
    )
    offered, registered = done.stdout.strip().split("\n")
    assert offered == "simulation_1 simulation_2 simulation_3"
    assert registered == "complete -o default -F _modsim3d_completion modsim3d"


@pytest.mark.parametrize(("shell", "file"), [("bash", ".bashrc"), ("zsh", ".zshrc"), ("fish", ".config/fish")])
def test_completion_is_installed_for_each_shell(tmp_path: Path, shell: str, file: str) -> None:
    subprocess.run(
        [sys.executable, "-m", "modsim3d", "--install-completion", shell],
        capture_output=True,
        timeout=120,
        check=True,
        env={**os.environ, **SHELL_IS_NAMED, "HOME": str(tmp_path)},
    )
    assert (tmp_path / file).exists()
    script = next(path for path in tmp_path.rglob("*modsim3d*") if path.is_file()).read_text()
    assert f"_MODSIM3D_COMPLETE=complete_{shell}" in script
