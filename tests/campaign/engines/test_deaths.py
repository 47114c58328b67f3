"""Runs that end their worker: by their own doing they have crashed, from outside they are tried again and noted."""

from pathlib import Path

import pytest

from modsim3d.campaign.folder import killed_sentence, opened_campaign
from modsim3d.campaign.report.campaign_page import cautions
from modsim3d.campaign.workers import ProcessPool
from modsim3d.core.document import Text
from tests.campaign.campaigns import Losing, no_engine
from tests.campaign.engines.campaigns import MORTAL, Campaigns, content

CRASHES = {
    "exit": "the run ended its worker process (exit status 3)",
    "nothing": "the run ended its worker process (exit status 0)",
    "segfault": "the run ended its worker process (SIGSEGV)",
    "term": "the run ended its worker process (SIGTERM)",
    "interrupt": "the run ended its worker process (exit status 130)",
}


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
