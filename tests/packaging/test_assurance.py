"""The page for assessors promises nothing that is not there: commands, scripts, files, tests and pages exist."""

import re
from pathlib import Path

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


def test_commands_scripts_files_and_pages_that_are_named_exist() -> None:
    lines = re.findall(r"(?:`|^)modsim3d ([a-z-]+(?: [a-z-]+)?)", TEXT, flags=re.MULTILINE)
    known = {command for _, command, *_ in COMMANDS}
    assert len(lines) > 5 and [line for line in lines if not {line, line.split()[0]} & known] == []
    for script, *rest in (code.split() for code in CODE if code.startswith("script/")):
        assert (ROOT / script).is_file(), script
        if script == "script/campaign":
            assert (ROOT / "benchmarks" / "campaigns" / f"{rest[0]}.py").is_file(), rest
    assert [name for name in FILES if not (ROOT / name).exists()] == []
    assert [link for link in LINKS if not (PAGE.parent / link.partition("#")[0]).is_file()] == []


def test_what_there_is_is_shown_by_something_and_what_is_missing_is_said() -> None:
    for asked, there_is, shown_by, missing in ROWS:
        assert asked and (there_is == "–") == (shown_by == "–"), asked
        assert there_is != "–" or missing != "–", asked
        assert shown_by == "–" or "`" in shown_by or "](" in shown_by, asked
    assert "no comparison with a real detector on video at sea yet" in TEXT
    assert len(ROWS) > 30 and len(LINKS) > 20 and len(FILES) > 10  # all of the page is looked at
