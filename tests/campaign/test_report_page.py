"""The page of a campaign: what stands first, what it admits, that it needs nothing else, and its numbers."""

import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy import stats

from modsim3d.campaign.done_rows import with_plan
from modsim3d.campaign.folder import CampaignFolder, files_of_campaign
from modsim3d.campaign.keys import CampaignKeys, SearchKeys
from modsim3d.campaign.means import mean_rows, required_means, with_required
from modsim3d.campaign.plan import Plan
from modsim3d.campaign.report.campaign_page import campaign_page, crash_sections, mean_sections
from modsim3d.campaign.report.parameter_charts import (
    BINS,
    _with_required,
    by_level,
    over_seeds,
    parameters_of,
    seed_cells,
)
from modsim3d.campaign.report.parameter_charts import parameter_sections as sections
from modsim3d.campaign.report.search_page import report_campaign, search_page
from modsim3d.campaign.report.words import Score, constant, required_scores, requirement_sections, verdict_sentence
from modsim3d.campaign.verdicts.verdict import Verdict, judge
from modsim3d.campaign.work.row import crashed_row, table_of
from modsim3d.core.text import three_digits_with_interval
from modsim3d.view.pages import tables
from modsim3d.view.pages.charts import ChartInterval, strip
from tests.campaign import hand_made_tables
from tests.campaign.campaigns import html_of_blocks, run_campaign_file

GRID = {"grid": {"state": ["clear", "haze"], "waves.significant_height_m": [0.2, 0.6, 1.0]}}


def plan_of(seeds, vary=(GRID,), require=(), **keys):
    return hand_made_tables.plan_of(seeds, list(require), ("sort", "bytetrack"), 2, vary=list(vary), **keys)


def table_for(plan, crashed=(), seed=1):
    """A table of drawn scores, with the columns of the plan; runs of some numbers crashed."""
    hota = np.random.default_rng(seed).random(len(plan))
    rows = ({"hota": value, "simulated_s": 9.0, "worst_s": None} for value in hota)
    return with_plan(hand_made_tables.table_of_runs(rows, crashed), plan)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    keys = {"scene": "harbour", "steps": 20, "seeds": {"traffic": 2}, "trackers": ["reference"]}
    vary, require = [{"grid": {"state": ["excellent", "terrible"]}}], [{"score": "hota", "at_least": 0.5}]
    return run_campaign_file(tmp_path_factory.mktemp("report"), "c.yaml", **keys, vary=vary, require=require).folder


def verdict(requirement, outcome, **more):
    given = {"text": "hota at least 0.5", "tracker": "sort", "condition": 0, "why": "It is so.", "confidence": 0.95}
    numbers = {"estimate": 0.55, "low": 0.52, "high": 0.58, "seeds": 8}
    return Verdict(requirement=requirement, outcome=outcome, **{**given, **numbers, **more})


def sentence(*outcomes):
    plan = plan_of(2, require=[{"score": "hota", "at_least": 0.5}] * len(outcomes))
    return verdict_sentence(plan, [verdict(place, outcome) for place, outcome in enumerate(outcomes)])


def test_the_first_sentence_counts_requirements_of_which_one_that_failed_in_one_condition_has_failed():
    assert sentence("met", "met") == "✓ All 2 requirements are met, at 95 % confidence each."
    each = "✗ Not met: of 3 requirements 1 failed, 1 is undecided and 1 is met, at 95 % confidence each."
    assert sentence("met", "failed", "undecided") == each
    assert sentence("undecided") == "? Not decided: the requirement is undecided, at 95 % confidence each."
    assert sentence("failed", "failed").startswith("✗ Not met: all 2 requirements failed, at")
    assert "no requirements" in sentence()
    plan = plan_of(2, require=[{"score": "hota", "at_least": 0.5}])
    found = [verdict(0, "met"), verdict(0, "failed", condition=1, why="Too low <here>.", crashed=1)]
    assert verdict_sentence(plan, found).startswith("✗ Not met")
    html = html_of_blocks(requirement_sections(plan, found))
    assert "✗ failed (1 failed, 1 met)" in html and "Too low &lt;here&gt;." in html
    assert html.index("✗ failed</td>") < html.index("✓ met</td>")


