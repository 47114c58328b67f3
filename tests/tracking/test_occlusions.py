"""Occlusions, recall and association broken down, establishment and breaks, by hand and against slow sums."""

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import astuple, replace

import numpy as np
import pytest

from modsim3d.tracking.score_page import _cells
from modsim3d.tracking.scores.breakdown import Bin, association_of_pairs, breakdown
from modsim3d.tracking.scores.continuity import Continuity, continuity, false_track_lengths_s
from modsim3d.tracking.scores.occlusions import OcclusionEpisode, Survival, hidden, occlusions, survival, within
from modsim3d.tracking.scores.scored_run import ScoredRun, frame_lengths_s
from modsim3d.view.pages.tables import table
from tests.tracking.hand_made import LABELS, Seen, box, hand_made, placed

A = box()
VISIBLE = (1, 1, 1, 0.5, 0.3, 0.2, 0, 1, 1, 1, 1, 1, 1, 1)
"""Of one vessel in 14 frames, 0.5 s apart: it is occluded from 2 to 3.5 s."""


def seen(tracks: Sequence[tuple[int, int]], visible: Sequence[float | None] = VISIBLE) -> ScoredRun:
    """A vessel, and tracks on it as (frame, track)."""
    truth = [Seen(k, 0, A, fraction) for k, fraction in enumerate(visible)]
    return hand_made(truth, [(frame, track, A) for frame, track in tracks], 14, step_s=0.5)


def test_a_hidden_vessel_is_followed_by_the_track_from_before_or_by_another_or_by_none() -> None:
    truth = [Seen(k, 0, A, float(k not in (2, 3, 4, 5))) for k in range(7)]
    tracks = [(0, 9, A), (1, 1, A), (2, 1, A), (3, 2, A), (4, 2, A)]  # 9, 1 before; while hidden 1, 2, 2, none
    assert astuple(hidden(hand_made(truth, tracks, 7))) == (4, 3 / 4, 1 / 4)
    assert astuple(hidden(hand_made(truth, tracks[2:], 7))) == (4, 3 / 4, 0)  # nothing followed it before
    assert astuple(hidden(replace(hand_made(truth, tracks, 7), frames=np.array([2, 6])))) == (1, 1, 1)
    assert astuple(hidden(hand_made(truth[:2], tracks, 7))) == (0, None, None)
    back = [Seen(0, 0, A), Seen(5, 0, A, 0)]  # it comes back hidden, as a new identity
    assert astuple(hidden(hand_made(back, [(0, 1, A), (5, 1, A)], 6))) == (1, 1, 0)
    beside = [Seen(0, 0, A), Seen(1, 1, A, 0)]  # the track is that of another vessel
    assert astuple(hidden(hand_made(beside, [(0, 1, A), (1, 1, A)], 2))) == (1, 1, 0)


def test_the_track_after_an_occlusion_is_the_one_before_or_not_and_none_is_judged_if_the_vessel_is_gone():
    whole = OcclusionEpisode("C0", "v0", 2.0, 3.5, 1.5, 0.0, True, 1, 1, True)
    # From the first frame below half to the next frame after the last.
    assert occlusions(seen([(3, 1), (8, 1)])) == (whole,)
    for tracks, *expected in (
        ([(3, 1), (7, 2), (8, 1)], 1, 2, False),  # another track is the first after
        ([(3, 1), (4, 2), (7, 2)], 1, 2, False),  # the change was during the occlusion
        ([(2, 1), (3, 2), (7, 2)], 2, 2, True),  # the last one before is what counts
        ([(2, 1), (11, 1)], 1, 1, True),  # 1 s before and 2 s after, both just in time
        ([(1, 1), (7, 1)], None, 1, None),  # 1.5 s before: too early
        ([(3, 1), (12, 1)], 1, None, False),  # 2.5 s after: too late
        ([(3, 1), (5, 1)], 1, None, False),  # during it only
        ([], None, None, None),
    ):
        (found,) = occlusions(seen(tracks))
        assert [found.track_before, found.track_after, found.survived] == expected, tracks
        assert found.followed_before == (found.track_before is not None)
    scored = seen([(3, 1)], VISIBLE[:7])
    assert occlusions(scored)[0].survived is None and survival(scored) == Survival(1, 0, None, 0)
    through = (1, 1, 1, 1, 0.2, None, 0, None, 1, 1, 1, 1, 1, 1)
    (found,) = occlusions(seen([(k, 1) for k in (*range(4), *range(8, 14))], through))
    assert (found.start_s, found.end_s, found.least_visible_fraction, found.survived) == (2, 3.5, 0, True)
    never_again = (1, 1, 1, 1, 0.2, *(None,) * 9)
    assert survival(seen([(k, 1) for k in range(4)], never_again)) == Survival(1, 0, None, 0)


