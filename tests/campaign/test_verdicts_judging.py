"""Requirements against tables written by hand: what is met, failed or undecided, and why."""

import numpy as np
import pyarrow as pa
import pytest

from modsim3d.campaign.verdicts.bounds import skewed_bounds
from modsim3d.campaign.verdicts.seed_values import Runs, paired
from modsim3d.campaign.verdicts.verdict import judged
from modsim3d.campaign.verdicts.wording import levels_of, seeds_needed, warnings_of
from modsim3d.campaign.work.row import table_of
from tests.campaign.hand_made_tables import plan_of, table_of_scores

CLEAN = {"score": "id_switches", "at_most": 0, "in": 0.99}
HOTA = {"score": "hota", "at_least": 0.6}


def one(plan, score, values, crashed=()):
    (verdict,) = judged(plan, table_of_scores(plan, score, values, crashed))
    return verdict


@pytest.mark.parametrize(
    ("seeds", "wrong", "outcome"),
    [(299, 0, "met"), (298, 0, "undecided"), (299, 1, "undecided"), (473, 1, "met"), (299, 20, "failed")],
)
def test_a_share_is_met_from_299_clean_seeds_on_or_473_with_one_failure(seeds, wrong, outcome):
    verdict = one(plan_of(seeds, [CLEAN]), "id_switches", [1] * wrong + [0] * (seeds - wrong))
    assert (verdict.outcome, verdict.seeds) == (outcome, seeds)


@pytest.mark.parametrize(("seeds", "outcome"), [(680, "met"), (679, "undecided")])
def test_a_sequential_share_is_met_from_680_clean_seeds_on(seeds, outcome):
    plan = plan_of(1000, [CLEAN], stop="sequential")
    assert one(plan, "id_switches", [0] * seeds).outcome == outcome


def test_a_campaign_that_is_looked_at_once_decides_nothing_before_its_end():
    verdict = one(plan_of(300, [CLEAN]), "id_switches", [0] * 299)
    assert (verdict.outcome, verdict.low, verdict.high) == ("undecided", None, None)
    assert "299 traffic seeds of 300 are done, 100 % right so far" in verdict.why


def test_a_seed_is_right_if_the_runs_with_all_its_detector_seeds_are():
    plan = plan_of(3, [{**CLEAN, "in": 0.5}], detector=2)
    assert one(plan, "id_switches", [[0, 0], [0, 1], [1, 0]]).estimate == pytest.approx(1 / 3)


def test_a_mean_is_one_over_seeds_of_means_over_their_runs():
    values = np.array([[0.7, 0.9], [0.6, np.nan], [0.5, 0.5]])
    verdict = one(plan_of(3, [HOTA], detector=2), "hota", values)
    seeds = np.array([0.8, 0.6, 0.5])
    assert verdict.estimate == pytest.approx(seeds.mean())
    assert verdict.low == pytest.approx(max(0.0, float(skewed_bounds(seeds, 0.05, 1.0))))


@pytest.mark.parametrize(("requirement", "mean", "outcome"), [
    ({"score": "hota", "at_least": 0.6}, 0.7, "met"), ({"score": "hota", "at_least": 0.6}, 0.5, "failed"),
    ({"score": "hota", "at_most": 0.6}, 0.7, "failed"), ({"score": "hota", "at_most": 0.6}, 0.5, "met"),
    ({"score": "hota", "at_least": 0.6}, 0.6, "undecided"),
])  # fmt: skip
@pytest.mark.parametrize("stop", ["once", "sequential"])
def test_a_mean_is_judged_on_the_side_that_the_requirement_names(requirement, mean, outcome, stop):
    values = mean + 0.05 * np.tile([-1, 1], 50)
    assert one(plan_of(100, [requirement], stop=stop), "hota", values).outcome == outcome


def test_equal_values_prove_nothing_of_a_mean():
    verdict = one(plan_of(50, [HOTA]), "hota", [0.7] * 50)
    assert verdict.outcome == "undecided" and "`in`" in verdict.why


def test_a_crashed_run_counts_as_wrong_and_never_drops_out():
    verdict = one(plan_of(299, [CLEAN]), "id_switches", [0] * 299, crashed={7})
    assert (verdict.outcome, verdict.seeds, verdict.crashed) == ("undecided", 299, 1)
    assert verdict.estimate == pytest.approx(298 / 299)


