"""Requirements on differences between two trackers that are paired by traffic seed."""

import numpy as np
import pyarrow.parquet as pq
import pytest

from benchmarks.resampled_means import STORED, TRAFFICS, differences, turned
from modsim3d.campaign.done_rows import with_plan
from modsim3d.campaign.means import required_means
from modsim3d.campaign.plan import cases_of
from modsim3d.campaign.ranking import worst_runs
from modsim3d.campaign.report.campaign_page import mean_sections, paired_sections
from modsim3d.campaign.report.coverage import trace_sections
from modsim3d.campaign.report.words import required_scores
from modsim3d.campaign.verdicts.bounds import skewed_bounds
from modsim3d.campaign.verdicts.verdict import judge
from modsim3d.campaign.verdicts.wording import measured_offers, seeds_needed, warnings_of
from modsim3d.cli.campaign_text import requirement_in_words
from tests.campaign.campaigns import html_of_blocks, run_campaign_file
from tests.campaign.hand_made_tables import plan_of, table_of_runs, table_of_scores, verdict_of

NO_WORSE = {"score": "siap_completeness", "of": "new", "minus": "old", "at_least": -0.02}
TRACKERS = ({"tracker": "sort", "name": "old"}, {"tracker": "bytetrack", "name": "new"})
SEEDS = 60  # from 50 on a mean difference of this score is judged at 95 %


def values_of(difference, seeds=SEEDS):
    """Scores of old and new, whose spread is that of the traffic: it is ten times that of their difference."""
    rng = np.random.default_rng(7)
    old = rng.normal(0.5, 0.1, seeds)
    return np.column_stack([old, old + difference + rng.normal(0, 0.01, seeds)])


def one(requirement, values, crashed=(), score="siap_completeness", **keys):
    return verdict_of(plan_of(len(values), [requirement], TRACKERS, **keys), score, values, crashed)


@pytest.mark.parametrize("stop", ["once", "sequential"])
@pytest.mark.parametrize(("requirement", "difference", "outcome"), [
    ({}, 0.1, "met"), ({}, -0.35, "failed"), ({"at_least": 0.1}, 0.1, "undecided"),
    ({"at_least": None, "at_most": 0.3}, 0.1, "met"), ({"of": "old", "minus": "new"}, -0.3, "met"),
    ({"in": 0.8}, 0.1, "met"), ({"in": 0.8}, -0.35, "failed"),
])  # fmt: skip
def test_a_difference_is_judged_by_that_of_each_traffic_seed(requirement, difference, outcome, stop):
    verdict = one({**NO_WORSE, **requirement}, values_of(difference, 200), stop=stop)
    turn = -1 if requirement.get("of") == "old" else 1
    assert (verdict.outcome, verdict.seeds) == (outcome, 200)
    assert verdict.tracker == ("new − old" if turn > 0 else "old − new")
    if "in" not in requirement:
        assert verdict.estimate == pytest.approx(turn * difference, abs=0.01)


@pytest.mark.parametrize("crashed", [{0}, {1}])
def test_a_bound_is_over_the_span_of_differences_and_a_lost_run_of_either_tracker_takes_the_worst_of_it(crashed):
    values, requirement = values_of(0.0, 100), {**NO_WORSE, "at_least": -0.1}
    met, lost = one(requirement, values), one(requirement, values, crashed)
    assert (met.outcome, lost.outcome, lost.crashed) == ("met", "met", 1)
    assert "siap_completeness of new minus old at least -0.1" in met.text and "best possible difference in" in lost.why
    difference = values[:, 1] - values[:, 0]
    for verdict, each in ((met, difference), (lost, np.append(-1.0, difference[1:]))):
        assert verdict.low == pytest.approx(float(skewed_bounds(each, 0.05, 1.0)))
    assert one(requirement, values, range(10)).outcome == "undecided"


def test_a_lost_run_or_an_infinite_value_is_wrong_with_in_and_leaves_a_mean_without_worst_value_undecided():
    assert one({**NO_WORSE, "in": 0.5}, values_of(0.1), {3, 4}).estimate == pytest.approx(1 - 2 / SEEDS)
    requirement = {"score": "gospa", "of": "new", "minus": "old", "at_most": 50}
    verdict = one(requirement, values_of(0.1), {3}, "gospa")
    assert verdict.outcome == "undecided" and "no worst possible value" in verdict.why
    values = values_of(0.1)
    values[3], values[4, 0] = np.inf, np.inf
    verdict = one(requirement, values, score="gospa")
    assert (verdict.outcome, verdict.nothing, verdict.undefined) == ("undecided", 2, 0)
    assert one({**requirement, "in": 0.5}, values, score="gospa").estimate == pytest.approx(1 - 2 / SEEDS)


@pytest.mark.parametrize("lazy", ["old", "new"])
def test_a_managed_score_must_rest_on_enough_of_both_trackers(lazy):
    requirement = {"score": "rmse_px", "of": "new", "minus": "old", "at_most": 1, "in": 0.5}
    assert "resting_on" in warnings_of(plan_of(6, [requirement], TRACKERS))[0]
    plan = plan_of(6, [{**requirement, "resting_on": 0.8}], TRACKERS)
    few, many = {"misses": 8, "true_positives": 2}, {"misses": 0, "true_positives": 10}
    rows = [few if name == lazy else many for name in ("old", "new")] + [many] * 10
    (verdict,) = judge(plan, table_of_runs({"appearances": 2, "rmse_px": 3.0, **row} for row in rows))
    assert (verdict.nothing, verdict.estimate) == (1, pytest.approx(5 / 6))


