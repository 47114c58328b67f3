"""Processes on this machine: they die, are killed, end with the main one; and what becomes of their runs."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pyarrow as pa
import pytest

from modsim3d.campaign import running
from modsim3d.campaign.folder import killed_sentence, opened_campaign
from modsim3d.campaign.plan import Plan
from modsim3d.campaign.report.campaign_page import cautions
from modsim3d.campaign.verdicts.verdict import Verdict
from modsim3d.campaign.workers import CampaignWorker, Death, ProcessPool
from modsim3d.core.document import Text
from tests.campaign.campaigns import Losing, Shuffled, no_engine
from tests.campaign.engines.campaigns import MORTAL, Campaigns, Content, alive, content, waited_for
from tests.campaign.one_process import ThisProcess


def test_a_process_that_is_killed_in_a_task_is_replaced(campaigns: Campaigns, out: Path) -> None:
    here, tasks = campaigns.planned(out)
    pool = ProcessPool(1)
    with campaigns.holding() as waiting:
        for task in tasks[:2]:
            pool.submit(task)
        (killed,) = waiting()
        os.kill(killed, signal.SIGKILL)
        assert pool.next() == (tasks[0], Death.of(0, -signal.SIGKILL))
        pool.submit(tasks[0])
    assert [pool.next()[0] for _ in range(2)] == [tasks[1], tasks[0]]
    assert set(here.done.iterdir()) == {task.path for task in tasks[:2]}
    pool.close()
    campaigns.check_end(out)


def test_a_process_that_has_done_nothing_is_ended_at_once() -> None:
    process = CampaignWorker()
    process.close()
    assert process.wait() == -signal.SIGKILL


FORKS = """
from modsim3d.campaign.workers import CampaignWorker
workers = CampaignWorker(), CampaignWorker()
assert all(each.answer() is None for each in workers)  # they are ready
for each in workers:
    each.close()
print(*(type(each._process).__name__ for each in workers), *(each.wait() for each in workers))
"""


def test_a_fork_holds_no_pipe_of_another_which_therefore_ends_by_itself() -> None:
    alone = {"OPENBLAS_NUM_THREADS": "1", "JE_ARROW_MALLOC_CONF": "background_thread:false"}
    said = subprocess.check_output([sys.executable, "-c", FORKS], env={**os.environ, **alone}, text=True)
    assert said.split() == ["ForkProcess", "ForkProcess", "0", "0"]


def test_a_signal_to_all_processes_stops_the_campaign_and_crashes_no_run(campaigns: Campaigns, out: Path) -> None:
    """The worker has it first, the main process a moment later."""
    with campaigns.holding() as waiting, campaigns.coordinator("1", out) as coordinator:
        os.kill(waiting()[0], signal.SIGTERM)
        time.sleep(0.5)
        coordinator.send_signal(signal.SIGINT)
        assert coordinator.wait(30) in (-signal.SIGINT, 1)
    campaigns.check_end(out)


@pytest.mark.parametrize(("number", "count", "threads"), [(signal.SIGKILL, 2, 1), (signal.SIGINT, 1, 2)])
def test_all_processes_end_with_the_main_one_and_the_same_command_goes_on(campaigns, out, number, count, threads):
    """They are forks of it or, where it has threads, new interpreters."""
    with campaigns.holding() as waiting, campaigns.coordinator(str(count), out, threads=threads) as coordinator:
        workers = waiting(count)
        coordinator.send_signal(number)
        assert coordinator.wait(30) in (-number, 1)
        waited_for(lambda: not any(map(alive, workers)))
    campaigns.check_end(out)


ENDS = {"exit": "exit status 3", "nothing": "exit status 0", "segfault": "SIGSEGV", "term": "SIGTERM"}
ENDS["interrupt"] = "exit status 130"
CRASHES = {how: f"the run ended its worker process ({end})" for how, end in ENDS.items()}


def test_a_run_that_ends_its_process_has_crashed_and_one_that_is_killed_is_tried_again(campaigns, doomed, out):
    with campaigns.coordinator("1", out, "mortal") as coordinator:
        assert coordinator.communicate()[1] == ""
    result = campaigns.run("mortal", no_engine, out)
    rows = {row["tracker"]: row for row in result.table.to_pylist()}
    assert {path.name for path in doomed.iterdir()} == {*MORTAL}
    assert {name: row["error"] for name, row in rows.items() if row["status"] == "crashed"} == CRASHES
    assert {name for name, row in rows.items() if row["status"] == "done"} == {"reference", "kill"}
    said = "Killed from outside, and their work tried again: 1 worker (SIGKILL 1×); runs under way: 4 (campaign.log)."
    assert killed_sentence(result.folder) == said and Text(said) in cautions(result.folder, result.table)


def test_a_worker_that_is_lost_without_a_word_is_noted_with_its_runs(campaigns: Campaigns, out: Path) -> None:
    first_two = iter([True, True])
    result = campaigns.run("plain", lambda: Losing(lambda task: next(first_two, False)), out)
    assert content(out) == campaigns.reference
    assert "2 workers (its Dask worker was lost 2×); runs under way: 0, 1, " in str(killed_sentence(result.folder))
    assert killed_sentence(opened_campaign(campaigns.folder / "reference")) is None


@pytest.mark.parametrize(("name", "said"), [
    ("deaf", "the run ended its worker process (it closed the pipe)"),
    ("leaving", "ModsimError: the plug-in 'mortal' of fragile 1.0 failed: SystemExit: 5 (fragile.py, line"),
])  # fmt: skip
def test_a_run_that_closes_the_pipe_or_calls_sys_exit_has_crashed(campaigns, doomed, out, monkeypatch, name, said):
    monkeypatch.setattr("modsim3d.campaign.workers._END_S", 0.3)
    (error,) = campaigns.run(name, lambda: ProcessPool(1), out).table["error"].to_pylist()
    assert error.startswith(said)


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
