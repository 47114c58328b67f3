"""A detector that is simulated and learned again, and what was asked of it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from typer.testing import CliRunner, Result

from modsim3d import load_scene, run_scene
from modsim3d.cli.main import app
from modsim3d.detector.model import ERROR_PAIRS
from modsim3d.io.input_files import data_folder

ROOT = Path(__file__).resolve().parents[2]
DETECTOR = ROOT / "tests" / "data" / "learn" / "round_trip.yaml"
SETTINGS = {"reference", "merge_overlap", "split_aspect", "edges", "rate", "times_s"}
"""Numbers of a detector file that stand beside those that are learned."""


def command(*words: object) -> Result:
    """What a command says on a wide terminal; its errors are raised."""
    return CliRunner().invoke(app, [*map(str, words)], catch_exceptions=False, env={"COLUMNS": "300"})


def simulate(name: str, folder: Path, mode: int, steps=None, seed=0, detector=DETECTOR, image_size_px=None) -> Path:
    """Run a shipped scene with vessels of the detector's labels and the detector; gives the run directory. With a size,
    images are the middles of the cameras' images, of that size."""
    scene = yaml.safe_load((data_folder("scenes") / f"{name}.yaml").read_text())
    if isinstance(scene["vessels"], str):  # in files of their own
        scene["vessels"] = json.loads((data_folder("scenes") / scene["vessels"]).read_text())
        scene["poses"]["file"] = str(data_folder("scenes") / scene["poses"]["file"])
    labels = yaml.safe_load(Path(detector).read_text())["labels"]
    for number, vessel in enumerate(scene["vessels"].values()):
        vessel["label"] = labels[number % len(labels)]
        vessel.pop("mesh", None)  # exact geometry of shoeboxes is quick
    scene["detector"] = str(detector)
    scene["annotation"] = {"mode": mode, "source": "analytic"}
    scene["seed"] = seed
    for camera in scene["cameras"].values() if image_size_px else ():
        camera |= {"image_size_px": image_size_px, "principal_point_px": [side / 2 for side in image_size_px]}
    scene["steps"] = steps or scene["steps"]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.json"
    path.write_text(json.dumps(scene))
    run_scene(load_scene(str(path)), folder / "run", overwrite=True)
    return folder / "run"


def asked_of(path: Path = DETECTOR) -> dict[str, np.ndarray]:
    """The numbers of the detector file by the paths that learning gives them."""
    content = yaml.safe_load(path.read_text())
    asked = {"transition_matrix": content["transition_matrix"]}
    for section in ("dropout", "persistence", "false_positives"):
        asked |= _numbers_below(section, content.get(section, {}))
    if "false_positives.density" in asked:
        density = np.array(asked["false_positives.density"], dtype=float)
        asked["false_positives.density"] = density / density.sum()
    per_image = content["false_positives"]["model"] == "per_image"
    number = "false_positives_per_image" if per_image else "false_discovery_rate"
    for name, state in content["states"].items():
        covariance = np.array(state["box_error"]["covariance"])
        std = np.sqrt(np.diag(covariance))
        asked |= {
            f"states.{name}.confusion": state["confusion"],
            f"states.{name}.false_positive_labels": state["false_positive_labels"],
            f"states.{name}.{number}": state[number],
            f"states.{name}.box_error_mean": state["box_error"]["mean"],
            f"states.{name}.box_error_std": std,
            f"states.{name}.box_error_correlation": [covariance[i, j] / (std[i] * std[j]) for i, j in ERROR_PAIRS],
        }
        law, prefix = state["box_error"], f"states.{name}.box_error"
        asked |= {f"{prefix}_{key}": law[key] for key in ("degrees_of_freedom", "growth") if key in law}
        asked |= _numbers_below(f"states.{name}.confidence", state["confidence"])
        asked |= _numbers_below(f"states.{name}.dropout", state.get("dropout", {}))
    return {path: np.array(value, dtype=float) for path, value in asked.items()}


def _numbers_below(path: str, section: dict[str, Any]) -> dict[str, Any]:
    """Numbers and lists of numbers of a section by their paths, without those that are not learned."""
    found = {}
    for key, value in section.items():
        below = f"{path}.{str(key).lower()}"  # YAML reads `true` as a truth value
        if isinstance(value, dict):
            found |= _numbers_below(below, value)
        elif key not in SETTINGS and not isinstance(value, str):
            found[below] = value
    return found


def outside(asked, intervals) -> dict[str, int]:
    intervals, found = {each.key.path: (each.low, each.high) for each in intervals}, {}
    for path, value in asked.items():
        low, high = intervals.get(path, (np.inf, np.inf))
        wrong = int(np.sum((value < low - 1e-9) | (value > high + 1e-9)))
        found |= {path: wrong} if wrong else {}
    return found
