"""Where and how large false positives are, and the sea in which they are put."""

import itertools
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import stats

from modsim3d.core.boxes import sizes
from modsim3d.core.errors import ModsimError
from modsim3d.detector import false_positive_placement
from modsim3d.detector.false_positive_placement import PLACE_STEP_PX, Placement, sea_polygons, uniform_places
from modsim3d.detector.records import FALSE_POSITIVE, Detections
from tests.detector import detector_builders as build

LEVEL = (0.0, 1.0, -800.0)  # the horizon at 800 px
TILTED = (0.3, 1.0, -1300.0)
HORIZONS = [(0.0, 1.0, -500.0), (0.6, 0.8, -900.0), (-1.0, 0.0, 40.0), (0.0, -1.0, 300.0), (0.0, 1.0, -5000.0)]
"""Sea below row 500; below a slope; left of column 40; above row 300; nowhere."""


def places(placement: Placement, sea: tuple[float, float, float], count: int = 6_000, **drift: Any) -> np.ndarray:
    uniforms = np.random.default_rng(4).random((count, 3))
    return placement.places(np.tile(sea, (count, 1)), build.IMAGE_PX, uniforms, **drift)


def below(points: np.ndarray, sea: tuple[float, float, float]) -> np.ndarray:
    a, b, c = sea
    return (a * points[:, 0] + b * points[:, 1] + c) / np.hypot(a, b)


