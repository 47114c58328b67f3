"""One score behind misses and confidence: chances and levels hold exactly, and its memory is the one that was asked."""

from typing import Any

import numpy as np
import pytest
from scipy import special, stats

from modsim3d.detector.chain import Detector
from modsim3d.detector.records import TRUE, Detections, Targets
from tests.detector import detector_builders as build

VESSELS, FRAMES, STEP_S, MISS_RATE = 3000, 40, 0.5, 0.25
SCORE = {"vessel_share": 0.3, "shares": [0.2, 0.4], "times_s": [1, 6]}


def seen(vessels: int = VESSELS) -> Targets:
    return build.steady_targets(FRAMES, vessels, build.centred(600, 600), [0] * vessels)


def detector(score: dict[str, Any] = SCORE, **persistence: Any) -> Detector:
    confusion = [[0.6, 0.1], [0.15, 0.6], [MISS_RATE, 0.3]]
    confidence = {kind: {"quantiles": [0.25, 0.95]} for kind in ("true", "false")}
    data = build.one_state_data(false_discovery_rate=0, confusion=confusion, confidence=confidence)
    return build.detector(data | {"persistence": {"score": score, **persistence}}, 5, STEP_S)


@pytest.fixture(scope="module")
def found() -> Detections:
    return detector().detect(build.make_frames(FRAMES, time_step_s=STEP_S), seen())


def test_misses_labels_and_confidences_have_their_chances_at_any_time_and_the_correlation_of_the_score(found) -> None:
    label = build.by_frame(found, found.label, FRAMES, VESSELS, -1)
    confidence, missed = build.by_frame(found, found.confidence, FRAMES, VESSELS), label < 0
    for frame in (0, 1, FRAMES - 1):
        for share, p in ((missed[frame], MISS_RATE), (label[frame] == 1, 0.15)):
            assert abs(share.mean() - p) < 4 * np.sqrt(p * (1 - p) / VESSELS)
        assert stats.kstest((confidence[frame][~missed[frame]] - 0.25) / 0.7, "uniform").pvalue > 1e-3
    z = special.ndtri(MISS_RATE)
    for lag in (1, 2, 4, 8, 16, 32):
        apart_s = lag * STEP_S
        correlation = 0.3 + 0.2 * np.exp(-apart_s / 1) + 0.4 * np.exp(-apart_s / 6)
        both = stats.multivariate_normal([0, 0], [[1, correlation], [correlation, 1]]).cdf([z, z])
        of_vessels = (missed[:-lag] & missed[lag:]).mean(axis=0)
        assert abs(of_vessels.mean() - both) < 4 * of_vessels.std() / np.sqrt(VESSELS)
    # A vessel grows unsure before it is lost.
    lost, sure = missed[1:][~missed[:-1]], confidence[:-1][~missed[:-1]]
    shares = [lost[(sure > low) & (sure <= low + 0.14)].mean() for low in (0.25, 0.39, 0.53, 0.67, 0.81)]
    assert np.all(np.diff(shares) < 0) and shares[0] > 10 * shares[-1]


def test_the_frames_before_and_other_vessels_change_nothing() -> None:
    frames, few = build.make_frames(FRAMES, time_step_s=STEP_S), seen(20)
    whole = detector().detect(frames, few)
    assert build.all_bytes(build.detect_in_chunks(detector(), frames, few, [0, 17, FRAMES])) == build.all_bytes(whole)
    alone = detector().detect(frames, seen(1))
    ours = (whole.kind == TRUE) & (whole.target % 20 == 0)
    np.testing.assert_array_equal(whole.confidence[ours], alone.confidence[alone.kind == TRUE])
