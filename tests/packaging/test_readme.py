"""Files and rooms that README, CONTRIBUTING and the pages of docs name are there."""

import re
from pathlib import Path
from types import ModuleType

README = Path(__file__).resolve().parents[2] / "README.md"


def test_files_and_rooms_that_documents_name_are_there() -> None:
    pages = [README, README.parent / "CONTRIBUTING.md", *README.parent.glob("docs/*.md")]
    readme, contributing, *docs = (page.read_text(encoding="utf-8") for page in pages)
    named = set(re.findall(r"`((?:[a-z_]+/)+(?:[a-z_]+\.(?:py|md))?|[a-z_]+\.py)`", contributing))
    assert len(named) > 30
    named |= {*re.findall(r"\]\(([^)#:]+)\)", readme)}
    named |= {name for text in (readme, contributing, *docs) for name in re.findall(r"modsim3d/[\w/]+\.\w+", text)}
    missing = [name for name in named if not any((README.parent / top / name).exists() for top in ("", "modsim3d"))]
    assert not missing


def test_the_tables_of_rooms_are_those_of_the_contract() -> None:
    """What `script/make_rooms` writes is there already."""
    path = README.parent / "script" / "make_rooms"
    module = ModuleType("make_rooms")
    module.__file__ = str(path)
    exec(compile(path.read_text(encoding="utf-8"), path, "exec"), vars(module))
    text = (README.parent / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert module.page(text) == text
    assert all(f"`{each.parent.name}/`" in text for each in (README.parent / "modsim3d").glob("*/__init__.py"))
