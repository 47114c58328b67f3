"""A detector that is simulated and learned again, and what was asked of it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import yaml

from modsim3d.detector.model import ERROR_PAIRS
from modsim3d.runs.run import run_scene
from modsim3d.scene.reading import data_folder, load_scene

ROOT = Path(__file__).resolve().parents[2]
DETECTOR = ROOT / "tests" / "data" / "learn" / "round_trip.yaml"
LABELS = ("sailboat", "motorboat", "ferry")


def simulate(name: str, folder: Path, mode: int, steps: int | None = None, seed: int = 0, detector=DETECTOR) -> Path:
    """Run a shipped scene with vessels of three labels and the detector; gives the run directory."""
    scene = yaml.safe_load((data_folder("scenes") / f"{name}.yaml").read_text())
    for number, vessel in enumerate(scene["vessels"].values()):
        vessel["label"] = LABELS[number % 3]
    scene["detector"] = str(detector)
    scene["annotation"] = {"mode": mode, "source": "analytic"}
    scene["seed"] = seed
    scene["steps"] = steps or scene["steps"]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.json"
    path.write_text(json.dumps(scene))
    run_scene(load_scene(str(path)), folder / "run", overwrite=True)
    return folder / "run"


def asked_of(path: Path = DETECTOR) -> dict[str, np.ndarray]:
    """The numbers of the detector file by the paths that learning gives them."""
    content = yaml.safe_load(path.read_text())
    clutter = content["false_positives"]
    density = np.array(clutter["density"], dtype=float)
    asked = {
        "transition_matrix": content["transition_matrix"],
        "dropout.size_px.per_doubling": content["dropout"]["size_px"]["per_doubling"],
        "persistence.class_s": content["persistence"]["class_s"],
        "persistence.box_s": content["persistence"]["box_s"],
        "false_positives.density": density / density.sum(),
        "false_positives.size.px": clutter["size"]["px"],
        "false_positives.size.log_std": clutter["size"]["log_std"],
    }
    for key in ("duplicates", "merges", "splits"):
        if key in clutter:
            asked[f"false_positives.{key}"] = clutter[key]
    for name, state in content["states"].items():
        covariance = np.array(state["box_error"]["covariance"])
        std = np.sqrt(np.diag(covariance))
        asked |= {
            f"states.{name}.confusion": state["confusion"],
            f"states.{name}.false_positive_labels": state["false_positive_labels"],
            f"states.{name}.false_discovery_rate": state["false_discovery_rate"],
            f"states.{name}.box_error_mean": state["box_error"]["mean"],
            f"states.{name}.box_error_std": std,
            f"states.{name}.box_error_correlation": [covariance[i, j] / (std[i] * std[j]) for i, j in ERROR_PAIRS],
        }
        if "degrees_of_freedom" in state["box_error"]:
            asked[f"states.{name}.box_error_degrees_of_freedom"] = state["box_error"]["degrees_of_freedom"]
        for kind, scores in state["confidence"].items():
            for key, value in scores.items():
                asked[f"states.{name}.confidence.{str(kind).lower()}.{key}"] = value
    return {path: np.array(value, dtype=float) for path, value in asked.items()}


def outside(asked, intervals) -> dict[str, int]:
    """How many numbers of each path lie outside their intervals; a path that was not learned has all outside."""
    intervals = {each.key.path: (each.low, each.high) for each in intervals}
    found = {}
    for path, value in asked.items():
        if path not in intervals:
            found[path] = value.size
            continue
        low, high = intervals[path]
        wrong = int(np.sum((value < low - 1e-9) | (value > high + 1e-9)))
        if wrong:
            found[path] = wrong
    return found
