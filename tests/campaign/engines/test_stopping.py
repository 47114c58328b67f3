"""A campaign that stops when all is decided counts the same runs whoever makes them, in whatever order."""

from functools import partial
from pathlib import Path

import pyarrow as pa
import pytest

from modsim3d.campaign import running
from modsim3d.campaign.plan import Plan
from modsim3d.campaign.verdicts.verdict import Verdict
from tests.campaign.campaigns import Losing, Shuffled
from tests.campaign.engines.campaigns import Campaigns, Content, content
from tests.campaign.one_process import ThisProcess


def decided_by_the_second_seed(plan: Plan, table: pa.Table) -> tuple[Verdict, ...]:
    seeds = len(set(table["traffic_seed"].to_pylist()))
    return (Verdict(0, "", "", 0, "met" if seeds >= 2 else "undecided", "", 0.95, None, None, None, seeds),)


@pytest.fixture
def decided(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running, "judged", decided_by_the_second_seed)


@pytest.fixture(scope="module")
def one_by_one(campaigns: Campaigns) -> Content:
    """What comes of a campaign that is decided by two of four seeds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(running, "judged", decided_by_the_second_seed)
        result = campaigns.run("sequential", ThisProcess, "one_by_one")
    assert result.table["run"].to_pylist() == list(range(4))
    return content(campaigns.folder / "one_by_one")


@pytest.mark.usefixtures("decided")
@pytest.mark.parametrize("width", [2, 8])
def test_runs_beyond_the_end_are_left_out(campaigns: Campaigns, out: Path, one_by_one: Content, width: int) -> None:
    campaigns.run("sequential", lambda: Shuffled(width), out)
    assert content(out) == one_by_one


@pytest.mark.usefixtures("decided")
def test_a_campaign_killed_beyond_its_end_counts_no_more(campaigns: Campaigns, out: Path, one_by_one: Content) -> None:
    here, tasks = campaigns.planned(out, "sequential")
    engine = ThisProcess()
    for task in (tasks[3], tasks[1], tasks[0]):  # the third is missing
        engine.submit(task)
        engine.next()
    engine.close()
    assert len(list(here.done.iterdir())) == 3
    campaigns.run("sequential", ThisProcess, out)
    assert content(out) == one_by_one


def test_a_run_that_always_ends_its_process_is_reported_and_the_rest_goes_on(campaigns: Campaigns, out: Path) -> None:
    deadly = partial(Losing, lambda task: any(run.tracker.label == "fatal" for run in task.runs))
    table = campaigns.run("fatal", deadly, out).table
    assert table["status"].to_pylist() == ["done", "crashed"] and table["error"].to_pylist() == [None, running.DIED]
