"""Detector files: what a model has of them, what is said of wrong ones, and what is in the shipped ones."""

import copy
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from modsim3d.core.errors import InputError
from modsim3d.detector.confidence import NormalScores
from modsim3d.detector.file.reading import load_detector, parse_detector
from modsim3d.detector.file.schema import covariance_problems
from modsim3d.detector.model import DetectorModel
from modsim3d.io.strict_text import load_yaml
from tests.detector import detector_builders as build
from tests.detector.test_chain import scattered_targets

SKEWED = [list(row) for row in build.COVARIANCE_PX2]
SKEWED[0][2] = 1150
DELETED = object()
SLOPE = {"per_doubling": 1, "reference": 50}
GROWTH = {"unit": "mixed", "mean": [0] * 4, "covariance": [[0] * 4] * 4, "growth": [0, 0.1, 0, 0]}
INDEFINITE = np.diag([4.0, 9.0, 1.0, 1.0])
INDEFINITE[2, 3] = INDEFINITE[3, 2] = 3.0  # eigenvalues 4 and −2
PLAIN_FALSE = {"model": "calibrated", "placement": "uniform", "size": {"model": "truth"}}
OFF = {
    **{"dropout": {"model": "confusion", "anchor": "state_rate"}, "gates": {}},
    **{"persistence": {"class_s": 0, "box_s": 0}, "performance": {"scope": "shared", "schedule": []}},
    "false_positives": PLAIN_FALSE | dict.fromkeys(("duplicates", "merges", "splits"), 0),
}


def changed(path: str, value: Any) -> dict[str, Any]:
    data = copy.deepcopy(build.detector_data())
    *sections, key = path.split(".")
    section = data
    for name in sections:
        section = section.setdefault(name, {})
    section[key] = value
    if value is DELETED:
        del section[key]
    return data


def problems(data: Any) -> tuple[str, ...]:
    with pytest.raises(InputError) as caught:
        parse_detector(data)
    return caught.value.problems


