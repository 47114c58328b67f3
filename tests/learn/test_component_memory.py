"""Components of box errors that last differently long are learned as such, and those that last alike are not."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.persistence import BoxMemory
from modsim3d.learn.learned import Learned
from modsim3d.learn.match_types import NAMES
from tests.learn.one_state import IOU, detected, detector, drawn_models, learned_from, moored

T_LAW = {"unit": "px", "law": "student_t", "degrees_of_freedom": 5}
ERRORS = {**T_LAW, "mean": [0, 1, 0, 0], "covariance": np.diag([4.0, 3.0, 6.0, 3.0]).tolist()}
MEMORY = {
    "vessel_share": [0.05, 0.45, 0.1, 0.2, 0.2],
    "shares": [[0.5, 0.05, 0.4, 0.3, 0.2], [0.1, 0.4, 0.1, 0.4, 0.4]],
    "times_s": [0.6, 5.0],
}
APART_S = np.array([0.5, 1, 2, 4, 8, 16])


def learned_again(persistence: dict[str, Any], seed: int, boats: int = 60) -> Learned:
    data = detector({"mean": 0.6, "std": 0.15}, persistence=persistence)
    data["states"]["usual"] |= {"false_discovery_rate": 0.02, "box_error": ERRORS}
    labelled = moored(400, boats, columns=10, size_px=(2700.0, 1800.0), side_px=80.0)
    return learned_from(detected(labelled, data, seed), IOU, ("relative", "mixed", *NAMES), replicates=40)


def test_the_memory_of_each_component_is_learned_again_and_one_time_of_those_that_last_alike(tmp_path: Path) -> None:
    learned = learned_again({"box": MEMORY}, 1)
    memory = parse_detector(learned.detector()).persistence.box
    assert memory is not None
    asked = BoxMemory(np.array(MEMORY["vessel_share"]), np.array(MEMORY["shares"]), np.array(MEMORY["times_s"]))
    off = np.abs(memory.correlation(APART_S) - asked.correlation(APART_S))
    assert off[:, :4].max() < 0.09
    assert off[:, 4].max() < 0.15  # of how large errors are, which is seen through those that are large
    kept = {each.key.path: each for each in learned.intervals(0.99)}["persistence.box.vessel_share"]
    assert np.all(kept.low <= asked.vessel_share) and np.all(asked.vessel_share <= kept.high)
    drawn = [model.persistence.box.vessel_share[1] for model in drawn_models(learned, tmp_path, 40)]
    assert 0.02 < np.std(drawn) < 0.2  # by a campaign
    alike = parse_detector(learned_again({"box_s": 2.0}, 2, boats=20).detector()).persistence
    assert alike.box is None and alike.box_s == pytest.approx(2.0, rel=0.25)
