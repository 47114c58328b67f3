"""A score behind misses and confidence: learned again where it is, and not where both are drawn apart."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import yaml

from modsim3d.campaign.drawn_detectors import LearnedUncertainty, drawn_detector
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.persistence import LatentScore
from modsim3d.learn.learned import Learned, uncertainty_text
from modsim3d.scene.settings import choose_detector
from tests.formats.labelled_sets import images, truth
from tests.learn.one_state import detected, learned_in, observed_in, of_boats
from tests.learn.scored_sets import detector

FRAMES, BOATS, STEP_S, MISS_RATE = 500, 40, 0.5, 0.3
ASKED = {"vessel_share": 0.3, "shares": [0.2, 0.4], "times_s": [1.0, 6.0]}


def learned_again(persistence: dict[str, Any], seed: int, without: frozenset[str] = frozenset(),
                  confusion: tuple[tuple[float, ...], ...] = ((1 - MISS_RATE,), (MISS_RATE,))) -> Learned:  # fmt: skip
    image, boat = np.repeat(np.arange(FRAMES), BOATS), np.tile(np.arange(BOATS), FRAMES)
    corner = np.column_stack([100 + 250.0 * (boat % 8), 200 + 250.0 * (boat // 8)])
    names = ("boat", "ship")[: len(confusion[0])]
    annotations = truth(image, boat % len(names), np.hstack([corner, corner + 60]), identity=boat)
    frames = images(FRAMES, (2200.0, 1600.0), np.arange(FRAMES) * STEP_S)
    labelled = replace(of_boats(frames, annotations), labels=names)
    data = detector({"mean": 0.6, "std": 0.15}) | {"persistence": persistence, "labels": list(names)}
    of_false = [1 / len(names)] * len(names)
    usual = {"confusion": [list(row) for row in confusion], "false_discovery_rate": 0.05}
    data["states"]["usual"] |= usual | {"false_positive_labels": of_false}
    return learned_in(observed_in(detected(labelled, data, seed), without=without), replicates=40)


@pytest.fixture(scope="module")
def learned() -> Learned:
    return learned_again({"score": ASKED}, 1)


def test_the_memory_of_a_score_is_learned_again(learned: Learned) -> None:
    model = parse_detector(learned.detector())
    score = model.persistence.score
    assert score is not None and model.persistence.confidence_s == model.persistence.class_s == 0
    asked = LatentScore(0.3, (0.2, 0.4), (1.0, 6.0))
    apart_s = np.array([0.5, 1, 2, 4, 8, 16])
    assert np.abs(score.correlation(apart_s) - asked.correlation(apart_s)).max() < 0.08
    intervals = {each.key.path: each for each in learned.intervals(0.99)}
    kept = intervals["persistence.score.vessel_share"]
    assert kept.low <= 0.3 <= kept.high < 0.6
    assert intervals["states.usual.confusion"].high[-1, 0] > MISS_RATE > intervals["states.usual.confusion"].low[-1, 0]


def test_labels_that_persist_do_so_beside_a_score() -> None:
    two = ((0.5, 0.2), (0.2, 0.5), (0.3, 0.3))
    learned = learned_again({"score": ASKED, "class_s": 5.0}, 3, confusion=two)
    persistence = parse_detector(learned.detector()).persistence
    assert persistence.score is not None and persistence.class_s == pytest.approx(5, rel=0.3)
    assert parse_detector(learned_again({"score": ASKED}, 3, confusion=two).detector()).persistence.class_s == 0


def test_misses_and_confidences_that_are_drawn_apart_have_no_score() -> None:
    apart = learned_again({"class_s": 2.0, "confidence_s": 2.0}, 2)
    persistence = parse_detector(apart.detector()).persistence
    assert persistence.score is None and persistence.class_s == pytest.approx(2, rel=0.2)
    assert persistence.confidence_s == pytest.approx(2, rel=0.2)
    assert any(note.startswith("persistence.score: none; detections before a miss") for note in apart.notes)


def test_a_score_can_be_left_out() -> None:
    without = learned_again({"score": ASKED}, 1, frozenset({"score"}))
    persistence = parse_detector(without.detector()).persistence
    assert persistence.score is None and persistence.class_s > 0 and persistence.confidence_s > 0


def test_a_campaign_draws_scores_that_can_be(learned: Learned, tmp_path) -> None:
    text = yaml.safe_dump(learned.detector())
    path = tmp_path / "learned.yaml"
    path.write_text(text)
    known = LearnedUncertainty.model_validate(json.loads(uncertainty_text(learned, text)))
    shares = []
    for seed in range(40):
        drawn = drawn_detector(known, seed)
        model, _ = choose_detector(path, settings=drawn, may_be_unread=True)
        assert model.persistence.score is not None
        shares.append(model.persistence.score.vessel_share)
    assert 0.02 < np.std(shares) < 0.2
