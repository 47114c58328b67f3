"""`campaign --plan`: how many runs there will be, and how many seeds each requirement needs."""

import json

import numpy as np
import pytest

from modsim3d.campaign.done_rows import Expectation, needed_seeds, parsed_expectation
from modsim3d.campaign.folder import CampaignFolder, planned
from modsim3d.campaign.verdicts.bounds import skewed_bounds
from modsim3d.core.errors import ModsimError
from tests.campaign.campaigns import campaign_file, checked_campaign, run_campaign_file
from tests.campaign.hand_made_tables import plan_of, table_of_scores

HOTA = {"score": "hota", "at_least": 0.6}
CLEAN = {"score": "id_switches", "at_most": 0, "in": 0.99}
TRACKERS = ("bytetrack", "sort")


def one(requirement, expected=None, **keys):
    (found,) = needed_seeds(plan_of(20, [requirement], **keys), expected or {}, None)
    return found


@pytest.mark.parametrize(("requirement", "sign"), [
    ({"score": "hota", "at_least": 0.63}, 1), ({"score": "hota", "at_most": 0.77}, -1),
])  # fmt: skip
def test_a_mean_needs_the_least_seeds_with_which_its_bound_is_beyond_the_threshold_in_four_of_five(requirement, sign):
    seeds = one(requirement, {"hota": Expectation(0.7, 0.1)}).seeds
    rng, limits = np.random.default_rng(5), {1: 1.0, -1: 0.0}

    def met(count):
        values = sign * rng.normal(0.7, 0.1, (4_000, count))
        threshold = requirement.get("at_least", requirement.get("at_most"))
        return np.mean(skewed_bounds(values, 0.05, sign * limits[sign]) >= sign * threshold)

    assert met(seeds) == pytest.approx(0.8, abs=0.05) and met(seeds) > 0.77 and met(seeds - 1) < 0.82
    assert 15 <= seeds <= 25


def test_a_share_needs_its_clean_seeds_and_a_mean_its_spread_or_is_never_met_on_the_wrong_side(monkeypatch):
    once, sequential = one(CLEAN), one(CLEAN, stop="sequential")
    assert (once.seeds, sequential.seeds) == (299, 680) and "473 if one is not" in once.why
    never, unknown = one(HOTA, {"hota": Expectation(0.6, 0.1)}), one(HOTA)
    assert never.seeds is None and never.why.startswith("never: the expected mean, 0.6, is not above")
    assert unknown.seeds is None and "--expect 'hota=MEAN:SPREAD'" in unknown.why and "--like DIR" in unknown.why
    assert 20 <= one(HOTA, {"hota": Expectation(0.7, 0.1)}, stop="sequential").seeds <= 50  # with a bound of its own
    monkeypatch.setattr("modsim3d.campaign.verdicts.wording.offered_from", lambda *_: 30)
    assert one(HOTA, {"hota": Expectation(0.9, 0.01)}).seeds == 30  # the least seeds of offers count


@pytest.mark.parametrize("requirement", [
    {"score": "rmse_px", "at_most": 8}, {"score": "hota", "at_least": 1.2},
    {"score": "hota", "of": "sort", "minus": "bytetrack", "at_least": 0},
])  # fmt: skip
def test_what_no_number_of_seeds_can_meet_is_never_whatever_is_expected(requirement):
    found = one(requirement, {"rmse_px": Expectation(1.0, 0.1), "hota": Expectation(0.9, 0.1)}, trackers=TRACKERS)
    assert found.seeds is None and found.why.startswith("never: ")


@pytest.mark.parametrize(("text", "said"), [
    ("hota", "needs {SCORE: (MEAN, SPREAD)}, as in {"), ("hota=a:b", "(got 'hota=a:b')"),
    ("hota=0.7:0", "needs a spread above 0 (got 0)"), ("hota=inf:1", "(got 'hota=inf:1')"),
    ("hotta=0.7:0.1", "no requirement is on the mean of 'hotta' (did you mean 'hota'?)"),
    ("id_switches=1:1", "no requirement is on the mean of 'id_switches'"),
])  # fmt: skip
def test_a_wrong_expectation_is_refused(text, said):
    with pytest.raises(ModsimError, match=r"^expect") as refused:
        parsed_expectation(text, plan_of(5, [HOTA, CLEAN]))
    assert said in str(refused.value)
    assert parsed_expectation("hota=0.7:0.05", plan_of(5, [HOTA])) == ("hota", Expectation(0.7, 0.05))


