"""Tracks on hidden vessels, and occlusions that tracks survive or not, worked out by hand."""

from collections.abc import Sequence

import numpy as np
import pytest

from modsim3d.tracking.scores.occlusions import Hidden, OcclusionEpisode, Survival, hidden, occlusions, survival, within
from modsim3d.tracking.scores.scored import Scored
from tests.tracking.hand_made import Seen, box, hand_made

A = box()
VISIBLE = (1, 1, 1, 0.5, 0.3, 0.2, 0, 1, 1, 1, 1, 1, 1, 1)
"""Of one vessel in 14 frames, 0.5 s apart: it is occluded from 2 to 3.5 s."""


def seen(tracks: Sequence[tuple[int, int]], visible: Sequence[float | None] = VISIBLE) -> Scored:
    """A vessel, and tracks on it as (frame, track)."""
    truth = [Seen(k, 0, A, fraction) for k, fraction in enumerate(visible)]
    return hand_made(truth, [(frame, track, A) for frame, track in tracks], 14, step_s=0.5)


def test_a_hidden_vessel_is_followed_by_the_track_from_before_or_by_another_or_by_none() -> None:
    truth = [Seen(k, 0, A, float(k not in (2, 3, 4, 5))) for k in range(7)]
    tracks = [(0, 9, A), (1, 1, A), (2, 1, A), (3, 2, A), (4, 2, A)]  # 9, 1 before; while hidden 1, 2, 2, none
    assert hidden(hand_made(truth, tracks, 7)) == Hidden(4, 3 / 4, 1 / 4)
    assert hidden(hand_made(truth, tracks[2:], 7)) == Hidden(4, 3 / 4, 0)  # nothing followed it before
    assert hidden(hand_made(truth, tracks, 7).in_frames(np.array([2, 6]))) == Hidden(1, 1, 1)
    assert hidden(hand_made(truth[:2], tracks, 7)) == Hidden(0, None, None)
    back = [Seen(0, 0, A), Seen(5, 0, A, 0)]  # it comes back hidden, as a new identity
    assert hidden(hand_made(back, [(0, 1, A), (5, 1, A)], 6)) == Hidden(1, 1, 0)
    beside = [Seen(0, 0, A), Seen(1, 1, A, 0)]  # the track is that of another vessel
    assert hidden(hand_made(beside, [(0, 1, A), (1, 1, A)], 2)) == Hidden(1, 1, 0)


def test_an_occlusion_is_from_the_first_frame_below_half_to_the_next_frame_after_the_last() -> None:
    found = OcclusionEpisode("C0", "v0", 2.0, 3.5, 1.5, 0.0, True, 1, 1, True)
    assert occlusions(seen([(3, 1), (8, 1)])) == (found,)


@pytest.mark.parametrize(
    ("tracks", "before", "after", "survived"),
    [
        ([(3, 1), (7, 2), (8, 1)], 1, 2, False),  # another track is the first after
        ([(3, 1), (4, 2), (7, 2)], 1, 2, False),  # the change was during the occlusion
        ([(2, 1), (3, 2), (7, 2)], 2, 2, True),  # the last one before is what counts
        ([(2, 1), (11, 1)], 1, 1, True),  # 1 s before and 2 s after, both just in time
        ([(1, 1), (7, 1)], None, 1, None),  # 1.5 s before: too early
        ([(3, 1), (12, 1)], 1, None, False),  # 2.5 s after: too late
        ([(3, 1), (5, 1)], 1, None, False),  # during it only
        ([], None, None, None),
    ],
)
def test_the_track_after_an_occlusion_is_the_one_before_or_not(tracks, before, after, survived) -> None:
    (found,) = occlusions(seen(tracks))
    assert (found.track_before, found.track_after, found.survived) == (before, after, survived)
    assert found.followed_before == (before is not None)


def test_an_occlusion_after_which_the_vessel_is_gone_judges_no_track_and_without_a_pixel_it_is_not_back() -> None:
    scored = seen([(3, 1)], VISIBLE[:7])
    assert occlusions(scored)[0].survived is None and survival(scored) == Survival(1, 0, None, 0)
    through = (1, 1, 1, 1, 0.2, None, 0, None, 1, 1, 1, 1, 1, 1)
    (found,) = occlusions(seen([(k, 1) for k in (*range(4), *range(8, 14))], through))
    assert (found.start_s, found.end_s, found.least_visible_fraction, found.survived) == (2, 3.5, 0, True)
    never_again = (1, 1, 1, 1, 0.2, *(None,) * 9)
    assert survival(seen([(k, 1) for k in range(4)], never_again)) == Survival(1, 0, None, 0)


def test_occlusions_of_two_vessels_in_two_cameras_are_apart() -> None:
    # Vessel 0 in camera 0 and vessel 1 in camera 1 are occluded at once; only the track of the first stays.
    boxes = (A, box(200))
    truth = [Seen(2 * k + c, c, boxes[c], 1 if k != 2 else 0.1) for k in range(5) for c in (0, 1)]
    tracks = [(2 * k + c, 7 + (c and k > 2), boxes[c]) for k in range(5) for c in (0, 1) if k != 2]
    scored = hand_made(truth, tracks, 5, cameras=2)
    found = [(each.camera, each.vessel, each.survived) for each in occlusions(scored)]
    assert found == [("C0", "v0", True), ("C1", "v1", False)]
    assert survival(scored) == Survival(2, 2, 0.5, 2)
    assert survival(scored.in_frames(np.array([4]))) == Survival(1, 1, 1, 1)


def test_two_occlusions_of_a_vessel_are_two_and_one_at_the_end_lasts_as_long_as_a_frame() -> None:
    visible = (1, 0.4, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0.1)
    found = occlusions(seen([(k, 1) for k in range(14)], visible))
    assert [(each.start_s, each.end_s, each.survived) for each in found] == [(0.5, 1, True), (6.5, 7, None)]
    assert occlusions(seen([], (1,) * 14)) == () and survival(hand_made([], [], 2)) == Survival(0, 0, None, 0)


def test_the_last_bits_of_times_decide_nothing() -> None:
    spans_s = np.array([4.4 - 2.4, 2.0, 2.001, np.nan])
    assert spans_s[0] > 2 and within(spans_s, 2).tolist() == [True, True, False, False]
    since_1970_s = 1_700_000_000.2 - 1_700_000_000.1
    assert since_1970_s > 0.1 and within(np.array([since_1970_s]), 0.1).all()
