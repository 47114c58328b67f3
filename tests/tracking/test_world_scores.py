"""Scores of tracks in the world against values worked out by hand."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modsim3d import ModsimError, RunRows, StoredRun, score_run
from modsim3d.geometry.kinematics import HullTracks
from modsim3d.tracking.score_page import score_page
from modsim3d.tracking.scores.errors import nees
from modsim3d.tracking.scores.scored_run import SetDistance
from modsim3d.tracking.world.following import WorldTruth
from modsim3d.tracking.world.scoring import Quartiles, VesselMean, WorldScores, quartiles, score_world
from modsim3d.tracks.tracks import TrackEstimates, WorldTracks
from tests.scenes import camera_keys
from tests.tracks import track_files
from tests.tracks.track_files import ANCHORED, ASTERN, CROSSER, OWN, PLACES_M, STARTS_M, STEPS, TIMES_S, VELOCITIES_M_S


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    return track_files.sea_run(tmp_path_factory.mktemp("sea") / "run")


@pytest.fixture(scope="module")
def rows(run: StoredRun) -> RunRows:
    return RunRows.of(run)


@pytest.fixture(scope="module")
def scored(rows: RunRows) -> Any:
    """Whether a camera sees each vessel, (S, V)."""
    return WorldTruth.of(rows).scored


def tracks_of(parts: Sequence[tuple[int, Any]], shift_m: Any = (0, 0), **columns: Any) -> WorldTracks:
    """One track for each vessel and its times, in order, on the vessel's true place but for a shift."""
    track = np.concatenate([np.full(len(times), index) for index, (_, times) in enumerate(parts)])
    vessel = np.array([vessel for vessel, _ in parts])[track]
    times_s = np.concatenate([times for _, times in parts])
    position = STARTS_M[vessel] + times_s[:, None] * VELOCITIES_M_S[vessel] + np.asarray(shift_m, dtype=float)
    names = tuple(f"t{index}" for index in range(len(parts)))
    return WorldTracks.of("t", track, names, times_s, position, VELOCITIES_M_S[vessel], columns.get("covariance"))


def perfect(scored: Any, **columns: Any) -> WorldTracks:
    return tracks_of([(vessel, TIMES_S[scored[:, vessel]]) for vessel in (CROSSER, ANCHORED)], **columns)


def values(scores: WorldScores, *names: str) -> list[float | int | None]:
    return [scores.flat()[name] for name in names]


