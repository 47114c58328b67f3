"""A key of a detector file changes the detections, or is said not to be read; the page knows every key."""

import copy
import re
import typing
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pydantic import BaseModel

from modsim3d.core.errors import InputError
from modsim3d.detector.file.reading import file_of, load_detector, parse_detector, shipped_detectors
from modsim3d.detector.file.schema import DetectorFile
from modsim3d.detector.file.unread_keys import dead_lines, unread_settings
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import KINDS, Detections
from modsim3d.io.strict_text import load_yaml
from modsim3d.scene.settings import Setting, changed
from tests.detector import detector_builders as build
from tests.detector.detector_builders import all_bytes, detector_data, state_data
from tests.detector.test_states import STEP_S, rich_frames, rich_targets
from tests.detector_variants import CHANGES, variant

SKEWED = [[0.002, 0, 0, 0], [0, 0.001, 0, 0], [0, 0, 0.003, 0], [0, 0, 0, 0.001]]
OTHERS: dict[str, list[Any]] = {
    **{"labels": [["x"], ["x", "y"], ["x", "y", "z"]], "confidence_threshold": [0.25], "operating_threshold": [0.65]},
    "initial_state": ["haze", "fog", "terrible"],
    "transition_matrix": [[[0.5, 0.5], [0.5, 0.5]], [[0.25] * 4] * 4, [[1]]],
    **{"transition_interval_s": [0.7], "scope": ["per_camera"], "schedule": [[[1, "haze"]], [[1, "terrible"]]]},
    "anchor": ["none", "state_rate"],
    "visible_fraction": [{"per_unit": -3, "reference": 0.5}, {"edges": [0.5], "odds": [1, 5]}],
    "partly_hidden": [{"per_unit": 1.5, "reference": 0}, {"edges": [0.5], "odds": [1, 5]}],
    "size_px": [{"per_doubling": -0.9, "reference": 20}, {"edges": [50], "odds": [1, 5]}],
    "distance_m": [{"per_doubling": 0.9, "reference": 20}, {"edges": [900], "odds": [1, 5]}],
    **{"intercept": [[0.5], [0.5] * 2, [0.5] * 3], "learned_log_odds": [[[0.5]], [[0.5]] * 2, [[0.5]] * 3]},
    **{"per_unit": [-2.5], "per_doubling": [-0.4], "reference": [0.3], "edges": [[700, 2000]]},
    **{"odds": [[2.0, 0.5, 1.0]], "max_range_m": [500], "min_box_px": [30], "max_occlusion": [0.5]},
    **{"update_interval_s": [0.5], "max_detections": [2], "class_s": [2.5], "box_s": [2.5], "confidence_s": [2.5]},
    **{"merge_s": [2.5], "class_vessel_share": [0.4], "box_vessel_share": [0.4], "score": [{"vessel_share": 0.4}]},
    **{"vessel_share": [0.2, [0.2] * 4], "shares": [[0.3], [[0.3] * 4]], "times_s": [[3.5]], "rate": [0.9]},
    **{"placement": ["uniform", "horizon_band", "density"], "band_px": [50], "density": [[[1, 0], [0, 1]]]},
    **{"far_half_px": [30], "size": [{"model": "fixed", "px": [30, 40]}], "px": [[30, 40]], "log_std": [0.9]},
    **{"persistence": [{"lifetime_s": 3, "share": 0.9}], "lifetime_s": [9.5], "drift_px_s": [99], "share": [0.3]},
    **{"duplicates": [0.04], "merges": [0.95], "merge_overlap": [0.01], "splits": [0.04], "split_aspect": [1.1]},
    "confusion": [[[0.5], [0.5]], [[0.5, 0.1, 0.1], [0.1, 0.5, 0.1], [0.1, 0.1, 0.5], [0.3, 0.3, 0.3]]],
    **{"false_positive_labels": [[0.1, 0.2, 0.7]], "false_discovery_rate": [0.5], "false_positives_per_image": [3.5]},
    "box_error": [{"unit": "relative", "mean": [0, 0, 0, 0], "covariance": SKEWED}],
    **{"unit": ["px", "relative"], "mean": [0.51, [0.1, 0.1, 0.1, 0.1]], "std": [0.2], "covariance": [SKEWED]},
    "box": [{"vessel_share": [0.4] * 4}],
    **{"degrees_of_freedom": [3], "law": ["normal"], "growth": [[0.1, 0.1, 0.1, 0.1]]},
    **{"true": [{"mean": 0.5, "std": 0.2}], "false": [{"mean": 0.5, "std": 0.2}], "quantiles": [[0.3, 0.5, 0.9]]},
    **{"precision_recall": [[[0.4, 0.99], [0.7, 0.8]]], "visibility_slope": [0.15], "size_slope": [0.15]},
    "size_reference_px": [500.0],
}
"""Name of a key → values of which at least one is another one than the file's and fits it."""


