"""Runs of a few steps that the tests of this folder share; no test writes into them."""

import pytest

from modsim3d.runs.run_rows import RunRows
from tests.tracks.track_files import detected_tracks, scene_run


@pytest.fixture(scope="package")
def small_run(tmp_path_factory):
    """Two cameras, of which one takes a frame at every second step."""
    return scene_run(tmp_path_factory.mktemp("tracks") / "strait", "strait", seed=3)


@pytest.fixture(scope="package")
def small_rows(small_run):
    return RunRows.of(small_run)


@pytest.fixture(scope="package")
def small_tracks(small_rows):
    return detected_tracks(small_rows)


@pytest.fixture(scope="package")
def one_camera_run(tmp_path_factory):
    return scene_run(tmp_path_factory.mktemp("tracks") / "simulation_1", "simulation_1")
