"""Components of box errors that last differently long are learned as such, and those that last alike are not."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from modsim3d.campaign.drawn_detectors import LearnedUncertainty, drawn_detector
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.persistence import BoxMemory
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Rule, match
from modsim3d.learn.learned import Learned, LearnSettings, learn, uncertainty_text
from modsim3d.learn.matches import Observed
from modsim3d.learn.simulated_results import simulated
from modsim3d.learn.states import Transitions
from modsim3d.scene.settings import choose_detector
from tests.formats.labelled_sets import found, images, truth
from tests.learn.scored_sets import detector

FRAMES, BOATS, STEP_S = 400, 60, 0.5
MEMORY = {
    "vessel_share": [0.05, 0.45, 0.1, 0.2, 0.2],
    "shares": [[0.5, 0.05, 0.4, 0.3, 0.2], [0.1, 0.4, 0.1, 0.4, 0.4]],
    "times_s": [0.6, 5.0],
}
APART_S = np.array([0.5, 1, 2, 4, 8, 16])


def learned_again(persistence: dict[str, Any], seed: int) -> Learned:
    image, boat = np.repeat(np.arange(FRAMES), BOATS), np.tile(np.arange(BOATS), FRAMES)
    corner = np.column_stack([100 + 250.0 * (boat % 10), 200 + 250.0 * (boat // 10)])
    annotations = truth(image, np.zeros(len(boat), dtype=np.int64), np.hstack([corner, corner + 80]), identity=boat)
    frames = images(FRAMES, (2700.0, 1800.0), np.arange(FRAMES) * STEP_S)
    labelled = LabelledSet(("boat",), ("usual",), frames, annotations, found([], [], [], []))
    data = detector({"mean": 0.6, "std": 0.15}) | {"persistence": persistence, "labels": ["boat"]}
    data["states"]["usual"] |= {"confusion": [[0.9], [0.1]], "false_discovery_rate": 0.02, "false_positive_labels": [1]}
    data["states"]["usual"]["box_error"] = {
        "unit": "px",
        "law": "student_t",
        "degrees_of_freedom": 5,
        "mean": [0, 1, 0, 0],
        "covariance": np.diag([4.0, 3.0, 6.0, 3.0]).tolist(),
    }
    state = np.zeros(FRAMES, dtype=np.int64)
    labelled = simulated(labelled, state, parse_detector(data), seed)
    observed = Observed(labelled, match(labelled, Rule(), 0.2), ("usual",), state, 0.2)
    return learn(observed, Transitions(np.zeros((1, 1))), LearnSettings(replicates=40))


@pytest.fixture(scope="module")
def learned() -> Learned:
    return learned_again({"box": MEMORY}, 1)


def test_the_memory_of_each_component_is_learned_again(learned: Learned) -> None:
    memory = parse_detector(learned.detector()).persistence.box
    assert memory is not None
    asked = BoxMemory(np.array(MEMORY["vessel_share"]), np.array(MEMORY["shares"]), np.array(MEMORY["times_s"]))
    off = np.abs(memory.correlation(APART_S) - asked.correlation(APART_S))
    assert off[:, :4].max() < 0.09
    assert off[:, 4].max() < 0.15  # of how large errors are, which is seen through those that are large
    kept = {each.key.path: each for each in learned.intervals(0.99)}["persistence.box.vessel_share"]
    assert np.all(kept.low <= asked.vessel_share) and np.all(asked.vessel_share <= kept.high)


def test_components_that_last_alike_have_one_time() -> None:
    model = parse_detector(learned_again({"box_s": 2.0}, 2).detector())
    assert model.persistence.box is None and model.persistence.box_s == pytest.approx(2.0, rel=0.25)


def test_a_campaign_draws_memories_that_can_be(learned: Learned, tmp_path: Path) -> None:
    text = yaml.safe_dump(learned.detector())
    path = tmp_path / "learned.yaml"
    path.write_text(text)
    known, kept = LearnedUncertainty.model_validate(json.loads(uncertainty_text(learned, text))), []
    for seed in range(40):
        model, _ = choose_detector(path, settings=drawn_detector(known, seed), may_be_unread=True)
        assert model.persistence.box is not None
        kept.append(model.persistence.box.vessel_share[1])
    assert 0.02 < np.std(kept) < 0.2
