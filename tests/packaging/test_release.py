"""One version of the package in all that names it; script/release writes docs/extras.md."""

import re
import tomllib
from datetime import date
from pathlib import Path

import yaml

import modsim3d
from tests.run_folders import finished
from tests.scenes import crossing

ROOT = Path(__file__).resolve().parents[2]


def test_metadata_changelog_citation_and_runs_have_one_version(tmp_path: Path) -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    said = "the environment has another version: script/setup test installs this one"
    assert modsim3d.__version__ == version, said
    headings = re.findall(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    released = [
        (tuple(map(int, each.split(".")[:3])), date.fromisoformat(day))
        for each, _, day in (heading.partition(" - ") for heading in headings[1:])
    ]
    assert headings[0] == "Unreleased" and headings[1].startswith(f"{version} - ")
    assert released == sorted(set(released), reverse=True)
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert (cited["version"], cited["date-released"]) == (version, released[0][1])
    assert f"With modsim3d {version} and" in (ROOT / "docs" / "extras.md").read_text(encoding="utf-8")
    run = finished(modsim3d.load_scene(crossing(tmp_path, 1), source="rectangles"), tmp_path / "run")
    assert run.settings["versions"]["modsim3d"] == version