def noted(*rows):
    plan = plan_of(2, require=[{"score": "hota", "at_least": 0.5}])
    return html_of_blocks(requirement_sections(plan, [verdict(0, "failed", **row) for row in rows])).count("It is so.")


def test_a_row_says_only_what_its_interval_does_not():
    below = {"estimate": 0.4, "low": 0.3, "high": 0.45}
    assert noted(below) == 0 and noted(below | {"low": None, "high": None}) == 1
    assert noted(below | {"undefined": 2}) == 1
    assert noted(below | {"high": 0.49996}) == 1  # printed as 0.500, the threshold
    plan = plan_of(2, require=[{"score": "hota", "at_least": 0.5, "in": 0.95}])
    html = html_of_blocks(requirement_sections(plan, [verdict(0, "failed", low=0.1, high=0.6)]))
    assert re.search(r"<th>0\.0\d+ to 1; shaded: at least 0\.950</th>", html)  # the axis of a share ends at 1


def test_the_verdict_stands_before_all_numbers_and_the_page_names_their_meaning_and_needs_no_network(
    campaign, tmp_path
):
    report_campaign(campaign.path, tmp_path / "report.html")
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert campaign.finished
    body = html.partition("<body>")[2]
    (lead,) = re.findall(r'<p class="lead">(.*?)</p>', body)
    assert "requirement" in lead
    parts = [lead, "This traffic only", "Requirements</h2>", "Means</h2>"]
    assert sorted(parts, key=body.index) == parts
    assert "Seeds change the detector and the waves; no result speaks of other traffic." in html
    assert "HOTA (0 to 1)" in html and ">Scores against what is varied</h2>" in html
    assert re.search(r"<h3>Run \d+: reference, HOTA \S+ \(requirement 1\)</h3>", html)
    assert "1. HOTA at least 0.5" in html.partition("What each verdict rests on")[2] and "[0]" not in html
    assert not re.findall(r'(?:src|href)="(?!data:|#)', html) and "<script" not in html and len(html) < 3e6
    assert all(path.is_file() for path in files_of_campaign(campaign))


def test_keys_that_are_set_for_all_runs_are_named():
    plan = plan_of(2, set={"waves.apply_to": "all"}, vary=[{"grid": {"waves.level": ["small"]}}])
    assert constant(plan) == {"waves.apply_to": "all", "waves.level": "small"}
    assert tables.facts([("plan", "0" * 64)]).count("<wbr>") == 3  # a checksum may be broken for a narrow screen


def test_an_unfinished_campaign_says_so_first_and_crashes_are_grouped_by_their_error(campaign, tmp_path):
    page = campaign_page(CampaignFolder(tmp_path, campaign.facts, campaign.plan), table_of([]), [])
    assert '<p class="lead">Not finished: 0 of 4 runs are done, and nothing on this page is a verdict.</p>' in page
    rows = [crashed_row(number, "ValueError: <a>" if number < 2 else "KeyError: b") for number in range(3)]
    html = html_of_blocks(crash_sections(campaign, with_plan(table_of(rows), campaign.plan)))
    assert "3 runs of 3 crashed" in html and html.index("ValueError: &lt;a&gt;") < html.index("KeyError: b")
    assert f"campaign reproduce {campaign.path} 0 --out" in re.sub("<wbr>|</?span[^>]*>", "", html)
    assert html_of_blocks(crash_sections(campaign, table_for(plan_of(2)))) == ""


