"""Lookout requirements: approaches that are known at a distance, counted and bounded with traffic seeds as clusters."""

import json
from pathlib import Path

import numpy as np
import pytest

from modsim3d.campaign.keys import CampaignKeys
from modsim3d.campaign.report.campaign_page import campaign_page
from modsim3d.campaign.reproduce import reproduce_run
from modsim3d.campaign.verdicts.bounds import mean_share_low
from modsim3d.campaign.verdicts.verdict import judge
from tests.campaign.campaigns import problems_of, run_campaign_file
from tests.campaign.hand_made_tables import plan_of, table_of_runs

KNOWN = {"known_at_m": 900, "share": 0.8, "of": {"length_m": [8, 15], "label": "boat"}}


def approach(in_view_m=2000, closest_m=100, known_m=1000, one_track_m=1000, length_m=12, label="boat"):
    return dict(locals())


def verdict(seeds, crashed=(), planned=None, **keys):
    table = table_of_runs([{"approaches": json.dumps(each)} for each in seeds], crashed)
    (found,) = judge(plan_of(planned or len(seeds), [KNOWN | keys]), table)
    return found


def test_only_vessels_of_the_kind_that_were_in_view_beyond_and_came_so_near_count_and_the_others_are_told_apart():
    counted = [approach(), approach(one_track_m=899), approach(in_view_m=900, closest_m=900, one_track_m=900)]
    apart = [approach(in_view_m=899), approach(in_view_m=400), approach(closest_m=901)]
    others = [approach(length_m=7.9), approach(length_m=15), approach(label="ship")]
    found = verdict([counted + apart + others])
    assert found.text == "boat of 8 to 15 m known at 900 m, in 80 % of approaches" and found.estimate == 2 / 3
    near, far = "2 of 3 approaches are known at 900 m", "(2 appeared nearer, 1 never came so near); mean of 1 traffic"
    assert f"{near} {far}" in found.why
    every = verdict([counted + apart + others], of={})
    assert every.estimate == 5 / 6 and "vessels known at 900 m" in every.text
    lost = [approach(one_track_m=0)]
    assert (verdict([lost]).estimate, verdict([lost], one_track=False).estimate) == (0, 1)
    assert verdict([[approach()], lost * 3]).estimate == 0.5  # each seed counts as much
    nothing = verdict([[], [approach(in_view_m=20)]])
    assert (nothing.outcome, nothing.estimate, nothing.low) == ("undecided", None, None)


def test_it_is_met_or_failed_by_the_bound_of_the_requirement_when_all_seeds_are_done_and_no_run_crashed():
    good = [[approach()] * 2] * 60
    found = verdict(good)
    assert found.outcome == "met" and found.low == pytest.approx(0.04 ** (1 / 60))
    assert verdict(good, share=0.98).outcome == "undecided"
    assert verdict([[approach(one_track_m=0)] * 2] * 60).outcome == "failed"
    lost = verdict(good, crashed=[3])
    assert (lost.outcome, lost.crashed, lost.estimate) == ("met", 1, 59 / 60) and "1 seed with a run that" in lost.why
    assert verdict(good, crashed=range(60)).outcome == "failed"
    partly = verdict(good, planned=61)
    assert (partly.outcome, partly.estimate, partly.low) == ("undecided", 1, None) and "when all 61" in partly.why


@pytest.mark.parametrize("seeds", [12, 20, 40])
def test_the_bound_errs_as_seldom_as_it_says_also_where_dense_traffic_is_harder_or_seeds_are_all_or_nothing(seeds):
    rng, runs = np.random.default_rng(3), 400
    dense = rng.random((runs, seeds)) < 0.1
    size = np.maximum(rng.lognormal(1, 1, (runs, seeds)).round(), 1).astype(int)
    denser = np.clip(1.05 - 0.03 * size, 0.3, 1)
    for shares, mean in (
        (rng.binomial(np.where(dense, 30, 2), np.where(dense, 0.7, 1)) / np.where(dense, 30, 2), 0.97),
        (rng.binomial(size, denser) / size, None),
        ((rng.random((runs, seeds)) < 0.9).astype(float), 0.9),
        (rng.beta(9, 1, (runs, seeds)), 0.9),
    ):
        mean = shares.mean() if mean is None else mean
        low, high = (np.array([mean_share_low(each, 0.05) for each in values]) for values in (shares, 1 - shares))
        for errs in (low > mean, 1 - high < mean):
            assert errs.mean() <= 0.05 + 4 * np.sqrt(0.05 * 0.95 / runs)
        assert np.median(low) > mean - 1.3 / np.sqrt(seeds)