MEMORIES = {"persistence": {"box": {"vessel_share": [0.3] * 5, "shares": [[0.2] * 5], "times_s": [2.0]}}}


MODELS = {
    "dropout": ["logistic", "table", "confusion"],
    "false_positives": ["per_image", "thesis", "calibrated"],
    "size": ["fixed", "lognormal", "truth"],
}
STEPS = 400
FRAMES, TARGETS = rich_frames(STEPS), build.chunk(rich_frames(), rich_targets(), 0, STEPS)[1]
LAST_S = float(FRAMES.times_s[-1])


def paths(model: Any, data: dict[str, Any], *before: str) -> Iterator[tuple[str, ...]]:
    """Every key that a file may have, of sections that are not there too."""
    for name, field in model.model_fields.items():
        if (*before, name) == ("states",):
            for state in data["states"]:
                yield from paths(next(sections(field.annotation)), data, "states", state)
            continue
        inner = next(iter(sections(field.annotation)), None)
        if inner is None or name in OTHERS:
            yield (*before, name)
        if inner is not None:
            yield from paths(inner, data, *before, name)


def meaning(model: DetectorModel) -> dict[str, Any]:
    """The file with all defaults."""
    content = file_of(model).model_dump()
    if (content["false_positives"]["size"] or {}).get("model") == "truth":
        content["false_positives"]["size"] = None
    return content


def run(data: DetectorModel | dict[str, Any]) -> Detections:
    """What a detector makes of the targets, their labels counted round if it has others than three."""
    model = data if isinstance(data, DetectorModel) else parse_detector(copy.deepcopy(data))
    targets = replace(TARGETS, label=TARGETS.label % len(model.labels))
    return build.run(model, FRAMES, targets, step_s=STEP_S)


def output(data: dict[str, Any]) -> object:
    return parse_detector(copy.deepcopy(data)).labels, all_bytes(run(data))


def in_every_state(data: dict[str, Any]) -> dict[str, Any]:
    """The file with each state forced for a while, so that a run comes to all of them."""
    schedule = [[LAST_S * place / len(data["states"]), name] for place, name in enumerate(data["states"])]
    return {**data, "performance": {**data.get("performance", {}), "schedule": [*schedule, [0.98 * LAST_S, None]]}}


@pytest.mark.parametrize("name", [
    *(name for name in shipped_detectors() if not name.startswith("conditions/")),
    *("conditions/foggy_cloudy", "dropout by a table of distance", "Student's t box errors"),
    *("confidence from a precision-recall curve", "memories"),
])  # fmt: skip
def test_a_key_changes_the_detections_or_is_refused(name: str) -> None:
    made = {"memories": lambda: variant("plain") | MEMORIES, **{each: partial(variant, each) for each in CHANGES}}
    plain = made[name]() if name in made else load_yaml(shipped_detectors()[name], "detector")
    moving = in_every_state(plain)
    unchanged = {id(base): (output(base), meaning(parse_detector(base))) for base in (plain, moving)}
    silent, read = [], 0
    for path in paths(DetectorFile, plain):
        base = moving if path[0] == "states" else plain
        key, values = ".".join(path), MODELS[path[-2]] if path[-1] == "model" else OTHERS[path[-1]]
        for value in values:
            try:
                data, _ = changed(base, path, Setting(f"detector.{key}", value), ("detector",))
                model = parse_detector(copy.deepcopy(data))
            except InputError:
                continue
            before, meant = unchanged[id(base)]
            if meaning(model) == meant or unread_settings(model, [key]):
                continue
            read += 1
            if output(data) == before:
                silent.append(f"{key}={value}")
    assert not silent and read > 20


PER_IMAGE = {"false_positives": {"model": "per_image", "rate": 0.4}}


def two_states(**changes: Any) -> dict[str, Any]:
    data = detector_data(**copy.deepcopy(changes))
    if data["false_positives"]["model"] == "per_image":
        for state in data["states"].values():
            del state["false_discovery_rate"]
    return data


def own_rates() -> dict[str, Any]:
    data = two_states(**PER_IMAGE)
    for state in data["states"].values():
        state["false_positives_per_image"] = 0.5
    del data["false_positives"]["rate"]
    return data