def test_what_an_earlier_campaign_lost_is_left_out_of_its_spread_and_said(tmp_path, monkeypatch):
    plan = plan_of(20, [HOTA, {**HOTA, "of": "sort", "minus": "bytetrack", "in": 0.5}], TRACKERS)
    earlier = plan_of(6, [], TRACKERS, seed=2)
    table = table_of_scores(earlier, "hota", np.tile([0.7, 0.8, 0.75, 0.6], 3), crashed={0})
    monkeypatch.setattr("modsim3d.campaign.done_rows.results_table", lambda _: table)
    bytetrack, sort, share = needed_seeds(plan, {}, CampaignFolder(tmp_path, {}, earlier))
    assert bytetrack.expected.mean == pytest.approx(np.mean([0.75, 0.7, 0.75, 0.7, 0.75]))
    assert "1 lost run of it left out" in bytetrack.why and "lost" not in sort.why
    assert (share.tracker, share.seeds) == ("sort − bytetrack", 5)


CAMPAIGN = {
    "scene": "harbour", "steps": 12, "seeds": {"traffic": 4}, "vary": [{"grid": {"state": ["excellent", "bad"]}}],
    "trackers": ["sort", "reference"], "require": [{"score": "hota", "at_least": 0.1}, CLEAN],
}  # fmt: skip


def test_the_command_runs_nothing_and_takes_an_earlier_campaign_for_its_spread(modsim3d, tmp_path):
    earlier = run_campaign_file(tmp_path, "earlier.yaml", **CAMPAIGN)
    other = {**CAMPAIGN, "seeds": {"traffic": 50}, "trackers": ["sort", "bytetrack"]}
    file = campaign_file(tmp_path, "next.yaml", **other)
    told = modsim3d("campaign", "plan", file, "--like", tmp_path / "earlier", "--json")
    found = json.loads(told.out)
    assert not (tmp_path / "out").exists()
    assert (told.status, found["folder"], found["finished"]) == (0, None, False)
    assert (found["runs"], found["frames"]) == (200, 200 * 12)
    needed = [each for each in found["needed"] if each["requirement"] == 0]
    assert [each["tracker"] for each in needed] == ["sort", "sort", "bytetrack", "bytetrack"]
    assert all(each["seeds"] is None and "--expect 'hota=MEAN:SPREAD'" in each["why"] for each in needed[2:])
    hota = earlier.table["hota"].to_numpy().reshape(4, 2, 2)[:, 0, 0]
    expected = {"mean": pytest.approx(hota.mean()), "spread": pytest.approx(hota.std(ddof=1)), "lost": 0}
    assert needed[0]["expected"] == expected and needed[0]["seeds"] >= 3
    assert [each["seeds"] for each in found["needed"] if each["requirement"] == 1] == [299]
    text = modsim3d("campaign", "plan", file, "--expect", "hota=0.3:0.1")
    assert text.status == 0 and "seeds needed" in text.out and "normal" in text.out and "2,400 frames" in text.out


def test_no_spread_is_taken_from_a_search_and_an_earlier_campaign_that_is_not_there_is_named(modsim3d, tmp_path):
    search = {"minimise": "hota", "over": {"detector.operating_threshold": [0.2, 0.6]}, "budget": 2, "batch": 1}
    keys = {key: value for key, value in CAMPAIGN.items() if key in ("scene", "steps")}
    earlier = checked_campaign(tmp_path, "search.yaml", **keys, trackers=["reference"], search=search)
    planned(earlier, tmp_path / "search")
    file = campaign_file(tmp_path, "next.yaml", **CAMPAIGN)
    like = "--like", tmp_path / "search"
    refused = ([file, *like], "holds a search"), ([tmp_path / "search.yaml"], "a search has no requirements")
    for options, said in (*refused, ([file, "--like", "nowhere"], "nowhere")):
        told = modsim3d("campaign", "plan", *options)
        assert told.status == 2 and said in told.err
