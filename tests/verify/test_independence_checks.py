"""Independent draws pass, and lies that leave every single number as it is are found."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.model import DetectorModel
from modsim3d.scene.reading import load_scene
from modsim3d.verify.box_error_checks import state_fits
from modsim3d.verify.error_fit import MomentTable
from modsim3d.verify.evidence import Evidence
from modsim3d.verify.independence_checks import GROUP, independence_checks
from modsim3d.verify.many_seeds import ManyDetections
from modsim3d.verify.verification import verify
from tests.detector_variants import Data, thesis_data
from tests.verify.lies import LIES, Lie, told


@pytest.fixture(scope="module")
def many() -> ManyDetections:
    return ManyDetections.of_scene(load_scene("simulation_3", mode=2, source="analytic"))


@pytest.fixture(scope="module")
def table() -> MomentTable:
    return MomentTable()


def one_state(**sections: object) -> DetectorModel:
    """A detector of one state whose box errors no box cuts down: errors of one box fit any other."""
    data: Data = thesis_data() | {"transition_matrix": [[1.0]], "initial_state": "good"}
    data["states"] = {"good": data["states"]["good"]}
    error = data["states"]["good"]["box_error"]
    error["mean"] = [value / 20 for value in error["mean"]]
    error["covariance"] = [[value / 400 for value in row] for row in error["covariance"]]
    return parse_detector(data | sections)


@pytest.fixture(scope="module")
def honest(many: ManyDetections) -> Evidence:
    return many.detect(one_state(), 3)


def test_an_honest_run_obeys_and_each_pattern_is_tested(honest: Evidence, table: MomentTable) -> None:
    found = verify(one_state(), honest, table)
    assert found.obeys, [(verdict.parameter.name, verdict.p_value) for verdict in found.failed]
    tested = {verdict.parameter.name for verdict in found.verdicts if verdict.p_value is not None}
    assert tested >= set(LIES.values())


@pytest.mark.parametrize("lie", LIES, ids=lambda lie: lie.__name__)
def test_a_lie_that_leaves_single_numbers_intact_is_found(honest: Evidence, table: MomentTable, lie: Lie) -> None:
    failed = verify(one_state(), told(lie, honest), table).failed
    assert LIES[lie] in [verdict.parameter.name for verdict in failed]
    assert {verdict.parameter.group for verdict in failed} == {GROUP}
