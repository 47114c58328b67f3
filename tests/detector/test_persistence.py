"""Noise that stays and that vessels keep: rates, levels, covariances and memories are those that were asked."""

from typing import Any

import numpy as np
import pytest
from scipy import special, stats

from modsim3d.detector import persistence
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.records import MERGED, TRUE, Detections, Targets
from modsim3d.scene.reading import load_scene
from modsim3d.verify.error_fit import MomentTable
from modsim3d.verify.evidence import ManyDetections
from modsim3d.verify.verification import verify_evidence
from tests.detector import detector_builders as build
from tests.detector_variants import variant

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


def test_rates_hold_although_misses_persist_and_box_errors_keep_their_covariance(found, step_s):
    labels, kept = labels_over_time(found, 3000), np.exp(-step_s / TAU_S)
    for label, rate in ((0, 0.7), (1, 0.1), (-1, 0.2)):
        # Correlated by kept^lag, so that (1 − kept) / (1 + kept) of the numbers are worth as much as independent ones.
        standard_error = np.sqrt(rate * (1 - rate) / labels.size * (1 + kept) / (1 - kept))
        assert abs(np.mean(labels == label) - rate) < 4 * standard_error
    missed = (labels < 0).astype(float) - 0.2
    for lag in (1, 2, 5):
        assert abs(np.mean(missed[lag:] * missed[:-lag]) / 0.16 - kept**lag) < 0.04
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


def _complete_runs(values: np.ndarray) -> np.ndarray:
    """Lengths of the runs of True that neither begin nor end the record."""
    borders = np.flatnonzero(np.diff(values.astype(int)))
    lengths = np.diff(borders)
    return lengths[0 if values[borders[0] + 1] else 1 :: 2]


def test_a_hidden_vessel_comes_back_with_its_noise_and_confidence_keeps_its_distribution_and_memory(step_s):
    data = build.one_state_data(false_discovery_rate=0, confusion=build.ALL_SEEN)
    data |= {"persistence": {"class_s": 2, "box_s": 2}}
    boxes = build.same_boxes(200, 3, build.centred(600, 600))
    whole = detect(data, build.make_targets(boxes), 200, 0.1)
    boxes[50:120, 1] = np.nan
    gap = detect(data, build.make_targets(boxes), 200, 0.1)
    assert np.array_equal(gap.boxes_px[gap.frame >= 120], whole.boxes_px[whole.frame >= 120])
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


def test_confidence_that_persists_changes_nothing_else_and_without_memory_bytes_are_plain():
    plain, targets = build.one_state_data(), all_seen(200)
    without = detect(plain, targets, 200, 0.1)
    with_it = detect(plain | {"persistence": {"confidence_s": 2.0}}, targets, 200, 0.1)
    true = without.kind == TRUE
    assert (with_it.confidence[true] != without.confidence[true]).mean() > 0.9
    assert np.array_equal(with_it.confidence[~true], without.confidence[~true]) and (~true).sum() > 100
    columns = build.all_bytes(with_it).keys() - {"confidence"}
    assert all(build.all_bytes(with_it)[name] == build.all_bytes(without)[name] for name in columns)
    data, targets = build.one_state_data(), all_seen(200)
    plain = detect(data, targets, 200, 0.1)
    brief = detect(data | {"persistence": {"class_s": 1e-4, "box_s": 1e-4}}, targets, 200, 0.1)
    assert build.all_bytes(brief) == build.all_bytes(plain)
    sure = detect(data | {"persistence": {"confidence_s": 1e-4}}, targets, 200, 0.1)
    np.testing.assert_allclose(sure.confidence, plain.confidence, atol=1e-6)
    plain, zero, brief = (pairs(each, 200) for each in ({}, {"merge_s": 0.0}, {"merge_s": 1e-4}))
    assert (plain.kind == MERGED).any()
    assert build.all_bytes(plain) == build.all_bytes(zero) == build.all_bytes(brief)


