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
from modsim3d.tracking.scores.scored import Rules, Scored
from modsim3d.tracks.tracks import Similarity
from tests.tracking.hand_made import box, hand_made

FRAMES = 60
RULES = Rules(gap_s=100, similarity=Similarity("centre", 20, 0.5))  # pairs up to 10 px apart
_START = dt.datetime(2024, 1, 1)


def test_one_vessel_followed_all_the_time() -> None:
    scored = hand_made([(k, 0, box()) for k in range(4)], [(k, 7, box(3, 4)) for k in range(4)], 4, rules=RULES)
    assert siap(scored) == Siap(1, 1, 0, 5, 0, 1)


def test_the_last_bits_of_times_are_in_no_share() -> None:
    truth = [(k, vessel, box(100 * vessel)) for vessel in range(3) for k in range(7 + vessel)]
    tracks = [(k, vessel, place) for k, vessel, place in truth]
    assert siap(hand_made(truth, tracks, 12, step_s=0.1, rules=RULES)).siap_longest_track_share == 1


def test_a_second_track_on_a_vessel_is_ambiguous_and_not_spurious() -> None:
    """4 vessel-frames with 6 tracks, one more track far off; distances 0 (four times) and 6 (twice)."""
    truth = [(k, 0, box()) for k in range(4)]
    tracks = [*((k, 7, box()) for k in range(4)), (1, 8, box(6)), (2, 8, box(6)), (3, 9, box(300))]
    assert siap(hand_made(truth, tracks, 4, rules=RULES)) == Siap(1, 1.5, 1 / 7, 2, 0, 1)


def test_a_track_goes_to_the_nearest_vessel() -> None:
    """The matching would keep the track on vessel 0, which is 8 px away; vessel 1 is 2 px away."""
    truth = [(0, 0, box()), (1, 0, box()), (1, 1, box(10))]
    assert siap(hand_made(truth, [(0, 7, box()), (1, 7, box(8))], 2, rules=RULES)) == Siap(2 / 3, 1, 0, 1, 0, 2 / 3)


def test_of_two_vessels_as_near_as_each_other_a_track_goes_to_the_one_that_it_follows() -> None:
    """The smaller vessel lies in the middle of the larger one in frame 1."""
    smaller = [(k, 1, box(5 + 50 * (k != 1), 5, 10, 10)) for k in range(3)]
    truth = [(k, 0, box()) for k in range(3)] + smaller
    assert siap(hand_made(truth, truth, 3, rules=RULES)) == Siap(1, 1, 0, 0, 0, 1)


def test_another_track_is_a_change_and_halves_the_longest_stretch() -> None:
    """10 s, track 7 for 6 s, then track 8 for 4 s."""
    truth = [(k, 0, box()) for k in range(20)]
    tracks = [(k, 7 if k < 12 else 8, box()) for k in range(20)]
    assert siap(hand_made(truth, tracks, 20, step_s=0.5, rules=RULES)) == Siap(1, 1, 0, 0, 0.1, 0.6)


def test_a_track_that_pauses_is_no_change_but_breaks_the_stretch() -> None:
    """Frames 0-3 and 6-9 of 10."""
    truth = [(k, 0, box()) for k in range(10)]
    tracks = [(k, 7, box()) for k in range(10) if k not in (4, 5)]
    assert siap(hand_made(truth, tracks, 10, rules=RULES)) == Siap(0.8, 1, 0, 0, 0, 0.4)


def test_with_two_tracks_at_once_one_stays_on_the_longer_one() -> None:
    """7 in frames 0-2, 8 in 1-5, 9 in 2-3: one change is enough, in 6 s."""
    truth, spans = [(k, 0, box()) for k in range(6)], {7: range(3), 8: range(1, 6), 9: range(2, 4)}
    tracks = [(k, track, box()) for track, span in spans.items() for k in span]
    assert siap(hand_made(truth, tracks, 6, rules=RULES)) == Siap(1, 10 / 6, 0, 0, 1 / 6, 5 / 6)


def test_two_vessels_that_change_places_with_their_tracks_have_a_change_each() -> None:
    truth = [(k, vessel, box(100 * vessel)) for k in range(4) for vessel in range(2)]
    tracks = [(k, vessel, box(100 * (vessel ^ (k > 1)))) for k in range(4) for vessel in range(2)]
    assert siap(hand_made(truth, tracks, 4, rules=RULES)) == Siap(1, 1, 0, 0, 2 / 8, 4 / 8)


def test_what_lies_on_a_hidden_vessel_is_left_out_and_breaks_no_stretch() -> None:
    """Hidden in frame 1, with two tracks on it."""
    truth = [(0, 0, box()), (1, 0, box(), 0.0), (2, 0, box())]
    tracks = [*((k, 7, box()) for k in range(3)), (1, 8, box(5))]
    assert siap(hand_made(truth, tracks, 3, rules=RULES)) == Siap(1, 1, 0, 0, 0, 1)


def test_cameras_are_apart() -> None:
    truth = [(frame, 0, box()) for frame in range(4)]
    scored = hand_made(truth, [(0, 7, box()), (2, 7, box())], 2, cameras=2, rules=RULES)
    assert siap(scored) == Siap(0.5, 1, 0, 0, 0, 0.5)


def test_only_the_frames_in_question_count() -> None:
    truth, tracks = [(k, 0, box()) for k in range(4)], [(0, 7, box()), (1, 7, box(4)), (2, 8, box()), (3, 9, box(300))]
    scored = hand_made(truth, tracks, 4, rules=RULES)
    assert siap(scored.in_frames(np.array([0, 1]))) == Siap(1, 1, 0, 2, 0, 1)


def test_of_nothing_nothing_is_said() -> None:
    assert siap(hand_made([], [], 2)) == Siap(None, None, None, None, None, None)
    assert siap(hand_made([(0, 0, box())], [], 2)) == Siap(0, None, None, None, None, 0)
    assert siap(hand_made([], [(0, 7, box())], 2)) == Siap(None, None, 1, None, None, None)


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
    theirs, ours = _stone_soup(truth, tracks), siap(_along_a_line(truth, tracks))
    names = ("Completeness", "Ambiguity", "Spuriousness", "Position Accuracy")
    found = (ours.siap_completeness, ours.siap_ambiguity, ours.siap_spuriousness, ours.siap_positional_accuracy_px)
    np.testing.assert_allclose(found, [theirs[f"SIAP {name}"] for name in names], rtol=1e-9)


def test_changes_and_stretches_are_those_of_stone_soup_where_no_track_pauses() -> None:
    """Stone Soup takes times from the first to the last frame: 19 s of 20 frames, 11 s of the longer track."""
    truth = [(k, 0, 0.0) for k in range(20)]
    tracks = [(k, 7 if k < 12 else 8, 0.0) for k in range(20)]
    theirs, ours = _stone_soup(truth, tracks), siap(_along_a_line(truth, tracks))
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
    ours = siap(_along_a_line(truth, tracks))
    assert changes > 3 and ours.siap_id_changes_per_s == pytest.approx(changes / tracked)
    assert ours.siap_longest_track_share == pytest.approx(longest / len(truth))


def _along_a_line(truth: list, tracks: list) -> Scored:
    """Rows of frame, name and place."""
    boxed = [[(frame, name, box(x)) for frame, name, x in rows] for rows in (truth, tracks)]
    return hand_made(*boxed, 1 + max(frame for frame, *_ in truth), rules=RULES)


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