CONFUSION, COVARIANCE = "states.fog.confusion", "states.fog.box_error.covariance"
SCORES, ERROR, FALSE = "states.fog.confidence", "states.fog.box_error", "states.fog.false_discovery_rate"
SHARE, BOX, NU = "persistence.score", "persistence.box", "degrees_of_freedom"
T = build.box_error(build.MEAN_PX, build.COVARIANCE_PX2) | {"law": "student_t", NU: 6.0}
MEMORY = {"vessel_share": [0.1] * 5, "shares": [[0.5] * 5, [0.3] * 5], "times_s": [0.1, 0.8]}
BAD = [
    ("labels", [], "labels: is empty"),
    ("labels", ["sail", "sail"], "labels: label 'sail' appears twice"),
    ("labels", ["sail", 7], "labels[1]: text is needed (got 7)"),
    ("states", {}, "states: is empty"),
    ("confidence_threshold", 1.5, "confidence_threshold: must be at most 1 (got 1.5)"),
    ("confidence_threshold", -0.1, "confidence_threshold: must be at least 0"),
    ("confidence_threshold", "0.2", "confidence_threshold: a number is needed (got '0.2')"),
    ("initial_state", "claer", "initial_state: unknown state 'claer' (did you mean 'clear'?)"),
    ("transition_interval_s", 0, "transition_interval_s: must be above 0"),
    ("transition_interval_s", 1e-300, "transition_interval_s: 1e-300 is too small to calculate with: at least 1e-09"),
    ("transition_interval_s", 1e300, "transition_interval_s: must be at most 1000000000"),
    ("false_positives", {"model": "per_image", "rate": 1e150}, "rate: must be at most 1000"),
    ("states.fog.confidence.size_reference_px", 5e-324, "size_reference_px: 4.94066e-324 is too small to calculate"),
    ("states.fog.confidence.std", 5e-324, "std: 4.94066e-324 is too small to calculate with"),
    ("states.fog.box_error.mean", [0, 0, 1e308, 0], "mean[2]: must be at most 1000000000"),
    ("false_positives", {"model": "calibratd"}, "unknown model 'calibratd' (did you mean 'calibrated'?)"),
    (
        "transition_matrix",
        [[0.9, 0.1], [0.2, 0.8]],
        "rows sum to one and its columns do not: it looks row-stochastic a",
    ),
    ("transition_matrix", [[0.9, 1.2], [0.1, -0.2]], "transition_matrix[0][1]: must be "),
    ("transition_matrix", [[0.9, 0.2], [0.2, 0.9]], "'clear' sums to 1.1, must sum to 1; column 'fog' sums to 1.1, m"),
    ("transition_matrix", [[1.0]], "transition_matrix: is 1 × 1, must be 2 × 2: one row and one column"),
    ("transition_matrix", [[1.0, 0.0], [1.0]], "transition_matrix: its rows have different lengths: 2, 1"),
    ("transition_matrix", [], "transition_matrix: is 0 × 0, must be 2 × 2"),
    (CONFUSION, [[0.5, 0.2], [0.1, 0.4], [0.44, 0.4]], "sums to 1.04, must sum to 1; to change misses alone, set miss"),
    (CONFUSION, [[50, 20], [10, 40], [40, 40]], "counts (50), must have shares of each true label; modsim3d.learn_"),
    (f"{ERROR}.std", [0.1, 0.1], "states.fog.box_error: std: a number from 0 is needed, or a list of one for each of"),
    (f"{ERROR}.std", -0.1, "for each of e_x, e_y, e_w, e_h (got -0.1)"),
    (CONFUSION, [[0.5, 0.2], [0.1, 0.4], [0.4, 0.401]], "states.fog.confusion: column 'motor' sums to 1.001"),
    (CONFUSION, [[0.5, 0.1, 0.4], [0.2, 0.4, 0.4]], "sail, motor; it looks row-stochastic and must be transposed"),
    (CONFUSION, [[0.5, 0.2], [0.5, 0.8]], "is 2 × 2, must be 3 × 2: rows sail, motor, background; columns"),
    (CONFUSION, [[0.5, 0.2], [0.1, 0.4], [float("nan"), 0.4]], "states.fog.confusion[2][0]"),
    ("states.fog.false_positive_labels", [1.0], "states.fog.false_positive_labels: has 1 entries, must have"),
    ("states.fog.false_positive_labels", [0.5, 0.6], "states.fog.false_positive_labels: sums to 1.1"),
    (FALSE, 1, "must be below 1: it is the share of false positives among all detections, and 1 would take infinitely"),
    ("states.fog.false_discovery_rate", -0.2, "states.fog.false_discovery_rate: is -0.2, must be from 0 to 0.99"),
    ("states.fog.box_error.unit", "m", "fog.box_error.unit: must be 'px', 'relative' or 'mixed' (got 'm')"),
    ("states.fog.box_error.mean", [1, 2, 3], "states.fog.box_error.mean: has 3 entries, must have 4: e_x"),
    (COVARIANCE, SKEWED, "covariance: is not symmetric: row e_x, column e_w is 1150, row e_w, column e_x is 1157"),
    (COVARIANCE, INDEFINITE.tolist(), "definite, so no errors can have it: its smallest eigenvalue is -2, must be"),
    (COVARIANCE, (INDEFINITE * 1e8).tolist(), "smallest eigenvalue is -2e+08"),  # without overflow
    (COVARIANCE, [[1.0]], "covariance: is 1 × 1, must be 4 × 4: rows and columns e_x"),
    (SCORES, {"mean": 0.6, "std": -0.1}, "states.fog.confidence.std: must be "),
    (SCORES, {"mean": 67, "std": 0.1}, "states.fog.confidence.mean: must be at most"),
    ("states.fog.drop_out", 0.3, "states.fog.drop_out: unknown key"),
    ("dropout", {"model": "logistc"}, "dropout.model: must be 'confusion', 'logistic' or 'table'"),
    ("dropout", {"model": "logistic"}, "needs at least one of visible_fraction, partly_hidden, size_px, distance_m"),
    ("dropout", {"model": "confusion", "size_px": SLOPE}, "model confusion has no size_px"),
    ("dropout", {"model": "table", "size_px": SLOPE}, "size_px: model table needs edges and odds"),
    ("dropout", {"model": "logistic", "size_px": {"per_unit": 1}}, "a reference at which nothing changes"),
    ("dropout", {"model": "logistic", "size_px": SLOPE | {"per_unit": 1}}, "exactly one of per_unit and per_doubling"),
    ("dropout", {"model": "logistic", "size_px": SLOPE | {"reference": 0}}, "it must be above 0 with per_doubling"),
    ("dropout", {"model": "table", "size_px": {"edges": [9, 4], "odds": [1, 1, 1]}}, "must ascend (got 9, 4)"),
    ("dropout", {"model": "table", "size_px": {"edges": [9], "odds": [1]}}, "has 1 edges and 1 odds"),
    ("dropout", {"model": "table", "size_px": {"edges": [9], "odds": [1, 0]}}, "dropout.size_px.odds[1]"),
    ("dropout", {"model": "logistic", "siz_px": SLOPE}, "dropout.siz_px: unknown key (did you mean 'size_px'?)"),
    ("gates", {"max_detections": 0}, "gates.max_detections: must be above 0"),
    ("gates", {"max_occlusion": 2}, "gates.max_occlusion: must be at most 1"),
    ("persistence", {"class_s": -1}, "persistence.class_s: must be at least 0"),
    ("performance", {"schedule": [[5, "fgo"]]}, "unknown state 'fgo' (did you mean 'fog'?)"),
    ("performance", {"schedule": [[5, "fog"], [5, "clear"]]}, "must ascend (got 5, 5)"),
    ("performance", {"scope": "each"}, "performance.scope: must be 'shared' or 'per_camera'"),
    ("false_positives", {"model": "thesis", "far_half_px": 9}, "false_positives.far_half_px: model thesis has its own"),
    ("false_positives", {"model": "per_image"}, "missing in clear, fog"),
    ("false_positives", {"model": "calibrated", "rate": 1}, "false_positives.rate: model calibrated has none"),
    ("false_positives", {"model": "calibrated", "band_px": 9}, "goes with placement horizon_band"),
    ("false_positives", {"model": "calibrated", "placement": "density"}, "goes with placement density"),
    ("false_positives", {"model": "calibrated", "density": [[1], [1, 2]]}, "must have rows of one length"),
    ("false_positives", {"model": "calibrated", "density": [[0, 0]]}, "must have a weight above 0"),
    ("false_positives", {"model": "calibrated", "size": {"model": "fixed"}}, "px [width, height] goes with model f"),
    ("false_positives", {"model": "calibrated", "duplicates": 0.3}, "may make 0.3: lower them, or choose per_image"),
    ("false_positives", {"model": "calibrated", "persistence": {"lifetime_s": 0}}, "must be at least 0.01"),
    ("states.fog.false_positives_per_image", 1, "model calibrated has none"),
    ("states.fog.box_error.unit", "mixed", "growth goes with unit mixed"),
    ("states.fog.box_error.growth", [1, 1, 1], "growth: has 3 entries, must have 4"),
    (SCORES, {"mean": 0.5}, "give mean and std, or true and false, or precision_recall"),
    (SCORES, {True: {"mean": 0.5, "std": 0}}, "give mean and std, or true and false"),
    (SCORES, {True: {"mean": 0.5}, False: {"mean": 0.5, "std": 0}}, "confidence.true: give either mean"),
    (SCORES, {True: {"quantiles": [0.5, 0.4]}, False: {}}, "must not fall: they are quantiles"),
    (SCORES, {"precision_recall": [[0.5, 0.6], [0.4, 0.6]]}, "recalls must ascend"),
    (SCORES, {"precision_recall": [[0.5, 0.1], [0.6, 0.9]]}, "no detector has such a curve"),
    (SCORES, {"precision_recall": [[0.9, 0.6]]}, "ends at recall 0.9, but the confusion matrix"),
    (SCORES, {"precision_recall": [[0.6, 0.8]]}, "ends at precision 0.8, but false_disc"),
    ("states.fog.box_error", GROWTH, "e_y can only grow from a variance above 0"),
    ("operating_threshold", 0.1, "operating_threshold: is 0.1, must be at least 0.2, the confidence_threshold"),
    (FALSE, DELETED, "states.fog.false_discovery_rate: missing: model calibrated reads it"),
    (ERROR, T | {NU: 2}, "is 2, must be from 2.1 to 1000: near 2"),
    (ERROR, T | {NU: 1e6}, "is 1e+06, must be from 2.1"),
    (ERROR, T | {NU: None}, "law student_t needs degrees_of_freedom"),
    (ERROR, T | {"law": "normal"}, "law normal has no degrees_of_freedom"),
    (ERROR, T | {"law": "studnet_t"}, "unknown law 'studnet_t'"),
    *(("persistence", {"box_vessel_share": share}, "box_vessel_share") for share in (1.0, -0.1, "half")),
    (SHARE, {"vessel_share": 0.7, "shares": [0.4], "times_s": [1]}, "sum to 1.1, must not exceed 1"),
    (SHARE, {"shares": [0.4]}, "1 shares and 0 times_s"),
    (SHARE, {"shares": [0.4], "times_s": [0]}, "times_s"),
    ("persistence", {"score": {"vessel_share": 0.3}, "confidence_s": 1.0}, "confidence_s: with a score"),
    ("persistence", {"box": MEMORY, "box_s": 1.0}, "with a memory of each component, box, leave them out"),
    (BOX, MEMORY | {"vessel_share": [0.5, 0.1]}, "vessel_share has 2 numbers, must have one each for e_x, e_y, e_w, e"),
    (BOX, MEMORY | {"shares": [[0.1] * 4, [0.1] * 5]}, "shares has 4 numbers"),
    (BOX, MEMORY | {"times_s": [1.0]}, "has 2 lists of shares and 1 times_s"),
    (BOX, MEMORY | {"vessel_share": [0.9, 0, 0, 0, 0]}, "of a component sum to 1.7, must not exceed 1"),
    *((key, DELETED, f"{key}: missing") for key in ("labels", "states", "transition_matrix", "initial_state")),
    *(("states", value, "states") for value in (None, [1], "fog", {"fog": None})),
]


