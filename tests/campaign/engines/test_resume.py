"""Whatever interrupted a campaign or damaged its files: the same command again ends with the same bytes."""

import errno
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest

from modsim3d.campaign import done_rows, folder, running
from modsim3d.campaign.folder import CampaignFolder
from modsim3d.campaign.work import task
from modsim3d.campaign.work.row import crashed_row
from modsim3d.campaign.work.task import TaskReport, Worker
from modsim3d.core.errors import OutputError
from tests.campaign.campaigns import interrupt
from tests.campaign.engines.campaigns import Campaigns, content
from tests.campaign.one_process import ThisProcess

STEPS = [(module, name) for module in (done_rows, folder) for name in ("make_folder", "sync_file", "sync_folder")]
STEPS += [(folder.shutil, "rmtree"), (done_rows, "write_files"), (running, "remove_done"), (running, "write_verdicts")]
"""What the end of a campaign does, and where it may be interrupted."""


@pytest.fixture(scope="module")
def made(campaigns: Campaigns, tmp_path_factory: pytest.TempPathFactory) -> CampaignFolder:
    """A campaign that is interrupted before its end."""
    here, tasks = campaigns.planned(tmp_path_factory.mktemp("made") / "out")
    with closing(Worker()) as worker:
        for each in tasks:
            worker.do(each)
    return here


@pytest.fixture
def half(campaigns: Campaigns, made: CampaignFolder, tmp_path: Path) -> Iterator[Path]:
    """A campaign two of whose tasks are done; in the end it must be as if nothing had happened."""
    shutil.copytree(made.path, tmp_path / "out")
    for each in sorted((tmp_path / "out" / "done").iterdir())[2:]:
        each.unlink()
    yield tmp_path / "out"
    campaigns.check_end(tmp_path / "out")


def test_a_damaged_file_is_made_again_and_what_is_half_written_or_of_another_plan_is_nothing(half: Path) -> None:
    damaged = min((half / "done").iterdir())
    whole = damaged.read_bytes()
    flips = (*range(0, len(whole), 61), len(whole) - 1)  # in values, descriptions of columns, and the checksum
    flipped = (whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :] for place in flips)
    for each in (*flipped, whole[:-100]):
        damaged.write_bytes(each)
        assert task.stored_report(damaged) is None
    (half / "done" / ".000000008_0.rows.0").write_bytes(b"PAR1")
    (half / ".results.0" / "scene=simulation_1").mkdir(parents=True)
    rows = task.table_of([crashed_row(number, "of another plan") for number in (4, 1_000)])
    task.store(half / "done" / "000000004_0123456789abcdef.rows", rows, TaskReport(2, 2, 1.0, 1.0, "", 0))


def test_a_full_disk_is_told_and_nothing_that_is_done_is_lost(half, campaigns, monkeypatch):
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    before = sorted((half / "done").iterdir())
    with monkeypatch.context() as patch, pytest.raises(OutputError, match="No space left on device"):
        patch.setattr(task.os, "fsync", full)
        campaigns.run("plain", ThisProcess, half)
    assert sorted((half / "done").iterdir()) == before


def test_a_crash_between_any_two_steps_of_the_end(campaigns, made, out, monkeypatch):
    campaign, steps = campaigns.checked(), 0
    while True:
        out, left = shutil.copytree(made.path, out.with_name(f"out{steps}")), steps

        def step(function: Callable[..., object], *given: object, **options: object) -> object:
            nonlocal left
            left -= 1
            if left < 0:
                raise KeyboardInterrupt
            return function(*given, **options)

        with monkeypatch.context() as patch:
            for module, name in STEPS:
                patch.setattr(module, name, partial(step, getattr(module, name)))
            try:
                running.run_plan(campaign, out, ThisProcess)
            except KeyboardInterrupt:
                steps += 1
            else:
                break
        running.run_plan(campaign, out, ThisProcess)
        assert content(out) == campaigns.reference
    assert steps > len(STEPS)


def test_results_beside_rows_that_were_not_removed_and_two_processes_that_end_at_once(half, campaigns, monkeypatch):
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(running, "remove_done", interrupt)
        campaigns.run("plain", ThisProcess, half)
    assert (half / "results").is_dir() and (half / "done").is_dir()
    campaigns.run("plain", ThisProcess, half)
    here, _ = campaigns.planned(half)
    done_rows.write_results(here, done_rows.results_table(here), [])  # by another one, where there are no locks


def test_a_worker_that_comes_late_does_not_bring_the_folder_back(campaigns: Campaigns, out: Path) -> None:
    _, tasks = campaigns.planned(out)
    campaigns.run("plain", ThisProcess, out)
    with pytest.raises(OutputError, match="cannot be written"):
        Worker().do(tasks[0])
    assert content(out) == campaigns.reference
