"""Which track follows which vessel."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modsim3d.core.errors import ModsimError
from modsim3d.tracks.tracks import Similarity, Tracks
from modsim3d.tracks.true_tracks import TrueTracks, best_pairs, follow

Row = tuple[int, int, float]  # frame, identity or track, and the left edge of a box of 10 × 10 px


def box(x_px: float) -> list[float]:
    return [x_px, 0, x_px + 10, 10]


def true_tracks(rows: list[Row], hidden: tuple[int, ...] = ()) -> TrueTracks:
    frame, identity, boxes = (np.array(column) for column in zip(*((f, i, box(x)) for f, i, x in rows), strict=True))
    unseen = np.isin(np.arange(len(rows)), hidden)
    return TrueTracks(1, np.arange(len(rows)), frame, identity, identity, 0 * identity, boxes, ~unseen, unseen)


def tracks(rows: list[Row]) -> Tracks:
    return Tracks.of(1, *(np.array(column) for column in zip(*((f, t, box(x)) for f, t, x in rows), strict=True)))


def test_a_track_keeps_its_vessel_as_long_as_it_is_alike_enough() -> None:
    """The vessels, the tracks, and the row of the track that follows each vessel."""
    start, later = [(0, 7, 0.0)], [(2, 7, 3.0), (2, 8, 1.0)]
    for why, vessels, others, expected in (
        ("another is more alike, by 9/11", [(0, 1, 0), (1, 1, 0)], [*start, (1, 7, 3), (1, 8, 1)], [0, 1]),
        ("no track in a frame", [(0, 1, 0), (1, 1, 0), (2, 1, 0)], [*start, *later], [0, -1, 1]),
        ("no vessel in a frame", [(0, 1, 0), (2, 1, 0)], [*start, (1, 7, 0.0), *later], [0, 2]),
        ("alike no longer, by 6/14", [(0, 1, 0), (1, 1, 0)], [*start, (1, 7, 4), (1, 8, 1)], [0, 2]),
        # Of new pairs the sum of similarities decides: track 7 is nearest to 2, but then 1 would have nothing.
        ("new pairs", [(0, 1, 0), (0, 2, 4)], [(0, 7, 3), (0, 8, 6)], [0, 1]),
    ):
        found = follow(true_tracks(vessels), tracks(others), Similarity())
        assert found.track_row.tolist() == expected, why
        assert found.truth_row[found.track_row[found.found]].tolist() == np.flatnonzero(found.found).tolist(), why


def test_a_track_on_a_hidden_vessel_is_neither_right_nor_wrong_and_without_truth_every_track_is_false() -> None:
    truth = true_tracks([(0, 1, 0), (0, 2, 100)], hidden=(1,))
    found = follow(truth, tracks([(0, 7, 0), (0, 8, 100), (0, 9, 500)]), Similarity())
    assert (found.counted.tolist(), found.false.tolist()) == ([True, False, True], [False, False, True])
    found = follow(truth.take(np.array([], dtype=int)), tracks([(0, 7, 0)]), Similarity())
    assert (found.counted.tolist(), found.false.tolist()) == ([True], [True])


def test_centre_similarity_falls_linearly_to_the_scale_and_one_that_cannot_be_is_refused() -> None:
    alike = Similarity("centre", scale_px=20)(np.array([box(0)]), np.array([box(0), box(5), box(20), box(90)]))
    np.testing.assert_allclose(alike, [1, 0.75, 0, 0])
    wrong: tuple[tuple[dict[str, Any], str], ...] = (
        ({"name": "centre"}, "similarity centre needs scale_px"),
        ({"scale_px": 5.0}, "a scale is for similarity centre"),
        ({"name": "centre", "scale_px": 0.0}, "the scale of similarity centre must be above 0"),
        ({"least": 0.0}, "--threshold must be above 0"),
        ({"least": 1.5}, "--threshold must be above 0 and at most 1"),
    )
    for given_keys, message in wrong:
        with pytest.raises(ModsimError, match=message):
            Similarity(**given_keys)


@given(st.integers(0, 5), st.integers(0, 5), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_pairs_are_the_best_of_all_assignments(a: int, b: int, seed: int) -> None:
    """Against all assignments one by one."""
    alike = np.random.default_rng(seed).uniform(size=(a, b))
    i, j = best_pairs(alike, 0.5, np.zeros((a, b), dtype=bool))
    assert (alike[i, j] >= 0.5).all() and len(set(i.tolist())) == len(i) and len(set(j.tolist())) == len(j)
    assert alike[i, j].sum() == pytest.approx(best_sum(alike, 0))


def best_sum(alike: np.ndarray, row: int, taken: frozenset[int] = frozenset()) -> float:
    if row == len(alike):
        return 0.0
    free = (column for column in range(alike.shape[1]) if column not in taken and alike[row, column] >= 0.5)
    worth = (alike[row, column] + best_sum(alike, row + 1, taken | {column}) for column in free)
    return max(best_sum(alike, row + 1, taken), *worth, 0.0)


def test_cameras_remember_on_their_own_and_numbers_of_tracks_are_their_own() -> None:
    """Two cameras: frames 0 and 2 are of the first, 1 of the second."""
    rows, boxes = np.arange(3), np.array([box(0)] * 3)
    truth = TrueTracks(2, rows, rows, rows * 0, np.array([0, 1, 0]), rows * 0, boxes, rows >= 0, rows < 0)
    given = Tracks.of(2, np.array([0, 1, 2, 2]), np.array([7, 9, 7, 8]), np.array([box(0), box(0), box(3), box(1)]))
    assert follow(truth, given, Similarity()).track_row.tolist() == [0, 1, 2]
    numbers = Tracks.of(2, np.array([3, 0, 1, 2]), np.array([5, 5, 5, 4]), np.zeros((4, 4)))
    assert (numbers.frame.tolist(), numbers.identity.tolist()) == ([0, 1, 2, 3], [1, 2, 0, 2])
