"""Processes on this machine: they die, are killed, and end with the main process."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from modsim3d.campaign.workers import CampaignWorker, Death, ProcessPool
from tests.campaign.engines.campaigns import Campaigns, alive, waited_for


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
    """The worker is the first to have it; the main process has it a moment later."""
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
