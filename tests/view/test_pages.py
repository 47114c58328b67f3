"""Commands of README and the pages of docs are ones that modsim3d takes; script/docs checks their links."""

import re
import shlex
from pathlib import Path

import typer

from modsim3d.cli.main import app

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / name for name in ("README.md", "CONTRIBUTING.md")] + sorted((ROOT / "docs").glob("*.md"))
FENCE = re.compile(r"^```(?:text|sh)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"^(?:\w+ \| )?modsim3d (?!:)(.*)$", flags=re.MULTILINE)


def commands(page):
    for fence in FENCE.findall(page.read_text(encoding="utf-8")):
        for found in COMMAND.findall(fence.replace("\\\n", " ")):
            yield shlex.split(found, comments=True)


def test_commands_are_taken():
    known = typer.main.get_command(app).commands
    for page in PAGES:
        for name, *arguments in commands(page):
            assert name in known, page
            known[name].make_context(name, arguments)
