"""Runs of a few steps that the tests of this folder share; no test writes into them."""

import pytest

import modsim3d
from modsim3d.runs.run_rows import RunRows
from tests.tracks.track_files import detected_tracks


@pytest.fixture(scope="package")
def small_run(tmp_path_factory):
    """Two cameras, of which one takes a frame at every second step."""
    folder = tmp_path_factory.mktemp("tracks") / "strait"
    modsim3d.run_scene(modsim3d.load_scene("strait", steps=8, source="analytic", seed=3), folder)
    return modsim3d.open_run(folder)


@pytest.fixture(scope="package")
def small_rows(small_run):
    return RunRows.of(small_run)


@pytest.fixture(scope="package")
def small_tracks(small_rows):
    return detected_tracks(small_rows)


@pytest.fixture(scope="package")
def one_camera_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tracks") / "simulation_1"
    modsim3d.run_scene(modsim3d.load_scene("simulation_1", steps=8, source="analytic"), folder)
    return modsim3d.open_run(folder)
