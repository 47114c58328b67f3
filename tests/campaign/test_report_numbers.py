"""The numbers of the page of a campaign against slow, obvious ones."""

import re

import numpy as np
import pytest
from scipy import stats

from modsim3d.campaign.done_rows import with_plan
from modsim3d.campaign.report.campaign_page import mean_sections
from modsim3d.campaign.report.parameter_charts import BINS, by_level, over_seeds, parameters_of, seed_cells
from modsim3d.campaign.report.parameter_charts import parameter_sections as sections
from modsim3d.campaign.report.words import Score, required_scores
from modsim3d.core.text import three_digits_with_interval
from modsim3d.view.pages.charts import ChartInterval, strip
from tests.campaign import hand_made_tables
from tests.campaign.campaigns import html_of_blocks

GRID = {"grid": {"state": ["clear", "haze"], "waves.significant_height_m": [0.2, 0.6, 1.0]}}


def plan_of(seeds, vary=(GRID,), require=(), **keys):
    return hand_made_tables.plan_of(seeds, list(require), ("sort", "bytetrack"), 2, vary=list(vary), **keys)


def table_for(plan, crashed=(), seed=1):
    """A table of drawn scores, with the columns of the plan; runs of some numbers crashed."""
    hota = np.random.default_rng(seed).random(len(plan))
    rows = ({"hota": value, "simulated_s": 9.0, "worst_s": None} for value in hota)
    return with_plan(hand_made_tables.table_of_runs(rows, crashed), plan)


def test_a_mean_and_its_interval_are_over_traffic_seeds_and_one_value_gives_no_interval():
    plan = plan_of(5)
    table = table_for(plan)
    found = over_seeds(seed_cells(plan, table, "hota"))
    rows = [r for r in table.to_pylist() if r["tracker"] == "bytetrack" and r["condition"] == 4]
    seeds = sorted({r["traffic_seed"] for r in rows})
    values = [np.mean([r["hota"] for r in rows if r["traffic_seed"] == seed]) for seed in seeds]
    low, high = stats.t.interval(0.95, len(values) - 1, np.mean(values), stats.sem(values))
    assert [found.mean[4, 1], found.low[4, 1], found.high[4, 1]] == pytest.approx([np.mean(values), low, high])
    assert (len(rows), found.seeds[4, 1]) == (10, 5)
    for values in ([0.4], [0.7, 0.7, 0.7], []):
        found = over_seeds(np.array(values, dtype=float)[:, None])
        assert np.isnan([found.low[0], found.high[0]]).all(), values


def test_a_crashed_run_is_in_no_mean_and_is_counted():
    plan = plan_of(3)
    crashed = {1, 3}  # both detector seeds of the first seed, condition 0, bytetrack
    found = over_seeds(seed_cells(plan, table_for(plan, crashed), "hota"))
    assert found.seeds[0].tolist() == [3, 2]
    assert "crashed runs" in html_of_blocks(mean_sections(plan, table_for(plan, crashed)))
    assert "crashed runs" not in html_of_blocks(mean_sections(plan, table_for(plan)))


def test_means_at_a_level_are_those_of_a_loop():
    plan = plan_of(4)
    table = table_for(plan)
    (state, height) = parameters_of(plan, table)
    assert (state.levels, height.levels) == (("clear", "haze"), ("0.2", "0.6", "1"))
    found = by_level(seed_cells(plan, table, "hota"), height.index, 3)
    rows = table.to_pylist()
    for level, value in enumerate((0.2, 0.6, 1.0)):
        chosen = [r for r in rows if r["waves.significant_height_m"] == value and r["tracker"] == "sort"]
        seeds = {r["traffic_seed"] for r in chosen}
        by_seed = [np.mean([r["hota"] for r in chosen if r["traffic_seed"] == seed]) for seed in seeds]
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
    wanted = [
        np.mean([r["hota"] for r in rows if (r["condition"], r["tracker"]) == (condition, tracker)])
        for tracker in ("sort", "bytetrack")
        for condition in range(6)
    ]
    assert [float(text) for text in shown] == pytest.approx(wanted, abs=6e-4)


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