def test_a_band_holds_all_evenly_and_a_map_gives_each_cell_its_weight():
    for sea in (LEVEL, TILTED):
        found = places(Placement(band_px=120), sea)
        depth = false_positive_placement.depths_px(np.tile(sea, (len(found), 1)), found)
        np.testing.assert_allclose(depth, below(found, sea), atol=1e-9)
        assert depth.min() > -1e-6 and depth.max() < 120 + 1e-6, sea
        assert stats.kstest(depth / 120, "uniform").pvalue > 1e-4, sea
    for sea in ((0.0, 1.0, 500.0), (0.0, 1.0, -9000.0), (0.0, 0.0, 1.0), (0.0, 1.0, -2400.0)):
        found = places(Placement(band_px=30, far_half_px=50), sea, 500)
        assert np.all((found >= 0) & (found <= build.IMAGE_PX)) and not np.isnan(found).any(), sea
    found = places(Placement(far_half_px=90), LEVEL)
    truncated = stats.truncexpon(1600 / (90 / np.log(2)), scale=90 / np.log(2))
    assert stats.kstest(below(found, LEVEL), truncated.cdf).pvalue > 1e-4
    assert stats.kstest(found[:, 0] / build.IMAGE_PX[0], "uniform").pvalue > 1e-4
    # Persistent ones are placed level by level, others by area: the same distribution over a tilted sea.
    still = places(Placement(), TILTED, drift_px=np.zeros(6_000))
    plain = places(Placement(), TILTED)
    assert below(still, TILTED).min() > -1e-6
    for axis in (0, 1):
        assert stats.ks_2samp(still[:, axis], plain[:, axis]).pvalue > 1e-4
    density = np.array([[0.0, 1.0, 3.0], [2.0, 0.0, 4.0]])
    found = places(Placement(density=density), LEVEL)
    assert not np.any(1024 * found % 1) and np.any(512 * found % 1)  # on the grid, and on no coarser one
    rows, columns = (found[:, 1] // 1200).astype(int), (found[:, 0] // 1200).astype(int)
    counts = np.zeros((2, 3))
    np.add.at(counts, (np.minimum(rows, 1), np.minimum(columns, 2)), 1)
    assert np.all(counts[density == 0] == 0)
    assert stats.chisquare(counts[density > 0], density[density > 0] / 10 * len(found)).pvalue > 1e-4
    uniforms = np.array([[0.0, 0.0, 0.0], [0.2, 0.5, 0.5], [0.9, 0.25, 0.75]])
    placement = Placement(density=np.array([[1.0, 3.0], [0.0, 4.0]]))
    for drift_px, x in ((None, [0, 600, 500]), (np.array([10.0, -20, 400]), [10, 580, 700])):  # the last turns
        found = placement.places(np.tile(HORIZONS[0], (3, 1)), (800, 600), uniforms, drift_px)
        np.testing.assert_array_equal(found, np.column_stack([x, [0, 150, 525]]))
    start = places(Placement(), TILTED, 300, drift_px=np.zeros(300))
    later = places(Placement(), TILTED, 300, drift_px=np.full(300, 40.0))
    np.testing.assert_allclose(below(later, TILTED), below(start, TILTED), atol=2 * PLACE_STEP_PX)
    moved = np.hypot(*(later - start).T)
    assert np.mean(np.abs(moved - 40) < 2 * PLACE_STEP_PX) > 0.95
    far = places(Placement(), TILTED, 300, drift_px=np.linspace(-1e5, 1e5, 300))
    assert np.all((far >= 0) & (far <= build.IMAGE_PX))


def detect(false_positives: dict[str, Any], frames: int = 3000, vessels: int = 6) -> Detections:
    data = build.one_state_data(box_error=build.no_error(), false_discovery_rate=0.4)
    boxes = build.same_boxes(frames, vessels, build.centred(80, 40))
    boxes[:, :1] = [100, 100, 300, 150]
    data["false_positives"] = false_positives
    return build.run(data, build.make_frames(frames), build.make_targets(boxes))


FIXED = {"model": "fixed", "px": [30, 20]}


def inner_sizes(found: Detections) -> np.ndarray:
    boxes = found.boxes_px[found.kind == FALSE_POSITIVE]
    return sizes(boxes[np.all((boxes > 0) & (boxes < [*build.IMAGE_PX, *build.IMAGE_PX]), axis=1)])


def test_an_empty_sea_has_false_alarms_at_their_rate_and_sizes_are_as_asked() -> None:
    found = detect({"model": "per_image", "rate": 0.7, "size": FIXED}, vessels=0)
    counts = np.bincount(found.frame, minlength=3000)
    assert np.all(found.kind == FALSE_POSITIVE)
    assert abs(counts.mean() - 0.7) < 4 * np.sqrt(0.7 / 3000)
    assert abs(counts.var() - 0.7) < 4 * np.sqrt((0.7 + 2 * 0.49) / 3000)
    data = build.detector_data(transition_matrix=[[0.9, 0.1], [0.1, 0.9]])
    data["false_positives"] = {"model": "per_image", "rate": 0.2, "size": FIXED}
    data["states"]["fog"]["false_positives_per_image"] = 2.0
    found = build.run(data, build.make_frames(5000), build.steady_targets(5000, 2, build.centred(600, 600)))
    counts = np.bincount(found.frame[found.kind == FALSE_POSITIVE], minlength=5000)
    for state, rate in ((0, 0.2), (1, 2.0)):
        ours = counts[found.states == state]
        assert abs(ours.mean() - rate) < 4 * np.sqrt(rate / len(ours))
    fixed = inner_sizes(detect({"model": "calibrated", "size": FIXED}))
    np.testing.assert_allclose(fixed, np.tile([30.0, 20.0], (len(fixed), 1)))
    spread = {"model": "lognormal", "px": [60, 30], "log_std": 0.3}
    varied = inner_sizes(detect({"model": "calibrated", "size": spread}))
    logs = np.log(varied[:, 0] / 60)
    assert abs(logs.mean()) < 4 * 0.3 / np.sqrt(len(logs)) + 0.01  # large ones are cut at the edge a little more
    assert abs(logs.std() - 0.3) < 0.02
    np.testing.assert_allclose(varied[:, 0] / varied[:, 1], 2)
    found = inner_sizes(detect({"model": "per_image", "rate": 2}))
    wide = np.isclose(found, [200, 50], rtol=0.045).all(axis=1)
    np.testing.assert_allclose(found[~wide], np.tile([80, 40], (np.sum(~wide), 1)), rtol=0.045)
    assert abs(wide.mean() - 1 / 6) < 4 * np.sqrt(5 / 36 / len(wide))
    with pytest.raises(ModsimError, match="give false_positives a size"):
        detect({"model": "per_image", "rate": 2}, vessels=0)
    planes, uniforms = np.tile(HORIZONS, (4, 1)), np.random.default_rng(8).random((20, 3))
    options = ({}, {"band_px": 100.0}, {"far_half_px": 60.0}, {"band_px": 80.0, "far_half_px": 30.0})
    for placement, moved in itertools.product([Placement(**each) for each in options], (None, np.full(20, 300.0))):
        together = placement.places(planes, (800, 600), uniforms, moved)
        for row in range(20):
            one = slice(row, row + 1)
            alone = placement.places(planes[one], (800, 600), uniforms[one], None if moved is None else moved[one])
            np.testing.assert_array_equal(together[one], alone, f"{placement}")
    uniforms = np.stack(np.meshgrid(np.linspace(0, 0.999, 12), np.linspace(0, 0.999, 9), [0.3]), axis=-1).reshape(-1, 3)
    planes = np.tile(HORIZONS[0], (len(uniforms), 1))
    x, y = Placement(band_px=80.0).places(planes, (800, 600), uniforms).T
    np.testing.assert_allclose(x, 800 * uniforms[:, 1], atol=PLACE_STEP_PX)
    np.testing.assert_allclose(y, 500 + 80 * uniforms[:, 0], atol=2 * PLACE_STEP_PX)
    _, y = Placement(far_half_px=20.0).places(planes, (800, 600), uniforms).T
    # The share of a density 2^(−d / 20) above depth d, of 100 in all, solved for d.
    np.testing.assert_allclose(y, 500 - 20 * np.log2(1 - uniforms[:, 0] * (1 - 2.0**-5)), atol=0.02)
    moved = Placement(band_px=80.0).places(planes, (800, 600), uniforms, np.full(len(uniforms), 50.0))
    free = uniforms[:, 1] * 800 < 740
    np.testing.assert_allclose(moved[free, 0], 50 + 800 * uniforms[free, 1], atol=PLACE_STEP_PX)
    turned = 2 * 800 - 50 - 800 * uniforms[:, 1]
    expected = np.minimum(turned, 50 + 800 * uniforms[:, 1])[~free]
    np.testing.assert_allclose(moved[~free, 0], expected, atol=PLACE_STEP_PX)


SMALL_PX = (36, 24)


def half_plane(angle_rad: float, offset_px: float) -> np.ndarray:
    """Sea on the far side of a line that passes the small image's middle at a distance."""
    a, b = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[a, b, -a * 18 - b * 12 + offset_px]])


