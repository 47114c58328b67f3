"""Help that can be read alone at 80 columns, completion in shells, without loading what the work needs."""

import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_type_hints

import pytest
import typer

from modsim3d.cli.main import COMMANDS, GROUPS, OLD_NAMES, app
from modsim3d.learn.learned_detector import RICHER
from tests.cli.conftest import Modsim3d

GROUP: Any = typer.main.get_command(app)


def leaves(group: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Each command by the words that name it."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from leaves(command, f"{path}{name} ")
        else:
            yield f"{path}{name}", command


LEAVES = dict(leaves(GROUP))
OPTIONS = [(name, each) for name, command in LEAVES.items() for each in command.params if each.name != "help"]
HEAVY = ("numpy", "scipy", "pyarrow", "OpenGL", "matplotlib", "PIL", "trimesh", "shapely", "pyrender")


def test_every_command_and_group_has_help_and_the_root_has_a_line_for_each(modsim3d: Modsim3d, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for name in ("", *GROUPS, *LEAVES):
        said = modsim3d(*name.split(), "-h")
        assert (said.status, said.err) == (0, ""), name
        assert said == modsim3d(*name.split(), "--help") and "Usage: modsim3d" in said.out
        assert "<bool>" not in said.out
        assert max(map(len, said.out.splitlines())) <= 80, name
    for name in ("", *GROUPS):
        said = modsim3d(*name.split())
        assert said.status == 2 and "Usage: modsim3d" in said.out + said.err
        assert " -h " in said.out + said.err
    lines = modsim3d("-h").out.splitlines()
    shown = [(panel, name, text) for panel, name, _, text in COMMANDS if " " not in name]
    for panel, name, short_help in (*shown, *((panel, name, text) for name, (panel, text) in GROUPS.items())):
        assert any(line.strip("│ ").split(maxsplit=1) == [name, short_help] for line in lines), name
        assert any(line.startswith(f"╭─ {panel} ─") for line in lines)
    examples = [line for line in lines if line.startswith(" modsim3d ")]
    assert len(examples) == 5


def options_by_name() -> dict[str, dict[str, Any]]:
    """Options by their long name, and by command."""
    found: dict[str, dict[str, Any]] = {}
    for command, parameter in OPTIONS:
        if parameter.param_type_name == "option":
            found.setdefault(max(parameter.opts, key=len), {})[command] = parameter
    return found


def test_commands_and_options_are_few_and_the_help_of_each_means_the_same_in_every_command():
    assert len(GROUP.commands) <= 16 and len(options_by_name()) <= 95
    counts = Counter(name for commands in options_by_name().values() for name in commands)
    assert {name for name, count in counts.items() if count > 20 and not name.startswith("learn")} == set()
    # It takes the same kind of value, and its help begins with the same word; `--out` has a test of its own.
    for name, parameter in OPTIONS:
        words = (parameter.help or "").rstrip(".").split()
        assert parameter.help.endswith(".") and len(words) >= 3, (name, parameter.name)
        strange = words[0] in ("Of", "For", "The", "May", "In", "When", "Also", "Added")
        assert not strange or parameter.name == "verbose", (name, parameter.name)
    for name, commands in options_by_name().items():
        first = {(parameter.help or "").split()[0].rstrip(",:") for parameter in commands.values()}
        taken = {parameter.metavar or "" for parameter in commands.values()}
        assert (len(first), len(taken)) == (1, 1) or name == "--out", (name, first, taken)


def test_an_old_name_answers_with_a_new_one_which_takes_neither_the_old_options_nor_a_misspelt_name(modsim3d) -> None:
    for old, new in OLD_NAMES.items():
        said = modsim3d(*old.split(" ")[:1], "x", *old.split(" ")[1:], "y")
        told = f"modsim3d: modsim3d {old} is {f'now: modsim3d {new}' if new else 'no more'}\n"
        assert said == (2, "", told)
        words = new.split()
        assert not new or any(name.split() == words[: len(name.split())] for name in LEAVES), old
        for option in (word for word in words if word.startswith("--")):
            assert option in options_by_name(), old
    said = modsim3d("view", "film", "run", "--visibility=800")
    new = "modsim3d: modsim3d view --visibility is now: modsim3d view film --look fog:M\n"
    assert (said.status, said.err) == (2, new)
    said = modsim3d("campaign", "example", "--out", "folder")
    assert (said.status, said.err) == (2, "modsim3d: modsim3d campaign is now: modsim3d campaign run CAMPAIGN\n")
    said = modsim3d("campaign", "stauts", "runs/example")
    assert said.status == 2 and "status" in said.err and "is now" not in said.err


def test_out_has_one_meaning_options_say_their_name_and_learn_names_what_can_be_left_out() -> None:
    (said,) = (p.help for name, p in OPTIONS if (name, p.name) == ("learn", "without"))
    assert said.partition(": ")[2].rstrip(".").split(", ") == list(RICHER)
    metavars = {name: p.metavar for name, p in OPTIONS if p.name == "out"}
    folders = ("run", "detect", "ais", "check truth", "check run", "export", "track", "score", "campaign run")
    files = ("learn", "learn-voyage", "report", "view film", "view frame", "view map", "campaign table")
    files += ("campaign report", "check scene")
    assert metavars == {**dict.fromkeys(folders, "DIR"), **dict.fromkeys(files, "FILE"), "campaign reproduce": "RUN"}
    # Typer 0.27 takes the metavar for the name of an option without one: `--SOURCE` for `--source`.
    unnamed = []
    for _, name, command, _ in COMMANDS:
        for parameter, hint in get_type_hints(command, include_extras=True).items():
            for option in getattr(hint, "__metadata__", ()):
                # In an annotation typer keeps the first name of an option in the place of its default.
                if isinstance(option, typer.models.OptionInfo) and not isinstance(option.default, str):
                    unnamed += [f"{name} --{parameter}"] if option.metavar == parameter.upper() else []
    assert unnamed == []


@pytest.mark.parametrize("arguments", [["-h"], ["run", "-h"], ["--version"], []])
def test_help_loads_nothing_that_the_work_needs(arguments: list[str]) -> None:
    script = (
        f"import sys; sys.argv = ['modsim3d', *{arguments!r}]\n"
        "from modsim3d.cli.main import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        f"print(*(name for name in {HEAVY!r} if name in sys.modules), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=True)
    assert done.stderr.strip() == ""


def test_python_dash_m_is_the_command_line(tmp_path: Path) -> None:
    def python_m(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "modsim3d", *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, cwd=tmp_path)

    assert "Usage: python -m modsim3d [OPTIONS]" in python_m("-h").stdout
    done = python_m("run")
    assert done.returncode == 2 and "Usage: python -m modsim3d run " in done.stderr
    assert "harbour" in python_m("scenes").stdout


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


def test_commands_values_and_scenes_are_completed_and_bash_does_it_with_the_script_that_is_shown(folder):
    line = ("bash", "run", "strait")
    asked = [("bash", "run", "s"), ("bash", ""), (*line, "--det"), (*line, "--source", "r")]
    asked += [("zsh", "run", "st"), ("fish", "run", "st"), ("bash", "track", "run", "--tracker", "s")]
    paths = [("run", "sc"), ("run", "scenes/"), ("check", "run", ""), ("run", "x", "--out", "")]
    shells = [(shell, *each) for shell in ("bash", "zsh", "fish") for each in paths]
    scenes, commands, options, values, zsh, fish, trackers, *files = completions(folder, *asked, *shells)
    shipped = ["simulation_1", "simulation_2", "simulation_3", "small_target", "strait"]
    assert [word for word in scenes if word] == [*shipped, "simple.json", "strange.yaml"]
    assert {"run", "learn", "scenes"} <= set(commands)
    assert "--detector-seed" in options and "rectangles" in values
    assert any("strait" in line for line in zsh) and "strait" in fish
    assert [word for word in trackers if word] == ["sort", "stonesoup_gnn", "stonesoup_jpda"]
    assert [first[:1] for first in files] == [[]] * 4 + [["_files"]] * 4 + [[]] * 4
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


SHELL_IS_NAMED = {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1", "PYTHONPATH": str(Path(__file__).parents[2])}
"""Options that show and install completion take the shell's name, in place of the shell that they were started from."""


@pytest.mark.parametrize(("shell", "file"), [("bash", ".bashrc"), ("zsh", ".zshrc"), ("fish", ".config/fish")])
def test_completion_is_installed_for_each_shell(tmp_path: Path, shell: str, file: str) -> None:
    line = [sys.executable, "-m", "modsim3d", "--install-completion", shell]
    environment = {**os.environ, **SHELL_IS_NAMED, "HOME": str(tmp_path)}
    subprocess.run(line, capture_output=True, timeout=120, check=True, env=environment)
    assert (tmp_path / file).exists()
    script = next(path for path in tmp_path.rglob("*modsim3d*") if path.is_file()).read_text()
    assert f"_MODSIM3D_COMPLETE=complete_{shell}" in script
