"""Shells complete commands, options, values and scenes; everything else they complete as files."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.test_help import HEAVY

SCRIPT = f"""import json, os, sys; sys.argv = ['modsim3d']
from modsim3d.cli.main import main
for environment in json.load(sys.stdin):
    print(end='', flush=True)
    if os.fork() == 0:
        os.environ.update(environment)
        try: main()
        except SystemExit: pass
        print(*(name for name in {HEAVY!r} if name in sys.modules), end='', file=sys.stderr)
        print(end='\\0', flush=True)
        os._exit(0)
    os.wait()"""
"""Answers each completion in a fork of a process that has imported the command line and nothing else."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("strange.yaml", "simple.json", "sea.txt"):
        (tmp_path / name).touch()
    (tmp_path / "scenes").mkdir()
    return tmp_path


def completions(folder: Path, *asked: tuple[str, ...]) -> list[list[str]]:
    """Words that shells in a folder offer for the last of each shell's words after `modsim3d`, as its script asks."""
    environments = [
        {
            "_MODSIM3D_COMPLETE": f"complete_{shell}",
            "COMP_WORDS": "\n".join(["modsim3d", *words]),
            "COMP_CWORD": str(len(words)),
            "_TYPER_COMPLETE_ARGS": " ".join(["modsim3d", *words]),
            "_TYPER_COMPLETE_FISH_ACTION": "get-args",
        }
        for shell, *words in asked
    ]
    command = [sys.executable, "-c", SCRIPT]
    text, options = json.dumps(environments), {"capture_output": True, "text": True, "timeout": 120, "check": True}
    done = subprocess.run(command, input=text, cwd=folder, **options)
    assert done.stderr.strip() == "", "loaded for a completion"
    *answers, rest = done.stdout.split("\0")
    assert rest == "" and len(answers) == len(asked)
    return [answer.split("\n") if answer.strip() else [] for answer in answers]


def test_commands_options_values_and_scenes_are_completed_and_files_left_to_the_shell(folder: Path) -> None:
    line = ("bash", "run", "strait")
    asked = [("bash", "run", "s"), ("bash", ""), (*line, "--det"), (*line, "--source", "r")]
    asked += [("zsh", "run", "st"), ("fish", "run", "st"), ("bash", "track", "run", "--tracker", "s")]
    paths = [("run", "sc"), ("run", "scenes/"), ("check", "run", ""), ("run", "x", "--out", "")]
    shells = [(shell, *each) for shell in ("bash", "zsh", "fish") for each in paths]
    scenes, commands, options, values, zsh, fish, trackers, *files = completions(folder, *asked, *shells)
    shipped = ["simulation_1", "simulation_2", "simulation_3", "strait"]
    assert [word for word in scenes if word] == [*shipped, "simple.json", "strange.yaml"]
    assert {"run", "learn", "scenes"} <= set(commands)
    assert "--detector-seed" in options and "rectangles" in values
    assert any("strait" in line for line in zsh) and "strait" in fish
    assert [word for word in trackers if word] == ["sort", "stonesoup_gnn", "stonesoup_jpda"]
    assert [first[:1] for first in files] == [[]] * 4 + [["_files"]] * 4 + [[]] * 4


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
    line, environment = ["bash", "--norc", "-c", lines, str(program)], {**os.environ, **SHELL_IS_NAMED}
    done = subprocess.run(line, capture_output=True, text=True, timeout=240, check=True, cwd=folder, env=environment)
    offered, registered = done.stdout.strip().split("\n")
    assert offered == "simulation_1 simulation_2 simulation_3"
    assert registered == "complete -o default -F _modsim3d_completion modsim3d"


@pytest.mark.parametrize(("shell", "file"), [("bash", ".bashrc"), ("zsh", ".zshrc"), ("fish", ".config/fish")])
def test_completion_is_installed_for_each_shell(tmp_path: Path, shell: str, file: str) -> None:
    line = [sys.executable, "-m", "modsim3d", "--install-completion", shell]
    environment = {**os.environ, **SHELL_IS_NAMED, "HOME": str(tmp_path)}
    subprocess.run(line, capture_output=True, timeout=120, check=True, env=environment)
    assert (tmp_path / file).exists()
    script = next(path for path in tmp_path.rglob("*modsim3d*") if path.is_file()).read_text()
    assert f"_MODSIM3D_COMPLETE=complete_{shell}" in script
