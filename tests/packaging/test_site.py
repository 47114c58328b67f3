"""The documents: their site, pictures, pages for assessors and continuous integration, and the one version of all."""

import re
import runpy
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable
from datetime import date
from pathlib import Path

import pytest
import yaml
from PIL import Image

import modsim3d
from modsim3d.cli.main import COMMANDS
from modsim3d.scene import reading
from tests.packaging.test_documents import blocks
from tests.run_folders import finished
from tests.scenes import crossing

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


GALLERY = REPOSITORY / "script" / "gallery"


@pytest.fixture
def gallery(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """The script, run in this process, which has imported most of what it needs; gives what it prints."""

    def run(*arguments: object) -> str:
        monkeypatch.setattr(sys, "argv", [str(GALLERY), *map(str, arguments)])
        monkeypatch.setattr(sys, "path", list(sys.path))
        try:
            runpy.run_path(str(GALLERY), run_name="__main__")
        except SystemExit as stopped:
            assert not stopped.code
        return capsys.readouterr().out

    return run


def test_every_picture_of_the_documents_is_made_by_the_gallery(gallery: Callable[..., str]) -> None:
    shown = set()
    for page in (REPOSITORY / "README.md", *(REPOSITORY / "docs").glob("*.md")):
        names = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", page.read_text())
        shown |= {(page.parent / name).resolve() for name in names}
    assert {path.parent for path in shown} == {REPOSITORY / "docs"}
    assert {path.name for path in shown} <= set(gallery("--list").split())
    assert all(path.is_file() for path in shown)


def test_gallery_draws(gallery: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that take little time; a change of what the script calls is noticed here. Both show the first 151 steps."""
    load_scene = reading.load_scene
    monkeypatch.setattr(reading, "load_scene", lambda name, **options: load_scene(name, **options | {"steps": 151}))
    written = gallery("--out", tmp_path, "looks.jpg", "map.png")
    assert written.count("kB") == 2
    for name in ("looks.jpg", "map.png"):
        with Image.open(tmp_path / name) as picture:
            assert min(picture.size) > 500


ASSURANCE = REPOSITORY / "docs" / "assurance.md"
ASSURANCE_TEXT = ASSURANCE.read_text(encoding="utf-8")
PROSE = re.sub(r"^```.*?^```$", "", ASSURANCE_TEXT, flags=re.MULTILINE | re.DOTALL)
CODE = sorted(set(re.findall(r"`([^`\n]+)`", PROSE)))
FILES = [code for code in CODE if re.match(r"(tests|docs|scenes|modsim3d|benchmarks|\.ci)/|[A-Z]+(\.md)?$", code)]
LINKS = sorted({link for link in re.findall(r"\]\(([^)]+)\)", PROSE) if not link.startswith("http")})
ROWS = [
    [cell.strip() for cell in line.strip("|").split(" | ")]
    for section in ASSURANCE_TEXT.split("\n## ")
    if "| Asked |" in section
    for line in section.splitlines()
    if line.startswith("| ") and not line.startswith("| Asked")
]


def test_commands_scripts_files_and_pages_that_the_page_for_assessors_names_exist() -> None:
    lines = re.findall(r"(?:`|^)modsim3d ([a-z-]+(?: [a-z-]+)?)", ASSURANCE_TEXT, flags=re.MULTILINE)
    known = {command for _, command, *_ in COMMANDS}
    assert len(lines) > 5 and [line for line in lines if not {line, line.split()[0]} & known] == []
    for script, *rest in (code.split() for code in CODE if code.startswith("script/")):
        assert (REPOSITORY / script).is_file(), script
        if script == "script/campaign":
            assert (REPOSITORY / "benchmarks" / "campaigns" / f"{rest[0]}.py").is_file(), rest
    assert [name for name in FILES if not (REPOSITORY / name).exists()] == []
    assert [link for link in LINKS if not (ASSURANCE.parent / link.partition("#")[0]).is_file()] == []


def test_what_assessors_find_is_shown_by_something_and_what_is_missing_is_said() -> None:
    for asked, there_is, shown_by, missing in ROWS:
        assert asked and (there_is == "–") == (shown_by == "–"), asked
        assert there_is != "–" or missing != "–", asked
        assert shown_by == "–" or "`" in shown_by or "](" in shown_by, asked
    assert "no comparison with a real detector on video at sea yet" in ASSURANCE_TEXT
    assert len(ROWS) > 30 and len(LINKS) > 20 and len(FILES) > 10  # all of the page is looked at


WORKFLOW_PAGE = REPOSITORY / "docs" / "continuous_integration.md"


def test_the_workflow_of_the_page_runs_a_campaign_and_keeps_its_page(call, tmp_path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    campaign, workflow = (text for _, text, file in blocks(WORKFLOW_PAGE) if file)
    Path("trial.yaml").write_text(campaign, encoding="utf-8")
    (job,) = yaml.safe_load(workflow)["jobs"].values()
    lines = [line.split() for step in job["steps"] for line in step.get("run", "").splitlines()]
    for words in lines:
        if words[0] == "modsim3d":
            status, said = call(*words[1:])
            assert status == 0, said
    assert [words[1:3] for words in lines if words[0] == "modsim3d"] == [["campaign", "run"], ["campaign", "report"]]
    assert f"modsim3d-{modsim3d.__version__}-" in next(words[-1] for words in lines if words[0] == "pip")
    assert all(Path(path).stat().st_size for path in job["steps"][-1]["with"]["path"].split())
    always = [step["if"] for step in job["steps"][-2:]]
    assert always == ["success() || failure()"] * 2  # also where a requirement failed


def test_metadata_changelog_citation_and_runs_have_one_version_and_the_citation_says_what_metadata_say(tmp_path):
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    version = project["version"]
    said = "the environment has another version: script/setup test installs this one"
    assert modsim3d.__version__ == version, said
    headings = re.findall(r"^## (.*)$", (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    released = [
        (tuple(map(int, each.split(".")[:3])), date.fromisoformat(day))
        for each, _, day in (heading.partition(" - ") for heading in headings[1:])
    ]
    assert headings[0] == "Unreleased" and headings[1].startswith(f"{version} - ")
    assert released == sorted(set(released), reverse=True)
    cited = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    assert (cited["version"], cited["date-released"]) == (version, released[0][1])
    assert cited["title"].startswith(f"{project['name']}: ")
    assert (cited["license"], cited["keywords"]) == (project["license"], project["keywords"])
    assert {"cff-version", "message", "title", "authors"} <= cited.keys()  # what the format asks for
    assert f"With modsim3d {version} and" in (REPOSITORY / "docs" / "extras.md").read_text(encoding="utf-8")
    run = finished(modsim3d.load_scene(crossing(tmp_path, 1), source="rectangles"), tmp_path / "run")
    assert run.settings["versions"]["modsim3d"] == version
