"""Help that can be read alone, everywhere, at 80 columns, and without loading what the work needs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any, get_type_hints

import pytest
import typer

from modsim3d.cli.main import COMMANDS, app
from modsim3d.learn.model_selection import RICHER
from tests.cli.conftest import Modsim3d

GROUP: Any = typer.main.get_command(app)
OPTIONS = [
    (name, parameter)
    for name, command in GROUP.commands.items()
    for parameter in command.params
    if parameter.name != "help"
]
HEAVY = ("numpy", "scipy", "pyarrow", "OpenGL", "matplotlib", "PIL", "trimesh", "shapely", "pyrender")


@pytest.mark.parametrize("flag", ["-h", "--help"])
@pytest.mark.parametrize("name", ["", *GROUP.commands])
def test_every_command_has_help(modsim3d: Modsim3d, monkeypatch: pytest.MonkeyPatch, name: str, flag: str) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    said = modsim3d(*filter(None, [name]), flag)
    assert (said.status, said.err) == (0, "")
    assert "Usage: modsim3d" in said.out
    assert "<bool>" not in said.out
    assert max(map(len, said.out.splitlines())) <= 80


@pytest.mark.parametrize(("command", "parameter"), OPTIONS, ids=[f"{name} {p.name}" for name, p in OPTIONS])
def test_the_help_of_an_option_can_be_read_alone(command: str, parameter: Any) -> None:
    words = (parameter.help or "").rstrip(".").split()
    assert parameter.help.endswith(".")
    assert len(words) >= 3
    assert words[0] not in ("Of", "For", "The", "May", "In", "When", "Also", "Added") or parameter.name == "verbose"


def test_learn_names_every_model_that_can_be_left_out() -> None:
    (said,) = (p.help for name, p in OPTIONS if (name, p.name) == ("learn", "without"))
    assert said.partition(": ")[2].rstrip(".").split(", ") == list(RICHER)


def test_options_that_are_called_as_what_they_take_say_their_name() -> None:
    """Typer 0.27 takes the metavar for the name of an option without one: `--SOURCE` for `--source`."""
    unnamed = []
    for _, name, command, _ in COMMANDS:
        for parameter, hint in get_type_hints(command, include_extras=True).items():
            for option in getattr(hint, "__metadata__", ()):
                # In an annotation typer keeps the first name of an option in the place of its default.
                if isinstance(option, typer.models.OptionInfo) and not isinstance(option.default, str):
                    unnamed += [f"{name} --{parameter}"] if option.metavar == parameter.upper() else []
    assert unnamed == []


def test_out_has_one_meaning() -> None:
    metavars = {name: p.metavar for name, p in OPTIONS if p.name == "out"}
    folders = dict.fromkeys(
        ("run", "detect", "ais", "compare", "verify", "export", "track", "score", "campaign"), "DIR"
    )
    assert metavars == {
        **folders,
        **dict.fromkeys(("learn", "guess", "report", "rerun", "view", "campaign-table", "campaign-report"), "FILE"),
        "campaign-run": "RUN",
    }


def test_the_root_help_has_every_command_on_one_line_of_80_columns(
    modsim3d: Modsim3d, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = modsim3d("-h").out.splitlines()
    for panel, name, _, short_help in COMMANDS:
        assert any(line.strip("│ ").split(maxsplit=1) == [name, short_help] for line in lines), name
        assert any(line.startswith(f"╭─ {panel} ─") for line in lines)
    examples = [line for line in lines if line.startswith(" modsim3d ")]
    assert len(examples) == 5


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
    assert done.returncode == 2
    assert "Usage: python -m modsim3d run " in done.stderr
    assert "harbour" in python_m("scenes").stdout
