"""Noise that stays: rates and covariances hold exactly, whatever the correlation time and the frame rate, merges are
as many as asked, and all is the same however a run is split."""

from typing import Any

import numpy as np
import pytest
from scipy import stats

from modsim3d.detector.records import MERGED, TRUE, Detections, Targets
from tests.detector import detector_builders as build

VESSELS, TAU_S = 40, 0.9


def detect(data: dict[str, Any], targets: Targets, frames: int, step_s: float, seed: int = 1) -> Detections:
    return build.detector(data, seed, step_s).detect(build.make_frames(frames, time_step_s=step_s), targets)


def labels_over_time(found: Detections, frames: int, vessels: int = VESSELS) -> np.ndarray:
    """Label of each vessel at each frame, −1 where it was missed."""
    return build.by_frame(found, found.label, frames, vessels, -1)


def all_seen(frames: int) -> Targets:
    return build.steady_targets(frames, VESSELS, build.centred(600, 600))


@pytest.fixture(scope="module", params=[0.1, 0.3])
def step_s(request: pytest.FixtureRequest) -> float:
    return float(request.param)


@pytest.fixture(scope="module")
def found(step_s: float) -> Detections:
    """One fixed state; rates of the first label: 0.7, 0.1, missed 0.2."""
    data = build.one_state_data(false_discovery_rate=0) | {"persistence": {"class_s": TAU_S, "box_s": TAU_S}}
    return detect(data, all_seen(3000), 3000, step_s)


def test_rates_hold_although_misses_persist_with_the_correlation_time_asked_for(found, step_s: float) -> None:
    labels, kept = labels_over_time(found, 3000), np.exp(-step_s / TAU_S)
    for label, rate in ((0, 0.7), (1, 0.1), (-1, 0.2)):
        # Correlated by kept^lag, so that (1 − kept) / (1 + kept) of the numbers are worth as much as independent ones.
        standard_error = np.sqrt(rate * (1 - rate) / labels.size * (1 + kept) / (1 - kept))
        assert abs(np.mean(labels == label) - rate) < 4 * standard_error
    missed = (labels < 0).astype(float) - 0.2
    for lag in (1, 2, 5):
        assert abs(np.mean(missed[lag:] * missed[:-lag]) / 0.16 - kept**lag) < 0.04


def test_runs_of_misses_in_a_fixed_state_have_their_law(found: Detections, step_s: float) -> None:
    # A miss stays one if its number is kept (ρ), or if a new one is a miss again: a run goes on with probability
    # ρ + (1 − ρ)·p, whatever its length so far, so lengths are geometric.
    missed = labels_over_time(found, 3000) < 0
    kept, p = np.exp(-step_s / TAU_S), 0.2
    goes_on = kept + (1 - kept) * p
    lengths = np.concatenate([_complete_runs(column) for column in missed.T])
    assert len(lengths) > 1500
    assert abs(lengths.mean() - 1 / (1 - goes_on)) < 4 * np.sqrt(goes_on) / (1 - goes_on) / np.sqrt(len(lengths))
    edges = [1, 2, 3, 5, 8, 13, 21]
    seen = np.histogram(lengths, [*edges, np.inf])[0]
    law = -np.diff([goes_on ** (edge - 1) for edge in edges], append=0)
    assert stats.chisquare(seen, law * len(lengths)).pvalue > 1e-3


def _complete_runs(values: np.ndarray) -> np.ndarray:
    """Lengths of the runs of True that neither begin nor end the record."""
    borders = np.flatnonzero(np.diff(values.astype(int)))
    lengths = np.diff(borders)
    return lengths[0 if values[borders[0] + 1] else 1 :: 2]


def test_a_miss_in_a_state_without_misses_is_impossible_however_long_misses_persist() -> None:
    states = build.detector_data()["states"]
    states["clear"]["confusion"] = build.ALL_SEEN
    states["fog"]["confusion"] = [[0, 0], [0, 0], [1, 1]]
    result = detect(build.detector_data(states=states, persistence={"class_s": 100}), all_seen(300), 300, 0.1)
    missed = (labels_over_time(result, 300) < 0).mean(axis=1)
    assert np.array_equal(missed, result.states) and 0 < missed.mean() < 1


