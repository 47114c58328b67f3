"""The Python of docs/python.md runs from top to bottom in an empty folder."""

import re
import subprocess
import sys
from pathlib import Path

import modsim3d
from tests.api.test_names import ELSEWHERE

PAGE = Path(__file__).resolve().parents[2] / "docs/python.md"


def blocks() -> list[tuple[int, str]]:
    """The line at which each block begins, and its text."""
    text = PAGE.read_text(encoding="utf-8")
    found = re.finditer(r"```python\n(.*?)```", text, re.S)
    return [(text.count("\n", 0, each.start(1)), each[1]) for each in found]


def printed() -> set[str]:
    """The lines that the page shows as printed: from one that begins with `<` to one that ends with `>`."""
    shown = re.findall(r"```text\n(<.*?>)\n```", PAGE.read_text(encoding="utf-8"), re.S)
    return {line for text in shown for line in without_times(text)}


def without_times(text: str) -> list[str]:
    return re.sub(r"time [0-9.]+ s", "time", text).splitlines()


def test_the_page_runs_from_top_to_bottom(tmp_path: Path) -> None:
    lines = ["from modsim3d.learn import self_check; self_check.SEEDS = 2  # fewer than a user's, to be quick"]
    for first, block in blocks():
        lines += [""] * (first - len(lines)) + block.splitlines()  # a traceback then names the line of the page
    script, empty = tmp_path / "page.py", tmp_path / "empty"
    script.write_text("\n".join(lines), encoding="utf-8")
    empty.mkdir()
    command = [sys.executable, "-W", "error:::__main__", script]
    done = subprocess.run(command, cwd=empty, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    learned = {"learned.yaml", "learned.html", "learned.uncertainty.json"}
    assert {path.name for path in empty.iterdir()} == {
        "runs",
        "checked",
        "frame.png",
        "moment.png",
        "page.html",
        *learned,
    }
    assert printed() and printed() <= set(without_times(done.stdout))
    assert "obeys its detector file" in done.stdout


def test_the_page_begins_with_ten_lines_and_names_every_function() -> None:
    text, (_, first) = PAGE.read_text(encoding="utf-8"), blocks()[0]
    assert sum(bool(line.strip()) for line in first.splitlines()) <= 10
    functions = [name for name in modsim3d.__all__ if name[0].islower() and name not in ELSEWHERE]
    assert len(functions) >= 8 and [name for name in functions if f"`{name}(" not in text] == []
