"""Errors of tracks in the image, their covariances, GOSPA and OSPA, worked out by hand and by sampling."""

from dataclasses import replace

import numpy as np
import pytest

from modsim3d.core.errors import ModsimError
from modsim3d.tracking.scores.errors import Errors, Gospa, Ospa, errors, gospa, nees_or_infinity, ospa
from modsim3d.tracking.scores.scored import LARGEST_CUTOFF, Rules, Scored, SetDistance
from modsim3d.tracks.tracks import Similarity
from tests.tracking.hand_made import box, hand_made

RULES = Rules(set_distance=SetDistance(cutoff=10))


@pytest.fixture(scope="module")
def four_frames() -> Scored:
    """A shift by (3, 4), a miss, a false track and an empty frame."""
    truth, tracks = [(0, 0, box()), (1, 0, box())], [(0, 7, box(3, 4)), (2, 7, box())]
    return hand_made(truth, tracks, 4, rules=RULES)


def test_distances_are_means_of_an_error_a_miss_a_false_track_and_an_empty_frame(four_frames: Scored) -> None:
    assert gospa(four_frames) == Gospa(15 / 4, 5 / 4, 5 / 4, 5 / 4)  # 5, 10 / 2, 10 / 2 and 0
    assert ospa(four_frames) == Ospa(25 / 4)  # 5, 10, 10 and 0


def test_a_larger_power_gives_parts_as_powers_and_the_largest_has_a_distance() -> None:
    squared = Rules(set_distance=SetDistance(cutoff=10, power=2))
    scored = hand_made([(0, 0, box()), (0, 1, box(100))], [(0, 7, box(3, 4))], 1, rules=squared)
    assert gospa(scored) == Gospa(pytest.approx(75**0.5), pytest.approx(25), pytest.approx(50), 0)
    largest = Rules(set_distance=SetDistance(cutoff=LARGEST_CUTOFF, power=10))
    assert ospa(hand_made([(0, 0, box())], [], 1, rules=largest)).ospa == pytest.approx(1e6)


def test_cutoffs_around_an_error_turn_it_into_a_miss_and_a_false_track(four_frames: Scored) -> None:
    """With c = 4 the error of 5 is a miss and a false track: 2 + 2, 2, 2 and 0."""
    low, high = (gospa(replace(four_frames, rules=Rules(set_distance=SetDistance(cutoff)))) for cutoff in (4, 20))
    assert low == Gospa(2, 0, 1, 1) and high == Gospa(25 / 4, 5 / 4, 5 / 2, 5 / 2)


def test_a_track_on_a_hidden_vessel_costs_nothing_and_frames_of_several_cameras_are_apart() -> None:
    scored = hand_made([(0, 0, box(), 0.0)], [(0, 7, box(1))], 1, rules=RULES)
    assert gospa(scored) == Gospa(0, 0, 0, 0) and ospa(scored) == Ospa(0)
    # The track of camera 1 is at the place of the vessel of camera 0.
    scored = hand_made([(0, 0, box())], [(1, 7, box())], 1, cameras=2, rules=RULES)
    assert gospa(scored) == Gospa(5, 0, 2.5, 2.5)


def test_only_the_frames_in_question_count_and_without_frames_there_is_no_distance(four_frames: Scored) -> None:
    assert gospa(four_frames.in_frames(np.array([0, 3]))) == Gospa(2.5, 2.5, 0, 0)
    nothing = four_frames.in_frames(np.empty(0, dtype=np.int64))
    assert gospa(nothing) == Gospa(None, None, None, None) and ospa(nothing) == Ospa(None)


def test_a_cutoff_or_a_power_out_of_range_is_refused() -> None:
    for cutoff in (0, -1, 1e200, np.inf, np.nan):
        with pytest.raises(ModsimError, match="--gospa C: must be above 0 and at most 1,000,000"):
            SetDistance(cutoff=cutoff, power=10)
    for power in (0.9, 11, np.nan):
        with pytest.raises(ModsimError, match="--gospa C:P: must have a power from 1 to 10"):
            SetDistance(power=power)


BY_CENTRE = Rules(similarity=Similarity("centre", 100))
TEN_PX = ((100, 0), (0, 100))


def test_errors_of_three_pairs_worked_by_hand() -> None:
    """Centres off by (3, 4), 0 and (9, 12) px; widths by 0, 2 and 0, heights by 0, 0 and 4."""
    tracks = [(0, 7, box(3, 4)), (1, 7, box(-1, 0, 22, 20)), (2, 7, box(9, 10, 20, 24))]
    found = errors(hand_made([(k, 0, box()) for k in range(3)], tracks, 3, rules=BY_CENTRE))
    assert (found.error_pairs, found.median_error_px) == (3, 5)
    sizes_px = found.rmse_px, found.rmse_width_px, found.rmse_height_px
    assert sizes_px == pytest.approx([(250 / 3) ** 0.5, (4 / 3) ** 0.5, (16 / 3) ** 0.5])
    assert (found.nees, found.anees, found.nees_pairs) == (None, None, 0)


def test_nees_is_over_the_pairs_with_a_covariance_and_anees_is_half_of_it() -> None:
    """e' P⁻¹ e of e = (10, 20) and P = [[4, 2], [2, 3]] is (3·100 − 4·200 + 4·400) / 8 = 137.5; of (10, 0) it is 1."""
    tracks = [(0, 7, box(10, 20), -1, ((4, 2), (2, 3))), (1, 7, box(10), -1, TEN_PX), (2, 7, box(30))]
    found = errors(hand_made([(k, 0, box()) for k in range(3)], tracks, 3, rules=BY_CENTRE))
    assert found.nees == pytest.approx(138.5 / 2) and found.anees == pytest.approx(138.5 / 4)
    assert (found.error_pairs, found.nees_pairs, found.singular_covariances) == (3, 2, 0)


def test_a_singular_covariance_makes_nees_infinite_and_is_counted() -> None:
    for singular in (((0, 0), (0, 0)), ((4, 2), (2, 1)), ((1, 0), (0, -1)), ((1e13, 0), (0, 1))):
        tracks = [(0, 7, box(1), -1, singular), (1, 7, box(1), -1, TEN_PX)]
        found = errors(hand_made([(0, 0, box()), (1, 0, box())], tracks, 2, rules=BY_CENTRE))
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
    found = errors(hand_made(truth, tracks, 2, rules=BY_CENTRE))
    assert (found.error_pairs, found.rmse_px) == (1, 1)
    assert errors(hand_made(truth, [], 2)) == Errors(0, None, None, None, None, None, None, 0, 0)