def test_rates_hold_in_states_that_change_much_faster_than_misses_do() -> None:
    data = build.detector_data(transition_matrix=[[0.3, 0.7], [0.7, 0.3]], persistence={"class_s": 2})
    result = detect(data, all_seen(3000), 3000, 0.1)
    missed, kept = labels_over_time(result, 3000) < 0, np.exp(-0.1 / 2)
    for state, rate in ((0, 0.2), (1, 0.4)):
        ours = missed[result.states == state]
        worth = 3000 * VESSELS * (1 - kept) / (1 + kept)
        assert abs(ours.mean() - rate) < 4 * np.sqrt(rate * (1 - rate) / worth)


def test_box_errors_keep_their_mean_and_covariance_and_are_jointly_normal_over_time(found, step_s: float) -> None:
    errors, kept = found.errors_px[found.kind == TRUE], np.exp(-step_s / TAU_S)
    worth = len(errors) * (1 - kept) / (1 + kept)
    c = np.array(build.COVARIANCE_PX2, dtype=float)
    assert not found.redrawn.any()
    assert np.all(np.abs(errors.mean(axis=0) - build.MEAN_PX) < 4 * np.sqrt(np.diag(c) / worth))
    # Products of two correlated normal numbers are correlated by kept²: more of them are worth something.
    worth = len(errors) * (1 - kept**2) / (1 + kept**2)
    standard_error = np.sqrt((np.outer(np.diag(c), np.diag(c)) + c**2) / worth)
    assert np.all(np.abs(np.cov(errors.T) - c) < 4 * standard_error)
    series = build.by_frame(found, (found.errors_px - build.MEAN_PX) / np.sqrt(np.diag(c)), 3000, VESSELS)
    for lag in (1, 3, 6):
        correlation = np.nanmean(series[lag:] * series[:-lag], axis=(0, 1))
        assert np.all(np.abs(correlation - kept**lag) < 0.04)
    # Of a first-order autoregressive process, and not of a number that is kept: what is new is normal, too.
    new = ((series[1:] - kept * series[:-1]) / np.sqrt(1 - kept**2))[..., 0]
    assert stats.kstest(new[~np.isnan(new)][::7], "norm").pvalue > 1e-4


def test_a_vessel_that_was_hidden_comes_back_with_the_noise_it_would_have_had() -> None:
    data = build.one_state_data(false_discovery_rate=0, confusion=build.ALL_SEEN)
    data |= {"persistence": {"class_s": 2, "box_s": 2}}
    boxes = build.same_boxes(200, 3, build.centred(600, 600))
    whole = detect(data, build.make_targets(boxes), 200, 0.1)
    boxes[50:120, 1] = np.nan
    gap = detect(data, build.make_targets(boxes), 200, 0.1)
    assert np.array_equal(gap.boxes_px[gap.frame >= 120], whole.boxes_px[whole.frame >= 120])


def test_confidence_keeps_its_distribution_and_has_the_correlation_time_asked_for(step_s: float) -> None:
    quantiles = [0.3, 0.5, 0.8, 0.95, 0.97, 0.98]
    scores = {"true": {"quantiles": quantiles}, "false": {"quantiles": quantiles}}
    data = build.one_state_data(confidence=scores) | {"persistence": {"confidence_s": TAU_S}}
    found = detect(data, all_seen(3000), 3000, step_s)
    values = build.by_frame(found, found.confidence, 3000, VESSELS)
    kept = np.exp(-step_s / TAU_S)
    levels = np.interp(values, quantiles, np.linspace(0, 1, 6))
    worth = np.isfinite(levels).sum() * (1 - kept) / (1 + kept)
    for at in (0.1, 0.5, 0.9):
        assert abs(np.mean(levels[np.isfinite(levels)] < at) - at) < 4 * np.sqrt(at * (1 - at) / worth)
    normal = stats.norm.ppf(levels)
    for lag in (1, 3, 6):
        assert abs(np.nanmean(normal[lag:] * normal[:-lag]) - np.exp(-lag * step_s / TAU_S)) < 0.04


def test_confidence_that_persists_changes_no_confidence_of_a_false_positive_and_nothing_else() -> None:
    plain, targets = build.one_state_data(), all_seen(200)
    without = detect(plain, targets, 200, 0.1)
    with_it = detect(plain | {"persistence": {"confidence_s": 2.0}}, targets, 200, 0.1)
    true = without.kind == TRUE
    assert (with_it.confidence[true] != without.confidence[true]).mean() > 0.9
    assert np.array_equal(with_it.confidence[~true], without.confidence[~true]) and (~true).sum() > 100
    columns = build.all_bytes(with_it).keys() - {"confidence"}
    assert all(build.all_bytes(with_it)[name] == build.all_bytes(without)[name] for name in columns)


