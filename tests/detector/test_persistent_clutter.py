"""False positives that stay for a while: how many, how long, how fast."""

import itertools
from typing import Any

import numpy as np
import pytest
from scipy import stats

from modsim3d.core.random_streams import Streams
from modsim3d.detector.false_positives import PersistentFalsePositives, persistent_false_positives
from modsim3d.detector.records import FALSE_POSITIVE, PERSISTENT, Detections
from tests.detector import detector_builders as build

FRAMES = 20_000


def watch(
    rates: Any, lifetime_s: float, frames: int = FRAMES, step_s: float = 0.1, seed: int = 1
) -> PersistentFalsePositives:
    seen = build.make_frames(frames, time_step_s=step_s)
    return persistent_false_positives(
        Streams(seed), seen, np.broadcast_to(np.asarray(rates, dtype=float), frames), lifetime_s
    )


@pytest.mark.parametrize("step_s", [0.1, 0.7])
@pytest.mark.parametrize("rate", [0.6, 2.3])
def test_each_frame_shows_a_poisson_number_with_its_rate(rate: float, step_s: float) -> None:
    counts = np.bincount(watch(rate, 2.0, step_s=step_s).frame, minlength=FRAMES)
    kept = np.exp(-step_s / 2.0)  # counts Δt apart are correlated by it
    assert abs(counts.mean() - rate) < 4 * np.sqrt(rate / FRAMES * (1 + kept) / (1 - kept))
    apart = counts[:: int(10 / step_s)]
    seen = np.bincount(np.minimum(apart, 6), minlength=7)
    law = stats.poisson.pmf(np.arange(6), rate)
    assert stats.chisquare(seen, np.append(law, 1 - law.sum()) * len(apart)).pvalue > 1e-4


def test_numbers_follow_a_rate_that_changes_from_frame_to_frame() -> None:
    rates = np.where(np.arange(FRAMES) % 2, 0.3, 1.4)
    counts = np.bincount(watch(rates, 2.0).frame, minlength=FRAMES)
    for rate in (0.3, 1.4):
        ours = counts[rates == rate]
        assert abs(ours.mean() - rate) < 4 * np.sqrt(rate / len(ours) * 2 * 2.0 / 0.2)


def test_places_sizes_and_directions_do_not_depend_on_the_rate_or_on_each_other() -> None:
    seen = watch(0.3, 0.5)
    _, births = np.unique(seen.uniforms[:, 0], return_index=True)
    numbers = np.column_stack([seen.uniforms[births], (seen.sign[births] + 1) / 2])
    for column in numbers[:, :5].T:
        assert stats.kstest(column, "uniform").pvalue > 1e-4
    correlations = np.corrcoef(numbers.T)[np.triu_indices(6, 1)]
    assert np.abs(correlations).max() < 4.5 / np.sqrt(len(births))
    assert abs(numbers[:, 5].mean() - 0.5) < 4 * 0.5 / np.sqrt(len(births))


def test_the_first_frames_are_no_emptier_than_later_ones_and_all_are_empty_at_a_rate_of_zero() -> None:
    counts = [len(watch(3.0, 5.0, frames=1, seed=seed).frame) for seed in range(250)]
    assert abs(np.mean(counts) - 3) < 4 * np.sqrt(3 / 250)
    seen = watch(0.0, 2.0, frames=10)
    assert seen.uniforms.shape == (0, 5) and len(seen.frame) == len(seen.age_s) == len(seen.sign) == 0
    rates = np.where(np.arange(400) < 200, 0.0, 2.5)
    assert watch(rates, 2.0, frames=400).frame.min() >= 200


def test_lifetimes_are_exponential() -> None:
    found = watch(1.0, 2.0)
    _, one = np.unique(found.uniforms[:, 0], return_inverse=True)
    shown = np.bincount(one)
    # In whole frames: one that is seen at all is seen once more with probability e^(−Δt/τ), again and again.
    again = np.exp(-0.1 / 2.0)
    assert abs(shown.mean() - 1 / (1 - again)) < 4 / (1 - again) / np.sqrt(len(shown))
    edges = np.array([1, 5, 12, 25, 50])
    law = -np.diff([again ** (edge - 1) for edge in edges], append=0)
    seen = np.histogram(shown, [*edges, np.inf])[0]
    assert stats.chisquare(seen, law * len(shown)).pvalue > 1e-4


def test_one_that_stays_keeps_its_numbers_and_grows_older() -> None:
    found = watch(1.0, 2.0, frames=500)
    for first in np.unique(found.uniforms[:, 0])[:20]:
        ours = found.uniforms[:, 0] == first
        assert len(np.unique(found.uniforms[ours], axis=0)) == 1
        np.testing.assert_allclose(np.diff(found.age_s[ours]), 0.1 * np.diff(found.frame[ours]))
        assert len(set(found.sign[ours])) == 1


def detect(frames: int = 6000, **persistence: float) -> Detections:
    data = build.one_state_data(false_discovery_rate=0.2, box_error=build.no_error())
    size = {"model": "fixed", "px": [40, 20]}
    data["false_positives"] = {"model": "calibrated", "size": size, "persistence": persistence}
    return build.run(data, build.make_frames(frames), build.steady_targets(frames, 6, build.centred(80, 40)))


@pytest.mark.parametrize("share", [1.0, 0.4])
def test_the_false_discovery_rate_holds_with_persistent_ones(share: float) -> None:
    found = detect(lifetime_s=1.0, share=share)
    false = found.false()
    n_true, kept = np.sum(~false), np.exp(-0.1)
    error = np.sqrt(n_true * 0.25 * (1 + kept) / (1 - kept)) * n_true / len(found) ** 2
    assert abs(false.mean() - 0.2) < 4 * error
    persistent = np.sum(found.kind == PERSISTENT) / np.sum(false)
    assert abs(persistent - share) < 0.06
    assert (share == 1.0) == (not np.any(found.kind == FALSE_POSITIVE))


def test_they_drift_along_the_horizon_at_their_speed() -> None:
    found = detect(600, lifetime_s=20.0, drift_px_s=30.0)
    persistent = found.kind == PERSISTENT
    boxes, frame = found.boxes_px[persistent], found.frame[persistent]
    tracks: dict[float, list[tuple[int, float]]] = {}
    for row, box in zip(frame.tolist(), boxes.tolist(), strict=True):
        tracks.setdefault(round(box[3], 6), []).append((row, box[0]))
    pairs = [pair for track in tracks.values() for pair in itertools.pairwise(track)]
    speeds = [abs(later[1] - earlier[1]) / (0.1 * (later[0] - earlier[0])) for earlier, later in pairs]
    assert len(speeds) > 200
    assert np.mean(np.isclose(speeds, 30, rtol=1e-6)) > 0.9  # but for those that turn or are cut at the edge
