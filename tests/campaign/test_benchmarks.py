"""The campaigns of benchmarks: committed pages are those of their figures, and a small sample of each."""

import json
from contextlib import closing
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy import stats

from benchmarks import resampled_means
from benchmarks.campaign_costs import CAMPAIGN, FULL, Cost, Million, pair_text
from benchmarks.campaign_parts import Coordinated, TaskCost
from benchmarks.campaigns import search as benchmark
from benchmarks.campaigns import sequences
from benchmarks.resampled_means import JUDGED_ON, RULE, SEEDS, STORED, TRACKERS, TRAFFICS, holds, lower_rate, offers
from modsim3d.campaign.keys import read_campaign
from modsim3d.campaign.plan import Plan
from modsim3d.campaign.search import run_search
from modsim3d.campaign.verdicts.bounds import corrected_bounds, skewed_bounds
from modsim3d.campaign.verdicts.wording import measured_offers
from modsim3d.campaign.work.layers import RunLayers
from tests.campaign.campaigns import checked_campaign
from tests.campaign.one_process import ThisProcess

CAMPAIGNS = Path(__file__).resolve().parents[2] / "docs" / "campaigns"
REQUIRED = {"hota": "low", "mota": "low", "idf1": "low", "id_switches": "high", "false_track_s": "high"}


@pytest.fixture(scope="module")
def figures():
    return json.loads((CAMPAIGNS / "sequences.json").read_text(encoding="utf-8"))


def test_the_committed_page_is_of_its_figures_and_means_are_judged_from_the_seeds_on_that_they_found(figures):
    assert (CAMPAIGNS / "sequences.md").read_text(encoding="utf-8") == sequences.text(figures)
    found, differences = figures["resampled"], figures["differences"]
    seeds = found["offers"] | differences["offers"]
    assert measured_offers() == {"confidences": found["confidences"], "seeds": seeds}
    place = found["confidences"].index(0.95)
    assert all(each is None or each >= 3 for offer in seeds.values() for bound in offer.values() for each in bound)
    assert all(seeds[score][bound][place] <= 10 for score, bound in REQUIRED.items())


def test_the_usual_means_have_four_fifths_of_the_power_of_t_from_ten_seeds_on_and_none_fails(figures):
    cells = [cell for cell in figures["resampled"]["cells"] if cell["score"] in REQUIRED]
    assert len(cells) == len(REQUIRED) * len(TRAFFICS) * len(TRACKERS) * 6
    assert all(cell["power"][RULE] >= 0.8 * cell["strict"] for cell in cells if cell["seeds"] >= 10)
    assert all(lower_rate(cell["wrong"][RULE], figures["resampled"]["campaigns"]) <= 0.05 for cell in cells)


def test_each_traffic_has_the_same_seeds_and_bounds_of_resampled_campaigns_hold_where_students_t_does_not():
    scores = pq.read_table(STORED)
    assert len(scores) == len(TRAFFICS) * SEEDS * len(TRACKERS)
    numbers = np.array(scores["traffic_seed"]).reshape(len(TRAFFICS), SEEDS, len(TRACKERS))
    assert np.all(numbers == numbers[0, :, :1])  # with each tracker
    found = resampled_means.measured(2_000, scores.select([*scores.column_names[:3], "hota", "false_track_s"]), (10,))
    cells = [cell for cell in found if REQUIRED[cell["score"]] == cell["bound"]]
    assert len(cells) == 2 * len(TRAFFICS) * len(TRACKERS) and all(holds(cell, 0.95, 2_000, RULE) for cell in cells)
    assert sum(not holds(cell, 0.95, 2_000, resampled_means.T) for cell in cells) > len(cells) / 3
    assert all(cell["power"][RULE] > 0.78 * cell["strict"] for cell in cells)


def test_an_offer_begins_behind_the_last_number_of_seeds_that_fails():
    def cell(seeds, wrong, traffic="basin"):
        rates = {RULE: dict.fromkeys((0.8, 0.9, 0.95, 0.99), wrong)}
        return {"score": "hota", "part": "whole", "bound": "low", "seeds": seeds, "wrong": rates, "traffic": traffic}

    cells = [cell(3, 0.0), cell(5, 0.15), cell(10, 0.0), cell(20, 0.04), cell(30, 0.0), cell(50, 0.0)]
    cells += [{**each, "bound": "high"} for each in cells]
    assert offers(cells, 20_000, JUDGED_ON)["hota"]["low"] == [3, 10, 10, 30]
    assert offers([*cells, cell(50, 0.5, "roads")], 20_000, JUDGED_ON)["hota"]["low"] == [None] * 4
    assert offers([*cells, cell(50, 0.5, "bay")], 20_000, JUDGED_ON)["hota"]["low"] == [3, 10, 10, 30]