def test_a_miss_in_a_state_without_misses_is_impossible_and_a_redraw_leaves_other_draws_alone() -> None:
    states = build.detector_data()["states"]
    states["clear"]["confusion"] = build.ALL_SEEN
    states["fog"]["confusion"] = [[0, 0], [0, 0], [1, 1]]
    result = detect(build.detector_data(states=states, persistence={"class_s": 100}), all_seen(300), 300, 0.1)
    missed = (labels_over_time(result, 300) < 0).mean(axis=1)
    assert np.array_equal(missed, result.states) and 0 < missed.mean() < 1
    data = build.detector_data(transition_matrix=[[0.3, 0.7], [0.7, 0.3]], persistence={"class_s": 2})
    result = detect(data, all_seen(3000), 3000, 0.1)
    missed, kept = labels_over_time(result, 3000) < 0, np.exp(-0.1 / 2)
    for state, rate in ((0, 0.2), (1, 0.4)):
        ours = missed[result.states == state]
        worth = 3000 * VESSELS * (1 - kept) / (1 + kept)
        assert abs(ours.mean() - rate) < 4 * np.sqrt(rate * (1 - rate) / worth)
    for keys in ({}, {"box_s": 2}):
        seen = build.one_state_data(false_discovery_rate=0, confusion=build.ALL_SEEN) | {"persistence": keys}
        boxes = build.same_boxes(300, 1, build.centred(600, 600))
        large = detect(seen, build.make_targets(boxes), 300, 0.1)
        boxes[::2] = build.centred(5, 5)
        mixed = detect(seen, build.make_targets(boxes), 300, 0.1)
        assert mixed.redrawn[::2].mean() > 0.5
        assert np.array_equal(mixed.errors_px[1::2], large.errors_px[1::2]), keys


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


MEMORY_FRAMES, STEP_S, KEPT_S = 60, 0.5, 0.8
CLASS_SHARE, BOX_SHARE, MISS_RATE = 0.4, 0.3, 0.25
SHARES = {"class_vessel_share": CLASS_SHARE, "box_vessel_share": BOX_SHARE}
LEVELS = {"quantiles": [0.25, 0.95]}
SCORE = build.one_state_data(
    **{"false_discovery_rate": 0, "confusion": [[0.6, 0.1], [0.15, 0.6], [MISS_RATE, 0.3]]},
    confidence={"true": LEVELS, "false": LEVELS},
) | {"persistence": {"score": {"vessel_share": 0.3, "shares": [0.2, 0.4], "times_s": [1, 6]}}}


def seen(vessels: int, frames: int = MEMORY_FRAMES) -> Targets:
    return build.steady_targets(frames, vessels, build.centred(600, 600))


def remembered(data: dict[str, Any], targets: Targets, frames: int = MEMORY_FRAMES) -> Detections:
    return build.detector(data, 3, STEP_S).detect(build.make_frames(frames, time_step_s=STEP_S), targets)


def keeping(persistence: dict[str, float], **state: Any) -> dict[str, Any]:
    return build.one_state_data(false_discovery_rate=0, **state) | {"persistence": persistence}


@pytest.mark.parametrize("tau_s", [0.0, KEPT_S], ids=["independent", "persistent"])
def test_rates_and_covariances_hold_over_vessels_and_a_part_of_every_correlation_stays(tau_s: float) -> None:
    found = remembered(keeping({"class_s": tau_s, "box_s": tau_s, **SHARES}), seen(600))
    label = build.by_frame(found, found.label, MEMORY_FRAMES, 600, -1)
    for asked, detected_label in ((0.7, 0), (0.1, 1), (0.2, -1)):
        of_vessel = (label == detected_label).mean(axis=0)
        assert abs(of_vessel.mean() - asked) < 4 * of_vessel.std() / np.sqrt(600)
    missed, p = label < 0, 0.2
    assert missed.mean(axis=0).std() > 0.15  # each has its own
    stays = p - 2 * special.owens_t(special.ndtri(p), np.sqrt((1 - CLASS_SHARE) / (1 + CLASS_SHARE)))
    stays = (stays - p * p) / (p - p * p)
    error = build.by_frame(found, found.errors_px - np.array([4, 7, -8, -1]), MEMORY_FRAMES, 600)
    covariance = np.nanmean(error[..., :, None] * error[..., None, :], axis=(0, 1))
    variances = np.diag(build.COVARIANCE_PX2)
    assert np.abs((covariance - build.COVARIANCE_PX2) / np.sqrt(np.outer(variances, variances))).max() < 0.12
    for lag in (1, 30):
        kept = np.exp(-lag * STEP_S / tau_s) if tau_s else 0.0
        products = ((missed[lag:] - p) * (missed[:-lag] - p)).mean(axis=0) / (p - p * p)
        standard_error = products.std() / np.sqrt(600)
        assert abs(products.mean() - (stays + (1 - stays) * kept)) < 4 * standard_error < 0.2
        products = np.nanmean(error[lag:] * error[:-lag], axis=(0, 1)) / variances
        assert np.abs(products - (BOX_SHARE + (1 - BOX_SHARE) * kept)).max() < 0.1