@pytest.mark.parametrize(("crashed", "outcome"), [(1, "met"), (30, "undecided")])
def test_a_mean_with_crashed_runs_must_hold_with_the_worst_value_in_their_place(crashed, outcome):
    values = 0.7 + 0.02 * np.tile([-1, 1], 50)
    assert one(plan_of(100, [HOTA]), "hota", values, crashed=range(crashed)).outcome == outcome


def test_a_mean_fails_only_if_it_does_with_the_best_value_in_place_of_crashed_runs():
    values = 0.5 + 0.02 * np.tile([-1, 1], 50)
    assert one(plan_of(100, [HOTA]), "hota", values, crashed=range(2)).outcome == "failed"
    assert one(plan_of(100, [HOTA]), "hota", values, crashed=range(30)).outcome == "undecided"


@pytest.mark.parametrize("requirement", [HOTA, {"score": "gospa", "at_most": 50}, {**HOTA, "at_least": 0.0001}])
@pytest.mark.parametrize("seeds", [1, 12])
def test_a_mean_fails_if_every_run_crashed(requirement, seeds):
    plan = plan_of(seeds, [requirement])
    verdict = one(plan, requirement["score"], [np.nan] * seeds, crashed=range(seeds))
    assert (verdict.outcome, verdict.estimate) == ("failed", None)
    assert f"no run has {requirement['score']}" in verdict.why


def test_seeds_in_which_nothing_went_wrong_are_left_out_and_fail_nothing():
    plan = plan_of(4, [{"score": "mean_track_break_s", "at_most": 3, "resting_on": 0.5}])
    rows = [{"run": run, "status": "done", "appearances": 2, "established": 2 * (run > 0)} for run in range(4)]
    (verdict,) = judged(plan, table_of(rows))
    assert (verdict.outcome, verdict.nothing, verdict.undefined) == ("undecided", 1, 3)
    assert "nothing of that kind went wrong" in verdict.why


@pytest.mark.parametrize(("requirement", "outcome"), [({"at_most": 3}, "failed"), ({"at_least": 0.5}, "undecided")])
def test_an_infinite_value_makes_a_mean_infinite_and_is_not_dropped(requirement, outcome):
    values = [1.1, np.inf, 1.2, np.inf, 1.0, 1.3]
    verdict = one(plan_of(6, [{"score": "gospa", **requirement}]), "gospa", values)
    assert (verdict.outcome, verdict.estimate, verdict.seeds, verdict.high) == (outcome, np.inf, 6, None)
    assert "the mean is ∞" in verdict.why


def test_an_infinite_value_is_wrong_where_it_may_be_no_more_than_something():
    verdict = one(plan_of(6, [{"score": "gospa", "at_most": 3, "in": 0.5}]), "gospa", [1, np.inf, 1, np.inf, 1, 1])
    assert verdict.estimate == pytest.approx(4 / 6)


def test_a_run_without_a_value_is_no_right_one_and_is_named_if_it_is_left_out():
    """Seeds of two detector seeds: right, wrong, right by one run, and without a value."""
    values = [[0.7, 0.7], [0.7, 0.1], [np.nan, 0.7], [np.nan, np.nan]]
    verdict = one(plan_of(4, [{**HOTA, "in": 0.5}], detector=2), "hota", values)
    assert (verdict.estimate, verdict.seeds, verdict.undefined) == (pytest.approx(2 / 3), 3, 1)
    assert "1 run of other traffic seeds without hota left out: 1000002." in verdict.why


def test_a_run_whose_tracker_gave_nothing_makes_its_seed_wrong_beside_one_that_is_right():
    plan = plan_of(2, [{"score": "detpr", "at_least": 0.6, "in": 0.5}], detector=2)
    rows = [{"run": run, "status": "done", "appearances": 3, "detpr": None if run == 1 else 0.9} for run in range(4)]
    (verdict,) = judged(plan, table_of(rows))
    assert (verdict.estimate, verdict.nothing, verdict.undefined, verdict.left_out) == (0.5, 1, 0, 0)


