"""Errors of tracks, covariances, GOSPA, OSPA and SIAP, by hand, by sampling, by laws and as Stone Soup has them."""

import datetime as dt
from collections import defaultdict
from dataclasses import replace
from itertools import permutations

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stonesoup.dataassociator.tracktotrack import TrackToTruth
from stonesoup.measures import Euclidean
from stonesoup.metricgenerator.manager import MultiManager
from stonesoup.metricgenerator.ospametric import GOSPAMetric, OSPAMetric
from stonesoup.metricgenerator.tracktotruthmetrics import SIAPMetrics
from stonesoup.types.groundtruth import GroundTruthPath, GroundTruthState
from stonesoup.types.state import State
from stonesoup.types.track import Track

from modsim3d.core.errors import ModsimError
from modsim3d.tracking.scores import errors
from modsim3d.tracking.scores.errors import Siap, siap
from modsim3d.tracking.scores.scored_run import MAX_CUTOFF, Rules, SetDistance
from modsim3d.tracks.tracks import Similarity
from tests.tracking.hand_made import box, hand_made, placed

RULES = Rules(set_distance=SetDistance(cutoff=10))


def test_distances_are_means_over_frames_and_a_larger_power_and_hidden_vessels_have_their_parts():
    """A shift by (3, 4), a miss, a false track and an empty frame."""
    truth, tracks = [(0, 0, box()), (1, 0, box())], [(0, 7, box(3, 4)), (2, 7, box())]
    scored = hand_made(truth, tracks, 4, rules=RULES)
    assert errors.gospa(scored) == errors.Gospa(15 / 4, 5 / 4, 5 / 4, 5 / 4)  # 5, 10 / 2, 10 / 2 and 0
    assert errors.ospa(scored) == errors.Ospa(25 / 4)  # 5, 10, 10 and 0
    assert errors.gospa(replace(scored, frames=np.array([0, 3]))) == errors.Gospa(2.5, 2.5, 0, 0)
    nothing = replace(scored, frames=np.empty(0, dtype=np.int64))
    assert errors.gospa(nothing) == errors.Gospa(None, None, None, None) and errors.ospa(nothing) == errors.Ospa(None)
    # With c = 4 the error of 5 is a miss and a false track: 2 + 2, 2, 2 and 0.
    low, high = (errors.gospa(replace(scored, rules=Rules(set_distance=SetDistance(cutoff)))) for cutoff in (4, 20))
    assert low == errors.Gospa(2, 0, 1, 1) and high == errors.Gospa(25 / 4, 5 / 4, 5 / 2, 5 / 2)
    squared = Rules(set_distance=SetDistance(cutoff=10, power=2))
    scored = hand_made([(0, 0, box()), (0, 1, box(100))], [(0, 7, box(3, 4))], 1, rules=squared)
    assert errors.gospa(scored) == errors.Gospa(pytest.approx(75**0.5), pytest.approx(25), pytest.approx(50), 0)
    largest = Rules(set_distance=SetDistance(cutoff=MAX_CUTOFF, power=10))
    assert errors.ospa(hand_made([(0, 0, box())], [], 1, rules=largest)).ospa == pytest.approx(1e6)
    scored = hand_made([(0, 0, box(), 0.0)], [(0, 7, box(1))], 1, rules=RULES)
    assert errors.gospa(scored) == errors.Gospa(0, 0, 0, 0) and errors.ospa(scored) == errors.Ospa(0)
    # The track of camera 1 is at the place of the vessel of camera 0.
    scored = hand_made([(0, 0, box())], [(1, 7, box())], 1, cameras=2, rules=RULES)
    assert errors.gospa(scored) == errors.Gospa(5, 0, 2.5, 2.5)
    for cutoff in (0, -1, 1e200, np.inf, np.nan):
        with pytest.raises(ModsimError, match="gospa_c: must be above 0 and at most 1,000,000"):
            SetDistance(cutoff=cutoff, power=10)
    for power in (0.9, 11, np.nan):
        with pytest.raises(ModsimError, match="gospa_p: must have a power from 1 to 10"):
            SetDistance(power=power)


BY_CENTRE = Rules(similarity=Similarity("centre", 100))
TEN_PX = ((100, 0), (0, 100))