def test_misses_labels_and_confidences_have_their_chances_and_each_vessel_its_own_memory() -> None:
    frames, vessels = 40, 3000
    found = remembered(SCORE, seen(vessels, frames), frames)
    label = build.by_frame(found, found.label, frames, vessels, -1)
    confidence, missed = build.by_frame(found, found.confidence, frames, vessels), label < 0
    for frame in (0, 1, frames - 1):
        for share, p in ((missed[frame], MISS_RATE), (label[frame] == 1, 0.15)):
            assert abs(share.mean() - p) < 4 * np.sqrt(p * (1 - p) / vessels)
        assert stats.kstest((confidence[frame][~missed[frame]] - 0.25) / 0.7, "uniform").pvalue > 1e-3
    z = special.ndtri(MISS_RATE)
    for lag in (1, 2, 4, 8, 16, 32):
        apart_s = lag * STEP_S
        correlation = 0.3 + 0.2 * np.exp(-apart_s / 1) + 0.4 * np.exp(-apart_s / 6)
        both = stats.multivariate_normal([0, 0], [[1, correlation], [correlation, 1]]).cdf([z, z])
        of_vessels = (missed[:-lag] & missed[lag:]).mean(axis=0)
        assert abs(of_vessels.mean() - both) < 4 * of_vessels.std() / np.sqrt(vessels)
    # A vessel grows unsure before it is lost.
    lost, sure = missed[1:][~missed[:-1]], confidence[:-1][~missed[:-1]]
    shares = [lost[(sure > low) & (sure <= low + 0.14)].mean() for low in (0.25, 0.39, 0.53, 0.67, 0.81)]
    assert np.all(np.diff(shares) < 0) and shares[0] > 10 * shares[-1]
    frames, targets = build.make_frames(MEMORY_FRAMES, time_step_s=STEP_S), seen(20)
    for data in (build.detector_data(persistence={"class_s": KEPT_S, **SHARES}), SCORE):
        detector = build.detector(data, 3, STEP_S)
        whole, alone = detector.detect(frames, targets), detector.detect(frames, seen(1))
        split = build.detect_in_chunks(detector, frames, targets, [0, 17, MEMORY_FRAMES])
        assert build.all_bytes(split) == build.all_bytes(whole)
        ours = (whole.kind == TRUE) & (whole.target % 20 == 0)
        for name in ("errors_px", "confidence"):
            np.testing.assert_array_equal(getattr(whole, name)[ours], getattr(alone, name)[alone.kind == TRUE])
    sure = build.by_frame(whole, whole.confidence, MEMORY_FRAMES, 20)  # as its score is, which correlates by 0.8
    both = ~np.isnan(sure[1:] + sure[:-1])
    assert np.corrcoef(sure[1:][both], sure[:-1][both])[0, 1] > 0.5


