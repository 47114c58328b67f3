"""Rows of points that lie in a tail of the normal distribution are worked out once: no bit of a result changes."""

import numpy as np
from scipy import special

from modsim3d.detector import truncation

POINTS = 512


def test_points_in_a_tail_give_the_bits_of_the_plain_way():
    generator = np.random.default_rng(3)
    uniforms = generator.random((9, POINTS))
    uniforms[:, 0] = 2.0**-53  # the least that is not 0
    spread = generator.random((9, POINTS))
    low = np.array([-40, -20, -14, -12, -7, -1, -20, -30, 2.0])[:, None] - spread
    high = np.array([1, 9, 30, 8, 9, 1, -14, -29, 12.0])[:, None] + spread / 2
    below, above = truncation._probabilities(low, high)
    plain_below, plain_above = special.ndtr(low), special.ndtr(high)
    inside, plain_inside = above - below, plain_above - plain_below
    np.testing.assert_array_equal(inside, plain_inside)
    np.testing.assert_array_equal(below + uniforms * inside, plain_below + uniforms * plain_inside)
    assert below.shape == (9, POINTS)


def test_rows_that_all_lie_in_tails_have_one_probability_each():
    below, above = truncation._probabilities(np.full((3, POINTS), -50.0), np.full((3, POINTS), 20.0))
    assert below.shape == above.shape == (3, 1)
    assert (above - below == 1).all()
