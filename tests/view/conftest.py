"""Small finished runs to look at."""

from pathlib import Path

import pytest

from modsim3d import RunRows, load_scene, open_run, run_scene
from tests.scenes import crossing, mistaken_strait


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve steps; tests write only pictures into it."""
    folder = tmp_path_factory.mktemp("view")
    run_scene(load_scene(crossing(folder, 12)), folder / "run")
    return folder / "run"


@pytest.fixture(scope="session")
def exact_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same scene with exact truth, for tracks that are made of it."""
    folder = tmp_path_factory.mktemp("analytic")
    run_scene(load_scene(str(crossing(folder, 12)), source="analytic"), folder / "run")
    return folder / "run"


@pytest.fixture(scope="session")
def rows(exact_run: Path) -> RunRows:
    return RunRows.of(open_run(exact_run))


@pytest.fixture(scope="session")
def mistaken_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which the detector makes every kind of mistake."""
    folder = tmp_path_factory.mktemp("mistaken")
    run_scene(load_scene(mistaken_strait(folder)), folder / "run")
    return folder / "run"
