"""Which vessel each track is shown on, and where it switches."""

import numpy as np

from modsim3d.core.arrays import NOBODY
from modsim3d.tracks.tracks import Similarity, Tracks
from modsim3d.view.followed_tracks import FollowedTracks
from tests.view.made_tracks import FALSE_TRACK, as_set, perfect, swapped, with_false

BOAT, SAIL = 0, 1


def followed(rows, tracks, *similarity):
    return FollowedTracks.of(as_set(tracks), rows, Similarity(*similarity))


def test_tracks_with_the_boxes_of_the_truth_follow_their_vessels_without_a_switch(rows):
    shown = followed(rows, perfect(rows))
    np.testing.assert_array_equal(shown.vessel, shown.tracks.track)
    assert not (shown.switched | shown.moved | shown.unscored | shown.false).any()
    assert shown.sentence() == "Tracks of made: 3 tracks on 3 vessels, 0 identity switches, 0 false tracks."
    none = followed(rows, perfect(rows).take(np.zeros(0, dtype=np.int64)))
    assert none.sentence() == "Tracks of made: 0 tracks on 0 vessels, 0 identity switches, 0 false tracks."


def test_two_tracks_that_swap_switch_and_move_a_new_number_switches_and_a_track_alone_that_goes_on_moves(rows):
    tracks = perfect(rows)
    shown = followed(rows, swapped(tracks, BOAT, SAIL, 6))
    for marked in (shown.switched, shown.moved):
        first = [shown.tracks.step[(shown.tracks.step >= 6) & (shown.vessel == vessel)].min() for vessel in (0, 1)]
        places = sorted(zip(shown.vessel[marked].tolist(), shown.tracks.step[marked].tolist(), strict=True))
        assert places == [(BOAT, first[0]), (SAIL, first[1])]
    assert "2 identity switches" in shown.sentence()
    number = np.where((tracks.track == SAIL) & (tracks.step >= 5), 7, tracks.track)
    shown = followed(rows, Tracks.of(1, tracks.frame, number, tracks.boxes_px))
    assert shown.tracks.track[shown.switched].tolist() == [7] and not shown.moved.any()
    assert "4 tracks on 3 vessels, 1 identity switch, 0" in shown.sentence()
    some = tracks.take(((tracks.track == SAIL) & (tracks.step < 2)) | ((tracks.track == 2) & (tracks.step >= 4)))
    shown = followed(rows, Tracks.of(1, some.frame, np.full(len(some), 5), some.boxes_px))
    assert shown.moved.sum() == 1 and not shown.switched.any()


def test_a_track_where_no_vessel_is_follows_nothing_and_is_false(rows):
    shown = followed(rows, with_false(perfect(rows), range(3, 6)))
    np.testing.assert_array_equal(shown.false, shown.tracks.track == FALSE_TRACK)
    assert shown.vessel[shown.false].tolist() == [NOBODY] * 3
    assert shown.sentence().endswith("4 tracks on 3 vessels, 0 identity switches, 1 false track.")


def test_a_track_that_stays_on_a_hidden_vessel_is_on_it_and_unscored(rows):
    hidden = (rows.numbers("visible_px") == 0) & (rows.numbers("silhouette_px") > 0)
    assert hidden.any()
    shown = followed(rows, Tracks.of(1, rows.truth_frame, rows.truth_vessel, rows.boxes_px("full")))
    on = set(zip(rows.truth_frame[hidden].tolist(), rows.truth_vessel[hidden].tolist(), strict=True))
    kept = shown.tracks.take(shown.unscored)
    assert set(zip(kept.frame.tolist(), kept.track.tolist(), strict=True)) == on
    np.testing.assert_array_equal(shown.vessel[shown.unscored], kept.track)


def test_a_trail_holds_the_centres_of_the_last_two_seconds_of_its_track(rows):
    shown = followed(rows, perfect(rows))
    row = int(np.flatnonzero((shown.tracks.track == SAIL) & (shown.tracks.step == 2))[0])
    mine = shown.tracks.take((shown.tracks.track == SAIL) & (shown.tracks.step <= 2))  # a step a second
    expected = ((mine.boxes_px[:, :2] + mine.boxes_px[:, 2:]) / 2)[::-1]
    np.testing.assert_allclose(shown.trail_px(row), expected, rtol=1e-12)


def test_a_box_beside_its_vessel_follows_it_by_distance_and_not_by_overlap(rows):
    tracks = perfect(rows).take(perfect(rows).track == 2)
    beside = tracks.boxes_px + np.tile((tracks.boxes_px[:, 2] - tracks.boxes_px[:, 0])[:, None], 4) * (1, 0, 1, 0)
    moved = Tracks.of(1, tracks.frame, tracks.track, beside)
    assert followed(rows, moved).false.all() and not followed(rows, moved, "centre", 2000.0, 0.1).false.any()
