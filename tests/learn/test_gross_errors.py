"""Normal box errors some of which are gross, and components that last differently long, are learned as such."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from modsim3d.campaign.drawn_detectors import LearnedUncertainty, drawn_detector
from modsim3d.detector.draws import ContaminatedNormal, StudentT, standardised
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.persistence import BoxMemory
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Rule, match
from modsim3d.learn.bootstrap import resample
from modsim3d.learn.box_errors.laws import ErrorSample, choose_law, learned_errors
from modsim3d.learn.learned import Learned, LearnSettings, learn, uncertainty_text
from modsim3d.learn.matches import Observed
from modsim3d.learn.simulated_results import simulated
from modsim3d.learn.states import Transitions
from modsim3d.scene.settings import choose_detector
from tests.formats.labelled_sets import found, images, truth
from tests.learn.scored_sets import detector
from tests.learn.test_student_t import MEAN, ROOT, at_sea, persistent

SHARE, RATIO = 0.15, (8.0, 3.0, 8.0, 4.0)
GROSS = ContaminatedNormal(SHARE, RATIO)
STD = np.array([4.0, 3.0, 6.0, 2.0])
NONE: frozenset[str] = frozenset()


def gross_errors(count: int, seed: int) -> np.ndarray:
    return MEAN + STD * standardised(GROSS, np.random.default_rng(seed).standard_normal((count, 5)))


@pytest.mark.parametrize("kept", [0.0, 0.9])
def test_normal_errors_have_no_gross_ones(kept: float) -> None:
    for seed in range(20):
        normal = persistent(kept, 20, 50, seed)[..., :4].reshape(-1, 4) @ ROOT.T
        assert choose_law(at_sea(normal), kept, NONE).law == "normal"


def test_each_law_is_told_from_the_other() -> None:
    for seed in range(5):
        heavy = standardised(StudentT(4.0), np.random.default_rng(seed).standard_normal((1500, 5))) @ ROOT.T
        assert choose_law(at_sea(heavy), 0.0, NONE).law == "student_t"
        law = choose_law(at_sea(gross_errors(800, seed)), 0.0, NONE)
        assert law.law == "contaminated_normal" and law.unit == "px"
        assert choose_law(at_sea(gross_errors(800, seed)), 0.0, frozenset({"gross", "student_t"})).law == "normal"


def test_tails_that_leave_hardly_a_covariance_keep_that_of_the_data() -> None:
    wild = np.random.default_rng(3).standard_t(1.9, size=(1500, 1)) * np.random.default_rng(4).standard_normal(
        (1500, 4)
    )
    fits = at_sea(wild)
    law = choose_law(fits, 0.0, NONE)
    fit = fits.of_law(law.unit, law.law)
    assert law.law == "contaminated_normal" and fit is not None
    np.testing.assert_allclose(fit.model.std, wild.std(axis=0), rtol=0.01)


def test_boxes_that_are_mostly_exact_stay_normal() -> None:
    errors = gross_errors(400, 1) - MEAN
    errors[:250] = 1e-9 * errors[:250]
    errors[250:] -= errors[250:].mean(axis=0)
    assert choose_law(at_sea(errors), 0.0, NONE).law != "contaminated_normal"


def test_estimates_stray_as_far_as_their_replicates_and_lie_around_the_truth() -> None:
    asked, z = np.array([*STD, SHARE, *RATIO]), []
    for seed in range(24):
        fit = at_sea(gross_errors(600, seed)).of_law("px", "contaminated_normal")
        assert fit is not None
        sample = ErrorSample(gross_errors(600, seed), np.arange(600), 0.0, "clear", "px", fit)
        learned = learned_errors(resample(images(600), 100, seed), sample)
        assert learned.gross_share is not None and learned.gross_ratio is not None
        columns = [each.column.values for each in (learned.std, learned.gross_share, learned.gross_ratio)]
        values = np.concatenate([np.atleast_2d(column.T).T for column in columns], axis=1)
        z.append((values[0] - asked) / values[1:].std(axis=0))
    assert np.abs(np.mean(z, axis=0)).max() < 4.5 / np.sqrt(24)
    assert np.abs(np.std(z, axis=0) - 1).max() < 4.5 / np.sqrt(48)


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
        "law": "contaminated_normal",
        "gross_share": 0.15,
        "gross_ratio": [6, 4, 6, 4],
        "mean": [0, 1, 0, 0],
        "covariance": np.diag([4.0, 3.0, 6.0, 3.0]).tolist(),
    }
    state = np.zeros(FRAMES, dtype=np.int64)
    labelled = simulated(labelled, state, parse_detector(data), seed)
    observed = Observed(labelled, match(labelled, Rule(), 0.2), ("usual",), state, 0.2, NONE)
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
    assert off[:, 4].max() < 0.15  # of whether errors are gross, which is seen through those that are
    kept = {each.key.path: each for each in learned.intervals(0.99)}["persistence.box.vessel_share"]
    assert np.all(kept.low <= asked.vessel_share) and np.all(asked.vessel_share <= kept.high)
    error = learned.detector()["states"]["usual"]["box_error"]
    assert error["law"] == "contaminated_normal" and error["gross_share"] == pytest.approx(0.15, abs=0.03)


def test_components_that_last_alike_have_one_time() -> None:
    model = parse_detector(learned_again({"box_s": 2.0}, 2).detector())
    assert model.persistence.box is None and model.persistence.box_s == pytest.approx(2.0, rel=0.25)


def test_a_campaign_draws_memories_and_gross_errors_that_can_be(learned: Learned, tmp_path: Path) -> None:
    text = yaml.safe_dump(learned.detector())
    path = tmp_path / "learned.yaml"
    path.write_text(text)
    known = LearnedUncertainty.model_validate(json.loads(uncertainty_text(learned, text)))
    shares, kept = [], []
    for seed in range(40):
        model, _ = choose_detector(path, settings=drawn_detector(known, seed), may_be_unread=True)
        distribution, memory = model.states[0].box_error.distribution, model.persistence.box
        assert isinstance(distribution, ContaminatedNormal) and memory is not None
        shares.append(distribution.gross_share)
        kept.append(memory.vessel_share[1])
    assert 0.002 < np.std(shares) < 0.05
    assert 0.02 < np.std(kept) < 0.2
