"""The thesis's detector with one further model switched on at a time."""

import copy
from collections.abc import Callable
from typing import Any

from modsim3d.io.input_files import data_folder
from modsim3d.io.strict_text import load_yaml

Data = dict[str, Any]


def thesis_data() -> Data:
    data: Data = load_yaml(data_folder("scenes") / "detectors" / "thesis.yaml", "detector")
    return data


def _every_state(change: Callable[[Data], None]) -> Callable[[Data], None]:
    def apply(data: Data) -> None:
        for state in data["states"].values():
            change(state)

    return apply


def _with(**sections: Any) -> Callable[[Data], None]:
    return lambda data: data.update(copy.deepcopy(sections))


def _relative(state: Data) -> None:
    error = state["box_error"]
    error.update(unit="relative", mean=[0.02, 0.03, -0.05, 0.01])
    error["covariance"] = [[value / 10_000 for value in row] for row in error["covariance"]]


def _mixed(state: Data) -> None:
    error = state["box_error"]
    error.update(unit="mixed", growth=[0.05, 0.05, 0.1, 0.1])
    error["covariance"] = [[value / 16 for value in row] for row in error["covariance"]]


def _heavy_tails(state: Data) -> None:
    state["box_error"].update(law="student_t", degrees_of_freedom=4)


def _apart(state: Data) -> None:
    state["confidence"] = {"true": {"mean": 0.75, "std": 0.12}, "false": {"mean": 0.45, "std": 0.15}}
    state["confidence"] |= {"visibility_slope": 0.3, "size_slope": 0.04}


def _curve(state: Data) -> None:
    found, right = 1 - state["confusion"][-1][0], 1 - state["false_discovery_rate"]
    state["confidence"] = {"precision_recall": [[found / 2, 0.99], [found, right]]}


ON_VESSELS = {"share": 0.1, "lifetime_s": 0.5, "mean": [0.1, -0.1, 0.2, 0.3], "std": [0.3, 0.2, 0.2, 0.3]}
CHANGES: dict[str, Callable[[Data], None]] = {
    "plain": lambda data: None,
    "thesis false positives": _with(false_positives={"model": "thesis"}),
    "dropout by size and distance, anchored": _with(
        dropout={"model": "logistic", "anchor": "state_rate"}
        | {"size_px": {"per_doubling": -0.6, "reference": 32}, "visible_fraction": {"per_unit": -1.0, "reference": 1.0}}
    ),
    "dropout by a table of distance": _with(
        dropout={"model": "table", "distance_m": {"edges": [1200, 1600], "odds": [0.6, 1.0, 1.8]}}
    ),
    "gates": _with(gates={"max_range_m": 1700, "min_box_px": 6, "max_occlusion": 0.6, "update_interval_s": 0.4}),
    "persistence of misses, 1 s": _with(persistence={"class_s": 1.0}),
    "persistence of box errors, 1 s": _with(persistence={"box_s": 1.0}),
    "persistence of misses and box errors, 10 s": _with(persistence={"class_s": 10.0, "box_s": 10.0}),
    "misses and box errors that never change": _with(persistence={"class_s": 1e9, "box_s": 1e9}),
    "persistence of confidence, 1 s": _with(persistence={"confidence_s": 1.0}),
    "relative box errors": _every_state(_relative),
    "mixed box errors": _every_state(_mixed),
    "Student's t box errors": _every_state(_heavy_tails),
    "false positives per image": _with(false_positives={"model": "per_image", "rate": 0.4}),
    "persistent false positives": _with(
        false_positives={"model": "calibrated", "persistence": {"lifetime_s": 2.0, "share": 0.5, "drift_px_s": 5}}
    ),
    "false positives on vessels": _with(false_positives={"model": "per_image", "rate": 0.2, "on_vessels": ON_VESSELS}),
    "doubled, split and merged boxes": _with(
        false_positives={"model": "calibrated", "duplicates": 0.03, "splits": 0.05, "split_aspect": 1.5, "merges": 0.3}
    ),
    "confidence of true and false apart, with slopes": _every_state(_apart),
    "confidence from a precision-recall curve": _every_state(_curve),
    "transitions every second": _with(transition_interval_s=1.0),
    "a chain for each camera": _with(performance={"scope": "per_camera"}),
    "a schedule": _with(performance={"schedule": [[60, "terrible"], [80, None]]}),
}
"""What the campaign calls a variant → the change of the detector file."""


def variant(name: str) -> Data:
    """The detector file of a variant."""
    data = thesis_data()
    CHANGES[name](data)
    return data
