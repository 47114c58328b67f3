"""SIAP of tracks in the image: worked out by hand, with Stone Soup's values, and against a slow way."""

import datetime as dt
from collections import defaultdict

import numpy as np
import pytest
from stonesoup.dataassociator.tracktotrack import TrackToTruth
from stonesoup.measures import Euclidean
from stonesoup.metricgenerator.manager import MultiManager
from stonesoup.metricgenerator.tracktotruthmetrics import SIAPMetrics
from stonesoup.types.groundtruth import GroundTruthPath, GroundTruthState
from stonesoup.types.state import State
from stonesoup.types.track import Track

from modsim3d.tracking.scores.errors import Siap, siap
from modsim3d.tracking.scores.scored import Rules
from modsim3d.tracks.tracks import Similarity
from tests.tracking.hand_made import box, hand_made, placed

FRAMES = 60
RULES = Rules(gap_s=100, similarity=Similarity("centre", 20, 0.5))  # pairs up to 10 px apart
_START = dt.datetime(2024, 1, 1)


def siap_of(truth: list[tuple], tracks: list[tuple], **options: float) -> Siap:
    return siap(hand_made(truth, tracks, 1 + max(frame for frame, *_ in truth), rules=RULES, **options))


def test_a_track_goes_to_the_nearest_vessel_and_a_second_one_there_is_ambiguous_and_not_spurious() -> None:
    vessel = placed(0, range(4))
    assert siap_of(vessel, placed(7, range(4), 3, 4)) == Siap(1, 1, 0, 5, 0, 1)  # followed all the time
    # 4 vessel-frames with 6 tracks, one more track far off; distances 0 (four times) and 6 (twice).
    second = [*placed(7, range(4)), *placed(8, (1, 2), 6), *placed(9, [3], 300)]
    assert siap_of(vessel, second) == Siap(1, 1.5, 1 / 7, 2, 0, 1)
    # The matching would keep the track on vessel 0, which is 8 px away; vessel 1 is 2 px away.
    nearest = siap_of([*placed(0, (0, 1)), *placed(1, [1], 10)], [*placed(7, [0]), *placed(7, [1], 8)])
    assert nearest == Siap(2 / 3, 1, 0, 1, 0, 2 / 3)
    # Of two as near as each other to the one that it follows: the smaller lies in the larger's middle in frame 1.
    truth = [*placed(0, range(3)), *placed(1, (0, 2), 55, 5, 10, 10), *placed(1, [1], 5, 5, 10, 10)]
    assert siap_of(truth, truth) == Siap(1, 1, 0, 0, 0, 1)


def test_another_track_is_a_change_and_a_pause_breaks_the_longest_stretch() -> None:
    # 10 s, track 7 for 6 s, then track 8 for 4 s.
    other = siap_of(placed(0, range(20)), placed(7, range(12)) + placed(8, range(12, 20)), step_s=0.5)
    assert other == Siap(1, 1, 0, 0, 0.1, 0.6)
    assert siap_of(placed(0, range(10)), placed(7, (0, 1, 2, 3, 6, 7, 8, 9))) == Siap(0.8, 1, 0, 0, 0, 0.4)
    # Tracks 7 in frames 0-2, 8 in 1-5, 9 in 2-3: one change to the longer one is enough, in 6 s.
    at_once = siap_of(placed(0, range(6)), [*placed(7, range(3)), *placed(8, range(1, 6)), *placed(9, (2, 3))])
    assert at_once == Siap(1, 10 / 6, 0, 0, 1 / 6, 5 / 6)
    # Two vessels that change places with their tracks have a change each.
    truth = [(k, vessel, box(100 * vessel)) for k in range(4) for vessel in range(2)]
    assert siap_of(truth, [(k, v ^ (k > 1), place) for k, v, place in truth]) == Siap(1, 1, 0, 0, 2 / 8, 4 / 8)


def test_what_lies_on_a_hidden_vessel_is_left_out_and_breaks_no_stretch() -> None:
    """Hidden in frame 1, with two tracks on it."""
    truth = [*placed(0, (0, 2)), (1, 0, box(), 0.0)]
    assert siap_of(truth, placed(7, range(3)) + placed(8, [1], 5)) == Siap(1, 1, 0, 0, 0, 1)


def test_cameras_are_apart_and_only_the_frames_in_question_and_no_last_bits_of_times_count() -> None:
    scored = hand_made(placed(0, range(4)), placed(7, (0, 2)), 2, cameras=2, rules=RULES)
    assert siap(scored) == Siap(0.5, 1, 0, 0, 0, 0.5)
    tracks = [*placed(7, [0]), *placed(7, [1], 4), *placed(8, [2]), *placed(9, [3], 300)]
    scored = hand_made(placed(0, range(4)), tracks, 4, rules=RULES)
    assert siap(scored.in_frames(np.array([0, 1]))) == Siap(1, 1, 0, 2, 0, 1)
    truth = [each for vessel in range(3) for each in placed(vessel, range(7 + vessel), 100 * vessel)]
    assert siap_of(truth, truth, step_s=0.1).siap_longest_track_share == 1


def test_of_nothing_nothing_is_said() -> None:
    assert siap(hand_made([], [], 2)) == Siap(None, None, None, None, None, None)
    assert siap(hand_made(placed(0, [0]), [], 2)) == Siap(0, None, None, None, None, 0)
    assert siap(hand_made([], placed(7, [0]), 2)) == Siap(None, None, 1, None, None, None)


