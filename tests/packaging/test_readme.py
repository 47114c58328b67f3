"""What the README shows must work as shown."""

import re
from pathlib import Path
from types import ModuleType

README = Path(__file__).resolve().parents[2] / "README.md"


def test_readme_names_files_that_exist():
    text = README.read_text(encoding="utf-8")
    for path in re.findall(r"\]\(([^)#:]+)\)", text):
        assert (README.parent / path).exists(), path


def test_contributing_names_files_and_rooms_that_are_there() -> None:
    """The rooms that are still to come are named as such."""
    text = (README.parent / "CONTRIBUTING.md").read_text(encoding="utf-8")
    to_come = {"tracking/", "campaign/"}
    named = set(re.findall(r"`((?:[a-z_]+/)+(?:[a-z_]+\.(?:py|md))?|[a-z_]+\.py)`", text)) - to_come
    missing = [name for name in named if not any((README.parent / top / name).exists() for top in ("", "modsim3d"))]
    assert len(named) > 30 and not missing


def test_the_tables_of_rooms_are_those_of_the_contract() -> None:
    """What `script/make_rooms` writes is there already."""
    path = README.parent / "script" / "make_rooms"
    module = ModuleType("make_rooms")
    module.__file__ = str(path)
    exec(compile(path.read_text(encoding="utf-8"), path, "exec"), vars(module))
    text = (README.parent / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert module.page(text) == text
    assert all(f"`{each.parent.name}/`" in text for each in (README.parent / "modsim3d").glob("*/__init__.py"))
