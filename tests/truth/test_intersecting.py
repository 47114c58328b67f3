"""Boxes that overlap in space: the analytic source names them, and the rendered one decides."""

import pickle

import pytest

from modsim3d.core.errors import InputError
from modsim3d.io.input_files import data_folder
from tests.command_line import call

SCENE = """
steps: 4
time_step_s: 1
vessels:
  rafted1: {{length_m: 12, beam_m: 4, air_draft_m: 3, label: Vessel}}
  rafted2: {{length_m: 12, beam_m: 4, air_draft_m: 4, label: Vessel}}
  apart: {{length_m: 12, beam_m: 4, air_draft_m: 3, label: Vessel}}
poses:
  tracks:
    rafted1: [[0, 100, 0], [10, 100, 1]]
    rafted2: [[0, 103, 0], [10, 103, 1]]
    apart: [[0, 100, 40], [10, 100, 41]]
cameras:
  C0:
    focal_length_m: 0.01
    pixel_size_m: [1.0e-5, 1.0e-5]
    principal_point_px: [400, 300]
    image_size_px: [800, 600]
    pose: {{position_m: [0, 0, 10]}}
annotation: {{mode: 2}}
detector: {folder}/detectors/thesis.yaml
"""


@pytest.mark.parametrize(("source", "annotated"), [("analytic", 4), ("rendered", 12)])
def test_run_names_intersecting_vessels_of_unknown_visibility(monkeypatch, tmp_path, capsys, source, annotated):
    scene = tmp_path / "raft.yaml"
    scene.write_text(SCENE.format(folder=data_folder("scenes")))
    out = str(tmp_path / "run")
    assert call(monkeypatch, "run", scene, "--source", source, "--out", out, "--no-sheet") == 0
    said = "".join(capsys.readouterr())
    assert ("rafted1 and rafted2 intersect" in said) == (source == "analytic")
    assert any(line.split()[:2] == ["annotated", str(annotated)] for line in said.splitlines())


def test_input_errors_come_through_from_another_process():
    error = InputError("scene x.yaml", ["a: wrong", "b: wrong"])
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.source, again.problems) == (str(error), error.source, error.problems)
