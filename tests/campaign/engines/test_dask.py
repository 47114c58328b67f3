"""A real scheduler and workers that are killed, come late or lose their scheduler."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from modsim3d.campaign.dask import DaskEngine, _raise_unless_killed
from modsim3d.campaign.folder import killed_sentence
from modsim3d.campaign.work.task import TaskReport
from modsim3d.campaign.workers import Death
from modsim3d.core.errors import ModsimError
from tests.campaign.engines.campaigns import Campaigns, alive, waited_for
from tests.campaign.engines.cluster import Cluster, cluster, free_port


@pytest.fixture(autouse=True)
def quick_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was lost is looked for often, so that no test waits for the next look."""
    monkeypatch.setattr("modsim3d.campaign.dask.LOOK_S", 0.1)


@pytest.fixture(scope="module")
def shared(campaigns: Campaigns, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A scheduler with one worker, for tests that leave it alive."""
    with cluster(tmp_path_factory.mktemp("cluster"), 1) as made:
        yield made


def test_a_client_that_was_killed_goes_on_to_the_same_bytes(campaigns: Campaigns, shared: Cluster, out: Path) -> None:
    with campaigns.holding() as waiting, campaigns.coordinator(shared.address, out) as client:
        waiting()
        client.kill()
    campaigns.check_end(out, lambda: DaskEngine(shared.address))


def test_a_run_ends_its_process_the_worker_stays_and_what_is_not_wanted_is_ended_at_once(campaigns, shared, out):
    _, tasks = campaigns.planned(out)
    _, (both,) = campaigns.planned(out.with_name("fatal"), "fatal")
    engine, fatal = DaskEngine(shared.address), replace(both, runs=both.runs[1:])
    engine.submit(fatal)
    assert engine.next() == (fatal, Death.of(1, 9))
    with campaigns.holding() as waiting:
        for task in tasks:
            engine.submit(task)
        (worker,) = waiting()  # a single one: the second thread waits
        engine.close()
        waited_for(lambda: not alive(worker))


def test_a_worker_without_the_folder_says_so(campaigns: Campaigns, shared: Cluster, out: Path) -> None:
    here, tasks = campaigns.planned(out)
    (here.path / "plan.json").rename(out.with_name("elsewhere"))
    engine = DaskEngine(shared.address)
    engine.submit(tasks[0])
    with pytest.raises(ModsimError, match=r"the worker on .* cannot read .*/plan.json \(No such file or directory\)"):
        engine.next()
    engine.close()


def test_a_run_ending_its_process_has_crashed(campaigns: Campaigns, doomed: Path, shared: Cluster, out: Path) -> None:
    result = campaigns.run("killed", lambda: DaskEngine(shared.address), out)
    assert result.table["error"].to_pylist() == [None, "the run ended its worker process (exit status 3)", None]
    assert "1 worker (SIGKILL 1×); runs under way: 2 (" in str(killed_sentence(result.folder))


def test_no_scheduler_is_told_and_a_task_whose_workers_were_lost_too_often_is_tried_again(monkeypatch) -> None:
    from distributed import KilledWorker

    monkeypatch.setattr("modsim3d.campaign.dask.CONNECT_S", 0.2)
    with pytest.raises(ModsimError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1"):
        DaskEngine(f"tcp://127.0.0.1:{free_port()}")
    _raise_unless_killed(KilledWorker("task", None, 3))
    with pytest.raises(ModsimError, match="a Dask worker cannot do a task: MemoryError: too large"):
        _raise_unless_killed(MemoryError("too large"))


def test_workers_and_the_scheduler_are_lost_and_others_come(campaigns: Campaigns, shared: Cluster, out: Path) -> None:
    """It leaves nothing of the cluster that the tests above share."""
    here, tasks = campaigns.planned(out)
    with closing(shared) as made:
        scheduler, first = made._processes
        engine = DaskEngine(made.address)
        engine.submit(tasks[0])
        waited_for(tasks[0].path.exists)
        first.kill()  # after it has finished, before anybody has asked for the result
        with campaigns.holding() as waiting:
            second = made.start_worker()  # it was not there when the task was handed in
            engine.submit(tasks[1])
            (killed,) = waiting()
            second.kill()  # in the middle; its process ends with it
            waited_for(lambda: not alive(killed))
            scheduler.kill()
            scheduler.wait()
            made.start_scheduler()
            made.start_worker()
        done = [engine.next() for _ in range(2)]
        assert {task.path for task, _ in done} == {task.path for task in tasks[:2]} == set(here.done.iterdir())
        assert all(isinstance(report, TaskReport) and report.crashed == 0 for _, report in done)
        engine.close()
    campaigns.check_end(out)