@pytest.mark.parametrize("seed", range(3))
def test_shares_and_accuracy_are_those_of_stone_soup(seed: int) -> None:
    """Tracks stay at a place for 5 frames and do not pause: Stone Soup 1.9.1 fails at an association of one frame, and
    at a track that pauses."""
    rng = np.random.default_rng(seed)
    blocks = FRAMES // 5
    there = np.repeat(rng.random((blocks, 3)) < 0.8, 5, axis=0)
    truth = [(k, v, 0.1 * k + 15.0 * v) for k in range(FRAMES) for v in range(3) if there[k, v]]
    places = np.repeat(rng.uniform(-15, 50, (blocks, 6)), 5, axis=0)
    tracks = [(k, t, 0.1 * k + places[k, t]) for k in range(FRAMES) for t in range(6) if 5 * t <= k < FRAMES - 5]
    theirs, ours = _stone_soup(truth, tracks), _along_a_line(truth, tracks)
    names = ("Completeness", "Ambiguity", "Spuriousness", "Position Accuracy")
    found = (ours.siap_completeness, ours.siap_ambiguity, ours.siap_spuriousness, ours.siap_positional_accuracy_px)
    np.testing.assert_allclose(found, [theirs[f"SIAP {name}"] for name in names], rtol=1e-9)


def test_changes_and_stretches_are_those_of_stone_soup_where_no_track_pauses() -> None:
    """Stone Soup takes times from the first to the last frame: 19 s of 20 frames, 11 s of the longer track."""
    truth = [(k, 0, 0.0) for k in range(20)]
    tracks = [(k, 7 if k < 12 else 8, 0.0) for k in range(20)]
    theirs, ours = _stone_soup(truth, tracks), _along_a_line(truth, tracks)
    assert ours.siap_id_changes_per_s == 1 / 20
    assert theirs["SIAP Rate of Track Number Change"] == pytest.approx(1 / 18)  # 11 s and 7 s
    assert ours.siap_longest_track_share == 12 / 20
    assert theirs["SIAP Longest Track Segment"] == pytest.approx(11 / 19)


@pytest.mark.parametrize("seed", range(3))
def test_changes_and_stretches_are_those_of_a_walk_along_the_frames(seed: int) -> None:
    """Tracks pause, change between vessels and overlap, and vessels are missing in frames."""
    rng = np.random.default_rng(seed)
    places = np.cumsum(rng.normal(0, 3, (FRAMES, 3)), axis=0) + np.array([0, 15, 30])
    truth = [(k, v, places[k, v]) for k in range(FRAMES) for v in range(3) if rng.random() < 0.95]
    on = np.repeat(rng.integers(0, 3, (FRAMES // 10, 6)), 10, axis=0)
    tracks = [(k, t, places[k, on[k, t]] + rng.normal(0, 4)) for k in range(FRAMES) for t in range(6)]
    tracks = [each for each in tracks if rng.random() < 0.5]
    nearest: dict[int, dict[int, set[int]]] = defaultdict(lambda: defaultdict(set))
    for frame, track, x in tracks:
        apart = {vessel: abs(x - at) for k, vessel, at in truth if k == frame}
        vessel = min(apart, key=apart.__getitem__, default=None)
        if vessel is not None and apart[vessel] <= 10:
            nearest[vessel][frame].add(track)
    changes = tracked = longest = 0
    for vessel in range(3):
        held: set[int] = set()
        stretch: dict[int, int] = {}
        best = 0
        for frame in [k for k, name, _ in truth if name == vessel]:
            there = nearest[vessel][frame]
            stretch = {track: stretch.get(track, 0) + 1 for track in there}
            best = max([best, *stretch.values()])
            if there:
                tracked += 1
                changes += bool(held) and not held & there
                held = (held & there) or there
        longest += best
    ours = _along_a_line(truth, tracks)
    assert changes > 3 and ours.siap_id_changes_per_s == pytest.approx(changes / tracked)
    assert ours.siap_longest_track_share == pytest.approx(longest / len(truth))


def _along_a_line(truth: list, tracks: list) -> Siap:
    """SIAP of rows of frame, name and place."""
    return siap_of(*([(frame, name, box(x)) for frame, name, x in rows] for rows in (truth, tracks)))


def _stone_soup(truth: list, tracks: list) -> dict[str, float]:
    """Stone Soup's SIAP of places along a line, one frame a second, by the titles of its metrics."""
    vessels, found = defaultdict(GroundTruthPath), defaultdict(Track)
    for frame, vessel, x in truth:
        vessels[vessel].append(GroundTruthState([x], timestamp=_START + dt.timedelta(seconds=frame)))
    for frame, track, x in tracks:
        found[track].append(State([x], timestamp=_START + dt.timedelta(seconds=frame)))
    manager = MultiManager(
        [SIAPMetrics(Euclidean(), Euclidean(), generator_name="siap", tracks_key="tracks", truths_key="truth")],
        TrackToTruth(association_threshold=10, consec_pairs_confirm=1, consec_misses_end=1),
    )
    manager.add_data({"tracks": set(found.values()), "truth": set(vessels.values())})
    return {title: metric.value for title, metric in manager.generate_metrics()["siap"].items()}
