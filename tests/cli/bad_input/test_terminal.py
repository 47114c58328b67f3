"""What inputs hold reaches a terminal as plain text, whatever the terminal's encoding, and whatever memory is left."""

import io
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from modsim3d.cli import terminal
from modsim3d.cli.shared import print_line, progress
from modsim3d.cli.terminal_tables import print_table
from tests.cli.bad_input.builders import Call, Inputs, refusal

HOSTILE = "a\x1b[2J\r\x07\x9b1m\u202eb[/bold] :smile: [red]c"
SHOWN = r"a\x1b[2J\r\x07\x9b1m\u202eb[/bold] :smile: [red]c"
CONTROL = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e]")


def test_control_characters_of_names_values_and_arguments_are_shown_and_not_obeyed(inputs: Inputs, call: Call) -> None:
    for file, path, value in [
        ("scene", "vessels", f"{HOSTILE}.json"),
        ("poses", "2.0/vehicle2/heading_rad", HOSTILE),
        ("scene", "poses/file", f"{HOSTILE}\nx.json"),
        ("scene", "detector", f"{HOSTILE}.yaml"),
    ]:
        inputs.set(file, path, value)
    inputs.data["scene"][HOSTILE] = 1
    said = refusal(call, ("check", "scene", inputs.write()))
    for part in (f"{SHOWN}: unknown key", f"{SHOWN}.json: no such file", f"{SHOWN}.yaml: no such", rf"{SHOWN}\nx.json"):
        assert part in said
    for arguments in (("check", "scene", HOSTILE), ("check", "scene", "x", HOSTILE), ("run", "x", f"--{HOSTILE}")):
        said += refusal(call, arguments)
    assert not CONTROL.search(said)


def test_an_argument_that_is_not_utf_8_is_refused(call: Call, tmp_path: Path) -> None:
    name = os.fsdecode(b"x\xff")
    for line in (("check", "scene", tmp_path / f"{name}.yaml"), ("run", "harbour", "--out", tmp_path / name)):
        refusal(call, line, r"x\udcff", "is not UTF-8")
    assert not list(tmp_path.iterdir())


def test_lines_tables_and_bars_show_text_as_it_is_in_the_colours_of_the_commands(monkeypatch) -> None:
    file, err, colours = io.StringIO(), io.StringIO(), io.StringIO()
    console = terminal.open_console(file=file, width=200, force_terminal=False)
    print_line(console, HOSTILE)
    print_table(console, HOSTILE, [(HOSTILE, "1")])
    said = file.getvalue()
    assert not CONTROL.search(said) and said.count(SHOWN) == 3
    monkeypatch.setattr(sys, "stderr", err)
    with progress(HOSTILE, 1) as advance:
        advance(1)
    assert not CONTROL.search(err.getvalue()) and "[/bold]" in err.getvalue()
    console = terminal.open_console(file=colours, width=80, force_terminal=True, color_system="standard")
    print_line(console, "a\x1b[2Jb", "bold red")
    assert colours.getvalue().startswith("\x1b[1;31ma\\x1b[2Jb\x1b[0m")


def process(*arguments: object, prefix: str = "", program: object = None, **environment: str) -> Any:
    command = [program] if program else [sys.executable, "-m", "modsim3d.cli.main"]
    shell = ["sh", "-c", f'{prefix} exec "$@"', "sh", *command, *map(str, arguments)]
    return subprocess.run(shell, capture_output=True, timeout=120, env={**os.environ, **environment}, check=False)


@pytest.mark.parametrize("encoding", ["latin-1", "ascii", "cp437"])
def test_any_encoding_of_the_output_will_do(inputs, call, prepared, tmp_path, encoding):
    run = tmp_path / "rün"
    assert call("run", inputs.write(), "--out", run, "--no-sheet")[0] == 0
    done = process("check", "run", run, program=prepared, PYTHONIOENCODING=encoding)
    assert done.returncode in (0, 1) and b"Traceback" not in done.stderr
    assert b"Performance state" in done.stdout
    assert process("scenes", PYTHONIOENCODING=encoding).returncode == 0


def test_too_little_address_space_is_one_line() -> None:
    for megabytes in (50, 400):
        done = process("check", "scene", "simulation_1", prefix=f"ulimit -v {megabytes * 1024};")
        limited = f"modsim3d: the address space is limited to {megabytes} MB (ulimit -v): "
        told = f"{limited}at least 1024 MB are needed to load the libraries\n"
        assert (done.returncode, done.stderr.decode()) == (2, told)


def test_lack_of_memory_and_of_libraries_is_one_line(call, monkeypatch):
    for error, part in (
        (MemoryError(), "modsim3d: there is not enough memory"),
        (ImportError("libx.so: failed to map segment"), "modsim3d: a library cannot be loaded: libx.so: failed to map"),
    ):

        def fail(*_: object, error: Exception = error, **__: object) -> None:
            raise error

        monkeypatch.setattr("modsim3d.scene.reading.load_scene", fail)
        said = refusal(call, ("check", "scene", "simulation_1"))
        assert said.startswith(part) and said.count("\n") == 1
