"""Runs that end their worker: by their own doing they have crashed, from outside they are tried again and noted."""

from __future__ import annotations

from pathlib import Path

import pytest

from modsim3d.campaign.folder import killed_sentence
from modsim3d.campaign.report.campaign_page import cautions
from modsim3d.campaign.work.task import Task, TaskReport
from modsim3d.campaign.workers import LOST, Death, ProcessPool, ThisProcess
from modsim3d.core.document import Text
from tests.campaign.engines.campaigns import MORTAL, Campaigns, content

CRASHES = {
    "exit": "the run ended its worker process (exit status 3)",
    "nothing": "the run ended its worker process (exit status 0)",
    "segfault": "the run ended its worker process (SIGSEGV)",
    "term": "the run ended its worker process (SIGTERM)",
    "interrupt": "the run ended its worker process (exit status 130)",
}


def test_a_run_that_ends_its_process_once_has_crashed_and_one_that_is_killed_is_tried_again(
    campaigns: Campaigns, doomed: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    result = campaigns.run("mortal", lambda: ProcessPool(1), tmp_path / "out")
    assert result is not None
    rows = {row["tracker"]: row for row in result.table.to_pylist()}
    assert {path.name for path in doomed.iterdir()} == {*MORTAL}
    said = {name: row["error"] for name, row in rows.items() if row["status"] == "crashed"}
    assert said == CRASHES
    assert {name for name, row in rows.items() if row["status"] == "done"} == {"reference", "kill"}
    assert "Traceback" not in capfd.readouterr().err
    assert killed_sentence(result.folder) == (
        "Killed from outside, and their work tried again: 1 worker (SIGKILL 1×); runs under way: 4 (campaign.log)."
    )
    assert Text(killed_sentence(result.folder)) in cautions(result.folder, result.table)
    again = campaigns.run("mortal", ThisProcess, tmp_path / "out")
    assert again is not None and again.table.equals(result.table)


def test_a_kill_changes_no_byte(campaigns: Campaigns, doomed: Path, tmp_path: Path) -> None:
    made = []
    for name in ("killed", "undisturbed"):
        assert campaigns.run("killed", lambda: ProcessPool(1), tmp_path / name) is not None
        made.append(content(tmp_path / name))
    assert made[0] == made[1]
    assert "killed" in (tmp_path / "killed" / "campaign.log").read_text()
    assert "killed" not in (tmp_path / "undisturbed" / "campaign.log").read_text()


class Losing(ThisProcess):
    """Loses the first two tasks with their worker, of which nothing is known."""

    lost = 0

    def next(self) -> tuple[Task, TaskReport | Death]:
        if self.lost < 2:
            self.lost += 1
            return self._waiting.pop(0), LOST
        return super().next()


def test_a_worker_that_is_lost_without_a_word_is_noted_with_its_runs(campaigns: Campaigns, tmp_path: Path) -> None:
    result = campaigns.run("plain", Losing, tmp_path / "out")
    assert result is not None
    assert content(tmp_path / "out") == campaigns.reference
    assert "2 workers (its Dask worker was lost 2×); runs under way: 0, 1, " in str(killed_sentence(result.folder))


def test_a_run_that_closes_the_pipe_and_goes_on_has_crashed(
    campaigns: Campaigns, doomed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("modsim3d.campaign.workers._END_S", 0.3)
    result = campaigns.run("deaf", lambda: ProcessPool(1), tmp_path / "out")
    assert result is not None
    assert result.table["error"].to_pylist() == ["the run ended its worker process (it closed the pipe)"]


def test_a_run_whose_tracker_calls_sys_exit_crashes_as_with_any_error(
    campaigns: Campaigns, doomed: Path, tmp_path: Path
) -> None:
    result = campaigns.run("leaving", lambda: ProcessPool(1), tmp_path / "out")
    assert result is not None
    (error,) = result.table["error"].to_pylist()
    assert error.startswith("ModsimError: the plug-in 'mortal' of fragile 1.0 failed: SystemExit: 5 (fragile.py, line")


def test_a_campaign_without_kills_says_nothing(campaigns: Campaigns, tmp_path: Path) -> None:
    result = campaigns.run("plain", ThisProcess, tmp_path / "out")
    assert result is not None and killed_sentence(result.folder) is None