def test_errors_and_nees_of_pairs_are_worked_by_hand_and_hidden_vessels_and_false_tracks_add_none():
    """Centres off by (3, 4), 0 and (9, 12) px; widths by 0, 2 and 0, heights by 0, 0 and 4."""
    tracks = [(0, 7, box(3, 4)), (1, 7, box(-1, 0, 22, 20)), (2, 7, box(9, 10, 20, 24))]
    found = errors.errors(hand_made([(k, 0, box()) for k in range(3)], tracks, 3, rules=BY_CENTRE))
    assert (found.error_pairs, found.median_error_px) == (3, 5)
    sizes_px = found.rmse_px, found.rmse_width_px, found.rmse_height_px
    assert sizes_px == pytest.approx([(250 / 3) ** 0.5, (4 / 3) ** 0.5, (16 / 3) ** 0.5])
    assert (found.nees, found.anees, found.nees_pairs) == (None, None, 0)
    truth, tracks = [(0, 0, box()), (1, 0, box(), 0.0)], [(0, 7, box(1)), (1, 7, box(40)), (1, 8, box(400))]
    found = errors.errors(hand_made(truth, tracks, 2, rules=BY_CENTRE))
    assert (found.error_pairs, found.rmse_px) == (1, 1)
    assert errors.errors(hand_made(truth, [], 2)) == errors.Errors(0, None, None, None, None, None, None, 0, 0)
    # e' P⁻¹ e of e = (10, 20) and P = [[4, 2], [2, 3]] is (3·100 − 4·200 + 4·400) / 8 = 137.5; of (10, 0) it is 1.
    tracks = [(0, 7, box(10, 20), -1, ((4, 2), (2, 3))), (1, 7, box(10), -1, TEN_PX), (2, 7, box(30))]
    found = errors.errors(hand_made([(k, 0, box()) for k in range(3)], tracks, 3, rules=BY_CENTRE))
    assert found.nees == pytest.approx(138.5 / 2) and found.anees == pytest.approx(138.5 / 4)
    assert (found.error_pairs, found.nees_pairs, found.singular_covariances) == (3, 2, 0)
    for singular in (((0, 0), (0, 0)), ((4, 2), (2, 1)), ((1, 0), (0, -1)), ((1e13, 0), (0, 1))):
        tracks = [(0, 7, box(1), -1, singular), (1, 7, box(1), -1, TEN_PX)]
        found = errors.errors(hand_made([(0, 0, box()), (1, 0, box())], tracks, 2, rules=BY_CENTRE))
        counts = found.nees_pairs, found.singular_covariances
        assert (found.nees, found.anees, *counts, found.rmse_px) == (np.inf, np.inf, 2, 1, 1), singular
    rng = np.random.default_rng(1)
    root = rng.normal(size=(4000, 2, 2))
    covariance = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(2)
    error = (np.linalg.cholesky(covariance) @ rng.normal(size=(4000, 2, 1)))[..., 0]
    squares = errors.nees_or_infinity(error, covariance)
    assert squares.mean() == pytest.approx(2, abs=4 * 2 / 4000**0.5)  # chi-square with 2 degrees: variance 4
    slow = [e @ np.linalg.inv(p) @ e for e, p in zip(error, covariance, strict=True)]
    np.testing.assert_allclose(squares, slow)


CUTOFF = 10.0
POWERS = (1.0, 2.0, 3.5)
_NOW = dt.datetime(2024, 1, 1)


@st.composite
def points(draw: st.DrawFn) -> np.ndarray:
    """0 to 4 points in a square of four cutoffs."""
    return draw(hnp.arrays(float, (draw(st.integers(0, 4)), 2), elements=st.floats(-20, 20, width=32)))