def test_what_is_never_missed_stays_so_and_a_memory_is_as_long_as_its_longest_part(monkeypatch):
    for mixed in (persistence.with_share, lambda share, kept, varying: np.full_like(kept, 40.0)):  # of probability 1
        monkeypatch.setattr(persistence, "with_share", mixed)
        found = remembered(keeping({"class_vessel_share": 0.9}, confusion=build.ALL_SEEN), seen(40))
        assert (found.kind == TRUE).sum() == 40 * MEMORY_FRAMES
    monkeypatch.undo()
    times_s, none = {"class_s": KEPT_S, "box_s": KEPT_S}, {"class_vessel_share": 0.0, "box_vessel_share": 0.0}
    plain, off = (remembered(keeping(each), seen(40)) for each in (times_s, times_s | none))
    assert build.all_bytes(plain) == build.all_bytes(off)
    shares, times_s = (0.2, 0.4), (0.3, 0.8)
    for kept, memory_s in ((0.0, 0.8), (0.1, persistence.NEVER_CHANGES_S)):
        box = persistence.BoxMemory(np.full(5, kept), np.tile(shares, (5, 1)).T, np.array(times_s))
        assert persistence.LatentScore(kept, shares, times_s).memory_s == box.memory_s == memory_s
    none = persistence.Persistence()
    assert none.class_memory_s == none.box_memory_s == persistence.LatentScore(0.0).memory_s == 0


MEMORY = {
    "vessel_share": [0.1, 0.5, 0.0, 0.2, 0.3],
    "shares": [[0.5, 0.1, 0.0, 0.3, 0.2], [0.3, 0.4, 0.2, 0.5, 0.5]],
    "times_s": [0.1, 0.8],
}
PLAIN = build.box_error([0, 0, 0, 0], np.diag([4.0, 4.0, 9.0, 1.0]))
HEAVY = PLAIN | {"law": "student_t", "degrees_of_freedom": 3}


def errors_of(error: dict[str, Any], frames: int = 1500) -> np.ndarray:
    """Errors (frames, 60 vessels, 4) of vessels that are always found, in standard deviations."""
    data = keeping({"box": MEMORY}, confusion=build.ALL_SEEN, box_error=error)
    targets = build.steady_targets(frames, 60, build.centred(2000, 1500))
    found = build.detector(data, 2).detect(build.make_frames(frames), targets)
    return build.by_frame(found, found.errors_px, frames, 60) / np.sqrt(np.diag(PLAIN["covariance"]))


def asked(component: int, lag: int) -> float:
    shares = [part[component] for part in MEMORY["shares"]]
    decays = [np.exp(-lag * 0.1 / time_s) for time_s in MEMORY["times_s"]]
    return float(MEMORY["vessel_share"][component] + np.dot(shares, decays))


@pytest.fixture(scope="module")
def errors() -> np.ndarray:
    return errors_of(PLAIN)


def test_components_and_large_errors_correlate_as_the_file_says_and_another_memory_is_named(errors):
    for component in range(4):
        for lag in (1, 5, 40):
            found = (errors[lag:, :, component] * errors[:-lag, :, component]).mean(axis=0)  # one mean of each vessel
            assert abs(found.mean() - asked(component, lag)) < 4 * found.std(ddof=1) / np.sqrt(60)
        one = (errors[..., component] ** 2).mean(axis=0)
        assert abs(one.mean() - 1) < 4 * one.std(ddof=1) / np.sqrt(60)
    np.testing.assert_array_equal(errors_of(PLAIN, 30), errors[:30], "how a run is split shows")
    # The normal number behind the scale of Student's t, which is the ratio to the normal errors of the same seed.
    scale = (errors_of(HEAVY) / errors)[..., 0]
    number = special.ndtri(stats.chi2(3).cdf(1 / scale**2))
    for lag in (1, 5, 40):
        found = (number[lag:] * number[:-lag]).mean(axis=0)
        assert abs(found.mean() - asked(4, lag)) < 4 * found.std(ddof=1) / np.sqrt(60)
    many = ManyDetections.of_scene(load_scene("simulation_1", mode=2, steps=500, source="analytic"))
    memories = MEMORY, MEMORY | {"times_s": [0.1, 0.1]}
    asked_for, made_with = (parse_detector(variant("plain") | {"persistence": {"box": each}}) for each in memories)
    table = MomentTable()
    for seed in range(2):
        found = verify_evidence(asked_for, many.detect(asked_for, seed), table)
        assert found.obeys, (seed, [(verdict.parameter.name, verdict.p_value) for verdict in found.failed])
    wrong = verify_evidence(asked_for, many.detect(made_with, 0), table)
    assert any(verdict.parameter.name.startswith("persistence.box") for verdict in wrong.failed)