@pytest.mark.parametrize(("requirement", "said"), [
    ({"score": "id_switches", "at_most": 0, "in": 0.5}, True), ({"score": "false_track_s", "at_most": 3}, True),
    ({"score": "mota", "at_least": -1}, True), ({"score": "mota", "at_least": 0.5}, False),
    ({"score": "gospa", "at_most": 50}, True), ({"score": "gospa", "at_most": 49}, False),
    ({"score": "misses", "at_most": 10}, True), ({"score": "misses", "at_most": 9}, False),
    ({"score": "assa", "at_least": 0.1}, False),
    ({"score": "id_switches", "at_most": 0, "in": 0.5, "resting_on": 0.5}, False),
])  # fmt: skip
def test_a_requirement_that_no_tracks_at_all_would_meet_says_so(requirement, said):
    """In each run there are 10 vessel-frames in 10 frames: without tracks GOSPA is half of its cutoff, 100 px."""
    row = {"status": "done", "frames": 10, "true_positives": 8, "misses": 2, "appearances": 2, "id_switches": 0}
    rows = [{**row, "run": run, "gospa": 9.0 + run, "mota": 0.7 + run / 100, "false_track_s": 1.0} for run in range(6)]
    (verdict,) = judged(plan_of(6, [requirement]), table_of(rows))
    assert verdict.met_without_tracks == said == ("No tracks at all would meet it too" in verdict.why)


def test_a_crashed_run_leaves_a_mean_without_worst_value_undecided():
    verdict = one(plan_of(10, [{"score": "gospa", "at_most": 50}]), "gospa", np.arange(10.0), crashed={3})
    assert verdict.outcome == "undecided" and verdict.high is None


def test_seeds_without_a_value_are_counted_apart_and_named():
    values = [0.7, np.nan, 0.72, 0.71, np.nan]
    verdict = one(plan_of(5, [HOTA]), "hota", values)
    assert (verdict.seeds, verdict.undefined, verdict.outcome) == (3, 2, "met")
    assert "1000001, 1000004" in verdict.why


def test_each_tracker_and_each_condition_has_a_verdict_and_drawn_values_split_nothing():
    vary = [{"grid": {"detector.miss_rate": [0.1, 0.2]}}, {"uniform": {"waves.level": [0, 3]}}]
    plan = plan_of(
        4, [HOTA, {**HOTA, "where": {"tracker": "sort", "detector.miss_rate": 0.2}}], ("bytetrack", "sort"), vary=vary
    )
    values = np.tile([0.1, 0.2, 0.3, 0.4], 4) + np.repeat([0.01, 0.02, 0.03, 0.04], 4)  # seed, condition, tracker
    verdicts = judged(plan, table_of_scores(plan, "hota", values))
    found = [(each.requirement, each.tracker, each.values["detector.miss_rate"], each.estimate) for each in verdicts]
    expected = [
        (0, "bytetrack", 0.1, 0.125),
        (0, "bytetrack", 0.2, 0.325),
        (0, "sort", 0.1, 0.225),
        (0, "sort", 0.2, 0.425),
        (1, "sort", 0.2, 0.425),
    ]
    assert [each[:3] for each in found] == [each[:3] for each in expected]
    assert [each[3] for each in found] == pytest.approx([each[3] for each in expected])
    assert levels_of(plan).any_wrong == pytest.approx(0.25) and levels_of(plan).all_met == pytest.approx(0.05)


def test_levels_leave_out_a_bound_that_says_nothing():
    few, many = (plan_of(3, [HOTA] * count) for count in (19, 20))
    said = "The probability that one or more of the 19 verdicts are wrong is at most 95 %."
    assert said in levels_of(few).sentences()
    assert not [each for each in levels_of(many).sentences() if "100 %" in each or "one or more" in each]


def test_a_state_within_the_runs_has_columns_of_its_own():
    plan = plan_of(5, [{**HOTA, "in": 0.5, "where": {"state": ["haze", "clear"]}}])
    rows = [
        {
            "run": run,
            "status": "done",
            "hota": 0.9,
            "state.haze.hota": 0.5 + run / 100,
            "state.clear.hota": 0.8 + run / 100,
        }
        for run in range(5)
    ]
    haze, clear = judged(plan, table_of(rows))
    assert (haze.outcome, clear.outcome) == ("failed", "met")
    assert haze.text == "hota at least 0.6 in state haze, in 50 % of traffic seeds" and haze.values == {"state": "haze"}


def test_rows_behind_a_missing_one_do_not_count():
    plan = plan_of(1000, [{**CLEAN, "in": 0.5}], stop="sequential")
    table = table_of_scores(plan, "id_switches", [0] * 20)
    (verdict,) = judged(plan, pa.concat_tables([table.slice(0, 5), table.slice(6)]))
    assert verdict.seeds == 5


def test_a_plan_that_is_too_small_is_said_so_before_it_starts():
    (once,) = warnings_of(plan_of(298, [CLEAN]))
    assert "299 traffic seeds that are all right, or 473 if one is not, and has 298" in once
    (sequential,) = warnings_of(plan_of(679, [CLEAN], stop="sequential"))
    assert "680" in sequential
    assert warnings_of(plan_of(299, [CLEAN])) == warnings_of(plan_of(680, [CLEAN], stop="sequential")) == []
    assert warnings_of(plan_of(50, [{"score": "hota", "at_least": 1.2}]))
    assert warnings_of(plan_of(1, [HOTA]))