def test_an_unread_key_is_told_with_the_one_that_works_and_a_dead_line_where_it_stands() -> None:
    for data, key, value, works in (
        (two_states(), "confidence_threshold", 0.4, "detector.operating_threshold"),
        (two_states(**PER_IMAGE), "states.clear.false_discovery_rate", 0.6, "detector.false_positives.rate"),
        (own_rates(), "states.fog.false_discovery_rate", 0.6, "detector.states.fog.false_positives_per_image"),
        (own_rates(), "false_positives.rate", 0.6, "detector.states.clear.false_positives_per_image"),
        (two_states(), "false_positives.merge_overlap", 0.5, "detector.false_positives.merges"),
        (two_states(), "persistence.merge_s", 0.5, "detector.false_positives.merges"),
        (two_states(), "false_positives.split_aspect", 2, "detector.false_positives.splits"),
        (two_states(), "dropout.anchor", "state_rate", "detector.dropout.model"),
        (two_states(), "states.fog.confidence.size_reference_px", 9, "detector.states.fog.confidence.size_slope"),
        (two_states(performance={"schedule": [[0, "fog"]]}), "states.clear.confidence.mean", 0.5, "in fog: set keys"),
        (two_states(performance={"schedule": [[0, "fog"]]}), "initial_state", "fog", "detector.performance.schedule"),
        (two_states(transition_matrix=[[1, 0], [0, 1]]), "states.fog.box_error.unit", "relative", "in clear"),
    ):
        set_data, _ = changed(data, key.split("."), Setting(f"detector.{key}", value), ("detector",))
        (reason,) = unread_settings(parse_detector(set_data), [key]).values() or [""]
        assert works in reason, key
    data = two_states(**PER_IMAGE)
    data["states"]["fog"] |= {"false_discovery_rate": 0.3}
    data["persistence"] = {"merge_s": 2}
    lines = [line.split(" in the")[0] for line in dead_lines(parse_detector(data))]
    assert lines == [f"nothing reads {key}" for key in ("states.fog.false_discovery_rate", "persistence.merge_s")]
    assert [line for path in shipped_detectors().values() for line in dead_lines(load_detector(path))] == []
    data = own_rates()
    data["false_positives"]["rate"] = 0.3
    (reason,) = unread_settings(parse_detector(data), ["false_positives"]).values()
    assert reason.startswith("false_positives.rate: each state has a rate of its own"), "a section with a dead line"
    model = parse_detector(two_states(false_positives={"model": "calibrated", "merges": 0.0, "merge_overlap": 0.5}))
    overlap, merges = "false_positives.merge_overlap", "false_positives.merges"
    assert unread_settings(model, [overlap])
    assert not unread_settings(model, [overlap, merges]) and not unread_settings(model, [overlap], [merges])
    state = parse_detector(two_states(**PER_IMAGE)).states[0]
    assert np.isnan(state.false_discovery_rate)
    assert repr(state) == "<PerformanceState clear: 0.4 false positives an image>"


def test_the_operating_threshold_drops_what_is_below_it_and_every_key_is_in_the_table_of_the_page():
    data = load_yaml(shipped_detectors()["rich"], "detector")
    whole, above = run(data), run(data | {"operating_threshold": 0.5})
    kept = whole.confidence >= 0.5
    assert (~kept & whole.false()).any() and (~kept & ~whole.false()).any() and kept.any()
    for column in ("frame", "target", "kind", "label", "boxes_px", "confidence"):
        np.testing.assert_array_equal(getattr(above, column), getattr(whole, column)[kept])
    assert above.gated[whole.target[~kept & ~whole.false()]].all()
    np.testing.assert_array_equal(above.states, whole.states)
    data = detector_data(states={"clear": state_data(), "fog": state_data(confidence={"mean": 0.2, "std": 0.2})})
    found = run(data)  # at the confidence threshold it drops nothing
    assert (found.confidence == 0.2).any()
    assert all_bytes(found) == all_bytes(run(data | {"operating_threshold": 0.2}))
    table = PAGE.split("## Every key")[1].split("\n## ")[0]
    words = set(re.findall(r"[a-z_]+", " ".join(re.findall(r"`([^`]+)`", table))))
    assert not set(keys(DetectorFile)) - words
    assert all(f"`{kind}`" in PAGE for kind in KINDS)
    (block,) = re.findall(r"```yaml\n(dropout:\n.*?)```", PAGE, flags=re.DOTALL)
    model = parse_detector(detector_data(**yaml.safe_load(block)))
    assert model.dropout.anchored and len(model.dropout.effects) == 2
    assert f"in {len(shipped_detectors()['rich'].read_text().splitlines())} lines" in PAGE


PAGE = (Path(__file__).resolve().parents[2] / "docs" / "detector.md").read_text(encoding="utf-8")


def sections(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in typing.get_args(annotation):
        yield from sections(part)


def keys(model: type[BaseModel]) -> Iterator[str]:
    for name, field in model.model_fields.items():
        yield name
        for section in sections(field.annotation):
            yield from keys(section)
