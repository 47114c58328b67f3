"""Runs that several files of this folder read."""

import pytest

from benchmarks.voyages.cases import SHOEBOXES
from modsim3d import StoredRun, load_scene, open_run, run_scene


@pytest.fixture(scope="package")
def strait_run(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    """The first 40 steps of the strait, by exact geometry; two cameras of which one is slower."""
    scene = load_scene("strait", steps=40, source="analytic", settings=SHOEBOXES)
    return open_run(run_scene(scene, tmp_path_factory.mktemp("strait") / "run").folder)
