"""Noise that vessels keep: rates and covariances hold over many vessels, and a part of every correlation stays."""

from typing import Any

import numpy as np
import pytest
from scipy import special

from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.records import TRUE, Detections, Targets
from tests.detector import detector_builders as build

VESSELS, FRAMES, STEP_S = 600, 60, 0.5
TAU_S, CLASS_SHARE, BOX_SHARE = 0.8, 0.4, 0.3
SHARES = {"class_vessel_share": CLASS_SHARE, "box_vessel_share": BOX_SHARE}


def seen(vessels: int = VESSELS, frames: int = FRAMES) -> Targets:
    return build.steady_targets(frames, vessels, build.centred(600, 600))


def detect(persistence: dict[str, float], targets: Targets, **state: Any) -> Detections:
    data = build.one_state_data(false_discovery_rate=0, **state) | {"persistence": persistence}
    return build.detector(data, 3, STEP_S).detect(build.make_frames(FRAMES, time_step_s=STEP_S), targets)


@pytest.fixture(scope="module", params=[0.0, TAU_S], ids=["independent", "persistent"])
def tau_s(request: pytest.FixtureRequest) -> float:
    return float(request.param)


@pytest.fixture(scope="module")
def found(tau_s: float) -> Detections:
    return detect({"class_s": tau_s, "box_s": tau_s, **SHARES}, seen())


def test_rates_hold_over_vessels_and_misses_far_apart_in_time_are_as_alike_as_the_share_says(
    found, tau_s: float
) -> None:
    label = build.by_frame(found, found.label, FRAMES, VESSELS, -1)
    for asked, seen_as in ((0.7, 0), (0.1, 1), (0.2, -1)):
        of_vessel = (label == seen_as).mean(axis=0)
        assert abs(of_vessel.mean() - asked) < 4 * of_vessel.std() / np.sqrt(VESSELS)
    missed, p = label < 0, 0.2
    assert missed.mean(axis=0).std() > 0.15  # each has its own
    stays = p - 2 * special.owens_t(special.ndtri(p), np.sqrt((1 - CLASS_SHARE) / (1 + CLASS_SHARE)))
    stays = (stays - p * p) / (p - p * p)
    for lag in (1, 30):
        kept = np.exp(-lag * STEP_S / tau_s) if tau_s else 0.0
        products = ((missed[lag:] - p) * (missed[:-lag] - p)).mean(axis=0) / (p - p * p)
        error = products.std() / np.sqrt(VESSELS)
        assert abs(products.mean() - (stays + (1 - stays) * kept)) < 4 * error < 0.2


def test_errors_have_their_covariance_and_a_correlation_that_stays(found: Detections, tau_s: float) -> None:
    error = build.by_frame(found, found.errors_px - np.array([4, 7, -8, -1]), FRAMES, VESSELS)
    covariance = np.nanmean(error[..., :, None] * error[..., None, :], axis=(0, 1))
    spread = np.sqrt(np.outer(np.diag(build.COVARIANCE_PX2), np.diag(build.COVARIANCE_PX2)))
    assert np.abs((covariance - build.COVARIANCE_PX2) / spread).max() < 0.12
    for lag in (1, 30):
        kept = np.exp(-lag * STEP_S / tau_s) if tau_s else 0.0
        products = np.nanmean(error[lag:] * error[:-lag], axis=(0, 1)) / np.diag(build.COVARIANCE_PX2)
        assert np.abs(products - (BOX_SHARE + (1 - BOX_SHARE) * kept)).max() < 0.1


def test_what_a_vessel_keeps_is_its_own_whoever_else_is_there_and_however_a_run_is_split() -> None:
    model = parse_detector(build.detector_data(persistence={"class_s": TAU_S, **SHARES}))
    frames, targets = build.make_frames(FRAMES, time_step_s=STEP_S), seen(20, FRAMES)
    detector = build.detector(model, 3, STEP_S)
    whole = detector.detect(frames, targets)
    assert build.all_bytes(build.detect_in_chunks(detector, frames, targets, [0, 17, FRAMES])) == build.all_bytes(whole)
    alone = detector.detect(frames, seen(1, FRAMES))
    ours = (whole.kind == TRUE) & (whole.target % 20 == 0)
    np.testing.assert_array_equal(whole.errors_px[ours], alone.errors_px[alone.kind == TRUE])


def test_what_is_never_missed_stays_so_and_without_shares_nothing_changes() -> None:
    found = detect({"class_vessel_share": 0.9}, seen(40), confusion=build.ALL_SEEN)
    assert (found.kind == TRUE).sum() == 40 * FRAMES
    times_s = {"class_s": TAU_S, "box_s": TAU_S}
    plain = detect(times_s, seen(40))
    off = detect(times_s | {"class_vessel_share": 0.0, "box_vessel_share": 0.0}, seen(40))
    assert build.all_bytes(plain) == build.all_bytes(off)
