import numpy as np
import pytest
import shapely
from hypothesis import assume, given
from hypothesis import strategies as st

from modsim3d.detector.false_positive_placement import sea_polygons, uniform_places

IMAGE_PX = (36, 24)


def half_plane(angle_rad: float, offset_px: float) -> np.ndarray:
    """Sea on the far side of a line that passes the image's middle at a distance."""
    a, b = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[a, b, -a * 18 - b * 12 + offset_px]])


def area(polygon: np.ndarray) -> float:
    x, y = polygon.T
    return abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))) / 2


@given(angle_rad=st.floats(-4, 4), offset_px=st.floats(-25, 25))
def test_sea_polygon_is_the_image_cut_by_the_half_plane(angle_rad: float, offset_px: float) -> None:
    plane = half_plane(angle_rad, offset_px)
    a, b, c = plane[0]
    middle = np.array([18, 12]) - np.array([a, b]) * offset_px
    along, far = 100 * np.array([-b, a]), 100 * np.array([a, b])
    corners = [middle - along, middle + along, middle + along + far, middle - along + far]
    sea = shapely.Polygon(corners).intersection(shapely.box(0, 0, *IMAGE_PX))
    assume(sea.area > 1e-6)
    polygon = sea_polygons(plane, IMAGE_PX)[0]
    assert area(polygon) == pytest.approx(sea.area, rel=1e-9, abs=1e-9)
    assert np.all(polygon @ [a, b] + c >= -1e-9) and np.all((polygon >= 0) & (polygon <= IMAGE_PX))


@pytest.mark.parametrize("plane", [[0, 0, -1], [0, 1, -100], [1, 0, -40]])
def test_without_sea_the_whole_image_is_used(plane: list[float]) -> None:
    assert area(sea_polygons(np.array([plane], dtype=float), IMAGE_PX)[0]) == 36 * 24


@pytest.mark.parametrize(("angle_rad", "offset_px"), [(np.pi / 2, 4), (1.2, -3), (0.4, 9), (-2.0, 0)])
def test_places_are_spread_evenly_over_the_sea(angle_rad: float, offset_px: float) -> None:
    plane, count = half_plane(angle_rad, offset_px), 40_000
    uniforms = np.random.default_rng(5).random((count, 3))
    places = uniform_places(np.repeat(plane, count, axis=0), IMAGE_PX, uniforms)
    assert np.all(places @ plane[0, :2] + plane[0, 2] >= -1e-9)
    sea = shapely.Polygon(sea_polygons(plane, IMAGE_PX)[0])
    x, y = np.meshgrid(np.arange(0, 36, 4), np.arange(0, 24, 4))
    for left, top in zip(x.ravel(), y.ravel(), strict=True):
        p = sea.intersection(shapely.box(left, top, left + 4, top + 4)).area / sea.area
        found = np.mean(np.all((places >= [left, top]) & (places < [left + 4, top + 4]), axis=1))
        assert abs(found - p) <= 4.5 * np.sqrt(p * (1 - p) / count) + 1e-9  # 54 cells an image


def test_sea_along_an_edge_only_puts_all_places_on_the_edge() -> None:
    planes = np.repeat([[0.0, 1.0, -24.0]], 50, axis=0)
    places = uniform_places(planes, IMAGE_PX, np.random.default_rng(5).random((50, 3)))
    assert np.all(places[:, 1] == 24) and np.all((places[:, 0] >= 0) & (places[:, 0] <= 36))
