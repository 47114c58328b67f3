"""The ray through the image of a point of the sea meets the sea there, for any camera, flat and curved."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from modsim3d.geometry.camera import Distortion, Intrinsics
from modsim3d.geometry.camera_poses import Mount, poses_ashore
from modsim3d.geometry.curved_sea import RADIUS_M, horizon_inverse_range, inverse_range, look, lowered

BROWN = Distortion(k1=-0.12, k2=0.03, p1=0.001, p2=-0.002)
PINHOLE = Intrinsics((1000.0, 900.0), (640.0, 400.0), (1280, 800), skew=3.0)
DISTORTED = Intrinsics((1000.0, 900.0), (640.0, 400.0), (1280, 800), distortion=BROWN)
ANGLES = st.tuples(st.floats(-0.3, 0.3), st.floats(-0.05, 0.1), st.floats(-3.1, 3.1))
"""Roll, pitch and yaw."""


@pytest.mark.parametrize("lens", [PINHOLE, DISTORTED], ids=["pinhole", "distorted"])
@pytest.mark.parametrize("curved", [False, True])
@given(angles_rad=ANGLES, offset_rad=st.floats(-0.4, 0.4), range_m=st.floats(20, 4000), height_m=st.floats(2, 40))
def test_a_point_of_the_sea_is_found_again(lens, curved, angles_rad, offset_rad, range_m, height_m) -> None:
    bearing = angles_rad[2] + offset_rad
    poses = poses_ashore(Mount((5.0, -3.0, height_m), *angles_rad), 1)
    point = poses.positions_m * [1, 1, 0] + range_m * np.array([[math.cos(bearing), math.sin(bearing), 0.0]])
    if curved:
        point = lowered(point, poses.positions_m)
    found = look(lens, poses, lens.project(poses.to_camera(point)))
    assert math.remainder(found[0, 0] - bearing, math.tau) == pytest.approx(0, abs=1e-8)
    horizon = horizon_inverse_range(np.array([height_m]), curved=curved)
    assert inverse_range(found[:, 1], horizon)[0] == pytest.approx(1 / range_m, rel=1e-5)


def test_the_horizon_of_a_curved_sea_is_where_the_textbook_has_it() -> None:
    # d = √(2 R h): from 20 m, 15.96 km
    assert 1 / horizon_inverse_range(np.array([20.0]), curved=True)[0] == pytest.approx(15_964, abs=1)
    assert horizon_inverse_range(np.array([20.0]), curved=False)[0] == 0
    assert np.isnan(horizon_inverse_range(np.array([-1.0, 0.0]), curved=True)).all()


@given(st.floats(1, 60), st.lists(st.floats(-3, 6), min_size=2, max_size=20, unique=True))
def test_inverse_range_ascends_through_the_horizon_without_a_jump(height_m: float, in_horizons: list[float]) -> None:
    horizon = horizon_inverse_range(np.array(height_m), curved=True)
    flat = np.sort(in_horizons) * horizon
    found = inverse_range(flat, np.broadcast_to(horizon, flat.shape))
    assert (np.diff(found)[np.diff(flat) > 1e-9 * horizon] > 0).all()
    at = inverse_range(np.array([2 * horizon, 2 * horizon * (1 + 1e-12)]), np.full(2, horizon))
    np.testing.assert_allclose(at, horizon, rtol=1e-5)
    below = found > horizon
    np.testing.assert_allclose(found[below] + 1 / (2 * RADIUS_M * height_m * found[below]), flat[below], rtol=1e-9)


def test_above_the_horizon_of_a_flat_sea_the_inverse_range_is_negative_and_under_water_there_is_none() -> None:
    up, down, sunk = np.array([[640.0, 300.0]]), np.array([[640.0, 500.0]]), (0.0, 0.0, -1.0)
    for pixel, sign in ((up, -1), (down, 1)):
        assert np.sign(look(PINHOLE, poses_ashore(Mount((0.0, 0.0, 5.0)), 1), pixel)[0, 1]) == sign
    assert np.isnan(look(PINHOLE, poses_ashore(Mount(sunk), 1), down)[0, 1])
    straight_down = poses_ashore(Mount((0.0, 0.0, 5.0), pitch_rad=math.pi / 2), 1)
    assert not look(PINHOLE, straight_down, np.array([[640.0, 400.0]]))[0, 1] < 1e6  # NaN, or right below
