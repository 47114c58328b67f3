"""Boxes that overlap in space: the analytic source names them, and the rendered one decides."""

import pickle

import pytest

from modsim3d.core.errors import InputError
from tests.scenes import write_scene

BOATS = {
    "rafted1": ([12, 4, 3], [[0, 100, 0], [10, 100, 1]]),
    "rafted2": ([12, 4, 4], [[0, 103, 0], [10, 103, 1]]),
    "apart": ([12, 4, 3], [[0, 100, 40], [10, 100, 41]]),
}


@pytest.mark.parametrize(("source", "annotated"), [("analytic", 4), ("rendered", 12)])
def test_run_names_intersecting_vessels_of_unknown_visibility(call, tmp_path, source, annotated):
    scene = write_scene(tmp_path, BOATS, 4)
    status, said = call("run", scene, "--source", source, "--out", tmp_path / "run", "--no-sheet")
    assert status == 0 and ("rafted1 and rafted2 intersect" in said) == (source == "analytic")
    assert any(line.split()[:2] == ["annotated", str(annotated)] for line in said.splitlines())


def test_input_errors_come_through_from_another_process():
    error = InputError("scene x.yaml", ["a: wrong", "b: wrong"])
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.source, again.problems) == (str(error), error.source, error.problems)