def test_occlusions_of_two_vessels_or_of_one_twice_are_apart_whatever_the_last_bits_of_times():
    # Vessel 0 in camera 0 and vessel 1 in camera 1 are occluded at once; only the track of the first stays.
    boxes = (A, box(200))
    truth = [Seen(2 * k + c, c, boxes[c], 1 if k != 2 else 0.1) for k in range(5) for c in (0, 1)]
    tracks = [(2 * k + c, 7 + (c and k > 2), boxes[c]) for k in range(5) for c in (0, 1) if k != 2]
    scored = hand_made(truth, tracks, 5, cameras=2)
    found = [(each.camera, each.vessel, each.survived) for each in occlusions(scored)]
    assert found == [("C0", "v0", True), ("C1", "v1", False)]
    assert survival(scored) == Survival(2, 2, 0.5, 2)
    assert survival(replace(scored, frames=np.array([4]))) == Survival(1, 1, 1, 1)
    visible = (1, 0.4, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0.1)
    found = occlusions(seen([(k, 1) for k in range(14)], visible))
    assert [(each.start_s, each.end_s, each.survived) for each in found] == [(0.5, 1, True), (6.5, 7, None)]
    assert occlusions(seen([], (1,) * 14)) == () and survival(hand_made([], [], 2)) == Survival(0, 0, None, 0)
    spans_s = np.array([4.4 - 2.4, 2.0, 2.001, np.nan])
    assert spans_s[0] > 2 and within(spans_s, 2).tolist() == [True, True, False, False]
    since_1970_s = 1_700_000_000.2 - 1_700_000_000.1
    assert since_1970_s > 0.1 and within(np.array([since_1970_s]), 0.1).all()


FIRST, SECOND = 4 / 7, 1 / 7
EXPECTED = {
    "visible_fraction": [
        Bin("1", 3, 2 / 3, FIRST),
        Bin("0.75 to 1", 1, 1, FIRST),
        Bin("0.5 to 0.75", 1, 1, FIRST),
        Bin("0.25 to 0.5", 1, 1, SECOND),
        Bin("below 0.25", 1, 0, None),
    ],
    # before are frames 1 and 2, during 3 and 4, after 6 and 7
    "phase": [
        *(Bin("before", 2, 1, FIRST), Bin("during", 2, 0.5, SECOND), Bin("after", 2, 0.5, FIRST)),
        Bin("elsewhere", 1, 1, FIRST),
    ],
    "occlusion": [Bin("3 to 10", 2, 0.5, SECOND, occlusions=1, judged=1, survived=1, to_survive=1)],
    "range": [
        *(Bin("0 to 100", 1, 1, FIRST), Bin("100 to 200", 2, 1, FIRST), Bin("200 to 400", 1, 1, SECOND)),
        *(Bin("400 to 800", 1, 0, None), Bin("800 and more", 2, 0.5, FIRST)),
    ],
    "size": [Bin("16 to 32", 7, 5 / 7, (4 * FIRST + SECOND) / 5)],
    "edge": [Bin("whole in the image", 6, 5 / 6, (4 * FIRST + SECOND) / 5), Bin("cut by the edge", 1, 0, None)],
    "state": [Bin("clear", 5, 4 / 5, (3 * FIRST + SECOND) / 4), Bin("haze", 2, 0.5, FIRST)],
    "label": [Bin(LABELS[0], 7, 5 / 7, (4 * FIRST + SECOND) / 5)],
}


