"""A camera that sees a circle of vessels (Jessen & Mohr (2023), Appendix B), checked by projecting the circle."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from modsim3d import InputError, camera_placement
from modsim3d.geometry.camera import Intrinsics
from modsim3d.geometry.camera_poses import Mount, poses_ashore

LEGACY = {"focal_length_m": 0.05, "sensor_width_m": 0.036}
LENS = Intrinsics.from_lens(0.05, (1e-5, 1e-5), (1800, 1200), (3600, 2400))


def columns(pose, centre=(1000, 1000), radius=500, intrinsics=LENS):
    """Columns at which the border of the circle appears."""
    around = np.linspace(0, 2 * np.pi, 7201)
    border = np.stack([centre[0] + radius * np.cos(around), centre[1] + radius * np.sin(around), 0 * around], axis=-1)
    return intrinsics.project(poses_ashore(Mount(**pose), 1).to_camera(border[None])[0])[:, 0]


def test_sides_of_the_view_touch_the_circle_where_the_camera_is_low():
    seen = columns(camera_placement((1000, 1000), 500, height_m=1e-3, **LEGACY))
    assert (seen.min(), seen.max()) == pytest.approx((0, 3600), abs=1e-2)


@given(
    centre=st.tuples(st.floats(-5e3, 5e3), st.floats(-5e3, 5e3)),
    radius=st.floats(5, 2000),
    height=st.floats(0.5, 300),
    view=st.floats(0.2, 2.5),
)
def test_whole_circle_is_seen_across_the_image_and_its_centre_in_the_middle(centre, radius, height, view):
    lens = {"focal_length_m": 0.01, "sensor_width_m": 0.02 * math.tan(view / 2)}
    focal_px = 1000 / math.tan(view / 2)
    intrinsics = Intrinsics((focal_px, focal_px), (1000, 1000), (2000, 2000))
    pose = camera_placement(centre, radius, height_m=height, **lens)
    seen = columns(pose, centre, radius, intrinsics)
    assert -1e-3 <= seen.min() <= seen.max() <= 2000 + 1e-3
    middle = poses_ashore(Mount(**pose), 1).to_camera(np.array([[[*centre, 0.0]]]))[0, 0]
    np.testing.assert_allclose(intrinsics.project(middle), (1000, 1000), atol=1e-3)


def test_distance_of_the_program_cuts_the_circle_at_the_sides_and_that_of_eq_b_2_is_within_it():
    pose = camera_placement((1000, 1000), 500, height_m=20, whole=False, **LEGACY)
    assert pose["position_m"] == pytest.approx([1000 + 500 / 0.36, 1000, 20])
    seen = columns(pose)
    assert seen.min() < -100 and seen.max() > 3700
    assert 500 / math.tan(2 * 2 * math.atan(0.36)) < 100 < 500


def test_pitch_of_table_9_5_is_that_of_eq_b_3_with_the_distance_to_the_origin():
    pose = camera_placement((1000, 1000), 520, height_m=20, whole=False, **LEGACY)
    assert pose["position_m"][0] == pytest.approx(2444, abs=0.5)
    assert math.atan(20 / pose["position_m"][0]) == pytest.approx(0.008, abs=5e-4)
    assert pose["pitch_rad"] == pytest.approx(0.0138, abs=5e-5)


def test_wrong_lengths_are_named_together():
    with pytest.raises(InputError) as wrong:
        camera_placement((math.nan, 0), -5, height_m=0, **LEGACY)
    lengths = tuple(f"{name} is not a length above 0" for name in ("radius_m: -5", "height_m: 0"))
    assert wrong.value.problems == (*lengths, "centre_m: nan is not finite")
