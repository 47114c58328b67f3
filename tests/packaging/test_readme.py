"""What the README shows must work as shown."""

import re
import tomllib
from pathlib import Path

import pytest

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


def test_every_room_of_the_package_is_in_the_architecture() -> None:
    package = README.parent / "modsim3d"
    rooms = {path.parent.name for path in package.glob("*/__init__.py")}
    table = (README.parent / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert {name for name in rooms if f"`{name}/`" not in table} == set()


@pytest.mark.parametrize("room", ["campaign", "learn"])
def test_the_floors_of_a_room_are_those_of_its_contract(room: str) -> None:
    root = README.parent
    settings = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    contract = next(each for each in settings["contracts"] if each.get("containers") == [f"modsim3d.{room}"])
    floors = [set(layer.split(" | ")) for layer in reversed(contract["layers"])]
    text = (root / "docs" / "architecture.md").read_text(encoding="utf-8")
    section = next(part for part in text.split("\n## ") if f"`{room}/`" in part.split("| Floor |")[0])
    table: dict[int, set[str]] = {}
    for floor, names in re.findall(r"^\| (\d+) \| (.+?) \|", section, re.MULTILINE):
        table.setdefault(int(floor), set()).update(re.findall(r"`(\w+)/?`", names))
    assert table == dict(enumerate(floors, 1))
