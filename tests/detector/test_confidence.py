"""Confidence by state, kind, looks, precision and recall; clipped normal numbers against integrals and an optimiser."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy import integrate, optimize, stats

from modsim3d.detector import confidence
from modsim3d.detector.confidence import PrecisionRecall, QuantileScores, StateConfidence
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


def test_confidence_is_of_its_kind_and_falls_with_the_hidden_share_and_small_boxes():
    _, found = detect({"true": {"mean": 0.7, "std": 0.05}, "false": {"mean": 0.4, "std": 0.04}})
    for kind, mean, std in ((~found.false(), 0.7, 0.05), (found.false(), 0.4, 0.04)):
        scores = found.confidence[kind]
        assert abs(scores.mean() - mean) < 4 * std / np.sqrt(len(scores))
        assert abs(scores.std() - std) < 4 * std / np.sqrt(2 * len(scores))
    quantiles = [0.2, 0.3, 0.7, 0.75, 1.0]
    _, found = detect({"true": {"quantiles": quantiles}, "false": {"mean": 0.3, "std": 0}})
    levels = np.interp(found.confidence[~found.false()], quantiles, np.linspace(0, 1, 5))
    assert stats.kstest(levels, "uniform").pvalue > 1e-4
    assert np.all(found.confidence[found.false()] == 0.3)
    ends = QuantileScores(np.array([0.2, 0.5, 1.0])).at(np.array([0.0, 0.5, 1 - 2.0**-53]))
    np.testing.assert_allclose(ends, [0.2, 0.5, 1.0], err_msg="the ends are reached")
    same = {"mean": 0.9, "std": 0.02}
    targets, found = detect({"true": same, "false": same, "visibility_slope": 0.5})
    true = ~found.false()
    hidden = 1 - targets.visible_fraction[found.target[true]]
    slope, at_zero = np.polyfit(hidden, found.confidence[true], 1)
    error = 4 * 0.02 / np.sqrt(true.sum() / 12)
    assert abs(slope + 0.5) < error and abs(at_zero - 0.9) < error
    assert abs(found.confidence[~true].mean() - 0.9) < 4 * 0.02 / np.sqrt(np.sum(~true))
    law, side_px = QuantileScores(np.array([0.9, 0.9])), np.array([16.0, 32.0, 64.0, 128.0])
    for slope, lost in (({}, 0), ({"size_slope": 0.1}, [0.2, 0.1, 0, 0])):
        scores = StateConfidence(law, law, **slope).score(np.full(4, 0.5), side_px < 0, np.full(4, 0.5), side_px)
        np.testing.assert_allclose(scores, 0.9 - np.array(lost))
    # The boxes are 80 × 40: 40·√2 a side.
    for reference_px, halvings in ((320, 2.5), (160, 1.5), (20, 0)):
        keys = {"mean": 0.9, "std": 0.01, "size_slope": 0.1, "size_reference_px": reference_px}
        _, found = detect(keys)
        scores = found.confidence[~found.false()]
        assert abs(scores.mean() - (0.9 - 0.1 * halvings)) < 4 * 0.01 / np.sqrt(len(scores)), reference_px
    keys = {"mean": 0.9, "std": 0.0, "size_slope": 0.1, "size_reference_px": 1024}
    _, found = detect(keys, box_error=build.box_error([0, 0, 40, 40], [[0] * 4] * 4), false_discovery_rate=0)
    np.testing.assert_allclose(found.confidence, 0.9 - 0.1 * np.log2(1024 / np.sqrt(120 * 80)))
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
    for scores in PrecisionRecall.through([[0.3, 1.0], [0.9, 1.0]]).scores(threshold):  # without false positives
        levels = np.array([0.0, 0.4, 0.8])
        np.testing.assert_allclose(scores.at(levels), threshold + (1 - threshold) * levels)


LAWS = [(0.6, 0.2, 0.2), (0.9, 0.3, 0.1), (0.1, 0.15, 0.3), (1.4, 0.5, 0.05), (-0.5, 0.4, 0.2), (0.5, 0.01, 0.2)]


@pytest.mark.parametrize(("mean", "std", "threshold"), LAWS)
def test_law_has_the_ends_and_the_moments_of_the_clipped_normal(mean, std, threshold):
    (nodes,), (probabilities,) = confidence.clipped_laws(np.array([mean]), std, threshold)
    normal = stats.norm(mean, std)
    assert (nodes[0], nodes[-1]) == (threshold, 1.0) and np.all(np.diff(nodes) >= 0)
    assert probabilities[[0, -1]] == pytest.approx([normal.cdf(threshold), normal.sf(1)], rel=1e-12, abs=1e-300)
    assert probabilities.sum() == pytest.approx(1, abs=1e-12)
    for power in (1, 2, 3):
        inside = integrate.quad(lambda x: x**power * normal.pdf(x), threshold, 1, points=[np.clip(mean, threshold, 1)])  # noqa: B023
        exact = inside[0] + threshold**power * normal.cdf(threshold) + normal.sf(1)
        assert probabilities @ nodes**power == pytest.approx(exact, rel=1e-9)


def log_likelihood(values, mean, std, low, high):
    normal = stats.norm(mean, std)
    inside = np.where(values >= high, normal.logsf(high), normal.logpdf(values))
    return np.where(values <= low, normal.logcdf(low), inside).sum()


@pytest.mark.parametrize("high", [1.0, 0.9, 3.0])
@pytest.mark.parametrize(("mean", "std"), [(0.6, 0.2), (0.8, 0.4), (0.35, 0.3)])
def test_fit_is_the_greatest_likelihood_that_a_general_optimiser_finds(mean, std, high):
    values = np.clip(np.random.default_rng(3).normal(mean, std, 4000), 0.2, high)
    found = confidence.fit_clipped(confidence.clipped_sums(values, 0.2, high).sum(axis=0)[None], 0.2, high)
    best = optimize.minimize(
        lambda law: -log_likelihood(values, law[0], np.exp(law[1]), 0.2, high),
        [0.5, -1.0],
        method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-9},
    )
    np.testing.assert_allclose(np.ravel(found), [best.x[0], np.exp(best.x[1])], atol=1e-6)
    if high == 1:
        score = confidence.clipped_score(values, found[0], float(found[1][0]), 0.2).mean(axis=0)
        np.testing.assert_allclose(score, 0, atol=1e-6)


def test_laws_beyond_an_end_are_that_end_and_sums_tell_ends_from_what_is_between():
    for mean, end in ((-5.0, 0), (7.0, -1)):  # fifty standard deviations away
        (nodes,), (probabilities,) = confidence.clipped_laws(np.array([mean]), 0.1, 0.2)
        assert len(nodes) == len(probabilities) and probabilities[end] == pytest.approx(1)
        assert probabilities.sum() == pytest.approx(1)
        assert ((nodes >= 0.2) & (nodes <= 1)).all()
    values = np.array([0.1, 0.2, 0.5, 0.9, 1.0])
    expected = [[1, 0, 0, 0, 0], [1, 0, 0, 0, 0], [0, 0, 1, 0.5, 0.25], [0, 1, 0, 0, 0], [0, 1, 0, 0, 0]]
    sums = confidence.clipped_sums(values, 0.2, 0.9)
    np.testing.assert_allclose(sums, expected)
    assert sums.dtype == np.float64
    rng = np.random.default_rng(4)
    samples = (np.clip(rng.normal(mean, 0.2, 500), 0.2, 1) for mean in (0.5, 0.8, 1.0))
    rows = np.array([confidence.clipped_sums(sample, 0.2, 1).sum(axis=0) for sample in samples])
    together = confidence.fit_clipped(np.vstack([rows, np.zeros(5)]), 0.2, 1.0)
    for row in range(3):
        fitted = np.ravel(confidence.fit_clipped(rows[[row]], 0.2, 1.0))
        np.testing.assert_allclose([column[row] for column in together], fitted, atol=1e-8)
    assert np.isnan([column[3] for column in together]).all()
