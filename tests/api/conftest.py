"""A run that the tests of this folder share."""

from __future__ import annotations

from pathlib import Path

import pytest

import modsim3d


@pytest.fixture(scope="session")
def scene() -> modsim3d.Scene:
    return modsim3d.load_scene("strait", steps=30, source="analytic", seed=3)


@pytest.fixture(scope="session")
def folder(scene, tmp_path_factory) -> Path:
    """A run directory; no test writes into it."""
    folder = tmp_path_factory.mktemp("api") / "run"
    modsim3d.run_scene(scene, folder)
    return folder
