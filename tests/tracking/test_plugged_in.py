"""A tracker from a package that pip has installed, run by the command."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from modsim3d.core.errors import InputError
from modsim3d.runs.run import run_scene
from modsim3d.scene.reading import load_scene
from modsim3d.tracking.track_run import track_run
from tests.scenes import crossing

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "tests" / "tracker_example"
SECTION = (ROOT / "docs" / "plugins.md").read_text(encoding="utf-8").split("\n## A tracker\n")[1].split("\n## ")[0]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plugged_in")
    run_scene(load_scene(crossing(folder, 40), source="analytic"), folder / "run")
    return folder / "run"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder into which pip has installed the package."""
    folder = tmp_path_factory.mktemp("site")
    package = shutil.copytree(EXAMPLE, folder / "package", ignore=shutil.ignore_patterns("__pycache__"))
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-build-isolation", "--no-deps"]
    line = [*pip, "--disable-pip-version-check", "--no-cache-dir", "--target", folder / "site", package]
    subprocess.run(line, check=True, capture_output=True, timeout=120, cwd=folder)
    return folder / "site"


def modsim3d(site: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), str(ROOT)])}
    line = [sys.executable, "-m", "modsim3d", *map(str, arguments)]
    return subprocess.run(line, env=environment, capture_output=True, text=True, timeout=120, check=False)


def test_the_page_quotes_the_package_that_is_tested() -> None:
    for language, name in (("toml", "pyproject.toml"), ("python", "modsim3d_overlap.py")):
        blocks = re.findall(rf"```{language}\n(.*?)```", SECTION, flags=re.DOTALL)
        assert blocks == [(EXAMPLE / name).read_text(encoding="utf-8")]


def test_the_tracker_has_ten_lines() -> None:
    _, tracker = (EXAMPLE / "modsim3d_overlap.py").read_text(encoding="utf-8").split("\n\n\n")
    assert len([line for line in tracker.splitlines() if line]) == 10


def test_an_installed_tracker_runs_by_its_name_with_its_settings(
    run: Path, site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = modsim3d(site, "track", run, "--tracker", "overlap", "--json", "--out", tmp_path / "a")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert said["package"] == f"{project['name']} {project['version']}"
    assert (said["name"], said["settings"], said["chosen"]) == ("overlap", {"least_iou": 0.3}, "the tracker's defaults")
    detections = pq.read_table(run / "detections.parquet")
    tracks = pq.read_table(tmp_path / "a" / "tracks.parquet")
    assert len(tracks) == len(detections) == said["counts"]["boxes"] == said["counts"]["detections"]
    assert 0 < said["counts"]["tracks"] < len(tracks)
    monkeypatch.syspath_prepend(site)
    strict = track_run(run, tmp_path / "b", tracker="overlap", settings={"least_iou": 1.1})
    assert strict.counts.tracks == len(tracks), "no two boxes are the same"
    with pytest.raises(InputError, match=r"least: unknown key \(did you mean 'least_iou'\?\)"):
        track_run(run, tmp_path / "c", tracker="overlap", settings={"least": 1})
    assert not (tmp_path / "c").exists()
