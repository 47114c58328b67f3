from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modsim3d.core.errors import InputError
from modsim3d.detector.confidence import NormalScores
from modsim3d.detector.file.reading import load_detector, parse_detector
from tests.detector.detector_builders import COVARIANCE_PX2, box_error, detector_data, state_data

SKEWED = [list(row) for row in COVARIANCE_PX2]
SKEWED[0][2] = 1150
INDEFINITE = np.diag([4.0, 9.0, 1.0, 1.0])
INDEFINITE[2, 3] = INDEFINITE[3, 2] = 3.0  # eigenvalues 4 and −2


def changed(path: str, value: Any) -> dict[str, Any]:
    data = copy.deepcopy(detector_data())
    *sections, key = path.split(".")
    section = data
    for name in sections:
        section = section[name]
    section[key] = value
    return data


def problems(data: Any) -> tuple[str, ...]:
    with pytest.raises(InputError) as caught:
        parse_detector(data)
    return caught.value.problems


BAD = [
    ("labels", [], "labels: is empty"),
    ("labels", ["sail", "sail"], "labels: label 'sail' appears twice"),
    ("labels", ["sail", 7], "labels[1]: text is needed (got 7)"),
    ("states", {}, "states: is empty"),
    ("confidence_threshold", 1.5, "confidence_threshold: Input should be less than or equal to 1 (got 1.5)"),
    ("confidence_threshold", -0.1, "confidence_threshold: Input should be greater than or equal to 0"),
    ("confidence_threshold", "0.2", "confidence_threshold: Input should be a valid number (got '0.2')"),
    ("initial_state", "claer", "initial_state: unknown state 'claer' (did you mean 'clear'?)"),
    ("transition_interval_s", 0, "transition_interval_s: Input should be greater than 0"),
    ("transition_interval_s", 1e-300, "transition_interval_s: 1e-300 is too small to calculate with: at least 1e-09"),
    ("transition_interval_s", 1e300, "transition_interval_s: Input should be less than or equal to 1000000000"),
    ("false_positives", {"model": "per_image", "rate": 1e150}, "rate: Input should be less than or equal to 1000"),
    ("states.fog.confidence.size_reference_px", 5e-324, "size_reference_px: 4.94066e-324 is too small to calculate"),
    ("states.fog.confidence.std", 5e-324, "std: 4.94066e-324 is too small to calculate with"),
    ("states.fog.box_error.mean", [0, 0, 1e308, 0], "mean[2]: Input should be less than or equal to 1000000000"),
    ("false_positives", {"model": "calibratd"}, "unknown model 'calibratd' (did you mean 'calibrated'?)"),
    ("transition_matrix", [[0.9, 0.1], [0.2, 0.8]], "transition_matrix: its rows sum to one and its columns"),
    ("transition_matrix", [[0.9, 0.1], [0.2, 0.8]], "must be transposed"),
    (
        "transition_matrix",
        [[0.9, 0.2], [0.1, 0.9]],
        "transition_matrix: column 'fog' sums to 1.1, must sum to 1",
    ),
    ("transition_matrix", [[0.9, 1.2], [0.1, -0.2]], "transition_matrix[0][1]: Input should be less than"),
    ("transition_matrix", [[1.0]], "transition_matrix: is 1 × 1, must be 2 × 2: one row and one column"),
    ("transition_matrix", [[1.0, 0.0], [1.0]], "transition_matrix: its rows have different lengths: 2, 1"),
    ("transition_matrix", [], "transition_matrix: is 0 × 0, must be 2 × 2"),
    (
        "states.fog.confusion",
        [[0.5, 0.2], [0.1, 0.4], [0.4, 0.401]],
        "states.fog.confusion: column 'motor' sums to 1.001",
    ),
    (
        "states.fog.confusion",
        [[0.5, 0.1, 0.4], [0.2, 0.4, 0.4]],
        "states.fog.confusion: is 2 × 3, must be 3 × 2",
    ),
    (
        "states.fog.confusion",
        [[0.5, 0.1, 0.4], [0.2, 0.4, 0.4]],
        "looks row-stochastic and must be transposed",
    ),
    (
        "states.fog.confusion",
        [[0.5, 0.2], [0.5, 0.8]],
        "is 2 × 2, must be 3 × 2: rows sail, motor, background; columns",
    ),
    ("states.fog.confusion", [[0.5, 0.2], [0.1, 0.4], [float("nan"), 0.4]], "states.fog.confusion[2][0]"),
    ("states.fog.false_positive_labels", [1.0], "states.fog.false_positive_labels: has 1 entries, must have"),
    ("states.fog.false_positive_labels", [0.5, 0.6], "states.fog.false_positive_labels: sums to 1.1"),
    ("states.fog.false_discovery_rate", 1, "states.fog.false_discovery_rate: is 1, must be below 1"),
    ("states.fog.false_discovery_rate", 1, "infinitely many"),
    ("states.fog.false_discovery_rate", -0.2, "states.fog.false_discovery_rate: is -0.2, must be from 0 to 0.99"),
    (
        "states.fog.box_error.unit",
        "m",
        "states.fog.box_error.unit: Input should be 'px', 'relative' or 'mixed' (got 'm')",
    ),
    ("states.fog.box_error.mean", [1, 2, 3], "states.fog.box_error.mean: has 3 entries, must have 4: e_x"),
    (
        "states.fog.box_error.covariance",
        SKEWED,
        "covariance: is not symmetric: row e_x, column e_w is 1150, row e_w, column e_x is 1157",
    ),
    (
        "states.fog.box_error.covariance",
        INDEFINITE.tolist(),
        "covariance: is not positive semi-definite, so no errors can have it: its smallest eigenvalue is -2,",
    ),
    ("states.fog.box_error.covariance", [[1.0]], "covariance: is 1 × 1, must be 4 × 4: rows and columns e_x"),
    ("states.fog.confidence", {"mean": 0.6, "std": -0.1}, "states.fog.confidence.std: Input should be great"),
    ("states.fog.confidence", {"mean": 67, "std": 0.1}, "states.fog.confidence.mean: Input should be less"),
    ("states.fog.drop_out", 0.3, "states.fog.drop_out: unknown key"),
]


