"""The harbour scene: dense, made by a script, and fit to compare sources of truth on."""

import subprocess
import sys
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import shapely
import yaml

from modsim3d.io.input_files import data_folder
from modsim3d.runs.pipeline import truth_block
from modsim3d.scene.reading import load_scene
from tests.scenes import footprints

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def scene():
    return load_scene("harbour")


def test_script_writes_the_very_scene_that_is_shipped(tmp_path):
    written = tmp_path / "harbour.yaml"
    subprocess.run([sys.executable, ROOT / "script" / "make_harbour", written], check=True)
    assert written.read_bytes() == (data_folder("scenes") / "harbour.yaml").read_bytes()


def test_thirty_vessels_from_kayak_to_large_ship_are_there_throughout(scene):
    lengths = [vessel.length_m for vessel in scene.vessels]
    assert len(lengths) == 30 and min(lengths) < 5 and 200 < max(lengths) <= 300
    assert {vessel.name.rstrip("0123456789") for vessel in scene.vessels} >= {"kayak", "yacht", "ferry", "ship"}
    assert scene.poses.poses(0, scene.steps).present.all()


def test_no_two_vessels_ever_touch(scene):
    hulls = footprints(scene, np.arange(0, scene.steps, 5))
    assert hulls.shape == (80, 30)
    areas_m2 = [vessel.length_m * vessel.beam_m for vessel in scene.vessels]
    np.testing.assert_allclose(shapely.area(hulls), np.tile(areas_m2, (80, 1)))
    first, second = np.array(list(combinations(range(30), 2))).T
    assert shapely.distance(hulls[:, first], hulls[:, second]).min() > 1.0


def test_every_vessel_has_a_shape_and_every_shipped_shape_is_there(scene):
    meshes = yaml.safe_load((data_folder("meshes") / "meshes.yaml").read_text(encoding="utf-8"))
    assert {vessel.shape for vessel in scene.vessels} == set(meshes)
    for vessel in scene.vessels:  # about as the mesh was designed, by length
        designed = meshes[vessel.shape]
        for name in ("beam_m", "air_draft_m"):
            stretched = getattr(vessel, name) / vessel.length_m / (designed[name] / designed["length_m"])
            assert 0.7 < stretched < 1.45, (vessel.name, name, stretched)


def test_at_least_a_third_of_the_vessel_frames_are_partly_hidden(scene, renderer):
    truths = (truth_block(scene, step, step + 1, renderer) for step in range(0, scene.steps, 10))
    fractions = np.concatenate([truth.visible_fraction for truth in truths])
    assert len(fractions) > 500 and (fractions == 0).any()
    assert ((fractions > 0) & (fractions < 1)).mean() >= 1 / 3
