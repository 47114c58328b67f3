"""Whatever interrupted a campaign or damaged its files: the same command again ends with the same bytes."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from modsim3d.campaign import running
from modsim3d.campaign.engines.interface import ThisProcess
from modsim3d.campaign.work import task
from modsim3d.campaign.work.task import Worker
from modsim3d.errors import OutputError
from tests.campaign.engines.campaigns import Campaigns, content


@pytest.fixture
def half(campaigns: Campaigns, tmp_path: Path) -> Iterator[Path]:
    """A campaign two of whose tasks are done; in the end it must be as if nothing had happened."""
    _, tasks = campaigns.planned(tmp_path / "out")
    worker = Worker()
    for each in tasks[:2]:
        worker.do(each)
    worker.close()
    yield tmp_path / "out"
    campaigns.run("plain", ThisProcess, tmp_path / "out")
    assert content(tmp_path / "out") == campaigns.reference


def test_a_file_that_was_cut_off_is_made_again(half: Path) -> None:
    damaged = min((half / "done").iterdir())
    damaged.write_bytes(damaged.read_bytes()[:-100])


def test_a_file_with_a_flipped_bit_in_its_middle_is_made_again(half: Path) -> None:
    damaged = min((half / "done").iterdir())
    content = bytearray(damaged.read_bytes())
    content[200] ^= 1
    damaged.write_bytes(content)
    assert task.stored_report(damaged) is None


def test_half_written_files_are_nothing(half: Path) -> None:
    (half / "done" / ".000000008_0.parquet.0").write_bytes(b"PAR1")
    (half / ".results.partial" / "scene=harbour").mkdir(parents=True)
    (half / ".plan.json.0").write_bytes(b"{")
    (half / ".plan.json.0").unlink()


def test_a_full_disk_is_told_and_nothing_that_is_done_is_lost(
    half: Path, campaigns: Campaigns, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    before = sorted((half / "done").iterdir())
    with monkeypatch.context() as patch, pytest.raises(OutputError, match="No space left on device"):
        patch.setattr(task.os, "fsync", full)
        campaigns.run("plain", ThisProcess, half)
    assert sorted((half / "done").iterdir()) == before


def test_results_in_place_beside_rows_that_were_not_removed(
    half: Path, campaigns: Campaigns, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(folder: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(running, "remove_done", killed)
        campaigns.run("plain", ThisProcess, half)
    assert (half / "results").is_dir()
    assert (half / "done").is_dir()


def test_a_worker_that_comes_late_does_not_bring_the_folder_back(campaigns: Campaigns, tmp_path: Path) -> None:
    _, tasks = campaigns.planned(tmp_path / "out")
    campaigns.run("plain", ThisProcess, tmp_path / "out")
    with pytest.raises(OutputError, match="cannot be written"):
        Worker().do(tasks[0])
    assert content(tmp_path / "out") == campaigns.reference