@pytest.mark.parametrize("std", [0.05, 2, [0.05, 0.04, 0.1, 0.2]])
def test_a_standard_deviation_is_short_for_a_covariance_in_whose_place_it_is(std: Any) -> None:
    numbers = std if isinstance(std, list) else [std] * 4
    short = parse_detector(changed(ERROR, {"unit": "relative", "std": std})).states[1].box_error
    np.testing.assert_array_equal(short.covariance, np.diag([number**2 for number in numbers]))
    assert short.mean.tolist() == [0] * 4
    both = parse_detector(changed(f"{ERROR}.std", std)).states[1].box_error
    np.testing.assert_array_equal(both.covariance, short.covariance)
    assert both.mean.tolist() == list(build.MEAN_PX)


def test_every_bad_value_is_told_and_singular_covariances_and_clipped_confidences_are_accepted():
    model = parse_detector(changed(SCORES, {"mean": 1.3, "std": 0.2}), "detector")
    assert model.states[1].confidence.true == NormalScores(1.3, 0.2)
    for path, value, message in BAD:
        assert message in "\n".join(problems(changed(path, value))), (path, value)
    wrong = {
        "clear": build.state_data(false_discovery_rate=1.0, confidence={"mean": 0.5, "std": -1}),
        "fog": build.state_data(
            confusion=[[0.5, 0.2], [0.1, 0.4], [0.5, 0.5]], box_error=build.box_error([0, 0, 0], -np.eye(4))
        ),
    }
    matrix = [[0.9, 0.2], [0.2, 0.8]]
    data = build.detector_data(confidence_threshold=2, initial_state="storm", transition_matrix=matrix, states=wrong)
    assert [problem.split(": ")[0] for problem in problems(data)] == [
        *("confidence_threshold", "initial_state", "transition_matrix", "states.clear.false_discovery_rate"),
        *("states.clear.confidence.std", "states.fog.confusion", "states.fog.box_error.mean"),
        "states.fog.box_error.covariance",
    ]
    data = changed("false_positives", {"model": "calibrated", "rate": 1, "band_px": 3, "duplicates": 0.9})
    assert [problem.split(":")[0] for problem in problems(data)] == [
        *("false_positives.rate", "false_positives.band_px"),
        *("states.clear.false_discovery_rate", "states.fog.false_discovery_rate"),
    ]
    for covariance in (np.outer([1, 2, 3, 4], [1, 2, 3, 4]), np.zeros((4, 4))):
        data = changed("states.fog.box_error", build.box_error([0, 0, 0, 0], covariance))
        assert np.array_equal(parse_detector(data).states[1].box_error.covariance, covariance)
    model = parse_detector(changed("states.fog.confusion", [[0.3333333, 0.2], [0.3333333, 0.4], [0.3333333, 0.4]]))
    assert abs(model.states[1].confusion.sum(axis=0) - 1).max() < 1e-15
    data = build.detector_data(initial_state="fog", transition_interval_s=5)
    del data["false_positives"]
    model = parse_detector(data)
    assert (model.labels, model.initial_state, model.transition_interval_s) == (("sail", "motor"), 1, 5)
    assert model.false_positives.model == "calibrated"  # by default
    assert [state.name for state in model.states] == ["clear", "fog"]
    fog = model.states[1]
    assert fog.confusion.tolist() == [[0.5, 0.2], [0.1, 0.4], [0.4, 0.4]]
    assert (fog.false_discovery_rate, fog.confidence.true) == (0.4, NormalScores(0.4, 0.2))
    for array in (fog.confusion, fog.box_error.mean, fog.box_error.covariance):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    data, targets, frames = build.detector_data(), scattered_targets(), build.make_frames(120)
    apart = copy.deepcopy(data) | OFF
    for state in apart["states"].values():
        normal = state["confidence"]
        state["confidence"] = {True: dict(normal), False: dict(normal), "visibility_slope": 0, "size_slope": 0}
    assert not parse_detector(apart).needs_target_statistics
    assert build.all_bytes(build.run(apart, frames, targets)) == build.all_bytes(build.run(data, frames, targets))


