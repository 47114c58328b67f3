"""A run that several tests share."""

import pytest

from modsim3d import StoredRun, load_scene
from tests.run_folders import finished
from tests.scenes import crossing


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    folder = tmp_path_factory.mktemp("crossing")
    return finished(load_scene(crossing(folder, 40), source="analytic"), folder / "run")