def test_a_vanishing_correlation_time_gives_the_plain_chains_bytes_and_confidence_to_its_rounding() -> None:
    data, targets = build.one_state_data(), all_seen(200)
    plain = detect(data, targets, 200, 0.1)
    brief = detect(data | {"persistence": {"class_s": 1e-4, "box_s": 1e-4}}, targets, 200, 0.1)
    assert build.all_bytes(brief) == build.all_bytes(plain)
    sure = detect(data | {"persistence": {"confidence_s": 1e-4}}, targets, 200, 0.1)
    np.testing.assert_allclose(sure.confidence, plain.confidence, atol=1e-6)
    plain, zero, brief = (pairs(each, 200) for each in ({}, {"merge_s": 0.0}, {"merge_s": 1e-4}))
    assert (plain.kind == MERGED).any()
    assert build.all_bytes(plain) == build.all_bytes(zero) == build.all_bytes(brief)


def test_a_redraw_leaves_the_first_draws_of_other_steps_and_the_latent_numbers_alone() -> None:
    for persistence in ({}, {"box_s": 2}):
        seen = build.one_state_data(false_discovery_rate=0, confusion=build.ALL_SEEN) | {"persistence": persistence}
        boxes = build.same_boxes(300, 1, build.centred(600, 600))
        large = detect(seen, build.make_targets(boxes), 300, 0.1)
        boxes[::2] = build.centred(5, 5)
        mixed = detect(seen, build.make_targets(boxes), 300, 0.1)
        assert mixed.redrawn[::2].mean() > 0.5
        assert np.array_equal(mixed.errors_px[1::2], large.errors_px[1::2]), persistence


@pytest.mark.parametrize("first", [1, 2, 40])
def test_detector_that_begins_at_a_later_step_detects_what_one_from_the_start_does(first: int) -> None:
    times = {"class_s": TAU_S, "box_s": TAU_S, "confidence_s": TAU_S}
    data = build.one_state_data(false_discovery_rate=0) | {"persistence": times}
    frames, targets = build.make_frames(45), build.steady_targets(45, 3, build.centred(600, 600))
    whole = build.detector(data).detect(frames, targets)
    later = build.detector(data).detect(*build.chunk(frames, targets, first, 45)[:2])
    for name in ("boxes_px", "label", "confidence"):
        np.testing.assert_array_equal(getattr(later, name), getattr(whole, name)[whole.frame >= first], name)


PAIRS, FRAMES, MERGES = 12, 3000, 0.3


def pairs(merge_s: dict[str, float], frames: int = FRAMES, **state: Any) -> Detections:
    """Detections of pairs of vessels that overlap, side by side."""
    data = build.one_state_data(**({"confusion": build.ALL_SEEN, "box_error": build.no_error()} | state))
    data |= {"false_positives": {"model": "calibrated", "merges": MERGES}, "persistence": merge_s}
    pair = np.array([[0.0, 1000, 100, 1050], [50.0, 1000, 250, 1060]])
    boxes = (pair + np.arange(PAIRS)[:, None, None] * [290.0, 0, 290, 0]).reshape(-1, 4)
    return detect(data, build.make_targets(np.tile(boxes, (frames, 1, 1))), frames, 0.1)


@pytest.mark.parametrize("merge_s", [0.0, 0.5, 3.0])
def test_merges_are_as_frequent_as_asked_and_last_as_long(merge_s: float) -> None:
    found = pairs({"merge_s": merge_s}, false_discovery_rate=0)
    merged = np.zeros(FRAMES * PAIRS, dtype=bool)
    merged[found.target[found.kind == MERGED] // 2] = True
    kept = np.exp(-0.1 / merge_s) if merge_s else 0.0
    variance = MERGES * (1 - MERGES)
    assert abs(merged.mean() - MERGES) < 4 * np.sqrt(variance / merged.size * (1 + kept) / (1 - kept))
    residual = merged.reshape(FRAMES, PAIRS) - MERGES
    for lag in (1, 4, 10):
        assert abs(np.mean(residual[lag:] * residual[:-lag]) / variance - kept**lag) < 0.07
    across = np.mean(residual[:, 1:] * residual[:, :-1]) / variance  # each pair has a number of its own
    assert abs(across) < 0.07