ROOT = Path(__file__).resolve().parents[2]
DETECTORS = ROOT / "scenes" / "detectors"


def load(name: str) -> DetectorModel:
    return load_detector(DETECTORS / f"{name}.yaml")


def test_the_script_writes_every_detector_file_and_what_is_no_mapping_or_no_file_is_refused(tmp_path):
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, ROOT / "script" / "make_detectors", tmp_path], check=True, env=environment)
    by_hand = {"coastal", "rich", "vessel"}
    shipped = {path.name: path.read_bytes() for path in DETECTORS.glob("*.yaml") if path.stem not in by_hand}
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == shipped
    assert len(shipped) == 4
    model = load("thesis")
    assert model.labels == ("Vessel",) and model.false_positives.model == "calibrated"
    assert [state.name for state in model.states] == ["excellent", "good", "bad", "terrible"]
    np.testing.assert_allclose([state.confusion[1, 0] for state in model.states], [0.133, 0.151, 0.245, 0.381])
    assert [state.false_discovery_rate for state in model.states] == [0.089, 0.113, 0.115, 0.255]
    assert model.states[1].box_error.covariance[0].tolist() == [3328, 87, -301, -220]
    assert model.states[3].box_error.mean.tolist() == [4.0, 8.2, -24.1, -8.9]
    assert model.transition_matrix[1, 0] == pytest.approx(0.0085)
    assert {state.confidence.true for state in model.states} == {NormalScores(0.67, 0.1)}
    ours, original = (yaml.safe_load((DETECTORS / f"{n}.yaml").read_text()) for n in ("thesis", "thesis_original"))
    assert original.pop("false_positives") == {"model": "thesis"}
    del ours["false_positives"]
    assert ours == original
    model = load("three_labels")
    assert model.labels == ("sailboat", "motorboat", "ferry")
    assert [state.confusion.shape for state in model.states] == [(4, 3), (4, 3)]
    assert all(np.all(state.confusion > 0) for state in model.states)
    (state,) = load("experiment_1").states
    assert state.false_discovery_rate == 0.119
    assert state.box_error.covariance[1].tolist() == [1.6, 12.2, -0.2, -13.9]
    for data in (None, [], "thesis", 3):
        assert "must be a mapping with the keys labels" in problems(data)[0]
    with pytest.raises(InputError, match=r"nothing\.yaml"):
        load_detector(tmp_path / "nothing.yaml")
    (tmp_path / "part.yaml").write_text("true: {mean: 0.7, std: 0.1}\nfalse: {mean: 0.4, std: 0.2}\n")
    model = parse_detector(changed("states.fog.confidence", load_yaml(tmp_path / "part.yaml", "part")))
    assert model.states[1].confidence.true == NormalScores(0.7, 0.1)
    assert model.states[1].confidence.false.mean == 0.4  # type: ignore[attr-defined]


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