def test_perfect_tracks_have_no_error_while_seen_and_tracks_shifted_by_3_and_4_metres_errors_of_5(scored, run, rows):
    hidden = np.flatnonzero(~scored[:, ANCHORED])
    assert 1 <= len(hidden) <= 8 and len(hidden) == hidden[-1] - hidden[0] + 1
    # Seen from the camera 5 m ahead of own ship's middle, the crosser then lies in the way.
    places_m = PLACES_M[hidden[len(hidden) // 2]]
    to_both = places_m[[CROSSER, ANCHORED]] - places_m[OWN] - (5, 0)
    assert np.ptp(np.arctan2(to_both[:, 1], to_both[:, 0])) < 0.05
    assert not scored[:, OWN].any() and not scored[:, ASTERN].any()
    leaves = int(np.flatnonzero(~scored[:, CROSSER])[0])
    assert scored[:leaves, CROSSER].all() and not scored[leaves:, CROSSER].any()
    # At 20.5 s it is 17.5 m ahead and 22 m to port of own ship: far outside 38.7 degrees.
    assert 10 < TIMES_S[leaves] < 20.5
    scores = score_world(rows, perfect(scored))
    assert score_world(run, perfect(scored)).flat() == scores.flat() and run.scene.vessel_names == track_files.NAMES
    np.testing.assert_allclose(WorldTruth.of(rows).hulls.centres_m, PLACES_M)
    assert values(scores, "rmse_m", "rmse_m_s", "gospa_m", "id_switches", "track_breaks", "false_tracks") == [0] * 6
    assert values(scores, "vessels", "established", "followed_share") == [2, 2, 1]
    assert values(scores, "pairs") == [scored.sum()]
    for met in scores.encounters:
        if met.seen_s is not None:
            assert (met.established_s, met.established_m) == (met.seen_s, met.seen_m)
    scores = score_world(rows, perfect(scored, shift_m=(3, 4)))
    assert scores.flat()["rmse_m"] == pytest.approx(5)
    assert values(scores, "rmse_m_low", "rmse_m_high") == [None, None]  # the same for both vessels
    assert values(scores, "gospa_m", "gospa_localisation_m") == pytest.approx([5 * scored.sum() / STEPS] * 2)
    assert values(scores, "rmse_m_s", "gospa_missed_m", "gospa_false_m", "nees") == [0, 0, 0, None]


def test_nees_of_a_shift_is_its_mahalanobis_distance_and_of_errors_of_their_covariance_their_dimension(rows, scored):
    whole = np.broadcast_to(np.diag([9.0, 4.0, 1.0, 1.0]), (int(scored.sum()), 4, 4)).copy()
    scores = score_world(rows, perfect(scored, shift_m=(3, 4), covariance=whole))
    assert values(scores, "nees", "anees", "nees_velocity", "nees_state", "anees_state") == [5, 2.5, 0, 5, 1.25]
    whole[3, 0, 0] = 0
    scores = score_world(rows, perfect(scored, shift_m=(3, 4), covariance=whole))
    found = values(scores, "nees", "anees", "nees_low", "nees_velocity", "nees_state")
    assert found == [np.inf, np.inf, None, 0, np.inf]
    rng, count = np.random.default_rng(5), 40_000
    factor = rng.normal(size=(4, 4))
    errors = rng.normal(size=(count, 4)) @ factor.T
    found = nees(errors, np.broadcast_to(factor @ factor.T, (count, 4, 4)))
    # A chi-square number with 4 degrees of freedom has the variance 8.
    assert found.mean() == pytest.approx(4, abs=4 * np.sqrt(8 / count))
    assert np.isnan(nees(errors[:1], np.full((1, 4, 4), np.nan))).all()


def test_each_vessel_counts_once_and_a_miss_and_a_false_track_cost_half_the_cutoff_each(rows, scored):
    both = tracks_of([(CROSSER, TIMES_S[:3]), (ANCHORED, TIMES_S)])
    both.position_m[both.track == 0] += (6, 8)
    scores = score_world(rows, both)
    # The t-quantile of 0.975 with one degree of freedom is 12.706, and the standard error of 10 and 0 is 5.
    assert values(scores, "rmse_m", "rmse_m_low", "rmse_m_high") == pytest.approx([5, 5 - 63.531, 5 + 63.531], abs=1e-3)
    assert values(scores, "followed_share") == pytest.approx([(3 / scored[:, CROSSER].sum() + 1) / 2])
    assert VesselMean.of(np.array([np.nan])) == VesselMean(None, None, None, 0)
    assert VesselMean.of(np.array([3.0, np.nan])) == VesselMean(3.0, None, None, 1)
    assert quartiles([40.0, None, 10.0, 30.0]) == Quartiles(None, 10.0, 30.0)
    assert quartiles([]) == Quartiles(None, None, None)
    lost = score_world(rows, tracks_of([(CROSSER, TIMES_S[scored[:, CROSSER]])]))
    missed = 25 * scored[:, ANCHORED].sum() / STEPS
    assert values(lost, "gospa_m", "gospa_missed_m", "gospa_false_m") == pytest.approx([missed, missed, 0])
    assert values(lost, "vessels", "established") == [2, 1]
    far = tracks_of([(ANCHORED, TIMES_S), (ANCHORED, TIMES_S[10:20])], shift_m=0)
    far.position_m[far.track == 1] += (0, 400)
    ghost = score_world(rows, far, set_distance=SetDistance(cutoff=30, power=1))
    crosser = 15 * scored[:, CROSSER].sum() / STEPS
    assert values(ghost, "gospa_missed_m", "gospa_false_m") == pytest.approx([crosser, 15 * 10 / 60])
    assert values(ghost, "false_tracks", "false_track_s") == [1, 5.0]
    none = score_world(rows, WorldTracks.of("t", np.zeros(0, dtype=np.int64), (), np.zeros(0), np.zeros((0, 2))))
    assert values(none, "gospa_m", "followed_share", "established") == [25 * scored.sum() / STEPS, 0, 0]
    assert values(none, "rmse_m", "nees", "pairs", "encounters", "encounters_established") == [None, None, 0, 1, 0]
    assert all(met.established_s is None and met.time_left_s is None for met in none.encounters)


def test_a_track_beyond_the_gate_follows_nothing_and_the_track_of_the_step_before_is_kept(rows, scored):
    # Followed from 1 s on by one track, by the next, by nobody for five steps, and by the third.
    parts = [(2, 10), (10, 20), (25, 30)]
    tracks = tracks_of([(ANCHORED, TIMES_S[slice(*part)]) for part in parts])
    last = replace(tracks, track=np.array([0, 1, 1])[tracks.track], track_names=("a", "b"))
    assert values(score_world(rows, last), "id_switches", "track_breaks", "false_tracks") == [1, 1, 0]
    assert values(score_world(rows, tracks), "id_switches", "track_breaks") == [2, 1]
    # Another comes nearer.
    tracks = tracks_of([(ANCHORED, TIMES_S), (ANCHORED, TIMES_S[30:])])
    tracks.position_m[tracks.track == 0] += (3, 4)
    kept = score_world(rows, tracks)
    assert values(kept, "id_switches", "rmse_m", "false_tracks") == [0, pytest.approx(5), 1]
    # While the crosser's track keeps the step from being empty, the anchored vessel has none at step 30.
    far = np.delete(TIMES_S[:40], 30)
    tracks = tracks_of([(ANCHORED, far), (ANCHORED, TIMES_S[31:40]), (CROSSER, TIMES_S[:40])])
    tracks.position_m[tracks.track == 0] += (3, 4)
    assert values(score_world(rows, tracks), "id_switches") == [1]
    tracks = tracks_of([(ANCHORED, TIMES_S)], shift_m=(0, 40))
    assert values(score_world(rows, tracks), "established", "false_tracks", "rmse_m") == [1, 0, 40]
    assert values(score_world(rows, tracks, gate_m=39), "established", "false_tracks", "rmse_m") == [0, 1, None]
    seen = [(vessel, TIMES_S[scored[:, vessel]]) for vessel in (CROSSER, ANCHORED)]
    unseen = [(OWN, TIMES_S), (ASTERN, TIMES_S), (CROSSER, TIMES_S[~scored[:, CROSSER]])]
    with_them, without = score_world(rows, tracks_of(seen + unseen)), score_world(rows, tracks_of(seen))
    assert with_them.flat() == without.flat() and with_them.encounters == without.encounters
    times_s = (1_700_000_000 + 0.05 * np.arange(40)) - 1_700_000_000
    for step in range(1, 40):
        centres_m = np.where(np.arange(40)[:, None, None] < step, np.nan, [[[3.0, 4.0]]])
        hulls = HullTracks(times_s, centres_m, centres_m[..., 0], np.ones((1, 2)))
        truth = WorldTruth(("a",), (), hulls, np.isfinite(centres_m[..., 0]))
        np.testing.assert_allclose(truth.positions_at(np.array([0.05 * step]), np.array([0])), [[3, 4]])


def test_vessels_that_carry_cameras_are_not_to_be_tracked(rows: RunRows, scored: Any, tmp_path: Path) -> None:
    bow = rows.scene.cameras[0]
    cameras = {
        vessel: camera_keys(1280, 720, focal_length_m=0.008, mount={"vessel": vessel, "position_m": [5, 0, 6]})
        for vessel in ("own", "crosser")
    }
    both = WorldTruth.of(RunRows.of(track_files.sea_run(tmp_path / "run", cameras=cameras, steps=4)))
    assert bow.mount.vessel == "own" and scored[:4, CROSSER].all()
    assert both.own_ships == (OWN, CROSSER) and not both.scored[:, [OWN, CROSSER]].any()
    assert both.scored[:, ANCHORED].all()


def test_the_nearest_estimate_in_time_stands_for_a_step_against_the_place_at_its_own_time(rows, scored) -> None:
    tracks = WorldTracks.of("t", np.zeros(3, dtype=np.int64), ("a", "b"), np.array([0.0, 0.9, 2.1]), np.zeros((3, 2)))
    found = TrackEstimates.of(np.array([0.0, 1.0, 2.0, 3.0]), tracks)
    np.testing.assert_array_equal([found.step, found.row], [[0, 1, 2], [0, 1, 2]])
    seen = TIMES_S[scored[:, CROSSER]]
    between = score_world(rows, tracks_of([(CROSSER, seen[:-1] + 0.2), (ANCHORED, TIMES_S - 0.1)]))
    assert values(between, "rmse_m", "rmse_m_s") == pytest.approx([0, 0], abs=1e-9)
    assert between.flat()["pairs"] == scored.sum() - 1
    slower = score_world(rows, tracks_of([(ANCHORED, TIMES_S[::4]), (CROSSER, seen[::4])]))
    # Each reaches a second to either side: those at 28 s to 29 s, and the crosser's last, at 18 s, to 19 s.
    assert values(slower, "rmse_m", "id_switches", "track_breaks") == pytest.approx([0, 0, 0], abs=1e-9)
    assert scored[:, CROSSER].sum() == 40 and slower.flat()["pairs"] == scored[:59, ANCHORED].sum() + 39


def test_an_encounter_has_the_numbers_of_two_straight_lines_and_late_estimates_their_own_time(rows, scored):
    # From own ship the crosser is at (120 − 5 t, −60 + 4 t): least distance 180 / √41 m at 840 / 41 s.
    tracks = tracks_of([(CROSSER, TIMES_S[6:20])])
    met = {each.vessel: each for each in score_world(rows, tracks).encounters}
    crosser = met["crosser"]
    assert (crosser.own_ship, crosser.kind, crosser.passed, crosser.expected) == ("own", "gives_way", True, True)
    assert (crosser.closest_m, crosser.closest_s) == pytest.approx((180 / np.sqrt(41), 840 / 41))
    assert (crosser.seen_s, crosser.seen_m) == pytest.approx((0, np.hypot(120, 60)))
    assert (crosser.established_s, crosser.established_m) == pytest.approx((3, np.hypot(105, 48)))
    assert crosser.time_left_s == pytest.approx(840 / 41 - 3)
    anchored = met["anchored"]
    assert (anchored.kind, anchored.passed, anchored.expected) == ("overtaking", False, False)
    assert (anchored.closest_s, anchored.established_s) == (29.5, None)
    assert "astern" not in met  # keeps its distance from the first step on
    keys = score_world(rows, tracks).flat()
    assert (keys["encounters"], keys["encounters_established"]) == (1, 1)
    assert keys["established_m"] == keys["established_m_lower"] == pytest.approx(np.hypot(105, 48))
    (crosser, *_) = score_world(rows, tracks_of([(CROSSER, TIMES_S[4:10] + 0.2)])).encounters
    at = (crosser.established_s, crosser.established_m)
    assert at == pytest.approx((2.2, np.hypot(120 - 5 * 2.2, -60 + 4 * 2.2)))
    tracks = tracks_of([(CROSSER, TIMES_S[4:10])])
    assert [met.vessel for met in score_world(rows, tracks, encounter_m=50).encounters] == ["crosser"]
    assert not score_world(rows, tracks, encounter_m=28).encounters


def test_distances_must_be_above_zero_and_the_page_marks_vessels_that_no_track_followed(run, rows, scored, tmp_path):
    for wrong in ({"gate_m": 0.0}, {"gate_m": np.nan}, {"encounter_m": -1.0}):
        with pytest.raises(ModsimError, match="must be above 0 metres"):
            score_world(rows, perfect(scored), **wrong)
    (tmp_path / "one.csv").write_text("time_s,track,w1_m,w2_m\n0,a,1,2\n")
    for rules, said in (
        ({"threshold": 0.7}, "^threshold: for tracks in the images, and none are given: leave out; .* gate_m"),
        ({"similarity": "centre", "scale_px": 9.0}, "^similarity: for tracks in the images"),
        ({"truth": "full"}, "^truth: for tracks in the images"),
        ({"by_class": True}, "^by_class=True: for"),
        ({"gap_s": 5.0}, "^gap_s: for"),
    ):
        with pytest.raises(ModsimError, match=said):
            score_run(run, tmp_path / "one.csv", **rules)
    assert score_run(run, tmp_path / "one.csv", threshold=0.5, gate_m=20.0, gospa_c=30.0, gospa_p=2.0).world
    w1_m, w2_m = PLACES_M[:9, CROSSER].T
    columns = {"time_s": TIMES_S[:9], "track": ["a"] * 9, "w1_m": w1_m, "w2_m": w2_m}
    page = score_page(score_run(run, track_files.write_csv(tmp_path / "one.csv", columns)))
    assert "2 vessels came nearer to own ship, and 1 passed her in this run. No track followed 1 vessel" in page
    assert page.count('<tr class="bad"><td data-label="vessel">anchored</td>') == page.count('<tr class="bad">') == 1


def test_a_track_that_takes_over_is_a_switch_and_predicted_closest_approaches_are_those_by_hand(rows):
    keys = ("t_gospa_switch_m", "t_gospa_missed_m", "t_gospa_false_m", "t_gospa_localisation_m")
    seen, halves = WorldTruth.of(rows).scored, tracks_of([(ANCHORED, TIMES_S[:30]), (ANCHORED, TIMES_S[30:])])
    missed = 25 * seen[:, CROSSER].sum() / STEPS
    found = score_world(rows, halves)
    assert values(found, *keys) == pytest.approx([50 / STEPS, missed, 0, 0])
    assert values(found, "t_gospa_m") == pytest.approx([missed + 50 / STEPS])
    assert values(score_world(rows, halves, set_distance=SetDistance(50, 1, 6)), keys[0]) == pytest.approx([6 / 60])
    # The run is one window. A half goes to the anchored vessel, which it lacks for the other half, the other to none.
    longer = max(seen[:30, ANCHORED].sum(), seen[30:, ANCHORED].sum()) / seen[:, ANCHORED].sum()
    assert values(found, "ospa2_m") == pytest.approx([(50 * (1 - longer) + 50) / 2])
    # 10 s before the CPA, the last step is at 10 s: then the crosser is at (70, −20) from own ship and makes (−5, 4).
    seen = TIMES_S[:36]
    truth_m, truth_s = 180 / np.sqrt(41), 840 / 41
    rules = {"right_m": 9, "before_s": 10, "alarm_m": 20}
    right = score_world(rows, tracks_of([(CROSSER, seen)]), cpa=rules)
    assert values(right, "cpa_right_share", "cpa_in_view", "cpa_predicted", "cpa_ghost_alarms") == [1, 1, 1, 0]
    assert values(right, "cpa_error_m", "tcpa_error_s", "cpa_false_alarms") == pytest.approx([0, 0, 0], abs=1e-9)
    # A track that is slower by 1 m/s crosses nearer and later: an alarm on a vessel that passes at 28 m.
    slower = tracks_of([(CROSSER, seen), (ANCHORED, TIMES_S[:9])])
    slower.velocity_m_s[slower.track == 0] -= (0, 1)
    slower.position_m[slower.track == 1] = PLACES_M[:9, OWN] + (300, 0)  # 100 m from all vessels, and at rest
    found = score_world(rows, slower, cpa=rules)
    cpa_m, tcpa_s = (70 * 3 - 20 * 5) / np.sqrt(34), (70 * 5 + 20 * 3) / 34
    assert values(found, "cpa_error_m", "tcpa_error_s") == pytest.approx([truth_m - cpa_m, 10 + tcpa_s - truth_s])
    assert values(found, "cpa_right_share", "cpa_alarms_due", "cpa_false_alarms") == [0, 0, 1]
    assert values(found, "cpa_ghost_alarms") == [0]  # own ship is there in 60 s
    later = score_world(rows, slower, cpa={"before_s": 70, "alarm_m": 20})
    assert values(later, "cpa_ghost_alarms", "cpa_in_view", "cpa_right_share") == [1, 0, None]
    (by_range,) = [each for each in found.approaches.by_range if each.predicted]
    assert (by_range.place, by_range.perfect_cpa_error_m) == (0, pytest.approx(0, abs=1e-9))


def test_an_alarm_is_missed_where_a_track_passes_too_far_or_has_no_velocity_or_there_is_none(rows: RunRows) -> None:
    faster = tracks_of([(CROSSER, TIMES_S[:36])])
    faster.velocity_m_s[:] += (0, 2)
    rules, keys = {"before_s": 10, "alarm_m": 29}, ("cpa_alarms_due", "cpa_missed_alarms", "cpa_predicted")
    assert values(score_world(rows, faster, cpa=rules), *keys) == [1, 1, 1]
    still = replace(faster, velocity_m_s=np.full_like(faster.velocity_m_s, np.nan))
    assert values(score_world(rows, still, cpa=rules), *keys) == [1, 1, 0]
    assert values(score_world(rows, tracks_of([(CROSSER, TIMES_S[:9])]), cpa=rules), *keys) == [1, 1, 0]
    for wrong, said in (
        ({"alarm_m": -1.0}, "cpa: alarm_m must be above 0"),
        ({"alarm": 1.0}, "unknown key 'alarm' .did you mean 'alarm_m'"),
    ):
        with pytest.raises(ModsimError, match=said):
            score_world(rows, faster, cpa=wrong)
