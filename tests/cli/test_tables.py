"""Tables lose no column and break no word, at any width and in a pipe."""

import io
import itertools
import os
import pty
import re
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from modsim3d.cli.shared import print_path
from modsim3d.cli.terminal import open_console
from modsim3d.cli.terminal_tables import print_prose, print_table

CELLS = st.text("ab1/._-é漢 ", max_size=30).map(lambda text: " ".join(text.split()))


def printed(width: int, *arguments: object, **options: object) -> list[str]:
    file = io.StringIO()
    print_table(open_console(file=file, width=width), *arguments, **options)  # type: ignore[arg-type]
    return file.getvalue().splitlines()


@given(
    st.integers(2, 4).flatmap(lambda count: st.lists(st.tuples(*[CELLS] * count), min_size=1, max_size=4)),
    st.integers(10, 120),
    st.booleans(),
)
def test_every_word_of_every_cell_is_printed_whole_and_in_order(rows, width, with_header):
    header = tuple(f"n{place}" for place in range(len(rows[0]))) if with_header else ()
    lines = printed(width, "", rows, header=header)
    words = "\n".join(lines).split()
    for row in rows:
        for cell in row:
            for word in cell.split():
                assert word in words
    assert not any(line.endswith(" ") for line in lines)


def test_a_file_name_and_a_number_are_never_broken() -> None:
    name = "/a/very/long/path/" + "x" * 90 + "/scene.yaml"
    rows = [(name, "0.2111 … 1", "some words that explain what this is about, at length"), ("b", "2", "c")]
    for width, header in itertools.product((40, 60, 80, 120, 200), ((), ("file", "interval", "meaning"))):
        text = "\n".join(printed(width, "title", rows, header=header))
        assert name in text and "0.2111 … 1" in text, (width, header)


def test_columns_stand_one_below_the_other_and_what_does_not_fit_below_its_row_with_their_names() -> None:
    lines = printed(40, "title", [("a", "1"), ("long", "22")], header=("name", "number"), right=(1,))
    assert lines == ["", "title", "name  number", "a          1", "long      22"]
    rows = [("parameter_with_a_name", "0.99", "0.2 … 1", "obeys"), ("other", "1", "–", "DIFFERS")]
    lines = printed(36, "", rows, header=("parameter", "asked", "interval", "verdict"), at_edge=3)
    assert lines[:2] == ["parameter_with_a_name          obeys", "    asked 0.99  interval 0.2 … 1"]
    assert lines[2:] == ["other                        DIFFERS", "    asked 1"]
    header = ("camera", "frames", "false\nalarms")  # whose lines stand on one below a row
    lines = printed(22, "", [("bow", "40", "10")], header=header)
    assert lines == ["camera  frames  false", "                alarms", "bow     40      10"]
    lines = printed(22, "", [("a_long_name", "40", "10")], header=header)
    assert lines == ["a_long_name", "    frames 40", "    false alarms 10"]
    rows = [("visible", "all", "10"), ("", "half", "2")]  # neither a line nor a space for what has no name
    lines = printed(16, "", rows, header=("by", "", "recall of boxes"))
    assert lines == ["visible", "    all", "    recall of", "    boxes 10", "    half", "    recall of", "    boxes 2"]
    rows = [("state", "0.5 [0.1, 0.9]", "0.6 [0.2, 0.8]")]  # cells are broken where they may be before rows are
    lines = printed(29, "", rows, header=("", "recall", "F1"), breaks=[lambda cell: cell.replace(" [", "\n[")])
    assert lines == ["       recall      F1", "state  0.5         0.6", "       [0.1, 0.9]  [0.2, 0.8]"]


@pytest.mark.parametrize("width", [60, 80, 120, None])
def test_verify_has_every_number_at_any_width(modsim3d, monkeypatch, run, tmp_path, width):
    if width:
        monkeypatch.setenv("COLUMNS", str(width))
    out = modsim3d("check", "run", run, "--out", tmp_path).out
    monkeypatch.delenv("COLUMNS", raising=False)
    table = modsim3d("check", "run", run, "--out", tmp_path, "--overwrite").out
    assert re.search(r"parameter +asked +measured +interval +noticed from +verdict", table)
    for word in table.split("\n\nwritten")[0].split():
        assert word in out or word in ("–", "parameter", "verdict")  # the verdict itself stands at the edge
    if width:
        assert max(len(line) for line in out.split("\nwritten")[0].splitlines()) <= width
    else:
        assert out == table


@pytest.mark.parametrize("width", [40, 70])
def test_an_error_on_a_terminal_is_broken_between_words(prepared: Path, width: int) -> None:
    command = [prepared, "check", "scene", "nowhere/at_all/in_this_folder.yaml"]
    ours, theirs = pty.openpty()
    environment = {**os.environ, "COLUMNS": str(width), "TERM": "xterm"}
    done = subprocess.run(command, stderr=theirs, timeout=120, check=False, env=environment)
    os.close(theirs)
    said = os.read(ours, 10_000).decode().replace("\r\n", "\n")
    os.close(ours)
    assert done.returncode == 2
    lines = said.splitlines()
    assert max(map(len, lines)) <= width and len(lines) > 2
    for word in ("nowhere/at_all/in_this_folder.yaml:", "simulation_1,", "simulation_2,", "strait)"):
        assert word in said.split()


def test_an_error_in_a_pipe_is_not_broken_whatever_columns_says(modsim3d, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    assert modsim3d("check", "scene", "nowhere.yaml").err.count("\n") == 2


def test_a_long_path_stands_on_a_line_of_its_own_and_prose_is_broken_between_words() -> None:
    file, path = io.StringIO(), Path("a_folder/" * 8)
    console = open_console(file=file, width=60)
    print_path(console, "run directory", Path("runs/first"))
    print_path(console, "run directory", path)
    print_prose(open_console(file=file, width=20), "the file /a/b/c/d/e/f/g/h.yaml is well", indent=2)
    prose = "  the file\n  /a/b/c/d/e/f/g/h.yaml\n  is well\n"
    assert file.getvalue() == f"run directory  runs/first\nrun directory\n{path}\n{prose}"
