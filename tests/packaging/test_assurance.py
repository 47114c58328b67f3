"""The page for assessors promises nothing that is not there: commands, scripts, files, tests and pages exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from modsim3d.cli.main import COMMANDS

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "assurance.md"
TEXT = PAGE.read_text(encoding="utf-8")
PROSE = re.sub(r"^```.*?^```$", "", TEXT, flags=re.MULTILINE | re.DOTALL)
CODE = sorted(set(re.findall(r"`([^`\n]+)`", PROSE)))
FILES = [code for code in CODE if re.match(r"(tests|docs|scenes|modsim3d|benchmarks|\.ci)/|[A-Z]+(\.md)?$", code)]
LINKS = sorted({link for link in re.findall(r"\]\(([^)]+)\)", PROSE) if not link.startswith("http")})
ROWS = [
    [cell.strip() for cell in line.strip("|").split(" | ")]
    for section in TEXT.split("\n## ")
    if "| Asked |" in section
    for line in section.splitlines()
    if line.startswith("| ") and not line.startswith("| Asked")
]


@pytest.mark.parametrize("name", sorted(set(re.findall(r"(?:`|^)modsim3d ([a-z-]+)", TEXT, flags=re.MULTILINE))))
def test_a_command_that_is_named_exists(name: str) -> None:
    assert name in {command for _, command, *_ in COMMANDS}


@pytest.mark.parametrize("code", [code for code in CODE if code.startswith("script/")])
def test_a_script_that_is_named_exists(code: str) -> None:
    script, *rest = code.split()
    assert (ROOT / script).is_file()
    if script == "script/campaign":
        assert (ROOT / "benchmarks" / "campaigns" / f"{rest[0]}.py").is_file()


@pytest.mark.parametrize("name", FILES)
def test_a_file_or_test_that_is_named_exists(name: str) -> None:
    assert (ROOT / name).exists()


@pytest.mark.parametrize("link", LINKS)
def test_a_page_that_is_linked_exists(link: str) -> None:
    assert (PAGE.parent / link.partition("#")[0]).is_file()


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0][:40])
def test_what_there_is_is_shown_by_something_and_what_is_missing_is_said(row: list[str]) -> None:
    asked, there_is, shown_by, missing = row
    assert asked
    assert (there_is == "–") == (shown_by == "–")
    assert there_is != "–" or missing != "–"
    assert shown_by == "–" or "`" in shown_by or "](" in shown_by


def test_the_page_says_that_no_comparison_with_the_sea_exists() -> None:
    assert "no comparison with a real detector on video at sea yet" in TEXT


def test_all_of_the_page_is_looked_at() -> None:
    assert len(ROWS) > 30 and len(LINKS) > 20 and len(FILES) > 10