def test_each_group_has_the_values_that_were_worked_out_and_occlusions_are_survived_by_length():
    """A vessel in eight frames, a second apart: occluded from 3 to 6 s, wholly hidden from 5 s on. Track 1 follows it
    in frames 0, 1, 2 and 6, coasts in 5, where nothing is scored, and track 2 follows in frame 3. Seven frames are
    scored. Of track 1 TPA = 4, FNA = 3, FPA = 0: A = 4/7; of track 2 A = 1/7."""
    visible, depth_m = (1, 0.8, 0.6, 0.3, 0.1, 0, 1, 1), (50, 100, 150, 250, 450, 450, 850, 850)
    truth = [Seen(k, 0, box(), visible[k], 0.9 if k == 7 else 1, depth_m[k]) for k in range(8)]
    tracks = [(k, 2 if k == 3 else 1, box()) for k in (0, 1, 2, 3, 5, 6)]
    groups = breakdown(hand_made(truth, tracks, 8, states=[0] * 6 + [1] * 2))
    assert [group.name for group in groups] == [*EXPECTED]
    for group in groups:
        for found, expected in zip(group.rows, EXPECTED[group.name], strict=True):
            assert vars(found) == pytest.approx(vars(expected), abs=1e-12), (group.name, found.bin)
    # Occluded from 1 to 2 s, with the same track before and after, and from 4 to 8 s, with another one after.
    truth = [Seen(k, 0, box(), 0.2 if k == 1 or 4 <= k < 8 else 1) for k in range(10)]
    tracks = [(k, 1 + k // 8, box()) for k in range(10)]
    found = {group.name: group.rows for group in breakdown(hand_made(truth, tracks, 10))}["occlusion"]
    told = [(row.bin, row.occlusions, row.judged, row.survived) for row in found]
    assert told == [("1 to 3", 1, 1, 1), ("3 to 10", 1, 1, 0)]
    assert not any(group.rows for group in breakdown(hand_made([], [(0, 1, box())], 2)))


def random(seed: int) -> ScoredRun:
    """Vessels with random visibility, range and place in the image, and tracks that switch and miss."""
    rng = np.random.default_rng(seed)
    truth, tracks = [], []
    for frame, vessel in np.ndindex(60, 5):
        if rng.random() < 0.95:
            fraction, place = rng.choice([0, 0.1, 0.3, 0.6, 0.8, 1]), box(60 * vessel)
            truth.append(Seen(frame, vessel, place, fraction, rng.choice([0.5, 1]), rng.uniform(0, 1000)))
        if rng.random() < 0.7:
            tracks.append((frame, vessel + 5 * int(rng.integers(3)), place))
    return hand_made(truth, tracks, 60, states=rng.integers(0, 2, 60).tolist(), step_s=0.5)


@pytest.mark.parametrize("seed", range(3))
def test_the_bins_of_a_group_together_are_all_vessel_frames_and_association_that_of_sets_of_frames(seed: int) -> None:
    scored = random(seed)
    found, association = association_of_pairs(scored)
    groups = {group.name: group.rows for group in breakdown(scored)}
    during = next(row for row in groups["phase"] if row.bin == "during")
    assert sum(row.vessel_frames for row in groups.pop("occlusion")) == during.vessel_frames
    for rows in groups.values():
        columns = [(row.vessel_frames, row.recall, row.association or 0) for row in rows]
        frames, recall, each = np.array(columns, dtype=float).T
        assert frames.sum() == len(scored.truth) and frames.min() > 0
        assert frames @ recall == pytest.approx(len(scored.pairs[0]))
        assert (frames * recall) @ each == pytest.approx(np.nansum(association))
    vessels, tracks, following = scored.following.truth, scored.following.tracks, scored.following
    for place in np.flatnonzero(found)[::7]:
        row = scored.truth_rows[place]
        mine, its = vessels.identity[row], tracks.identity[following.track_row[row]]
        of_vessel = {each for each in scored.truth_rows if vessels.identity[each] == mine}
        of_track = {each for each in scored.track_rows if tracks.identity[each] == its}
        together = [each for each in of_vessel if following.track_row[each] in of_track]
        union = len(of_vessel) + len(of_track) - len(together)
        assert association[place] == pytest.approx(len(together) / union)


def test_bars_of_the_page_have_one_width_for_a_share_in_all_columns() -> None:
    """Whatever the columns are as wide as: 0.91 under a narrow heading is longer than 0.65 under a wide one."""
    bins = (Bin("near", 9, 0.91, 0.65), Bin("near", 9, 1.0, None))
    shares = re.findall(r"--share: ([0-9.]+)", table([_cells(bins, "recall", "association")]))
    assert [float(share) for share in shares] == pytest.approx([0.91, 0.65, 1])  # none where there is no share


def vessel(frames: Iterable[int], hidden: Collection[int] = ()) -> list[tuple]:
    return [(frame, 0, box(), float(frame not in hidden)) for frame in frames]


def followed(truth: list[tuple], tracks: list[tuple], **options: float) -> Continuity:
    return continuity(hand_made(truth, tracks, 1 + max(frame for frame, *_ in truth), **options))


def test_breaks_and_losses_are_worked_by_hand_and_vessels_are_apart():
    found = vars(followed(vessel(range(10)), placed(7, range(10)), step_s=0.5))
    ones = dict.fromkeys(("appearances", "established", "established_share", "tracks_per_vessel"), 1)
    unknown = dict.fromkeys(("mean_track_break_s", "longest_track_break_s", "mean_false_track_s"))
    assert found == dict.fromkeys(found, 0) | ones | unknown
    # Followed in frames 2, 3, 5 and 8 of 10: breaks 4 (0.5 s) and 6-7 (1 s), lost in 9; 4 s from frame 2 on.
    found = followed(vessel(range(10)), placed(7, (2, 3, 5, 8)), step_s=0.5)
    assert (found.time_to_establish_s, found.longest_time_to_establish_s) == (1, 1)
    assert (found.track_breaks, found.track_break_s) == (2, 1.5)
    assert (found.mean_track_break_s, found.longest_track_break_s) == (0.75, 1)
    assert found.track_breaks_per_hour == 2 / 4 * 3600 and (found.lost, found.lost_s) == (1, 0.5)
    three = [(k, number, box(100 * number)) for k in range(4) for number in range(3)]
    found = followed(three, [(3, 7, box()), (1, 8, box(100)), (2, 8, box(100))])
    assert (found.appearances, found.established, found.established_share) == (3, 2, 2 / 3)
    assert (found.time_to_establish_s, found.longest_time_to_establish_s) == (2, 3)
    assert (found.track_breaks, found.lost, found.lost_s, found.tracks_per_vessel) == (0, 1, 1, 1)
    # Vessel 0 ends unfollowed and vessel 1 begins unfollowed: neither is a break.
    found = followed([each for each in three if each[1] < 2], [*placed(7, (0, 1)), (3, 8, box(100))])
    assert (found.track_breaks, found.lost, found.lost_s, found.time_to_establish_s) == (0, 1, 2, 1.5)


def test_hidden_frames_are_no_break_and_a_frame_stands_for_the_time_to_the_next_one():
    # Hidden in frames 2-4, not followed in 2-5: only frame 5 is a break.
    found = followed(vessel(range(8), hidden=(2, 3, 4)), placed(7, (0, 1, 6, 7)))
    assert (found.track_breaks, found.track_break_s, found.lost, found.appearances) == (1, 1, 0, 1)
    # Seen in frame 3, followed in frame 5; frames 1 and 2 do not count.
    assert followed(vessel(range(6), hidden=(0, 1, 2)), placed(7, (1, 2, 5))).time_to_establish_s == 2
    found = followed(vessel(range(5)), placed(7, (0, 1)) + placed(8, (3, 4)))
    assert (found.track_breaks, found.track_break_s, found.tracks_per_vessel) == (1, 1, 2)
    found = followed(vessel(range(4)), placed(7, (0, 1)) + placed(8, (2, 3)))
    assert (found.track_breaks, found.tracks_per_vessel, found.false_tracks) == (0, 2, 0)
    found = followed(vessel((0, 1, 6, 7)), placed(7, (0, 1, 7)))
    assert (found.appearances, found.established, found.track_breaks, found.time_to_establish_s) == (2, 2, 0, 0.5)
    scored = hand_made([], [], 6, cameras=2, step_s=0.5)
    rows = replace(scored.rows, frames=np.array([0, 1, 3, 4, 10]))  # camera 0 at steps 0, 2, 5; camera 1 at 0 and 1
    scored = replace(scored, rows=rows)
    assert frame_lengths_s(scored.rows, np.array([0, 1, 3, 4, 10])).tolist() == [1, 0.5, 0.5, 1.5, 1.5]
    assert frame_lengths_s(scored.rows, np.array([10, 4])).tolist() == [1.5, 1.5]
    for cameras in (1, 2):
        scored = hand_made([], [], 1, cameras=cameras)
        assert frame_lengths_s(scored.rows, scored.frames).tolist() == [1] * cameras


def test_false_tracks_are_those_that_never_follow_a_vessel_and_of_nothing_nothing_is_averaged():
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
    found = vars(continuity(hand_made([], [], 2)))
    unknown = {"established_share", "time_to_establish_s", "tracks_per_vessel", "track_breaks_per_hour"}
    assert unknown <= {name for name, value in found.items() if value is None}
    assert {found[name] for name in ("appearances", "track_breaks", "false_tracks", "false_tracks_per_hour")} == {0}
    never = followed(vessel([0]), [])
    assert (never.established, never.established_share, never.lost) == (0, 0, 0)
