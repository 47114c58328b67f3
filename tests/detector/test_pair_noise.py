"""Merges that stay: as many as asked, whatever the correlation time, and the same however a run is split."""

from typing import Any

import numpy as np
import pytest

from modsim3d.detector.chain import Detector
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.records import MERGED, Detections
from modsim3d.detector.target_statistics import TargetStatistics
from tests.detector.detector_builders import all_bytes, clock, make_frames, make_targets, no_error, one_state_data

PAIRS, FRAMES, STEP_S, MERGES = 12, 3000, 0.1, 0.3


def pairs_px(frames: int, pairs: int = PAIRS) -> np.ndarray:
    """Pairs of vessels that overlap, side by side."""
    pair = np.array([[0.0, 1000, 100, 1050], [50.0, 1000, 250, 1060]])
    shift = np.arange(pairs)[:, None, None] * [290.0, 0, 290, 0]
    return np.tile((pair + shift).reshape(-1, 4), (frames, 1, 1))


def asked(persistence: dict[str, float], **state: Any) -> dict[str, Any]:
    data = one_state_data(**({"confusion": [[1, 0], [0, 1], [0, 0]], "box_error": no_error()} | state))
    data["false_positives"] = {"model": "calibrated", "merges": MERGES}
    return data | {"persistence": persistence}


def detector(data: dict[str, Any]) -> Detector:
    return Detector(parse_detector(data), 1, TargetStatistics(), clock(STEP_S))


def merged(found: Detections, frames: int = FRAMES) -> np.ndarray:
    """Whether each pair came out as one box, shape (frames, pairs)."""
    result = np.zeros(frames * PAIRS, dtype=bool)
    result[found.target[found.kind == MERGED] // 2] = True
    return result.reshape(frames, PAIRS)


@pytest.mark.parametrize("merge_s", [0.0, 0.5, 3.0])
def test_merges_are_as_frequent_as_asked_and_last_as_long(merge_s: float) -> None:
    data = asked({"merge_s": merge_s}, false_discovery_rate=0)
    hits = merged(detector(data).detect(make_frames(FRAMES), make_targets(pairs_px(FRAMES))))
    kept = np.exp(-STEP_S / merge_s) if merge_s else 0.0
    variance = MERGES * (1 - MERGES)
    # Correlated by kept^lag, so that (1 − kept) / (1 + kept) of the numbers are worth as much as independent ones.
    assert abs(hits.mean() - MERGES) < 4 * np.sqrt(variance / hits.size * (1 + kept) / (1 - kept))
    residual = hits - MERGES
    for lag in (1, 4, 10):
        correlation = np.mean(residual[lag:] * residual[:-lag]) / variance
        assert abs(correlation - kept**lag) < 0.07
    across = np.mean(residual[:, 1:] * residual[:, :-1]) / variance  # each pair has a number of its own
    assert abs(across) < 0.07


def test_a_vanishing_correlation_time_gives_the_plain_detectors_bytes() -> None:
    frames, targets = make_frames(200), make_targets(pairs_px(200))
    plain, zero, brief = (
        detector(asked(each)).detect(frames, targets) for each in ({}, {"merge_s": 0.0}, {"merge_s": 1e-4})
    )
    assert (plain.kind == MERGED).any() and all_bytes(plain) == all_bytes(zero) == all_bytes(brief)
