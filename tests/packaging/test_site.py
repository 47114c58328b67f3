"""script/docs refuses what a reader of the site would stumble over."""

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

import modsim3d

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A checkout with two pages, the settings of the site and no setup to run."""
    for folder in ("script", "docs", "scenes"):
        (tmp_path / folder).mkdir()
    for file in ("script/docs", "docs/conf.py"):
        shutil.copy(REPOSITORY / file, tmp_path / file)
    (tmp_path / "script" / "setup").write_text("#!/bin/sh\n")
    (tmp_path / "script" / "setup").chmod(0o755)
    (tmp_path / ".venv").symlink_to(sys.prefix)
    (tmp_path / "scenes" / "there.yaml").write_text("steps: 1\n")
    (tmp_path / "README.md").write_text("# A site\n\n[limits](docs/limits.md#below)\n")
    (tmp_path / "docs" / "limits.md").write_text("# Limits\n\n[a scene](../scenes/there.yaml)\n\n## Below\n\nText.\n")
    return tmp_path


def build(site: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([site / "script" / "docs"], capture_output=True, text=True, timeout=300, check=False)


def api_page(site: Path, names: list[str]) -> None:
    rows = [f"| `modsim3d.{name}` | what it is for |" for name in names]
    (site / "docs" / "api.md").write_text("\n".join(["# Names", "", "| Name | |", "|---|---|", *rows, ""]))


def test_sound_pages_make_a_site_that_fetches_nothing_from_elsewhere(site: Path) -> None:
    names = ["load_scene", "Scene"]  # the site itself, another check of script/test, has all
    api_page(site, names)
    with (site / "docs" / "conf.py").open("a") as settings:
        settings.write(f"modsim3d.__all__ = {names}\n")
    finished = build(site)
    assert finished.returncode == 0, finished.stderr
    folder = site / "build" / "docs"
    assert f"open file://{folder}/index.html" in finished.stdout
    pages = {page: page.read_text(encoding="utf-8") for page in folder.rglob("*.html")}
    assert 'href="docs/limits.html#below"' in pages[folder / "index.html"]
    for part in ('id="modsim3d.load_scene"', "Names of all that can hide a vessel: the vessels"):
        assert part in pages[folder / "docs" / "api.html"]
    assert not any('src="http' in text or '<link href="http' in text for text in pages.values())


def test_faults_of_links_pictures_menu_and_names_of_the_package_are_all_named(site: Path) -> None:
    """A page with a misspelt name and one right one: docstrings of all the others would be most of the work."""
    with (site / "docs" / "limits.md").open("a") as page:
        page.write("[a](nowhere.md) [b](#no-anchor) [c](../README.md#other) [d](../scenes/nowhere.yaml) ![e](no.png)\n")
    (site / "docs" / "unlisted.md").write_text("# A page that nobody finds\n")
    api_page(site, ["load_scenery", "load_detector"])
    finished = build(site)
    for fault in ("nowhere.md", "no-anchor", "other", "nowhere.yaml", "no.png", "unlisted.md"):
        assert fault in finished.stderr
    assert finished.returncode == 1 and re.findall(r"there is no (\S+):", finished.stderr) == ["modsim3d.load_scenery"]
    missing = re.findall(r"no table has (\S+), which modsim3d\.__all__ lists", finished.stderr)
    assert missing == [f"modsim3d.{name}" for name in modsim3d.__all__ if name != "load_detector"]
    assert finished.stderr.count(" WARNING: ") == 6 + 1 + len(missing), finished.stderr


def test_citation_says_of_the_package_what_its_metadata_say() -> None:
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert citation["title"].startswith(f"{project['name']}: ")
    assert (citation["license"], citation["keywords"]) == (project["license"], project["keywords"])
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()  # what the format asks for