def test_resampled_bounds_are_those_of_verdicts_and_powers_are_compared_where_students_t_has_ninety_percent():
    drawn = np.random.default_rng(1).gamma(1.0, 1.0, (50, 8))
    mean, deviation, skewness = resampled_means.moments(drawn)
    high = -corrected_bounds(-mean, deviation, skewness, 8, 0.05, 0.0)
    assert high == pytest.approx([-float(skewed_bounds(-each, 0.05, 0.0)) for each in drawn])
    values = np.random.default_rng(2).normal(resampled_means.threshold_distance(10), 1.0, (20_000, 10))
    met = stats.ttest_1samp(values, 0.0, axis=1, alternative="greater").pvalue <= 0.05
    assert met.mean() == pytest.approx(0.9, abs=0.007)


def test_the_committed_page_is_what_the_campaign_makes_of_its_figures() -> None:
    data = json.loads((CAMPAIGNS / "search.json").read_text(encoding="utf-8"))
    assert (CAMPAIGNS / "search.md").read_text(encoding="utf-8") == benchmark.page(data)


def test_the_benchmark_searches_as_the_command_does(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    keys = benchmark.keys_of({**benchmark.PROBLEMS["seeds"], "steps": 6}, 3, 12)
    campaign = checked_campaign(tmp_path, **keys.model_dump(mode="json", by_alias=True, exclude_unset=True))
    found = run_search(campaign, tmp_path / "out", ThisProcess).table["hota"].to_pylist()
    with closing(RunLayers(keys, Path(), Path("cache"))) as layers:
        assert benchmark.searched(keys, layers) == found


def test_the_best_score_never_rises_and_the_verdict_follows_the_interval_of_the_differences() -> None:
    assert benchmark.best([0.5, None, 0.6, 0.4]) == [0.5, 0.5, 0.5, 0.4]
    for gain, said in ((-0.1, "found lower scores"), (0.1, "The random trials found lower")):
        found = [{"search": [0.5, 0.4 + gain + 0.001 * each], "random": [0.5, 0.4]} for each in range(5)]
        assert said in benchmark.verdict(found)
    mixed = [{"search": [0.4 + 0.1 * (-1) ** each], "random": [0.4]} for each in range(4)]
    assert "no advantage is shown" in benchmark.verdict(mixed)


TASK = TaskCost(wall_s=0.004, scheduler_s=0.001, client_s=0.002, bytes=3_000)
FEWER = Coordinated(20_000, 1_000, 10**7, 8.0, 1.0, 3 * 10**8, 10**7, 1)
MORE = Coordinated(100_000, 5_000, 5 * 10**7, 40.0, 5.0, 7 * 10**8, 5 * 10**7, 2)


def test_the_timed_campaign_has_1000_runs_of_300_steps_and_a_fifth_of_them_are_run_twice() -> None:
    plan = Plan.of(read_campaign(CAMPAIGN).keys)
    assert (len(plan), plan.keys.steps) == (1000, 300) and FULL.pair_seeds * plan.runs_by_seed == 200


def test_a_million_runs_are_worked_out_from_a_run_and_a_task() -> None:
    found = Million(1.5, TASK, FEWER, MORE)
    assert found.hours == pytest.approx(10**6 * 1.5 / 3600)
    assert found.tasks == 50_000  # of twenty runs
    assert found.tasks_per_s == pytest.approx(1000 / 30)
    assert found.grown("peak_bytes") == pytest.approx(7e8 + 9e5 * 4e8 / 8e4)
    limits = {"the command that hands the tasks out": 30 / 0.010, "the Dask scheduler": 30 / 0.001}
    assert found.limits == pytest.approx(limits)


def test_what_is_not_held_is_said() -> None:
    one, two = (Cost(200, 60_000, seconds, 240, 10**6, 1.7) for seconds in (240.0, 160.0))
    assert "+0.0% CPU seconds a run (within 5 %: held)" in pair_text(one, two, same=True)
    assert "1.50 × by the clock (at least 1.7 × on a quiet machine: **not held**)" in pair_text(one, two, same=True)
    assert "**different**" in pair_text(one, two, same=False)