@pytest.mark.parametrize("stop", ["once", "sequential"])
@pytest.mark.parametrize("requirement", [
    {"score": "hota", "at_least": 1}, {"score": "hota", "at_most": 0}, {"score": "hota", "at_least": 1.2, "in": 0.5},
])  # fmt: skip
def test_a_mean_at_the_end_of_its_score_and_a_value_beyond_it_can_never_be_met(requirement, stop):
    plan = plan_of(5_000, [requirement], stop=stop)
    assert warnings_of(plan)
    best = 1.0 if "at_least" in requirement else 0.0
    assert one(plan_of(50, [requirement], stop=stop), "hota", [best] * 50).outcome != "met"


def test_a_mean_of_switches_that_must_be_none_is_said_to_need_a_share():
    (said,) = warnings_of(plan_of(50, [{"score": "id_switches", "at_most": 0}]))
    assert "ask for a share of seeds with `in`" in said


def test_levels_are_never_a_probability_of_a_hundred_percent():
    twelve, many = (levels_of(plan_of(5, [HOTA] * count)).sentences() for count in (12, 21))
    assert "The probability that one or more of the 12 verdicts are wrong is at most 60 %." in twelve
    assert any("Of the 21 verdicts up to 1.05 are wrong on average" in each for each in many)
    assert not any("100 %" in each for each in many)


def test_an_undecided_share_says_that_a_second_campaign_shares_the_error():
    why = one(plan_of(299, [CLEAN]), "id_switches", [1] + [0] * 298).why
    assert "It would have taken 473 seeds with no more than 1 wrong." in why
    assert "half the error each (`confidence: 0.975`), or use `stop: sequential`" in why


@pytest.mark.parametrize("requirement", [HOTA, {"score": "id_switches", "at_most": 90}])
def test_a_mean_is_never_met_on_two_seeds(requirement):
    plan = plan_of(2, [requirement])
    (said,) = warnings_of(plan)
    verdict = one(plan, requirement["score"], [70, 71] if requirement["score"] == "id_switches" else [0.7, 0.71])
    assert (verdict.outcome, verdict.low, verdict.high) == ("undecided", None, None)
    assert "needs" in said and "traffic seeds with a value, and has 2" in verdict.why


def test_seeds_without_a_value_count_neither_for_the_seeds_that_a_mean_needs():
    needed = int(seeds_needed("hota", "low", 0.95))
    values = np.tile([0.7, 0.71, 0.72], needed)[:needed]
    assert one(plan_of(needed, [HOTA]), "hota", values).outcome == "met"
    verdict = one(plan_of(needed, [HOTA]), "hota", [np.nan, *values[1:]])
    assert verdict.outcome == "undecided" and f"and has {needed - 1}" in verdict.why


def test_a_mean_whose_bound_was_never_measured_to_hold_is_undecided_and_names_in():
    requirement = {"score": "hota", "at_least": 0.6, "confidence": 0.9999}
    verdict = one(plan_of(100, [requirement]), "hota", 0.7 + 0.02 * np.tile([-1, 1], 50))
    assert verdict.outcome == "undecided" and "ask for a share of seeds with `in`" in verdict.why


def test_the_seeds_between_two_measured_confidences_are_those_that_both_need(monkeypatch):
    offers = {"confidences": [0.9, 0.95, 0.99], "seeds": {"hota": {"low": [3, 20, 10], "high": [3, None, 3]}}}
    monkeypatch.setattr("modsim3d.campaign.verdicts.wording.measured_offers", lambda: offers)
    found = [seeds_needed("hota", "low", each) for each in (0.89, 0.9, 0.92, 0.95, 0.97, 0.99, 0.995)]
    assert found == [np.inf, 3, 20, 20, 20, 10, np.inf]
    assert seeds_needed("hota", "high", 0.92) == seeds_needed("loca", "low", 0.95) == np.inf


def test_a_threshold_is_told_as_it_was_given_and_a_mean_without_exponent():
    verdict = one(plan_of(3, [{"score": "gospa", "at_most": 1_234_567.5}]), "gospa", [23_456.0, 23_457.0, 23_461.0])
    assert verdict.text == "gospa at most 1234567.5" and "the mean is 23458;" in verdict.why


