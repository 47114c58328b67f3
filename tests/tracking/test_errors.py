"""Errors of tracks and their covariances, worked out by hand and by sampling."""

import numpy as np
import pytest

from modsim3d.tracking.scores.errors import Errors, errors, nees_or_infinity
from modsim3d.tracking.scores.scored import Rules
from modsim3d.tracks.tracks import Similarity
from tests.tracking.hand_made import box, hand_made

RULES = Rules(similarity=Similarity("centre", 100))
TEN_PX = ((100, 0), (0, 100))


def test_errors_of_three_pairs_worked_by_hand() -> None:
    """Centres off by (3, 4), 0 and (9, 12) px; widths by 0, 2 and 0, heights by 0, 0 and 4."""
    tracks = [(0, 7, box(3, 4)), (1, 7, box(-1, 0, 22, 20)), (2, 7, box(9, 10, 20, 24))]
    found = errors(hand_made([(k, 0, box()) for k in range(3)], tracks, 3, rules=RULES))
    assert (found.error_pairs, found.median_error_px) == (3, 5)
    sizes_px = found.rmse_px, found.rmse_width_px, found.rmse_height_px
    assert sizes_px == pytest.approx([(250 / 3) ** 0.5, (4 / 3) ** 0.5, (16 / 3) ** 0.5])
    assert (found.nees, found.anees, found.nees_pairs) == (None, None, 0)


def test_nees_is_over_the_pairs_with_a_covariance_and_anees_is_half_of_it() -> None:
    """e' P⁻¹ e of e = (10, 20) and P = [[4, 2], [2, 3]] is (3·100 − 4·200 + 4·400) / 8 = 137.5; of (10, 0) it is 1."""
    tracks = [(0, 7, box(10, 20), -1, ((4, 2), (2, 3))), (1, 7, box(10), -1, TEN_PX), (2, 7, box(30))]
    found = errors(hand_made([(k, 0, box()) for k in range(3)], tracks, 3, rules=RULES))
    assert found.nees == pytest.approx(138.5 / 2) and found.anees == pytest.approx(138.5 / 4)
    assert (found.error_pairs, found.nees_pairs, found.singular_covariances) == (3, 2, 0)


def test_a_singular_covariance_makes_nees_infinite_and_is_counted() -> None:
    for singular in (((0, 0), (0, 0)), ((4, 2), (2, 1)), ((1, 0), (0, -1)), ((1e13, 0), (0, 1))):
        tracks = [(0, 7, box(1), -1, singular), (1, 7, box(1), -1, TEN_PX)]
        found = errors(hand_made([(0, 0, box()), (1, 0, box())], tracks, 2, rules=RULES))
        counts = found.nees_pairs, found.singular_covariances
        assert (found.nees, found.anees, *counts, found.rmse_px) == (np.inf, np.inf, 2, 1, 1), singular


def test_errors_as_large_as_their_covariance_have_anees_1() -> None:
    rng = np.random.default_rng(1)
    root = rng.normal(size=(4000, 2, 2))
    covariance = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(2)
    error = (np.linalg.cholesky(covariance) @ rng.normal(size=(4000, 2, 1)))[..., 0]
    squares = nees_or_infinity(error, covariance)
    assert squares.mean() == pytest.approx(2, abs=4 * 2 / 4000**0.5)  # chi-square with 2 degrees: variance 4
    slow = [e @ np.linalg.inv(p) @ e for e, p in zip(error, covariance, strict=True)]
    np.testing.assert_allclose(squares, slow)


def test_hidden_vessels_and_false_tracks_add_no_error_and_without_pairs_there_is_none() -> None:
    truth, tracks = [(0, 0, box()), (1, 0, box(), 0.0)], [(0, 7, box(1)), (1, 7, box(40)), (1, 8, box(400))]
    found = errors(hand_made(truth, tracks, 2, rules=RULES))
    assert (found.error_pairs, found.rmse_px) == (1, 1)
    assert errors(hand_made(truth, [], 2)) == Errors(0, None, None, None, None, None, None, 0, 0)
