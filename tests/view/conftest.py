"""A small finished run to look at."""

from __future__ import annotations

from pathlib import Path

import pytest

from modsim3d.runs.run import run_scene
from modsim3d.scene.reading import load_scene
from tests.scenes import crossing


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve steps; tests write only pictures into it."""
    folder = tmp_path_factory.mktemp("view")
    run_scene(load_scene(crossing(folder, 12)), folder / "run")
    return folder / "run"