@pytest.mark.parametrize(("path", "value", "message"), BAD, ids=[f"{p}-{i}" for i, (p, _, _) in enumerate(BAD)])
def test_a_bad_value_is_told_with_its_path_and_what_would_be_right(path: str, value: Any, message: str) -> None:
    assert message in "\n".join(problems(changed(path, value)))


def test_every_problem_is_told_at_once() -> None:
    data = detector_data(
        confidence_threshold=2,
        initial_state="storm",
        transition_matrix=[[0.9, 0.2], [0.2, 0.8]],
        states={
            "clear": state_data(false_discovery_rate=1.0, confidence={"mean": 0.5, "std": -1}),
            "fog": state_data(
                confusion=[[0.5, 0.2], [0.1, 0.4], [0.5, 0.5]],
                box_error=box_error([0, 0, 0], -np.eye(4)),
            ),
        },
    )
    found = [problem.split(": ")[0] for problem in problems(data)]
    assert found == [
        "confidence_threshold",
        "initial_state",
        "transition_matrix",
        "states.clear.false_discovery_rate",
        "states.clear.confidence.std",
        "states.fog.confusion",
        "states.fog.box_error.mean",
        "states.fog.box_error.covariance",
    ]


def test_both_wrong_columns_are_named() -> None:
    (problem,) = problems(changed("transition_matrix", [[0.9, 0.2], [0.2, 0.9]]))
    assert "column 'clear' sums to 1.1" in problem
    assert "column 'fog' sums to 1.1" in problem


@pytest.mark.parametrize("key", ["labels", "states", "transition_matrix", "initial_state"])
def test_a_missing_key_is_told(key: str) -> None:
    data = detector_data()
    del data[key]
    assert f"{key}: missing" in problems(data)


@pytest.mark.parametrize("data", [None, [], "thesis", 3])
def test_something_that_is_no_mapping_is_refused(data: Any) -> None:
    assert "must be a mapping with the keys labels" in problems(data)[0]


@pytest.mark.parametrize("states", [None, [1], "fog", {"fog": None}])
def test_states_of_another_type_are_refused(states: Any) -> None:
    assert any(problem.startswith("states") for problem in problems(detector_data(states=states)))


def test_enormous_covariances_are_judged_without_overflow() -> None:
    data = changed("states.fog.box_error.covariance", (INDEFINITE * 1e8).tolist())
    assert "smallest eigenvalue is -2e+08" in problems(data)[0]


def test_singular_and_zero_covariances_are_accepted() -> None:
    singular = np.outer([1, 2, 3, 4], [1, 2, 3, 4])
    for covariance in (singular, np.zeros((4, 4))):
        data = changed("states.fog.box_error", box_error([0, 0, 0, 0], covariance))
        assert np.array_equal(parse_detector(data).states[1].box_error.covariance, covariance)


def test_columns_that_lack_a_few_digits_are_completed() -> None:
    model = parse_detector(changed("states.fog.confusion", [[0.3333333, 0.2], [0.3333333, 0.4], [0.3333333, 0.4]]))
    assert abs(model.states[1].confusion.sum(axis=0) - 1).max() < 1e-15


def test_a_model_holds_what_the_mapping_says() -> None:
    model = parse_detector(detector_data(initial_state="fog", transition_interval_s=5))
    assert model.labels == ("sail", "motor")
    assert model.initial_state == 1
    assert model.transition_interval_s == 5
    assert model.clutter.model == "calibrated"
    assert [state.name for state in model.states] == ["clear", "fog"]
    assert model.states[1].confusion.tolist() == [[0.5, 0.2], [0.1, 0.4], [0.4, 0.4]]
    assert model.states[1].false_discovery_rate == 0.4
    assert model.states[1].confidence.true == NormalScores(0.4, 0.2)


def test_arrays_of_a_model_cannot_be_written_to() -> None:
    state = parse_detector(detector_data()).states[0]
    for array in (state.confusion, state.box_error.mean, state.box_error.covariance):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_calibrated_is_the_default() -> None:
    data = detector_data()
    del data["false_positives"]
    assert parse_detector(data).clutter.model == "calibrated"


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing\.yaml"):
        load_detector(tmp_path / "nothing.yaml")
