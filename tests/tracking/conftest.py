"""A run that several tests share."""

import pytest

from modsim3d import StoredRun, load_scene, open_run, run_scene
from tests.scenes import crossing


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    folder = tmp_path_factory.mktemp("crossing")
    run_scene(load_scene(crossing(folder, 40), source="analytic"), folder / "run")
    return open_run(folder / "run")
