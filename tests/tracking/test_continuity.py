"""Establishment, breaks and false tracks, worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest

from modsim3d.tracking.scores.continuity import Continuity, continuity, false_track_lengths_s
from modsim3d.tracking.scores.scored import frame_lengths_s
from tests.tracking.hand_made import box, hand_made


def _followed(frames: list[int], steps: int = 10, **more) -> Continuity:
    """One vessel in all frames, half a second apart, followed in some by one track."""
    truth = [(k, 0, box()) for k in range(steps)]
    return continuity(hand_made(truth, [(k, 7, box()) for k in frames], steps, step_s=0.5, **more))


def test_a_vessel_followed_from_the_first_frame_to_the_last_has_nothing_to_count() -> None:
    found = vars(_followed(list(range(10))))
    ones = dict.fromkeys(("appearances", "established", "established_share", "tracks_per_vessel"), 1)
    unknown = dict.fromkeys(("mean_track_break_s", "longest_track_break_s", "mean_false_track_s"))
    assert found == dict.fromkeys(found, 0) | ones | unknown


def test_establishment_two_breaks_and_a_loss_worked_by_hand() -> None:
    """Followed in frames 2, 3, 5 and 8 of 10: breaks 4 (0.5 s) and 6-7 (1 s), lost in 9; 4 s from frame 2 on."""
    found = _followed([2, 3, 5, 8])
    assert (found.time_to_establish_s, found.longest_time_to_establish_s) == (1, 1)
    assert (found.track_breaks, found.track_break_s) == (2, 1.5)
    assert (found.mean_track_break_s, found.longest_track_break_s) == (0.75, 1)
    assert found.track_breaks_per_hour == 2 / 4 * 3600 and (found.lost, found.lost_s) == (1, 0.5)


def test_the_wait_of_a_vessel_that_is_never_followed_is_in_no_mean() -> None:
    truth = [(k, vessel, box(100 * vessel)) for k in range(4) for vessel in range(3)]
    scored = hand_made(truth, [(3, 7, box()), (1, 8, box(100)), (2, 8, box(100))], 4)
    found = continuity(scored)
    assert (found.appearances, found.established, found.established_share) == (3, 2, 2 / 3)
    assert (found.time_to_establish_s, found.longest_time_to_establish_s) == (2, 3)
    assert (found.track_breaks, found.lost, found.lost_s, found.tracks_per_vessel) == (0, 1, 1, 1)


def test_hidden_frames_are_no_break() -> None:
    """Hidden in frames 2-4, not followed in 2-5: only frame 5 is a break."""
    truth = [(k, 0, box(), 0.0 if k in (2, 3, 4) else 1.0) for k in range(8)]
    found = continuity(hand_made(truth, [(k, 7, box()) for k in (0, 1, 6, 7)], 8))
    assert (found.track_breaks, found.track_break_s) == (1, 1) and (found.lost, found.appearances) == (0, 1)


def test_a_vessel_that_is_hidden_first_waits_from_when_it_is_seen() -> None:
    truth = [(k, 0, box(), 0.0 if k < 3 else 1.0) for k in range(6)]
    found = continuity(hand_made(truth, [(k, 7, box()) for k in (1, 2, 5)], 6))
    assert found.time_to_establish_s == 2  # seen in frame 3, followed in frame 5; frames 1 and 2 do not count


def test_a_break_that_another_track_ends_is_a_break_and_two_tracks() -> None:
    truth = [(k, 0, box()) for k in range(5)]
    found = continuity(hand_made(truth, [(0, 7, box()), (1, 7, box()), (3, 8, box()), (4, 8, box())], 5))
    assert (found.track_breaks, found.track_break_s, found.tracks_per_vessel) == (1, 1, 2)


def test_a_change_of_tracks_without_a_pause_is_no_break() -> None:
    truth = [(k, 0, box()) for k in range(4)]
    found = continuity(hand_made(truth, [(k, 7 if k < 2 else 8, box()) for k in range(4)], 4))
    assert (found.track_breaks, found.tracks_per_vessel, found.false_tracks) == (0, 2, 0)


def test_breaks_of_vessels_are_apart() -> None:
    """Vessel 0 ends unfollowed and vessel 1 begins unfollowed: neither is a break."""
    truth = [(k, vessel, box(100 * vessel)) for k in range(4) for vessel in range(2)]
    found = continuity(hand_made(truth, [(0, 7, box()), (1, 7, box()), (3, 8, box(100))], 4))
    assert (found.track_breaks, found.lost, found.lost_s, found.time_to_establish_s) == (0, 1, 2, 1.5)


def test_a_vessel_that_comes_back_into_the_image_is_established_again() -> None:
    truth = [(k, 0, box()) for k in (0, 1, 6, 7)]
    found = continuity(hand_made(truth, [(0, 7, box()), (1, 7, box()), (7, 7, box())], 8))
    assert (found.appearances, found.established, found.track_breaks, found.time_to_establish_s) == (2, 2, 0, 0.5)


def test_false_tracks_are_those_that_never_follow_a_vessel_hidden_or_not() -> None:
    """Track 7 leaves its vessel, 8 follows a hidden one only, 9 (frames 0, 2) and 10 (frame 1) follow none."""
    truth = [*((k, 0, box()) for k in range(4)), (0, 1, box(200), 0.0)]
    tracks = [(0, 7, box()), (1, 7, box(400)), (0, 8, box(200)), (1, 8, box(400, 100))]
    scored = hand_made(truth, [*tracks, *((k, 9, box(500)) for k in (0, 2)), (1, 10, box(600))], 4, step_s=0.5)
    found = continuity(scored)
    assert false_track_lengths_s(scored).tolist() == [1, 0.5]
    assert (found.false_tracks, found.false_track_s, found.mean_false_track_s) == (2, 1.5, 0.75)
    assert found.false_tracks_per_hour == 2 / 2 * 3600  # 4 frames of half a second


def test_equal_numbers_in_two_cameras_are_two_tracks() -> None:
    scored = hand_made([(0, 0, box())], [(0, 7, box()), (1, 7, box()), (3, 7, box())], 2, cameras=2)
    found = continuity(scored)
    assert (found.false_tracks, found.false_track_s) == (1, 2)
    assert found.false_tracks_per_hour == 1 / 4 * 3600  # 2 s of 2 cameras


def test_of_nothing_nothing_is_averaged() -> None:
    found = continuity(hand_made([], [], 2))
    assert (found.appearances, found.track_breaks, found.false_tracks, found.false_tracks_per_hour) == (0, 0, 0, 0)
    assert found.established_share is None and found.time_to_establish_s is None
    assert found.tracks_per_vessel is None and found.track_breaks_per_hour is None
    never = continuity(hand_made([(0, 0, box())], [], 2))
    assert (never.established, never.established_share, never.lost) == (0, 0, 0)


def test_a_frame_stands_for_the_time_to_the_camera_s_next_one() -> None:
    scored = hand_made([], [], 6, cameras=2, step_s=0.5)
    rows = replace(scored.rows, frames=np.array([0, 1, 3, 4, 10]))  # camera 0 at steps 0, 2, 5; camera 1 at 0 and 1
    scored = replace(scored, rows=rows)
    assert frame_lengths_s(scored, np.array([0, 1, 3, 4, 10])).tolist() == [1, 0.5, 0.5, 1.5, 1.5]
    assert frame_lengths_s(scored, np.array([10, 4])).tolist() == [1.5, 1.5]


@pytest.mark.parametrize("cameras", [1, 2])
def test_an_only_frame_stands_for_a_second_if_the_camera_has_no_rate(cameras: int) -> None:
    scored = hand_made([], [], 1, cameras=cameras)
    assert frame_lengths_s(scored, scored.frames).tolist() == [1] * cameras