def _random_frames(count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Sets of 0 to 7 vessels and 0 to 7 tracks, never both empty."""
    rng = np.random.default_rng(7)
    sizes = rng.integers(0, 8, (count, 2))
    return [(rng.uniform(0, 30, (n, 2)), rng.uniform(0, 30, (m, 2))) for n, m in sizes if n + m]


def _states(values: np.ndarray) -> list[State]:
    return [State(value, timestamp=_NOW) for value in values]


@pytest.mark.parametrize("power", POWERS)
def test_gospa_and_its_parts_and_ospa_are_those_of_stone_soup(power: float) -> None:
    whole, mean = GOSPAMetric(p=power, c=CUTOFF), OSPAMetric(p=1, c=CUTOFF)
    for vessels, tracks in _random_frames(60):
        theirs = whole.compute_gospa_metric(_states(tracks), _states(vessels))[0].value
        ours = errors.gospa_frame(errors.distances(vessels, tracks), CUTOFF, power)
        wanted = [theirs[name] for name in ("distance", "localisation", "missed", "false")]
        np.testing.assert_allclose(ours, wanted, rtol=1e-9, atol=1e-9)
        if power == 1:
            distance = mean.compute_OSPA_distance(_states(tracks), _states(vessels)).value
            assert errors.ospa_frame(errors.distances(vessels, tracks), CUTOFF) == pytest.approx(distance, abs=1e-9)


@pytest.mark.parametrize("power", POWERS)
def test_no_assignment_is_cheaper(power: float) -> None:
    """Stone Soup's OSPA assigns by d instead of d^p, so for p > 1 all assignments are tried out instead."""
    for vessels, tracks in _random_frames(60):
        few, many = sorted((vessels[:5], tracks[:5]), key=len)
        costs = np.minimum(errors.distances(few, many), CUTOFF) ** power
        orders = permutations(range(len(many)), len(few))
        paired = min(sum(costs[i, j] for i, j in enumerate(order)) for order in orders)
        left, distance = CUTOFF**power * (len(many) - len(few)), errors.distances(few, many)
        ospa = ((paired + left) / len(many)) ** (1 / power) if len(many) else 0
        assert errors.ospa_frame(distance, CUTOFF, power) == pytest.approx(ospa)
        assert errors.gospa_frame(distance, CUTOFF, power).gospa == pytest.approx((paired + left / 2) ** (1 / power))


@given(points(), points(), st.sampled_from(POWERS))
def test_the_other_way_round_misses_and_false_tracks_change_places(a: np.ndarray, b: np.ndarray, power: float) -> None:
    both = (errors.distances(a, b), errors.distances(b, a))
    there, back = (errors.gospa_frame(distance, CUTOFF, power) for distance in both)
    np.testing.assert_allclose(there, (back.gospa, back.localisation, back.false, back.missed), atol=1e-9)
    there, back = (errors.ospa_frame(errors.distances(*pair), CUTOFF, power) for pair in ((a, b), (b, a)))
    assert there == pytest.approx(back)


@settings(max_examples=150)
@given(points(), points(), points(), st.sampled_from(POWERS))
def test_no_way_round_is_shorter(a: np.ndarray, b: np.ndarray, c: np.ndarray, power: float) -> None:
    for frame in (lambda *of: errors.gospa_frame(*of).gospa, errors.ospa_frame):
        direct, there, on = (frame(errors.distances(x, y), CUTOFF, power) for x, y in ((a, c), (a, b), (b, c)))
        assert direct <= there + on + 1e-9


@given(points(), points(), st.sampled_from(POWERS))
def test_the_distance_is_0_of_equal_sets_only_and_its_parts_add_up_to_its_power(a, b, power: float) -> None:
    assert errors.gospa_frame(errors.distances(a, a[::-1]), CUTOFF, power).gospa == 0
    assert errors.ospa_frame(errors.distances(a, a[::-1]), CUTOFF, power) == 0
    whole, *parts = errors.gospa_frame(errors.distances(a, b), CUTOFF, power)
    assert sum(parts) == pytest.approx(whole**power, rel=1e-9)
    if len(a) != len(b):
        assert whole >= CUTOFF / 2 ** (1 / power) - 1e-9
        assert errors.ospa_frame(errors.distances(a, b), CUTOFF, power) > 0


def test_parts_and_their_mean_are_worked_by_hand_also_of_empty_sets_and_without_frames():
    """Vessels at 0 and 100, tracks at 3 and 50: with c = 10 the pair costs 3, and 100 and 50 cost 5 each."""
    distance = np.array([[3.0, 50.0], [97.0, 50.0]])
    assert errors.gospa_frame(distance, 10) == (13, 3, 5, 5)
    assert errors.ospa_frame(distance, 10) == 6.5  # (3 + 10) / 2
    assert errors.gospa_frame(distance, 10, 2) == pytest.approx((109**0.5, 9, 50, 50))
    assert errors.ospa_frame(distance, 10, 2) == pytest.approx((109 / 2) ** 0.5)
    # A pair at the cutoff is a miss and a false track, and of empty sets the other one is charged.
    assert errors.gospa_frame(np.array([[10.0]]), 10) == (10, 0, 5, 5)
    for vessels, tracks, whole, mean in ((0, 0, 0, 0), (2, 0, 10, 10), (0, 3, 15, 10)):
        distance = np.zeros((vessels, tracks))
        assert errors.gospa_frame(distance, 10) == (whole, 0, 5 * vessels, 5 * tracks)
        assert errors.ospa_frame(distance, 10) == mean, (vessels, tracks)
    frames = [np.zeros((0, 0)), np.array([[4.0]]), np.zeros((1, 0))]  # GOSPA 0, 4, 5; OSPA 0, 4, 10
    assert errors.mean_gospa(frames, 10) == (3, 4 / 3, 5 / 3, 0)
    assert errors.mean_ospa(frames, 10) == pytest.approx(14 / 3)
    assert errors.mean_gospa([], 10) is None and errors.mean_ospa([], 10) is None


FRAMES = 60
SIAP_RULES = Rules(gap_s=100, similarity=Similarity("centre", 20, 0.5))  # pairs up to 10 px apart


def siap_of(truth: list[tuple], tracks: list[tuple], **options: float) -> Siap:
    return siap(hand_made(truth, tracks, 1 + max(frame for frame, *_ in truth), rules=SIAP_RULES, **options))


def test_tracks_go_to_the_nearest_vessel_and_changes_pauses_and_stretches_are_counted():
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
    # Hidden in frame 1, with two tracks on it.
    truth = [*placed(0, (0, 2)), (1, 0, box(), 0.0)]
    assert siap_of(truth, placed(7, range(3)) + placed(8, [1], 5)) == Siap(1, 1, 0, 0, 0, 1)
    scored = hand_made(placed(0, range(4)), placed(7, (0, 2)), 2, cameras=2, rules=SIAP_RULES)
    assert siap(scored) == Siap(0.5, 1, 0, 0, 0, 0.5)
    tracks = [*placed(7, [0]), *placed(7, [1], 4), *placed(8, [2]), *placed(9, [3], 300)]
    scored = hand_made(placed(0, range(4)), tracks, 4, rules=SIAP_RULES)
    assert siap(replace(scored, frames=np.array([0, 1]))) == Siap(1, 1, 0, 2, 0, 1)
    truth = [each for vessel in range(3) for each in placed(vessel, range(7 + vessel), 100 * vessel)]
    assert siap_of(truth, truth, step_s=0.1).siap_longest_track_share == 1
    assert siap(hand_made([], [], 2)) == Siap(None, None, None, None, None, None)
    assert siap(hand_made(placed(0, [0]), [], 2)) == Siap(0, None, None, None, None, 0)
    assert siap(hand_made([], placed(7, [0]), 2)) == Siap(None, None, 1, None, None, None)


@pytest.mark.parametrize("seed", range(3))
def test_shares_and_accuracy_are_those_of_stone_soup(seed: int) -> None:
    """Tracks stay at a place for 5 frames and do not pause: Stone Soup 1.9.1 fails at one frame, and at a pause."""
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
        vessels[vessel].append(GroundTruthState([x], timestamp=_NOW + dt.timedelta(seconds=frame)))
    for frame, track, x in tracks:
        found[track].append(State([x], timestamp=_NOW + dt.timedelta(seconds=frame)))
    manager = MultiManager(
        [SIAPMetrics(Euclidean(), Euclidean(), generator_name="siap", tracks_key="tracks", truths_key="truth")],
        TrackToTruth(association_threshold=10, consec_pairs_confirm=1, consec_misses_end=1),
    )
    manager.add_data({"tracks": set(found.values()), "truth": set(vessels.values())})
    return {title: metric.value for title, metric in manager.generate_metrics()["siap"].items()}
