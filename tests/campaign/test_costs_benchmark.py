"""What a campaign costs: the campaign that is timed, and what is worked out from it."""

import pytest

from benchmarks.campaign_costs import CAMPAIGN, FULL, Cost, Million, pair_text
from benchmarks.campaign_parts import Coordinated, TaskCost
from modsim3d.campaign.keys import read_campaign
from modsim3d.campaign.plan import Plan

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
