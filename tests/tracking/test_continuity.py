"""Establishment, breaks and false tracks, worked out by hand."""

from collections.abc import Collection, Iterable
from dataclasses import replace

import numpy as np

from modsim3d.tracking.scores.continuity import Continuity, continuity, false_track_lengths_s
from modsim3d.tracking.scores.scored import frame_lengths_s
from tests.tracking.hand_made import box, hand_made, placed


def vessel(frames: Iterable[int], hidden: Collection[int] = ()) -> list[tuple]:
    return [(frame, 0, box(), float(frame not in hidden)) for frame in frames]


def followed(truth: list[tuple], tracks: list[tuple], **options: float) -> Continuity:
    return continuity(hand_made(truth, tracks, 1 + max(frame for frame, *_ in truth), **options))


def test_a_vessel_followed_from_the_first_frame_to_the_last_has_nothing_to_count() -> None:
    found = vars(followed(vessel(range(10)), placed(7, range(10)), step_s=0.5))
    ones = dict.fromkeys(("appearances", "established", "established_share", "tracks_per_vessel"), 1)
    unknown = dict.fromkeys(("mean_track_break_s", "longest_track_break_s", "mean_false_track_s"))
    assert found == dict.fromkeys(found, 0) | ones | unknown


def test_establishment_two_breaks_and_a_loss_worked_by_hand() -> None:
    """Followed in frames 2, 3, 5 and 8 of 10: breaks 4 (0.5 s) and 6-7 (1 s), lost in 9; 4 s from frame 2 on."""
    found = followed(vessel(range(10)), placed(7, (2, 3, 5, 8)), step_s=0.5)
    assert (found.time_to_establish_s, found.longest_time_to_establish_s) == (1, 1)
    assert (found.track_breaks, found.track_break_s) == (2, 1.5)
    assert (found.mean_track_break_s, found.longest_track_break_s) == (0.75, 1)
    assert found.track_breaks_per_hour == 2 / 4 * 3600 and (found.lost, found.lost_s) == (1, 0.5)


def test_breaks_of_vessels_are_apart_and_the_wait_of_one_that_is_never_followed_is_in_no_mean() -> None:
    three = [(k, number, box(100 * number)) for k in range(4) for number in range(3)]
    found = followed(three, [(3, 7, box()), (1, 8, box(100)), (2, 8, box(100))])
    assert (found.appearances, found.established, found.established_share) == (3, 2, 2 / 3)
    assert (found.time_to_establish_s, found.longest_time_to_establish_s) == (2, 3)
    assert (found.track_breaks, found.lost, found.lost_s, found.tracks_per_vessel) == (0, 1, 1, 1)
    # Vessel 0 ends unfollowed and vessel 1 begins unfollowed: neither is a break.
    found = followed([each for each in three if each[1] < 2], [*placed(7, (0, 1)), (3, 8, box(100))])
    assert (found.track_breaks, found.lost, found.lost_s, found.time_to_establish_s) == (0, 1, 2, 1.5)


def test_hidden_frames_are_no_break_and_a_vessel_hidden_first_waits_from_when_it_is_seen() -> None:
    # Hidden in frames 2-4, not followed in 2-5: only frame 5 is a break.
    found = followed(vessel(range(8), hidden=(2, 3, 4)), placed(7, (0, 1, 6, 7)))
    assert (found.track_breaks, found.track_break_s, found.lost, found.appearances) == (1, 1, 0, 1)
    # Seen in frame 3, followed in frame 5; frames 1 and 2 do not count.
    assert followed(vessel(range(6), hidden=(0, 1, 2)), placed(7, (1, 2, 5))).time_to_establish_s == 2


def test_another_track_ends_a_break_and_makes_none_and_a_vessel_that_comes_back_is_established_again() -> None:
    found = followed(vessel(range(5)), placed(7, (0, 1)) + placed(8, (3, 4)))
    assert (found.track_breaks, found.track_break_s, found.tracks_per_vessel) == (1, 1, 2)
    found = followed(vessel(range(4)), placed(7, (0, 1)) + placed(8, (2, 3)))
    assert (found.track_breaks, found.tracks_per_vessel, found.false_tracks) == (0, 2, 0)
    found = followed(vessel((0, 1, 6, 7)), placed(7, (0, 1, 7)))
    assert (found.appearances, found.established, found.track_breaks, found.time_to_establish_s) == (2, 2, 0, 0.5)


def test_false_tracks_are_those_that_never_follow_a_vessel_hidden_or_not() -> None:
    """Track 7 leaves its vessel, 8 follows a hidden one only, 9 (frames 0, 2) and 10 (frame 1) follow none."""
    tracks = [(0, 7, box()), (1, 7, box(400)), (0, 8, box(200)), (1, 8, box(400, 100))]
    tracks += [(0, 9, box(500)), (2, 9, box(500)), (1, 10, box(600))]
    scored = hand_made([*vessel(range(4)), (0, 1, box(200), 0.0)], tracks, 4, step_s=0.5)
    found = continuity(scored)
    assert false_track_lengths_s(scored).tolist() == [1, 0.5]
    assert (found.false_tracks, found.false_track_s, found.mean_false_track_s) == (2, 1.5, 0.75)
    assert found.false_tracks_per_hour == 2 / 2 * 3600  # 4 frames of half a second
    found = continuity(hand_made(vessel([0]), placed(7, (0, 1, 3)), 2, cameras=2))
    assert (found.false_tracks, found.false_track_s) == (1, 2)  # equal numbers in two cameras are two tracks
    assert found.false_tracks_per_hour == 1 / 4 * 3600  # 2 s of 2 cameras


def test_of_nothing_nothing_is_averaged() -> None:
    found = vars(continuity(hand_made([], [], 2)))
    unknown = {"established_share", "time_to_establish_s", "tracks_per_vessel", "track_breaks_per_hour"}
    assert unknown <= {name for name, value in found.items() if value is None}
    assert {found[name] for name in ("appearances", "track_breaks", "false_tracks", "false_tracks_per_hour")} == {0}
    never = followed(vessel([0]), [])
    assert (never.established, never.established_share, never.lost) == (0, 0, 0)


def test_a_frame_stands_for_the_time_to_the_camera_s_next_one_and_without_a_rate_for_a_second() -> None:
    scored = hand_made([], [], 6, cameras=2, step_s=0.5)
    rows = replace(scored.rows, frames=np.array([0, 1, 3, 4, 10]))  # camera 0 at steps 0, 2, 5; camera 1 at 0 and 1
    scored = replace(scored, rows=rows)
    assert frame_lengths_s(scored.rows, np.array([0, 1, 3, 4, 10])).tolist() == [1, 0.5, 0.5, 1.5, 1.5]
    assert frame_lengths_s(scored.rows, np.array([10, 4])).tolist() == [1.5, 1.5]
    for cameras in (1, 2):
        scored = hand_made([], [], 1, cameras=cameras)
        assert frame_lengths_s(scored.rows, scored.frames).tolist() == [1] * cameras