@given(angle_rad=st.floats(-4, 4), offset_px=st.floats(-25, 25))
def test_sea_polygon_is_the_image_cut_by_the_half_plane(angle_rad: float, offset_px: float) -> None:
    plane = half_plane(angle_rad, offset_px)
    a, b, c = plane[0]
    middle = np.array([18, 12]) - np.array([a, b]) * offset_px
    along, far = 100 * np.array([-b, a]), 100 * np.array([a, b])
    corners = [middle - along, middle + along, middle + along + far, middle - along + far]
    sea = shapely.Polygon(corners).intersection(shapely.box(0, 0, *SMALL_PX))
    assume(sea.area > 1e-6)
    polygon = sea_polygons(plane, SMALL_PX)[0]
    assert shapely.Polygon(polygon).area == pytest.approx(sea.area, rel=1e-9, abs=1e-9)
    assert np.all(polygon @ [a, b] + c >= -1e-9) and np.all((polygon >= 0) & (polygon <= SMALL_PX))


def test_levels_at_shares_are_those_of_interpolation_and_without_sea_the_whole_image_is_used() -> None:
    rng = np.random.default_rng(9)
    weights, nodes, uniforms = rng.random((50, 20)), np.sort(rng.random((50, 20)), axis=1), rng.random(50)
    uniforms[:2] = 0.0, 0.001
    levels = false_positive_placement._inverse(weights, nodes, uniforms)
    for found, weight, node, share in zip(levels, weights, nodes, uniforms, strict=True):
        area = np.append(0, np.cumsum((weight[1:] + weight[:-1]) / 2 * np.diff(node)))
        assert found == pytest.approx(np.interp(share, area / area[-1], node))
    polygons = sea_polygons(np.array(HORIZONS[:4]), (800, 600))
    levels = (0.0, 20.0, 150.0, 299.0, 590.0, 700.0)
    lows, highs = false_positive_placement._slice(polygons[..., 1], polygons[..., 0], np.tile(levels, (4, 1)))
    for level, low, high in zip(levels, lows.T, highs.T, strict=True):
        for row, corners in enumerate(polygons):
            shape = shapely.Polygon(corners)
            line = shapely.intersection(shape, shapely.LineString([(-1, level), (801, level)]))
            left, _, right, _ = (shape if line.is_empty else line).bounds
            assert (low[row], high[row]) == (pytest.approx(left), pytest.approx(right))
    for plane in ([0.0, 0, -1], [0.0, 1, -100], [1.0, 0, -40]):
        assert shapely.Polygon(sea_polygons(np.array([plane]), SMALL_PX)[0]).area == 36 * 24, plane
    edge = np.repeat([[0.0, 1.0, -24.0]], 50, axis=0)
    found = uniform_places(edge, SMALL_PX, np.random.default_rng(5).random((50, 3)))
    assert np.all(found[:, 1] == 24) and np.all((found[:, 0] >= 0) & (found[:, 0] <= 36))


@pytest.mark.parametrize(("angle_rad", "offset_px"), [(np.pi / 2, 4), (1.2, -3), (0.4, 9), (-2.0, 0)])
def test_places_are_spread_evenly_over_the_sea(angle_rad: float, offset_px: float) -> None:
    plane, count = half_plane(angle_rad, offset_px), 40_000
    uniforms = np.random.default_rng(5).random((count, 3))
    found = uniform_places(np.repeat(plane, count, axis=0), SMALL_PX, uniforms)
    assert np.all(found @ plane[0, :2] + plane[0, 2] >= -1e-9)
    sea = shapely.Polygon(sea_polygons(plane, SMALL_PX)[0])
    for left, top in itertools.product(range(0, 36, 4), range(0, 24, 4)):
        p = sea.intersection(shapely.box(left, top, left + 4, top + 4)).area / sea.area
        share = np.mean(np.all((found >= [left, top]) & (found < [left + 4, top + 4]), axis=1))
        assert abs(share - p) <= 4.5 * np.sqrt(p * (1 - p) / count) + 1e-9  # 54 cells an image
