"""Confidence: by state, by kind, by looks, and by the precision and recall that it has to give."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy import stats

from modsim3d.detector.confidence import PrecisionRecall, QuantileScores
from modsim3d.detector.records import Detections, Targets
from tests.detector import detector_builders as build

CURVES = {
    "detector": [[0.1, 1.0], [0.4, 0.98], [0.6, 0.95], [0.75, 0.9], [0.8, 0.8]],
    "straight": [[0.8, 0.8]],
    "poor": [[0.05, 0.5], [0.3, 0.6], [0.8, 0.55]],
    "steep": [[0.79, 1.0], [0.8, 0.7]],
}


def detect(confidence: dict[str, Any], frames: int = 5000, **changes: Any) -> tuple[Targets, Detections]:
    targets = build.steady_targets(frames, 6, build.centred(80, 40))
    random = np.random.default_rng(2)
    targets = dataclasses.replace(targets, visible_fraction=random.uniform(0, 1, len(targets)))
    data = build.one_state_data(**({"box_error": build.no_error(), "confidence": confidence} | changes))
    return targets, build.run(data, build.make_frames(frames), targets)


def precision_recall(found: Detections, targets: Targets) -> tuple[np.ndarray, np.ndarray]:
    """The curve of a run: what a lower and lower threshold would find, by where detections came from."""
    order = np.argsort(-found.confidence, kind="stable")
    true = np.cumsum(~found.false()[order])
    return true / len(targets), true / np.arange(1, len(order) + 1)


@pytest.mark.parametrize("name", CURVES)
def test_the_runs_precision_recall_curve_is_the_one_asked_for(name: str) -> None:
    points, asked = CURVES[name], PrecisionRecall.through(CURVES[name])
    targets, found = detect({"precision_recall": points}, false_discovery_rate=1 - points[-1][1])
    recall, precision = precision_recall(found, targets)
    # Recall and precision end where the seed puts the rates; the shape before that is the confidence's.
    average = np.sum(precision * np.diff(recall, prepend=0) * (~found.false())[np.argsort(-found.confidence)])
    recalls = np.linspace(0, asked.recall[-1], 100_001)
    assert abs(average - np.trapezoid(asked.at(recalls), recalls)) < 0.02
    for level in (0.2, 0.5, 0.7):
        assert abs(precision[np.searchsorted(recall, level)] - asked.at(np.array(level))) < 0.03


def test_true_and_false_detections_have_their_own_confidence() -> None:
    _, found = detect({"true": {"mean": 0.7, "std": 0.05}, "false": {"mean": 0.4, "std": 0.04}})
    for kind, mean, std in ((~found.false(), 0.7, 0.05), (found.false(), 0.4, 0.04)):
        scores = found.confidence[kind]
        assert abs(scores.mean() - mean) < 4 * std / np.sqrt(len(scores))
        assert abs(scores.std() - std) < 4 * std / np.sqrt(2 * len(scores))


def test_an_empirical_distribution_is_straight_between_its_quantiles() -> None:
    quantiles = [0.2, 0.3, 0.7, 0.75, 1.0]
    _, found = detect({"true": {"quantiles": quantiles}, "false": {"mean": 0.3, "std": 0}})
    levels = np.interp(found.confidence[~found.false()], quantiles, np.linspace(0, 1, 5))
    assert stats.kstest(levels, "uniform").pvalue > 1e-4
    assert np.all(found.confidence[found.false()] == 0.3)
    ends = QuantileScores(np.array([0.2, 0.5, 1.0])).at(np.array([0.0, 0.5, 1 - 2.0**-53]))
    np.testing.assert_allclose(ends, [0.2, 0.5, 1.0], err_msg="the ends are reached")


def test_confidence_falls_with_the_hidden_share() -> None:
    same = {"mean": 0.9, "std": 0.02}
    targets, found = detect({"true": same, "false": same, "visibility_slope": 0.5})
    true = ~found.false()
    hidden = 1 - targets.visible_fraction[found.target[true]]
    slope, at_zero = np.polyfit(hidden, found.confidence[true], 1)
    error = 4 * 0.02 / np.sqrt(true.sum() / 12)
    assert abs(slope + 0.5) < error and abs(at_zero - 0.9) < error
    assert abs(found.confidence[~true].mean() - 0.9) < 4 * 0.02 / np.sqrt(np.sum(~true))


@pytest.mark.parametrize(("reference_px", "halvings"), [(320, 2.5), (160, 1.5), (20, 0)])
def test_confidence_falls_with_each_halving_below_the_reference_size(reference_px: float, halvings: float) -> None:
    # The boxes are 80 × 40: 40·√2 a side.
    same = {"mean": 0.9, "std": 0.01}
    _, found = detect({"true": same, "false": same, "size_slope": 0.1, "size_reference_px": reference_px})
    scores = found.confidence[~found.false()]
    assert abs(scores.mean() - (0.9 - 0.1 * halvings)) < 4 * 0.01 / np.sqrt(len(scores))


def test_size_is_that_of_the_detectors_own_box() -> None:
    keys = {"mean": 0.9, "std": 0.0, "size_slope": 0.1, "size_reference_px": 1024}
    _, found = detect(keys, box_error=build.box_error([0, 0, 40, 40], [[0] * 4] * 4), false_discovery_rate=0)
    np.testing.assert_allclose(found.confidence, 0.9 - 0.1 * np.log2(1024 / np.sqrt(120 * 80)))


def test_curves_that_no_detector_can_have_fall_between_two_recalls() -> None:
    assert all(PrecisionRecall.through(points).falls() is None for points in CURVES.values())
    curve = PrecisionRecall.through([[0.4, 0.3], [0.5, 0.9]])
    low, high = curve.falls() or (0.0, 0.0)
    assert 0.4 - 1e-3 < low < high <= 0.5
    assert curve.false_per_target(np.array([low])) > curve.false_per_target(np.array([high]))


@pytest.mark.parametrize("threshold", [0.0, 0.2, 0.6])
@pytest.mark.parametrize("name", CURVES)
def test_scores_make_the_curve_at_every_confidence(name: str, threshold: float) -> None:
    curve = PrecisionRecall.through(CURVES[name])
    true, false = curve.scores(threshold)
    share, last = np.linspace(0.01, 0.99, 50), curve.recall[-1]
    np.testing.assert_allclose(true.at(share), threshold + (1 - threshold) * share, atol=1e-9)
    confidence = false.at(share)
    recall = last * (1 - confidence) / (1 - threshold)  # of true detections above that confidence
    found = curve.false_per_target(recall) / curve.false_per_target(np.array([last]))
    np.testing.assert_allclose(found, 1 - share, atol=0.01)  # the steep curve rises within a dozen points of the grid


def test_detector_without_false_detections_has_one_distribution_of_scores() -> None:
    true, false = PrecisionRecall.through([[0.3, 1.0], [0.9, 1.0]]).scores(0.25)
    for scores in (true, false):
        np.testing.assert_allclose(scores.at(np.array([0.0, 0.4, 0.8])), [0.25, 0.55, 0.85])
