"""Rows of points that lie in a tail of the normal distribution are worked out once: no bit of a result changes."""

import numpy as np
import pytest
from scipy import special

from modsim3d.detector import truncation
from modsim3d.detector.draws import Normal, StudentT

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
    assert below.shape == above.shape == (3, 1) and (above - below == 1).all()


@pytest.mark.parametrize("distribution", [Normal(), StudentT(4.0)])
def test_boxes_far_from_their_bounds_have_the_bits_of_the_plain_way(monkeypatch, distribution):
    generator = np.random.default_rng(2)
    middles, halves = generator.uniform(0, 1000, (64, 2)), generator.choice([1.0, 30, 300], (64, 1))
    boxes = np.clip(np.concatenate([middles - halves, middles + halves], axis=1), 0, 1000)
    mix = generator.normal(size=(4, 4))
    law = generator.normal(size=4), mix @ mix.T
    images = np.full((64, 2), 1000.0)

    def parts():
        return list(truncation.accepted_errors(boxes, images, *law, distribution, POINTS, 16 * POINTS))

    found, far = parts(), []

    def none_far(*given):
        far.append(plain(*given).mean())
        return np.zeros(len(given[1]), dtype=bool)

    plain = truncation._far_from_bounds
    monkeypatch.setattr(truncation, "_far_from_bounds", none_far)
    for part, other in zip(found, parts(), strict=True):
        np.testing.assert_array_equal(part.errors, other.errors)
        np.testing.assert_array_equal(part.weights, other.weights)
    assert any(0 < share < 1 for share in far)