def test_a_search_is_no_rate_and_names_the_worst_first(campaign):
    search = SearchKeys.model_validate({"minimise": "hota", "over": {"waves.x_m": [0, 1]}, "budget": 4})
    keys = CampaignKeys.model_validate({"scenes": ["harbour"], "trackers": ["sort"], "search": search.model_dump()})
    folder = replace(campaign, plan=Plan.of(keys))
    scores = [{"hota": 0.6}, {"hota": 0.00691934}, {"status": "refused", "error": "waves break"}]
    table = hand_made_tables.table_of_runs({**each, "waves.x_m": 0.5, "traffic_seed": 7} for each in scores)
    html = search_page(folder, search, table)
    assert "The lowest HOTA of 3 trials is 0.00692, in trial 1." in html
    assert "no share or mean of them is a rate" in html
    assert "Not finished: 3 of 4 trials are done." in html and "waves break" in html
    assert re.findall(r'data-label="trial">(\d)</td><td class="number" data-label="HOTA">0\.', html) == ["1", "0"]


def means_of_seeds(rows):
    seeds = sorted({row["traffic_seed"] for row in rows})
    return [np.mean([row["hota"] for row in rows if row["traffic_seed"] == seed]) for seed in seeds]


def test_a_mean_and_its_interval_are_over_traffic_seeds_and_one_value_gives_no_interval():
    plan = plan_of(5)
    table = table_for(plan)
    found = over_seeds(seed_cells(plan, table, "hota"))
    rows = [r for r in table.to_pylist() if r["tracker"] == "bytetrack" and r["condition"] == 4]
    values = means_of_seeds(rows)
    low, high = stats.t.interval(0.95, len(values) - 1, np.mean(values), stats.sem(values))
    assert [found.mean[4, 1], found.low[4, 1], found.high[4, 1]] == pytest.approx([np.mean(values), low, high])
    assert (len(rows), found.seeds[4, 1]) == (10, 5)
    for values in ([0.4], [0.7, 0.7, 0.7], []):
        found = over_seeds(np.array(values, dtype=float)[:, None])
        assert np.isnan([found.low[0], found.high[0]]).all(), values


def test_a_mean_that_is_required_has_the_interval_of_its_requirement_in_table_and_chart():
    plan = plan_of(5, [{"grid": {"state": ["clear", "haze"]}}], [{"score": "hota", "at_least": 0.4}])
    table, trackers = table_for(plan), ("sort", "bytetrack")
    verdicts, (state,) = judge(plan, table), parameters_of(plan, table)
    found = by_level(seed_cells(plan, table, "hota"), state.index, 2)
    chart = _with_required(found, state, trackers, [each for *_, each in required_means(plan, verdicts)])
    rows = with_required(plan, mean_rows(table, ["state"], ["hota"]), verdicts)
    assert len(verdicts) == 4 and all(each.high is not None for each in verdicts)
    for each in verdicts:
        place = each.condition, trackers.index(each.tracker)
        (row,) = (row.means["hota"] for row in rows if row.values == {**each.values, "tracker": each.tracker})
        assert (chart.low[place], chart.high[place]) == (row.low, row.high) == (each.low, each.high)


def test_a_crashed_run_is_in_no_mean_and_is_counted_and_means_of_a_sequential_campaign_prove_nothing():
    plan, sequential = plan_of(3), plan_of(3, stop="sequential")
    crashed = {1, 3}  # both detector seeds of the first seed, condition 0, bytetrack
    assert over_seeds(seed_cells(plan, table_for(plan, crashed), "hota")).seeds[0].tolist() == [3, 2]
    assert "crashed runs" in html_of_blocks(mean_sections(plan, table_for(plan, crashed)))
    once, in_sequence = (html_of_blocks(mean_sections(each, table_for(each))) for each in (plan, sequential))
    assert "crashed runs" not in once and "these intervals describe and prove nothing" not in once
    assert "these intervals describe and prove nothing" in in_sequence