def test_a_difference_that_no_tracks_at_all_would_meet_says_so():
    requirement = {"score": "id_switches", "of": "new", "minus": "old", "at_most": 0, "in": 0.5}
    fewer, worse = np.tile([3, 2], (SEEDS, 1)), np.tile([0, 1], (SEEDS, 1))
    assert one(requirement, fewer, score="id_switches").met_without_tracks
    assert not one({**requirement, "at_most": -1}, worse, score="id_switches").met_without_tracks


def test_a_difference_has_one_verdict_in_each_condition_and_beyond_what_its_score_can_give_is_never_met():
    vary = [{"grid": {"state": ["good", "bad"]}}]
    plan = plan_of(5, [NO_WORSE, {**NO_WORSE, "where": {"state": "bad"}}], TRACKERS, vary=vary)
    assert [len(cases_of(plan, each)) for each in plan.keys.require] == [2, 1]
    words = requirement_in_words(plan.keys.require[1])
    assert words.startswith("mean siap_completeness of new minus old at least -0.02, where state bad")
    (said,) = warnings_of(plan_of(50, [{**NO_WORSE, "at_least": 1.2}], TRACKERS))
    assert "siap_completeness of new minus old is never above 1" in said
    assert warnings_of(plan_of(SEEDS, [NO_WORSE], TRACKERS)) == []


def test_no_difference_is_judged_by_what_was_measured_of_scores():
    verdict = one({**NO_WORSE, "score": "hota"}, values_of(0.1), score="hota")
    assert (verdict.outcome, verdict.low) == ("undecided", None)
    assert "ask for a share of seeds with `in` or use `stop: sequential`" in verdict.why
    seeds = measured_offers()["seeds"]
    assert seeds["difference.hota"]["low"] == seeds["difference.hota"]["high"]
    assert seeds_needed("difference.unknown", "low", 0.95) == np.inf
    (said,) = warnings_of(plan_of(50, [{**NO_WORSE, "where": {"state": "bad"}}], TRACKERS))
    assert "ask for a share of seeds with `in`" in said


def test_differences_are_drawn_from_pairs_on_the_same_seeds_with_both_signs():
    table = pq.read_table(STORED, columns=["traffic", "tracker", "traffic_seed", "hota"])
    found = list(differences(table))
    assert len(found) == 3 * len(TRAFFICS) and all(each.limits == (-1.0, 1.0) for each in found)
    rows = table.slice(0, 3).to_pylist()
    assert found[0].tracker == f"{rows[0]['tracker']} − {rows[1]['tracker']}"
    assert found[0].values[0] == pytest.approx(rows[0]["hota"] - rows[1]["hota"])
    assert turned({"tracker": "a − b", "bound": "low", "seeds": 3}) == {"tracker": "b − a", "bound": "high", "seeds": 3}


def test_the_page_holds_no_mean_against_the_threshold_of_a_difference_and_prints_no_second_interval():
    plan = plan_of(SEEDS, [NO_WORSE], TRACKERS)
    (score,) = required_scores(plan)
    assert score.column == "siap_completeness" and score.thresholds == ()
    table = table_of_scores(plan, "siap_completeness", values_of(0.1))
    html = html_of_blocks(paired_sections(plan, table))
    assert "above" in html and ">−0.099</td>" in html
    verdicts = judge(plan, with_plan(table, plan))
    html = html_of_blocks(mean_sections(plan, with_plan(table, plan), verdicts))
    assert verdicts and "Intervals of means that are required" not in html and required_means(plan, verdicts) == []


@pytest.mark.parametrize(("lost", "outcome"), [(1, "failed"), (0, "undecided")])
def test_a_mean_difference_fails_if_every_run_of_the_tracker_itself_crashed_and_not_of_the_other(lost, outcome):
    verdict = one(NO_WORSE, values_of(0.1), range(lost, 2 * SEEDS, 2))
    assert (verdict.outcome, verdict.estimate) == (outcome, None)


def test_a_campaign_page_traces_a_difference_to_the_runs_of_both_and_its_worst_run_has_the_worst_difference(tmp_path):
    require = [{**NO_WORSE, "score": "hota", "at_least": 0.9, "in": 0.5}]
    keys = {"scene": "harbour", "steps": 12, "seeds": {"traffic": 3}, "trackers": [*TRACKERS]}
    result = run_campaign_file(tmp_path, **keys, require=require)
    assert [each.tracker for each in result.verdicts] == ["new − old"]
    hota = result.table["hota"].to_numpy().reshape(3, 2)
    (worst,) = worst_runs(result.folder, result.table, result.verdicts, count=1)
    assert worst.number == 2 * int(np.argmin(hota[:, 1] - hota[:, 0])) + 1
    traced = html_of_blocks(trace_sections(result.folder, result.table, result.verdicts))
    assert "new − old" in traced and "0–5 (6 of them)" in traced
