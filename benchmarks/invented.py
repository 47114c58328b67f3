"""Models that learning finds in runs of the shipped detectors, beside those that they have."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.matching import Rule
from modsim3d.formats.reading.coco import read_coco
from modsim3d.formats.writing.coco import write_coco
from modsim3d.io.input_files import data_folder
from modsim3d.learn.learned_detector import LearnSettings, learn
from modsim3d.learn.states import Transitions, each_its_own
from tests.learn.one_state import observed_as
from tests.learn.round_trip import simulate

METHODS = {"confidence": "IoU", "provenance": "provenance"}
REPLICATES = 20
"""Which models are chosen does not depend on them."""


@dataclass(frozen=True)
class Shipped:
    """A shipped detector in a shipped scene, with its annotation mode and steps."""

    detector: str
    scene: str
    mode: int
    steps: int

    @property
    def name(self) -> str:
        """What it is called by `--case`."""
        return f"shipped_{self.detector}"

    @property
    def path(self) -> Path:
        """The detector file."""
        return data_folder("scenes") / "detectors" / f"{self.detector}.yaml"


SHIPPED = (
    Shipped("thesis", "simulation_1", 0, 1500),
    Shipped("coastal", "strait", 2, 300),
    Shipped("rich", "harbour", 2, 400),
)


def models_in(file: Mapping[str, Any]) -> set[str]:
    """Models of a detector file that the plainest one does not have, by their keys; those of states by state."""
    false, dropout = file.get("false_positives", {}), file.get("dropout", {})
    found = {f"persistence.{key}" for key, value in file.get("persistence", {}).items() if value}
    found |= {f"dropout.{key}" for key, value in dropout.items() if isinstance(value, dict)}
    found |= {f"false_positives.{key}" for key in ("on_vessels", "duplicates", "merges", "splits") if false.get(key)}
    found |= {f"false_positives.{key}" for key in ("persistence", "density", "band_px", "far_half_px") if key in false}
    for name, state in file["states"].items():
        error, confidence = state["box_error"], state["confidence"]
        laws = [error["unit"]] if error["unit"] != "px" else []
        laws += [error["law"]] if error.get("law", "normal") != "normal" else []
        found |= {f"states.{name}.box_error: {law}" for law in laws}
        kinds = [key for key in ("visibility_slope", "size_slope") if confidence.get(key)]
        kinds += [f"{key}: quantiles" for key in (True, False) if "quantiles" in confidence.get(key, ())]
        found |= {
            f"states.{name}.confidence.{kind}".replace("True", "true").replace("False", "false") for kind in kinds
        }
        found |= {
            f"states.{name}.dropout.{key}" for key, each in state.get("dropout", {}).items() if isinstance(each, dict)
        }
    return found


def invented(case: Shipped, seed: int) -> dict[str, dict[str, list[str]]]:
    """By way of matching: `invented` models, which the file does not have, and `missing` ones, from one run."""
    asked = yaml.safe_load(case.path.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        run = simulate(case.scene, Path(folder), case.mode, case.steps, seed, case.path)
        as_run, _ = labelled_run(run)
        as_files = read_coco("all", *write_coco(as_run, run.parent / "coco"))
    states = each_its_own(tuple(asked["states"]))
    chain = Transitions(np.zeros((len(states.names), len(states.names))))
    result = {}
    for method in METHODS:
        labelled = as_run if method == "provenance" else as_files
        image_state = states.of_images(labelled.images, labelled.conditions)
        settings = LearnSettings(Rule(method), replicates=REPLICATES, seed=seed)
        observed = observed_as(labelled, states.names, image_state, settings.rule)
        file = yaml.safe_load(yaml.safe_dump(learn(observed, chain, settings).detector()))
        seen = {
            f"states.{name}." for name, number in zip(states.names, np.bincount(image_state), strict=False) if number
        }
        expected = {each for each in models_in(asked) if not each.startswith("states.") or each.startswith(tuple(seen))}
        result[method] = {
            "invented": sorted(models_in(file) - models_in(asked)),
            "missing": sorted(expected - models_in(file)),
        }
    return result


def section(results: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """The section of the page; nothing without results."""
    if not results:
        return []
    lines = [
        "## Shipped detectors",
        "",
        "Models that are learned in runs of a shipped detector although its file does not have them, and those that it "
        "has and are not learned, with the number of seeds. What one way of matching cannot see is missing: boxes "
        "that the thesis's errors carry away from their vessels match nothing by IoU.",
        "",
        "| detector | seeds | matched by | invented | missing |",
        "|---|---|---|---|---|",
    ]
    for case in SHIPPED:
        runs = results.get(case.name, {}).get("runs", [])
        for method, words in METHODS.items() if runs else ():
            cells = (_counts(runs, method, kind) for kind in ("invented", "missing"))
            where = f"`{case.detector}` in {case.scene}, {case.steps:,} steps"
            lines.append(f"| {where} | {len(runs)} | {words} | {' | '.join(cells)} |")
    return [*lines, ""]


def _counts(runs: list[dict[str, dict[str, list[str]]]], method: str, kind: str) -> str:
    counts = Counter(name for run in runs for name in run[method][kind])
    return ", ".join(f"{name} {number}" for name, number in sorted(counts.items())) or "none"
