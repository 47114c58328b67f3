"""Noise that vessels keep: rates, levels and covariances hold over many vessels, and the memory of shares, of a score
behind misses and confidence and of each component of box errors is the one that was asked; `verify` holds the last."""

from typing import Any

import numpy as np
import pytest
from scipy import special, stats

from modsim3d.detector import persistence
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.records import TRUE, Detections, Targets
from modsim3d.scene.reading import load_scene
from modsim3d.verify.error_fit import MomentTable
from modsim3d.verify.evidence import ManyDetections
from modsim3d.verify.verification import verify_evidence
from tests.detector import detector_builders as build
from tests.detector_variants import variant

FRAMES, STEP_S, TAU_S = 60, 0.5, 0.8
CLASS_SHARE, BOX_SHARE, MISS_RATE = 0.4, 0.3, 0.25
SHARES = {"class_vessel_share": CLASS_SHARE, "box_vessel_share": BOX_SHARE}
LEVELS = {"quantiles": [0.25, 0.95]}
SCORE = build.one_state_data(
    **{"false_discovery_rate": 0, "confusion": [[0.6, 0.1], [0.15, 0.6], [MISS_RATE, 0.3]]},
    confidence={"true": LEVELS, "false": LEVELS},
) | {"persistence": {"score": {"vessel_share": 0.3, "shares": [0.2, 0.4], "times_s": [1, 6]}}}


def seen(vessels: int, frames: int = FRAMES) -> Targets:
    return build.steady_targets(frames, vessels, build.centred(600, 600))


def detect(data: dict[str, Any], targets: Targets, frames: int = FRAMES) -> Detections:
    return build.detector(data, 3, STEP_S).detect(build.make_frames(frames, time_step_s=STEP_S), targets)


def keeping(persistence: dict[str, float], **state: Any) -> dict[str, Any]:
    return build.one_state_data(false_discovery_rate=0, **state) | {"persistence": persistence}


@pytest.mark.parametrize("tau_s", [0.0, TAU_S], ids=["independent", "persistent"])
def test_rates_and_covariances_hold_over_vessels_and_a_part_of_every_correlation_stays(tau_s: float) -> None:
    found = detect(keeping({"class_s": tau_s, "box_s": tau_s, **SHARES}), seen(600))
    label = build.by_frame(found, found.label, FRAMES, 600, -1)
    for asked, seen_as in ((0.7, 0), (0.1, 1), (0.2, -1)):
        of_vessel = (label == seen_as).mean(axis=0)
        assert abs(of_vessel.mean() - asked) < 4 * of_vessel.std() / np.sqrt(600)
    missed, p = label < 0, 0.2
    assert missed.mean(axis=0).std() > 0.15  # each has its own
    stays = p - 2 * special.owens_t(special.ndtri(p), np.sqrt((1 - CLASS_SHARE) / (1 + CLASS_SHARE)))
    stays = (stays - p * p) / (p - p * p)
    error = build.by_frame(found, found.errors_px - np.array([4, 7, -8, -1]), FRAMES, 600)
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


def test_misses_labels_and_confidences_have_their_chances_at_any_time_and_the_correlation_of_the_score() -> None:
    frames, vessels = 40, 3000
    found = detect(SCORE, seen(vessels, frames), frames)
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


def test_what_a_vessel_keeps_is_its_own_whoever_else_is_there_and_however_a_run_is_split() -> None:
    frames, targets = build.make_frames(FRAMES, time_step_s=STEP_S), seen(20)
    for data in (build.detector_data(persistence={"class_s": TAU_S, **SHARES}), SCORE):
        detector = build.detector(data, 3, STEP_S)
        whole, alone = detector.detect(frames, targets), detector.detect(frames, seen(1))
        split = build.detect_in_chunks(detector, frames, targets, [0, 17, FRAMES])
        assert build.all_bytes(split) == build.all_bytes(whole)
        ours = (whole.kind == TRUE) & (whole.target % 20 == 0)
        for name in ("errors_px", "confidence"):
            np.testing.assert_array_equal(getattr(whole, name)[ours], getattr(alone, name)[alone.kind == TRUE])
    sure = build.by_frame(whole, whole.confidence, FRAMES, 20)  # as its score is, which correlates by 0.8
    both = ~np.isnan(sure[1:] + sure[:-1])
    assert np.corrcoef(sure[1:][both], sure[:-1][both])[0, 1] > 0.5


def test_what_is_never_missed_stays_so_and_without_shares_nothing_changes(monkeypatch) -> None:
    for mixed in (persistence.with_share, lambda share, kept, varying: np.full_like(kept, 40.0)):  # of probability 1
        monkeypatch.setattr(persistence, "with_share", mixed)
        found = detect(keeping({"class_vessel_share": 0.9}, confusion=build.ALL_SEEN), seen(40))
        assert (found.kind == TRUE).sum() == 40 * FRAMES
    monkeypatch.undo()
    times_s, none = {"class_s": TAU_S, "box_s": TAU_S}, {"class_vessel_share": 0.0, "box_vessel_share": 0.0}
    plain, off = (detect(keeping(each), seen(40)) for each in (times_s, times_s | none))
    assert build.all_bytes(plain) == build.all_bytes(off)


def test_a_memory_is_as_long_as_its_longest_part_and_endless_where_vessels_keep_a_share() -> None:
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


def test_each_component_correlates_with_itself_as_the_file_says(errors: np.ndarray) -> None:
    for component in range(4):
        for lag in (1, 5, 40):
            found = (errors[lag:, :, component] * errors[:-lag, :, component]).mean(axis=0)  # one mean of each vessel
            assert abs(found.mean() - asked(component, lag)) < 4 * found.std(ddof=1) / np.sqrt(60)
        one = (errors[..., component] ** 2).mean(axis=0)
        assert abs(one.mean() - 1) < 4 * one.std(ddof=1) / np.sqrt(60)
    np.testing.assert_array_equal(errors_of(PLAIN, 30), errors[:30], "how a run is split shows")


def test_large_errors_stay_as_long_as_the_fifth_number_says(errors: np.ndarray) -> None:
    """The normal number behind the scale of Student's t, which is the ratio to the normal errors of the same seed."""
    scale = (errors_of(HEAVY) / errors)[..., 0]
    number = special.ndtri(stats.chi2(3).cdf(1 / scale**2))
    for lag in (1, 5, 40):
        found = (number[lag:] * number[:-lag]).mean(axis=0)
        assert abs(found.mean() - asked(4, lag)) < 4 * found.std(ddof=1) / np.sqrt(60)


def test_honest_errors_obey_and_those_of_another_memory_are_named() -> None:
    many = ManyDetections.of_scene(load_scene("simulation_1", mode=2, steps=500, source="analytic"))
    memories = MEMORY, MEMORY | {"times_s": [0.1, 0.1]}
    asked_for, made_with = (parse_detector(variant("plain") | {"persistence": {"box": each}}) for each in memories)
    table = MomentTable()
    for seed in range(2):
        found = verify_evidence(asked_for, many.detect(asked_for, seed), table)
        assert found.obeys, (seed, [(verdict.parameter.name, verdict.p_value) for verdict in found.failed])
    wrong = verify_evidence(asked_for, many.detect(made_with, 0), table)
    assert any(verdict.parameter.name.startswith("persistence.box") for verdict in wrong.failed)