def test_means_at_a_level_are_those_of_a_loop():
    plan = plan_of(4)
    table = table_for(plan)
    (state, height) = parameters_of(plan, table)
    assert (state.levels, height.levels) == (("clear", "haze"), ("0.2", "0.6", "1"))
    found = by_level(seed_cells(plan, table, "hota"), height.index, 3)
    rows = table.to_pylist()
    for level, value in enumerate((0.2, 0.6, 1.0)):
        chosen = [r for r in rows if r["waves.significant_height_m"] == value and r["tracker"] == "sort"]
        by_seed = means_of_seeds(chosen)
        assert found.mean[level, 0] == pytest.approx(np.mean(by_seed))
        assert found.high[level, 0] - found.mean[level, 0] == pytest.approx(stats.t.ppf(0.975, 3) * stats.sem(by_seed))


def test_drawn_numbers_are_put_into_stretches_that_hold_them():
    plan = plan_of(40, [{"uniform": {"detector.x": {"low": 0.01, "high": 1, "scale": "log"}}}])
    (drawn,) = parameters_of(plan, table_for(plan))
    assert drawn.binned and drawn.log and len(drawn.levels) == BINS
    ends = np.array([level.split(" to ") for level in drawn.levels], dtype=float)[drawn.index[:, 0]]
    assert np.all((ends[:, 0] <= 1.01 * drawn.numbers[:, 0]) & (drawn.numbers[:, 0] <= 1.01 * ends[:, 1]))


def test_what_does_not_vary_has_no_chart_nor_has_an_empty_table_and_what_changes_together_says_so():
    pairs = {"pairs": {"state": ["clear", "haze"], "detector.rate": [0.1, 0.3]}}
    plan = plan_of(3, [pairs, {"grid": {"waves.spectrum": ["jonswap"]}}])
    table = table_for(plan)
    html = html_of_blocks(sections(plan, table))
    assert "waves.spectrum" not in html and "Two at a time" not in html
    assert "By state. It changes together with detector.rate" in html
    nothing = table.slice(0, 0)
    assert sections(plan, nothing) == [] and seed_cells(plan, nothing, "hota").shape == (0, 2, 2)


def test_each_cell_of_a_heat_map_has_its_number():
    plan = plan_of(3)
    table = table_for(plan)
    html = html_of_blocks(sections(plan, table)).partition("Two at a time")[2]
    shown, rows = re.findall(r'<td class="number"[^>]* style="[^"]*">([\d.]+)', html), table.to_pylist()
    assert len(shown) == 2 * 6
    for text, cell in zip(shown, product(("sort", "bytetrack"), range(6)), strict=True):
        wanted = np.mean([row["hota"] for row in rows if (row["tracker"], row["condition"]) == cell])
        assert float(text) == pytest.approx(wanted, abs=6e-4), cell


def test_a_mean_on_the_threshold_stands_on_the_dashed_line_and_an_interval_has_the_decimals_of_its_mean():
    drawn = strip(ChartInterval(0.5, 0.4, 0.6), 0.5, True, (0.0, 2.0), "")
    disc = re.search(r'<path d="M([\d.]+) 12.0m-4 0', drawn)[1]
    assert re.search(r'<line x1="([\d.]+)"[^>]*dasharray', drawn)[1] == disc
    numbers = (14.125, 11.354, 16.896), (9.4, 0.51, 10.7), (-0.4, -0.5, 0.25), (0.4, None, None)
    said = ["14.1 [11.4, 16.9]", "9.40 [0.51, 10.70]", "−0.400 [−0.500, 0.250]", "0.400"]
    assert [three_digits_with_interval(*each) for each in numbers] == said


def test_the_side_that_is_bad_is_that_of_a_requirement_on_a_share_of_seeds_too():
    high_is_good = ("motp", "established_share", "mostly_tracked")
    for score in (*high_is_good, "id_switches", "siap_spuriousness"):
        side = "at_least" if score in high_is_good else "at_most"
        (found,) = required_scores(plan_of(2, require=[{"score": score, side: 0.5, "in": 0.9}]))
        assert (found.lowest_is_worst, found.thresholds) == (score in high_is_good, ()), score
    assert Score("established_share").lowest_is_worst and not Score("siap_spuriousness").lowest_is_worst
    assert Score("motp").label.endswith("(0 to 1)")
