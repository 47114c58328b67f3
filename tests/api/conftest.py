"""Runs that the tests of this folder share; no test writes into them."""

from pathlib import Path

import pytest

import modsim3d
from benchmarks.voyages.cases import SHOEBOXES


@pytest.fixture(scope="session")
def scene() -> modsim3d.Scene:
    return modsim3d.load_scene("strait", steps=30, source="analytic", seed=3, settings=SHOEBOXES)


@pytest.fixture(scope="session")
def folder(scene, tmp_path_factory) -> Path:
    """Several cameras, one of them on a vessel and one that does not take a frame at each step."""
    folder = tmp_path_factory.mktemp("api") / "run"
    modsim3d.run_scene(scene, folder)
    return folder


@pytest.fixture(scope="session")
def thesis_folder(tmp_path_factory) -> Path:
    """One camera, and the thesis's detector."""
    folder = tmp_path_factory.mktemp("api") / "thesis"
    modsim3d.run_scene(modsim3d.load_scene("simulation_1", mode=2, steps=100, source="analytic"), folder)
    return folder
