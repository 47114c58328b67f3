"""What a detector file says of the models that it adds, and what is said when it is wrong."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from modsim3d.core.errors import InputError
from modsim3d.detector.confidence import NormalScores
from modsim3d.detector.file.reading import parse_detector
from modsim3d.io.strict_text import load_yaml
from tests.detector.detector_builders import all_bytes, detector_data, make_frames, run
from tests.detector.test_chain import scattered_targets

OFF = {
    "dropout": {"model": "confusion", "anchor": "state_rate"},
    "gates": {},
    "persistence": {"class_s": 0, "box_s": 0},
    "performance": {"scope": "shared", "schedule": []},
}
CLUTTER_OFF = {
    "model": "calibrated",
    "placement": "uniform",
    "size": {"model": "truth"},
    "duplicates": 0,
    "merges": 0,
    "splits": 0,
}


def changed(path: str, value: Any) -> dict[str, Any]:
    data = copy.deepcopy(detector_data())
    *sections, key = path.split(".")
    section = data
    for name in sections:
        section = section.setdefault(name, {})
    section[key] = value
    return data


def problems(data: Any) -> str:
    with pytest.raises(InputError) as caught:
        parse_detector(data)
    return "\n".join(caught.value.problems)


def test_models_that_are_switched_off_leave_every_byte_of_the_plain_chain() -> None:
    data = detector_data()
    targets, frames = scattered_targets(), make_frames(120)
    apart = copy.deepcopy(data) | OFF | {"false_positives": CLUTTER_OFF}
    for state in apart["states"].values():
        normal = state["confidence"]
        state["confidence"] = {True: dict(normal), False: dict(normal), "visibility_slope": 0, "size_slope": 0}
    assert not parse_detector(apart).needs_census
    assert all_bytes(run(parse_detector(apart), frames, targets)) == all_bytes(
        run(parse_detector(data), frames, targets)
    )


SLOPE = {"per_doubling": 1, "reference": 50}
BAD = [
    ("dropout", {"model": "logistc"}, "dropout.model: Input should be 'confusion', 'logistic' or 'table'"),
    ("dropout", {"model": "logistic"}, "needs at least one of visible_fraction, size_px, distance_m"),
    ("dropout", {"model": "confusion", "size_px": SLOPE}, "model confusion has no size_px"),
    ("dropout", {"model": "table", "size_px": SLOPE}, "size_px: model table needs edges and odds"),
    ("dropout", {"model": "logistic", "size_px": {"per_unit": 1}}, "a reference at which nothing changes"),
    ("dropout", {"model": "logistic", "size_px": SLOPE | {"per_unit": 1}}, "exactly one of per_unit and per_doubling"),
    ("dropout", {"model": "logistic", "size_px": SLOPE | {"reference": 0}}, "it must be above 0 with per_doubling"),
    ("dropout", {"model": "table", "size_px": {"edges": [9, 4], "odds": [1, 1, 1]}}, "must ascend (got 9, 4)"),
    ("dropout", {"model": "table", "size_px": {"edges": [9], "odds": [1]}}, "has 1 edges and 1 odds"),
    ("dropout", {"model": "table", "size_px": {"edges": [9], "odds": [1, 0]}}, "dropout.size_px.odds[1]"),
    ("dropout", {"model": "logistic", "siz_px": SLOPE}, "dropout.siz_px: unknown key (did you mean 'size_px'?)"),
    ("gates", {"max_detections": 0}, "gates.max_detections: Input should be greater than 0"),
    ("gates", {"max_occlusion": 2}, "gates.max_occlusion: Input should be less than or equal to 1"),
    ("persistence", {"class_s": -1}, "persistence.class_s: Input should be greater than or equal to 0"),
    ("performance", {"schedule": [[5, "fgo"]]}, "unknown state 'fgo' (did you mean 'fog'?)"),
    ("performance", {"schedule": [[5, "fog"], [5, "clear"]]}, "must ascend (got 5, 5)"),
    ("performance", {"scope": "each"}, "performance.scope: Input should be 'shared' or 'per_camera'"),
    ("false_positives", {"model": "thesis", "far_half_px": 9}, "false_positives.far_half_px: model thesis has its own"),
    ("false_positives", {"model": "per_image"}, "missing in clear, fog"),
    ("false_positives", {"model": "calibrated", "rate": 1}, "false_positives.rate: model calibrated has none"),
    ("false_positives", {"model": "calibrated", "band_px": 9}, "goes with placement horizon_band"),
    ("false_positives", {"model": "calibrated", "placement": "density"}, "goes with placement density"),
    ("false_positives", {"model": "calibrated", "density": [[1], [1, 2]]}, "must have rows of one length"),
    ("false_positives", {"model": "calibrated", "density": [[0, 0]]}, "must have a weight above 0"),
    (
        "false_positives",
        {"model": "calibrated", "size": {"model": "fixed"}},
        "px [width, height] goes with model fixed",
    ),
    ("false_positives", {"model": "calibrated", "duplicates": 0.3}, "may make 0.3: lower them, or choose per_image"),
    ("false_positives", {"model": "calibrated", "persistence": {"lifetime_s": 0}}, "greater than or equal to 0.01"),
    ("states.fog.false_positives_per_image", 1, "model calibrated has none"),
    ("states.fog.box_error.unit", "mixed", "growth goes with unit mixed"),
    ("states.fog.box_error.growth", [1, 1, 1], "growth: has 3 entries, must have 4"),
    ("states.fog.confidence", {"mean": 0.5}, "give mean and std, or true and false, or precision_recall"),
    ("states.fog.confidence", {True: {"mean": 0.5, "std": 0}}, "give mean and std, or true and false"),
    (
        "states.fog.confidence",
        {True: {"mean": 0.5}, False: {"mean": 0.5, "std": 0}},
        "confidence.true: give either mean",
    ),
    ("states.fog.confidence", {True: {"quantiles": [0.5, 0.4]}, False: {}}, "must not fall: they are quantiles"),
    ("states.fog.confidence", {"precision_recall": [[0.5, 0.6], [0.4, 0.6]]}, "recalls must ascend"),
    ("states.fog.confidence", {"precision_recall": [[0.5, 0.1], [0.6, 0.9]]}, "no detector has such a curve"),
    ("states.fog.confidence", {"precision_recall": [[0.9, 0.6]]}, "ends at recall 0.9, but the confusion matrix"),
    (
        "states.fog.confidence",
        {"precision_recall": [[0.6, 0.8]]},
        "ends at precision 0.8, but false_disc",
    ),
]


@pytest.mark.parametrize(("path", "value", "message"), BAD, ids=[f"{p}-{i}" for i, (p, _, _) in enumerate(BAD)])
def test_a_bad_value_is_told_with_what_would_be_right(path: str, value: Any, message: str) -> None:
    assert message in problems(changed(path, value))


def test_growth_needs_a_variance_to_grow_from() -> None:
    error = {"unit": "mixed", "mean": [0] * 4, "covariance": [[0] * 4] * 4, "growth": [0, 0.1, 0, 0]}
    assert "e_y can only grow from a variance above 0" in problems(changed("states.fog.box_error", error))


def test_every_contradiction_between_sections_is_told_at_once() -> None:
    data = changed("false_positives", {"model": "calibrated", "rate": 1, "band_px": 3, "duplicates": 0.9})
    found = problems(data)
    assert [line.split(":")[0] for line in found.splitlines()] == [
        "false_positives.rate",
        "false_positives.band_px",
        "states.clear.false_discovery_rate",
        "states.fog.false_discovery_rate",
    ]


def test_true_and_false_may_be_written_as_yaml_has_them(tmp_path: Any) -> None:
    (tmp_path / "part.yaml").write_text("true: {mean: 0.7, std: 0.1}\nfalse: {mean: 0.4, std: 0.2}\n")
    model = parse_detector(changed("states.fog.confidence", load_yaml(tmp_path / "part.yaml", "part")))
    assert model.states[1].confidence.true == NormalScores(0.7, 0.1)
    assert model.states[1].confidence.false.mean == 0.4  # type: ignore[attr-defined]
