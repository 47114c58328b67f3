from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modsim3d.core.errors import InputError
from modsim3d.world.poses.base import LongTimes, generated_timestamps
from modsim3d.world.poses.circular import circular_motion, swept_ring
from modsim3d.world.poses.replay import parse_poses
from modsim3d.world.vessels import Vessel

SHIPS = tuple(Vessel(f"vessel{i}", "Vessel", *size) for i, size in enumerate([(14, 4, 20)] * 2 + [(7, 3, 4)] * 3))


def motion(seed=0, ships=SHIPS, radius=(5.0, 500.0), steps=50):
    return circular_motion(ships, steps, 0.2, (1000.0, 1000.0), radius, (0.005, 0.03), seed)


def test_timestamps_are_exact_decimals():
    assert generated_timestamps(6, 0.2) == ("0.0", "0.2", "0.4", "0.6", "0.8", "1.0")
    last = {(4, 0.1): "0.3", (3, 1.0): "2.0", (2, 1e-7): "0.0000001", (2, 1e22): "10000000000000000000000.0"}
    assert {case: generated_timestamps(*case)[-1] for case in last} == last


INDEX = st.integers(-5000, 5000)


@given(steps=st.integers(1, 5000), first=INDEX, stop=INDEX, stride=st.integers(-3, 3).filter(bool))
@settings(max_examples=25, deadline=None)
def test_times_of_a_long_scene_are_the_generated_ones(steps, first, stop, stride):
    plain, long = generated_timestamps(steps, 0.1), LongTimes(steps, 0.1)
    assert len(long) == steps
    assert long[first:stop:stride] == plain[first:stop:stride]
    assert (long[0], long[-1]) == (plain[0], plain[-1])
    with pytest.raises(IndexError):
        long[steps]


def test_circular_motion_follows_the_source_and_a_ring_holds_every_point_of_a_hull():
    """Jessen & Mohr (2023), eq. 7.5 and 7.7: on the circle, heading along it."""
    circle = motion()
    poses = circle.poses(10, 20)
    offset = poses.positions_m[..., :2] - 1000.0
    np.testing.assert_allclose(np.hypot(*np.moveaxis(offset, -1, 0)), np.tile(circle.radii_m, (10, 1)))
    tangent = np.stack([np.cos(poses.headings_rad), np.sin(poses.headings_rad)], axis=-1)
    np.testing.assert_allclose((tangent * offset).sum(axis=-1), 0, atol=1e-9)
    assert (np.sum(np.diff(poses.positions_m[..., :2], axis=0) * tangent[:-1], axis=-1) > 0).all()
    # A hull of 14 m on a circle of 5 m reaches much farther out.
    along, across = np.meshgrid(np.linspace(-7, 7, 57), np.linspace(-2, 2, 17))
    distance, (inner, outer) = np.hypot(5.0 + across, along), swept_ring(5.0, 14.0, 4.0)
    assert (inner, outer) == pytest.approx((distance.min(), distance.max())) and outer > 9.8


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_rings_swept_by_the_hulls_are_disjoint(seed):
    circle = motion(seed, radius=(5.0, 60.0))
    rings = sorted(swept_ring(r, s.length_m, s.beam_m) for r, s in zip(circle.radii_m, SHIPS, strict=True))
    assert all(outer < inner for (_, outer), (inner, _) in pairwise(rings))
    assert ((circle.radii_m >= 5) & (circle.radii_m <= 60)).all()
    assert ((circle.rates_rad_s >= 0.005) & (circle.rates_rad_s <= 0.03)).all()


def test_seed_decides_the_circles_and_vessels_that_do_not_fit_are_an_error():
    np.testing.assert_array_equal(motion(3).radii_m, motion(3).radii_m)
    assert (motion(3).radii_m != motion(4).radii_m).all()
    with pytest.raises(InputError, match=r"no free ring for vessel 'vessel\d'.*between radii 5.0 and 8.0"):
        motion(radius=(5.0, 8.0))


def test_recorded_poses_keep_the_text_of_their_times_and_absent_vessels():
    here = {"center_position_m": [1, 2, 0], "heading_rad": 0.5}
    data = {"0": {"a": here}, "0.50": {"a": here, "b": {"center_position_m": [0, 0, 0.5], "heading_rad": -1}}}
    recorded = parse_poses(data, "poses", ["a", "b"])
    poses = recorded.poses(0, 2)
    assert (recorded.timestamps, poses.present.tolist()) == (("0", "0.50"), [[True, False], [True, True]])
    assert poses.positions_m[1].tolist() == [[1, 2, 0], [0, 0, 0.5]] and poses.headings_rad[1].tolist() == [0.5, -1]