def test_seeds_that_never_reach_a_state_are_left_out_and_the_state_is_named():
    plan = plan_of(6, [{**HOTA, "in": 0.5, "where": {"state": "haze"}}])
    hota = [0.7, None, 0.72, 0.71, 0.7, 0.7]
    rows = [{"run": run, "status": "done", "hota": 0.1, "state.haze.hota": hota[run]} for run in range(6)]
    (verdict,) = judged(plan, table_of(rows))
    assert (verdict.outcome, verdict.seeds, verdict.undefined) == ("met", 5, 1)
    said = "1 traffic seed without hota in state haze left out: 1000001. The truth has nothing to score there."
    assert said in verdict.why


def test_pairing_takes_off_what_both_trackers_share():
    plan = plan_of(40, [], ("bytetrack", "sort"))
    rng = np.random.default_rng(4)
    traffic, own = rng.normal(0.6, 0.05, (40, 1)), rng.normal(0, 0.01, (40, 2))
    values = traffic + own + [0.03, 0.0]
    (found,) = paired(plan, table_of_scores(plan, "hota", values), "hota")
    difference = values[:, 0] - values[:, 1]
    assert (found.first, found.second, found.seeds) == ("bytetrack", "sort", 40)
    assert found.mean == pytest.approx(difference.mean())
    assert found.high - found.mean == pytest.approx(2.0227 * difference.std(ddof=1) / 40**0.5, rel=1e-4)
    assert found.variance_ratio == pytest.approx(values.var(axis=0, ddof=1).sum() / difference.var(ddof=1))
    assert found.variance_ratio > 10


def test_a_sequential_difference_has_an_interval_only_if_the_score_has_bounds():
    plan = plan_of(400, [], ("bytetrack", "sort"), stop="sequential")
    values = np.tile([[0.9, 0.3], [0.8, 0.4]], (100, 1))
    (found,) = paired(plan, table_of_scores(plan, "hota", values), "hota")
    assert found.low < 0.5 < found.high and found.low > 0.3
    (unbounded,) = paired(plan, table_of_scores(plan, "gospa", values), "gospa")
    assert unbounded.low is unbounded.high is None and unbounded.mean == pytest.approx(0.5)


def test_a_run_with_nothing_to_score_widens_a_paired_difference_as_a_crash_does():
    plan = plan_of(50, [], ("bytetrack", "sort"))
    rows = [
        {"run": run, "status": "done", "appearances": 2, "assa": None if run == 7 else 0.7 + run % 4 / 100}
        for run in range(100)
    ]
    (found,) = paired(plan, table_of(rows), "assa")
    assert (found.crashed, found.undefined, found.seeds) == (1, 0, 49)


def test_a_crashed_run_widens_a_paired_difference_and_does_not_drop_out():
    plan = plan_of(100, [], ("bytetrack", "sort"))
    values = np.tile([[0.7, 0.5], [0.68, 0.5]], (50, 1))
    whole, lost = (paired(plan, table_of_scores(plan, "hota", values, crashed), "hota")[0] for crashed in ((), (6,)))
    assert (lost.crashed, lost.seeds) == (1, 99)
    assert lost.low < whole.low and lost.high > whole.high


def test_a_mean_over_drawn_detectors_is_said_to_become_narrow_and_a_share_is_not():
    (said,) = warnings_of(plan_of(50, [HOTA], uncertainty="learned"))
    assert "over all detectors that the labelled set allows" in said
    assert warnings_of(plan_of(50, [{**HOTA, "in": 0.9}], uncertainty="learned")) == []


def test_a_difference_that_is_always_the_same_has_no_interval_and_no_gain():
    values = np.array([[0.9, 0.8], [0.7, 0.6], [0.4, 0.3]])
    (found,) = paired(plan_of(3, [], ("bytetrack", "sort")), table_of_scores(plan_of(3, []), "hota", values), "hota")
    assert found.mean == pytest.approx(0.1)
    assert found.low is found.high is found.variance_ratio is None


def test_a_crashed_run_rests_on_nothing():
    values, share = np.array([[1.0], [np.nan], [2.0]]), np.array([[0.8], [np.nan], [0.4]])
    crashed = np.array([[False], [True], [False]])
    runs = Runs(values, crashed, np.zeros((3, 1), dtype=bool), share)
    assert runs.rests_on == pytest.approx(0.4)


def test_levels_of_means_are_those_measured():
    (first, *_, last) = levels_of(plan_of(20, [HOTA])).sentences()
    assert "as far as it was measured" in first and "`in` is exact there too" in last
