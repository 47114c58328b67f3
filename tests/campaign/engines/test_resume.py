"""Whatever interrupts a campaign, damages its files or ends its processes: the same command ends with its bytes."""

import errno
import os
import platform
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path

import pyarrow as pa
import pytest

from modsim3d.campaign import done_rows, folder, running, serving
from modsim3d.campaign.done_rows import DoneRows
from modsim3d.campaign.folder import CampaignFolder, killed_sentence, opened_campaign, planned
from modsim3d.campaign.plan import Plan
from modsim3d.campaign.report.campaign_page import cautions
from modsim3d.campaign.serving import check_worker
from modsim3d.campaign.verdicts.verdict import Verdict
from modsim3d.campaign.work import task
from modsim3d.campaign.work.row import crashed_row
from modsim3d.campaign.work.task import TaskReport, Worker
from modsim3d.campaign.workers import CampaignWorker, Death, ProcessPool
from modsim3d.core.document import Text
from modsim3d.core.errors import ModsimError, OutputError
from tests.campaign.campaigns import Losing, Shuffled, interrupt, no_engine
from tests.campaign.engines.campaigns import MORTAL, Campaigns, Content, alive, content
from tests.campaign.one_process import ThisProcess
from tests.run_folders import wait_for

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


def test_shards_make_each_run_once_and_the_command_without_them_gathers(campaigns: Campaigns, out: Path) -> None:
    made = set[Path]()
    for part, engine in ((3, ThisProcess), (1, ThisProcess), (2, ThisProcess), (1, no_engine)):
        before = {path: path.read_bytes() for path in made}
        campaigns.run_part("plain", engine, out, part, 3)
        made = set((out / "done").iterdir())
        assert {path: path.read_bytes() for path in before} == before
    assert not (out / "results").exists()
    campaigns.check_end(out, no_engine)
    campaigns.run_part("plain", no_engine, out, 2, 3)  # a job that starts when all is over
    assert content(out) == campaigns.reference


def test_shards_are_even_where_all_runs_share_one_truth(campaigns: Campaigns, out: Path) -> None:
    for part in (1, 2, 3, 4):
        campaigns.run_part("still", ThisProcess, out, part, 4)
        assert len(DoneRows(planned(campaigns.checked("still"), out)).read().numbers()) == 2 * part


def test_what_depends_on_other_runs_is_refused(campaigns: Campaigns, out: Path) -> None:
    with pytest.raises(ModsimError, match="stop: sequential looks at the runs of all parts"):
        campaigns.run_part("sequential", no_engine, out, 1, 2)
    with pytest.raises(ModsimError, match=r"shard=\(3, 2\): there are the parts 1/2 to 2/2"):
        campaigns.run_part("plain", no_engine, out, 3, 2)
    assert not (out).exists()


def test_shards_that_start_at_once_agree_on_the_plan(campaigns: Campaigns, out: Path) -> None:
    campaign = campaigns.checked()
    with ThreadPoolExecutor(16) as threads:
        found = list(threads.map(lambda _: planned(campaign, out), range(64)))
    assert len({each.work.plan_sha256 for each in found}) == 1
    assert sorted(path.name for path in (out).iterdir()) == ["campaign.yaml", "done", "plan.json"]
    with pytest.raises(OutputError, match="another plan"):
        planned(campaigns.checked("fatal"), out)


@pytest.mark.parametrize("package", ["fragile", "numpy"])
def test_a_worker_with_other_versions_is_refused(campaigns, out, monkeypatch, package):
    here, _ = campaigns.planned(out)
    check_worker(here.work)
    here_is, other = serving.version(package), {**serving.versions(), "numpy": "9.9"}
    if package == "numpy":
        monkeypatch.setattr(serving, "versions", lambda: other)
    else:
        monkeypatch.setattr(serving, "version", lambda name: "9.9")
    with pytest.raises(ModsimError, match=f"on {platform.node()} has .*{package} 9.9 instead of {here_is}"):
        check_worker(here.work)


def test_a_worker_that_finds_another_campaign_or_a_damaged_plan_is_refused(campaigns: Campaigns, out: Path) -> None:
    here, _ = campaigns.planned(out)
    with pytest.raises(ModsimError, match="finds another campaign at"):
        check_worker(replace(here.work, plan_sha256="0" * 64))
    (here.path / "plan.json").write_bytes(b"{}")
    with pytest.raises(ModsimError, match=r"plan\.json is damaged"):
        check_worker(here.work)


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
        assert coordinator.wait(120) in (-signal.SIGINT, 1)
    campaigns.check_end(out)


@pytest.mark.parametrize(("number", "count", "threads"), [(signal.SIGKILL, 2, 1), (signal.SIGINT, 1, 2)])
def test_all_processes_end_with_the_main_one_and_the_same_command_goes_on(campaigns, out, number, count, threads):
    """They are forks of it or, where it has threads, new interpreters."""
    with campaigns.holding() as waiting, campaigns.coordinator(str(count), out, threads=threads) as coordinator:
        workers = waiting(count)
        coordinator.send_signal(number)
        assert coordinator.wait(120) in (-number, 1)
        wait_for(lambda: not any(map(alive, workers)))
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
    monkeypatch.setattr(running, "judge", decided_by_the_second_seed)


@pytest.fixture(scope="module")
def one_by_one(campaigns: Campaigns) -> Content:
    """What comes of a campaign that is decided by two of four seeds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(running, "judge", decided_by_the_second_seed)
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
    for each in (tasks[3], tasks[1], tasks[0]):  # the third is missing
        engine.submit(each)
        engine.next()
    engine.close()
    assert len(list(here.done.iterdir())) == 3
    campaigns.run("sequential", ThisProcess, out)
    assert content(out) == one_by_one


def test_a_run_that_always_ends_its_process_is_reported_and_the_rest_goes_on(campaigns: Campaigns, out: Path) -> None:
    deadly = partial(Losing, lambda task: any(run.tracker.label == "fatal" for run in task.runs))
    table = campaigns.run("fatal", deadly, out).table
    assert table["status"].to_pylist() == ["done", "crashed"] and table["error"].to_pylist() == [None, running.DIED]
