import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from modsim3d.detector.confidence import NormalScores
from modsim3d.detector.file.reading import load_detector
from modsim3d.detector.file.schema import covariance_problems
from modsim3d.detector.model import DetectorModel

ROOT = Path(__file__).resolve().parents[2]
DETECTORS = ROOT / "scenes" / "detectors"


def load(name: str) -> DetectorModel:
    return load_detector(DETECTORS / f"{name}.yaml")


def test_the_script_writes_every_detector_file_byte_for_byte(tmp_path: Path) -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, ROOT / "script" / "make_detectors", tmp_path], check=True, env=environment)
    by_hand = {"coastal", "rich"}
    shipped = {path.name: path.read_bytes() for path in DETECTORS.glob("*.yaml") if path.stem not in by_hand}
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == shipped
    assert len(shipped) == 4


def test_thesis_detector_holds_tables_9_2_and_9_3() -> None:
    model = load("thesis")
    assert model.labels == ("Vessel",) and model.false_positives.model == "calibrated"
    assert [state.name for state in model.states] == ["excellent", "good", "bad", "terrible"]
    np.testing.assert_allclose([state.confusion[1, 0] for state in model.states], [0.133, 0.151, 0.245, 0.381])
    assert [state.false_discovery_rate for state in model.states] == [0.089, 0.113, 0.115, 0.255]
    assert model.states[1].box_error.covariance[0].tolist() == [3328, 87, -301, -220]
    assert model.states[3].box_error.mean.tolist() == [4.0, 8.2, -24.1, -8.9]
    assert model.transition_matrix[1, 0] == pytest.approx(0.0085)
    assert {state.confidence.true for state in model.states} == {NormalScores(0.67, 0.1)}


def test_the_original_differs_in_its_false_positives_only() -> None:
    ours, original = (yaml.safe_load((DETECTORS / f"{n}.yaml").read_text()) for n in ("thesis", "thesis_original"))
    assert original.pop("false_positives") == {"model": "thesis"}
    del ours["false_positives"]
    assert ours == original


def test_experiment_1_has_one_state_and_three_labels_a_full_confusion_matrix_in_each_of_two() -> None:
    model = load("three_labels")
    assert model.labels == ("sailboat", "motorboat", "ferry")
    assert [state.confusion.shape for state in model.states] == [(4, 3), (4, 3)]
    assert all(np.all(state.confusion > 0) for state in model.states)
    (state,) = load("experiment_1").states
    assert state.false_discovery_rate == 0.119
    assert state.box_error.covariance[1].tolist() == [1.6, 12.2, -0.2, -13.9]


def test_every_published_covariance_is_one() -> None:
    conditions = yaml.safe_load((DETECTORS / "data" / "detection_conditions.yaml").read_text())
    for entry in conditions.values():
        if "covariance_px2" in entry:
            matrix = np.array(entry["covariance_px2"])
        else:
            correlation = np.eye(4)
            for pair, value in entry["correlation"].items():
                i, j = ("xywh".index(axis) for axis in pair)
                correlation[i, j] = correlation[j, i] = value
            matrix = np.outer(entry["std_px"], entry["std_px"]) * correlation
        assert covariance_problems(matrix.tolist()) == []
    assert len(conditions) == 17
