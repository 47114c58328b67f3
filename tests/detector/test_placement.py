"""Where and how large false positives are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

from modsim3d.boxes import sizes
from modsim3d.detector import FALSE_POSITIVE, Detections, Detector, parse_detector, take_census
from modsim3d.detector.placement import PLACE_STEP_PX, Placement
from modsim3d.errors import ModsimError
from tests.detector.detector_builders import (
    IMAGE_PX,
    centred,
    clock,
    detector_data,
    make_frames,
    make_targets,
    no_error,
    one_state_data,
    run,
    same_boxes,
)

LEVEL = (0.0, 1.0, -800.0)  # the horizon at 800 px
TILTED = (0.3, 1.0, -1300.0)


def places(placement: Placement, sea: tuple[float, float, float], count: int = 6_000, **drift: Any) -> np.ndarray:
    uniforms = np.random.default_rng(4).random((count, 3))
    return placement.places(np.tile(sea, (count, 1)), IMAGE_PX, uniforms, **drift)


def below(points: np.ndarray, sea: tuple[float, float, float]) -> np.ndarray:
    a, b, c = sea
    return (a * points[:, 0] + b * points[:, 1] + c) / np.hypot(a, b)


@pytest.mark.parametrize("sea", [LEVEL, TILTED])
def test_a_band_holds_all_of_them_and_evenly(sea: tuple[float, float, float]) -> None:
    found = places(Placement(band_px=120), sea)
    depth = below(found, sea)
    assert depth.min() > -1e-6
    assert depth.max() < 120 + 1e-6
    assert stats.kstest(depth / 120, "uniform").pvalue > 1e-4


def test_the_density_halves_as_asked() -> None:
    depth = below(places(Placement(far_half_px=90), LEVEL), LEVEL)
    truncated = stats.truncexpon(1600 / (90 / np.log(2)), scale=90 / np.log(2))
    assert stats.kstest(depth, truncated.cdf).pvalue > 1e-4


def test_along_the_horizon_they_are_spread_evenly() -> None:
    found = places(Placement(far_half_px=90), LEVEL)
    assert stats.kstest(found[:, 0] / IMAGE_PX[0], "uniform").pvalue > 1e-4


def test_the_level_way_and_the_plain_way_spread_alike() -> None:
    # Persistent ones are placed level by level, others by area: the same distribution over a tilted sea.
    still = places(Placement(), TILTED, drift_px=np.zeros(6_000))
    plain = places(Placement(), TILTED)
    assert below(still, TILTED).min() > -1e-6
    for axis in (0, 1):
        assert stats.ks_2samp(still[:, axis], plain[:, axis]).pvalue > 1e-4


@pytest.mark.parametrize("sea", [(0.0, 1.0, 500.0), (0.0, 1.0, -9000.0), (0.0, 0.0, 1.0), (0.0, 1.0, -2400.0)])
def test_a_band_that_is_not_in_the_image_is_no_place_outside_it(sea: tuple[float, float, float]) -> None:
    found = places(Placement(band_px=30, far_half_px=50), sea, 500)
    assert np.all((found >= 0) & (found <= IMAGE_PX))
    assert not np.isnan(found).any()


def test_a_map_gives_each_cell_its_weight() -> None:
    density = np.array([[0.0, 1.0, 3.0], [2.0, 0.0, 4.0]])
    found = places(Placement(density=density), LEVEL)
    rows, columns = (found[:, 1] // 1200).astype(int), (found[:, 0] // 1200).astype(int)
    counts = np.zeros((2, 3))
    np.add.at(counts, (np.minimum(rows, 1), np.minimum(columns, 2)), 1)
    assert np.all(counts[density == 0] == 0)
    seen = counts[density > 0]
    assert stats.chisquare(seen, density[density > 0] / 10 * len(found)).pvalue > 1e-4


def test_drift_follows_the_horizon_and_turns_at_the_edge_of_the_image() -> None:
    start = places(Placement(), TILTED, 300, drift_px=np.zeros(300))
    later = places(Placement(), TILTED, 300, drift_px=np.full(300, 40.0))
    np.testing.assert_allclose(below(later, TILTED), below(start, TILTED), atol=2 * PLACE_STEP_PX)
    moved = np.hypot(*(later - start).T)
    assert np.mean(np.abs(moved - 40) < 2 * PLACE_STEP_PX) > 0.95
    far = places(Placement(), TILTED, 300, drift_px=np.linspace(-1e5, 1e5, 300))
    assert np.all((far >= 0) & (far <= IMAGE_PX))


def detect(false_positives: dict[str, Any], frames: int = 3000, vessels: int = 6, **state: Any) -> Detections:
    data = one_state_data(**({"box_error": no_error(), "false_discovery_rate": 0.4} | state))
    boxes = same_boxes(frames, vessels, centred(80, 40))
    boxes[:, :1] = [100, 100, 300, 150]
    targets = make_targets(boxes)
    model, seen = parse_detector(data | {"false_positives": false_positives}), make_frames(frames)
    return Detector(model, 1, take_census(model, [(seen, targets)]), clock()).detect(seen, targets)


FIXED = {"model": "fixed", "px": [30, 20]}


def test_an_empty_sea_has_false_alarms_at_their_rate_per_image() -> None:
    found = detect({"model": "per_image", "rate": 0.7, "size": FIXED}, vessels=0)
    counts = np.bincount(found.frame, minlength=3000)
    assert np.all(found.kind == FALSE_POSITIVE)
    assert abs(counts.mean() - 0.7) < 4 * np.sqrt(0.7 / 3000)
    assert abs(counts.var() - 0.7) < 4 * np.sqrt((0.7 + 2 * 0.49) / 3000)


def test_a_state_may_have_its_own_rate_per_image() -> None:
    data = detector_data(transition_matrix=[[0.9, 0.1], [0.1, 0.9]])
    data["false_positives"] = {"model": "per_image", "rate": 0.2, "size": FIXED}
    data["states"]["fog"]["false_positives_per_image"] = 2.0
    found = run(parse_detector(data), make_frames(5000), make_targets(same_boxes(5000, 2, centred(600, 600))))
    counts = np.bincount(found.frame[found.kind == FALSE_POSITIVE], minlength=5000)
    for state, rate in ((0, 0.2), (1, 2.0)):
        ours = counts[found.states == state]
        assert abs(ours.mean() - rate) < 4 * np.sqrt(rate / len(ours))


def inner_sizes(found: Detections) -> np.ndarray:
    boxes = found.boxes_px[found.kind == FALSE_POSITIVE]
    return sizes(boxes[np.all((boxes > 0) & (boxes < [*IMAGE_PX, *IMAGE_PX]), axis=1)])


def test_sizes_are_fixed_or_lognormal_as_asked() -> None:
    fixed = inner_sizes(detect({"model": "calibrated", "size": FIXED}))
    np.testing.assert_allclose(fixed, np.tile([30.0, 20.0], (len(fixed), 1)))
    varied = inner_sizes(
        detect({"model": "calibrated", "size": {"model": "lognormal", "px": [60, 30], "log_std": 0.3}})
    )
    logs = np.log(varied[:, 0] / 60)
    assert abs(logs.mean()) < 4 * 0.3 / np.sqrt(len(logs)) + 0.01  # large ones are cut at the edge a little more
    assert abs(logs.std() - 0.3) < 0.02
    np.testing.assert_allclose(varied[:, 0] / varied[:, 1], 2)


def test_sizes_come_from_all_of_the_scenes_boxes_where_a_frame_may_have_none() -> None:
    found = inner_sizes(detect({"model": "per_image", "rate": 2}))
    wide = np.isclose(found, [200, 50], rtol=0.03).all(axis=1)
    np.testing.assert_allclose(found[~wide], np.tile([80, 40], (np.sum(~wide), 1)), rtol=0.03)
    assert abs(wide.mean() - 1 / 6) < 4 * np.sqrt(5 / 36 / len(wide))


def test_a_scene_without_vessels_must_say_how_large_false_alarms_are() -> None:
    with pytest.raises(ModsimError, match="give false_positives a size"):
        detect({"model": "per_image", "rate": 2}, vessels=0)
