"""Processes on this machine: they die, are killed, and end with the main process."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from modsim3d.campaign.engines.interface import ThisProcess
from modsim3d.campaign.engines.pool import ProcessPool
from tests.campaign.engines.campaigns import Campaigns, alive, content, numbers_in, waited_for


def test_a_process_that_is_killed_or_ends_itself_in_the_middle_of_a_task_is_replaced(
    campaigns: Campaigns, tmp_path: Path
) -> None:
    here, tasks = campaigns.planned(tmp_path / "out")
    pool = ProcessPool(2)
    with campaigns.holding() as hold:
        for task in tasks[:2]:
            pool.submit(task)
        waited_for(lambda: len(numbers_in(hold)) == 2)
        killed, other = numbers_in(hold)
        os.kill(killed, signal.SIGKILL)
        died, report = pool.next()
        assert died in tasks
        assert report is None
        assert alive(other)
        pool.submit(died)  # nothing waits for the other process
        waited_for(lambda: len(numbers_in(hold)) == 3)
    assert {pool.next()[0].path, pool.next()[0].path} == {task.path for task in tasks[:2]} == set(here.done.iterdir())
    pool.submit(campaigns.fatal_task(tmp_path / "fatal"))
    assert pool.next()[1] is None
    pool.close()
    campaigns.run("plain", ThisProcess, tmp_path / "out")
    assert content(tmp_path / "out") == campaigns.reference


@pytest.mark.parametrize(("number", "count"), [(signal.SIGKILL, 2), (signal.SIGINT, 1)])
def test_all_processes_end_with_the_main_one_and_the_same_command_goes_on(
    campaigns: Campaigns, tmp_path: Path, number: signal.Signals, count: int
) -> None:
    out = tmp_path / "out"
    with campaigns.holding() as hold, campaigns.coordinator(str(count), out) as coordinator:
        waited_for(lambda: len(numbers_in(hold)) == count)
        workers = numbers_in(hold)
        coordinator.send_signal(number)
        assert coordinator.wait(30) in (-number, 1)
        waited_for(lambda: not any(alive(worker) for worker in workers))
    campaigns.run("plain", ThisProcess, out)
    assert content(out) == campaigns.reference