@pytest.mark.parametrize(("require", "keys", "said"), [
    ({"known_at_m": 900}, {}, "require[0]: known_at_m needs share"),
    ({"known_at_m": -1, "share": 0.9}, {}, "require[0].known_at_m: must be above 0 (got -1)"),
    ({"known_at_m": 900, "share": 0.9, "of": {"length_m": [15, 8]}}, {}, "needs two lengths, the smaller first"),
    ({"known_at_m": 900, "share": 0.9, "of": {"length": 8}}, {}, "require[0].kind.length: unknown key"),
    ({"known_at_m": 900, "share": 0.9, "at_least": 1}, {}, "require[0]: at_least does not go with known_at_m"),
    ({"score": "hota", "at_least": 0.4, "one_track": False}, {}, "require[0]: kind and one_track need known_at_m"),
    ({"known_at_m": 900, "share": 0.9, "where": {"state": "haze"}}, {}, "give state in vary, or leave it out"),
    ({"known_at_m": 900, "share": 0.9, "in": 0.5}, {}, "require[0]: share and in are the same here: leave one out"),
    ({"known_at_m": 900, "share": 0.9}, {"stop": "sequential"}, "known_at_m does not go with stop: sequential"),
    ({"known_at_m": 900, "share": 0.9}, {"scene": "simulation_1"}, "no vessel carries a camera"),
    ({"known_at_m": 900, "share": 0.9, "of": {"label": "bot"}}, {}, "there is no label 'bot' (did you mean 'boat'?)"),
])  # fmt: skip
def test_a_wrong_lookout_requirement_is_refused_with_what_is_wrong(tmp_path: Path, require, keys, said) -> None:
    given = {"scene": "fairway", "steps": 20, "trackers": ["sort"], "require": [require], **keys}
    assert any(said in problem for problem in problems_of(tmp_path, **given))


def test_a_campaign_has_its_approaches_table_and_chart_its_rows_repeat_and_other_plans_are_as_they_were(tmp_path):
    keys = {"scene": "small_target", "steps": 24, "trackers": ["reference"]}
    require = [{"known_at_m": 1250, "share": 0.5, "where": {"state": "haze"}}]
    require.append({"score": "hota", "at_least": 0.1, "in": 0.5})
    done = run_campaign_file(tmp_path, **keys, vary=[{"grid": {"state": ["clear", "haze"]}}], require=require)
    approaches = [each for text in done.table["approaches"].to_pylist() for each in json.loads(text)]
    targets = [(each["own_ship"], each["vessel"], each["length_m"]) for each in approaches]
    assert targets == [("own", f"target_{index}", 1.5) for index in (1, 2, 3)] * 2
    assert all(1300 < each["in_view_m"] < 1510 and each["closest_m"] < 1350 for each in approaches)
    assert [each.outcome for each in done.verdicts] == ["undecided"] * 3
    assert done.verdicts[0].values == {"state": "haze"}
    page = campaign_page(done.folder, done.table, done.verdicts).replace("\xa0", " ")
    assert "From where on vessels are known" in page and "vessels known at 1,250 m, in 50 % of approaches" in page
    assert page.count("<title>Vessels of ") + page.count('aria-label="Vessels of 0 to 8 m"') == 1
    again = reproduce_run(done.folder.path, 1, tmp_path / "again")
    assert again.row is not None and again.same and again.row["approaches"] == done.table["approaches"][1].as_py()
    plain = CampaignKeys.model_validate(keys | {"require": require[1:]}).model_dump(mode="json", by_alias=True)
    assert not {"known_at_m", "kind", "one_track"} & plain["require"][0].keys()


def test_scores_of_closest_approaches_and_trajectories_in_the_world_can_be_required() -> None:
    seen = {"vessels": 9, "cpa_in_view": 4, "cpa_predicted": 3}
    seen |= {"cpa_right_share": 0.75, "cpa_error_m": 30.0, "ospa2_m": 9.0}
    blind = {**seen, "cpa_predicted": 0, "cpa_right_share": 0.0, "cpa_error_m": None, "ospa2_m": 50.0}
    empty = {**blind, "cpa_in_view": 0, "cpa_right_share": None, "ospa2_m": 9.0}
    limits = {"cpa_right_share": {"at_least": 0.7}, "cpa_error_m": {"at_most": 50, "resting_on": 0.5}}
    limits |= {"ospa2_m": {"at_most": 10}}
    require = [{"score": score, "in": 0.5, **limit} for score, limit in limits.items()]
    found = judge(plan_of(20, require), table_of_runs([seen] * 15 + [blind, empty, empty, empty, empty]))
    assert [each.outcome for each in found] == ["met"] * 3
    assert [each.undefined for each in found] == [4, 4, 0]  # no encounter was in view: nobody's fault
    assert [each.estimate for each in found] == [15 / 16, 15 / 16, 19 / 20] and found[1].nothing == 1


def test_rules_in_the_world_reach_the_scores_and_leave_other_plans_as_they_were(tmp_path) -> None:
    keys, rows = {"scene": "fairway", "steps": 16, "trackers": ["world_gnn"]}, []
    for name, score in (("usual", {}), ("strict", {"in_world": {"gospa_c_m": 5.0, "gate_m": 1.0}})):
        rows += run_campaign_file(tmp_path, f"{name}.yaml", **keys, score=score).table.to_pylist()
    usual, strict = rows
    assert strict["gospa_m"] < usual["gospa_m"] / 5 and strict["ospa2_m"] <= 5 < usual["ospa2_m"]
    assert strict["followed_share"] < usual["followed_share"]
    assert reproduce_run(tmp_path / "usual", 0, tmp_path / "again", film=True).film is None  # no moment is known
    assert "in_world" not in CampaignKeys.model_validate(keys).model_dump(mode="json")["score"]
