"""A real scheduler and workers that are killed, come late or lose their scheduler, also as jobs of Slurm."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import pytest

from modsim3d.campaign.dask import DaskEngine, SlurmEngine, _raise_unless_killed
from modsim3d.campaign.folder import killed_sentence
from modsim3d.campaign.work.task import TaskReport
from modsim3d.campaign.workers import Death
from modsim3d.core.errors import ModsimError
from tests.campaign.engines.campaigns import Campaigns, alive
from tests.run_folders import wait_for


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def answers(port: int) -> bool:
    with socket.socket() as tried:
        return tried.connect_ex(("127.0.0.1", port)) == 0


class Cluster:
    """Processes on the loopback; workers have no nanny, so that one that is killed stays away."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._port = folder, free_port()
        self.address = f"tcp://127.0.0.1:{self._port}"
        self._processes: list[subprocess.Popen[bytes]] = []

    def start_scheduler(self) -> subprocess.Popen[bytes]:
        started = self._start("scheduler", "--host", "127.0.0.1", "--port", str(self._port), "--no-dashboard")
        wait_for(lambda: answers(self._port))
        return started

    def start_worker(self) -> subprocess.Popen[bytes]:
        """A worker with two threads, of which only one may make runs."""
        options = "--no-nanny", "--nthreads", "2", "--no-dashboard", "--host", "127.0.0.1"
        return self._start("worker", self.address, *options)

    def close(self) -> None:
        for process in self._processes:
            process.send_signal(signal.SIGKILL)
            process.wait()

    def _start(self, *arguments: str) -> subprocess.Popen[bytes]:
        line = [sys.executable, "-m", "distributed.cli.dask_" + arguments[0], *arguments[1:]]
        environment = {**os.environ, "DASK_DISTRIBUTED__LOGGING__DISTRIBUTED": "critical"}
        quiet = subprocess.DEVNULL
        self._processes.append(subprocess.Popen(line, cwd=self._folder, env=environment, stdout=quiet, stderr=quiet))
        return self._processes[-1]


@contextmanager
def cluster(folder: Path, workers: int) -> Iterator[Cluster]:
    made = Cluster(folder)
    try:
        made.start_scheduler()
        for _ in range(workers):
            made.start_worker()
        yield made
    finally:
        made.close()


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
        wait_for(lambda: not alive(worker))


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
        wait_for(tasks[0].path.exists)
        first.kill()  # after it has finished, before anybody has asked for the result
        with campaigns.holding() as waiting:
            second = made.start_worker()  # it was not there when the task was handed in
            engine.submit(tasks[1])
            (killed,) = waiting()
            second.kill()  # in the middle; its process ends with it
            wait_for(lambda: not alive(killed))
            scheduler.kill()
            scheduler.wait()
            made.start_scheduler()
            made.start_worker()
        done = [engine.next() for _ in range(2)]
        assert {task.path for task, _ in done} == {task.path for task in tasks[:2]} == set(here.done.iterdir())
        assert all(isinstance(report, TaskReport) and report.crashed == 0 for _, report in done)
        engine.close()
    campaigns.check_end(out)


SBATCH = """#!/bin/sh
cp "$1" {folder}/script
setsid sh {folder}/script > {folder}/log 2>&1 &
echo $! >> {folder}/jobs
echo "Submitted batch job $!"
"""
SCANCEL = '#!/bin/sh\nkill -- "-$1"\n'
CONFIGURATION = {
    "jobqueue.slurm.cores": 1, "jobqueue.slurm.memory": "1 GiB", "jobqueue.slurm.interface": "lo",
    "jobqueue.slurm.worker-extra-args": ["--no-nanny"],
}  # fmt: skip


@pytest.fixture
def slurm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder in which `jobs` names the jobs that were started."""
    for name, text in {"sbatch": SBATCH, "scancel": SCANCEL}.items():
        (tmp_path / name).write_text(text.replace("{folder}", str(tmp_path)))
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    yield tmp_path
    for job in jobs_in(tmp_path):
        with suppress(ProcessLookupError):
            os.killpg(job, signal.SIGKILL)


def configured(settings: dict[str, object]) -> AbstractContextManager[object]:
    import dask
    import dask_jobqueue  # noqa: F401 - it brings the defaults of its configuration

    return dask.config.set(settings)


def jobs_in(folder: Path) -> list[int]:
    path = folder / "jobs"
    return [int(line) for line in path.read_text().split()] if path.exists() else []


def test_jobs_make_the_runs_and_end_with_the_campaign(campaigns: Campaigns, slurm: Path) -> None:
    with configured(CONFIGURATION):
        campaigns.check_end(slurm / "out", lambda: SlurmEngine(1))
    assert "#SBATCH --cpus-per-task=1" in (slurm / "script").read_text()
    (job,) = jobs_in(slurm)
    wait_for(lambda: not alive(job))


def test_a_configuration_without_cores_is_told() -> None:
    nothing = dict.fromkeys(["jobqueue.slurm.cores", "jobqueue.slurm.memory"])
    with configured(nothing), pytest.raises(ModsimError, match=r"set jobqueue\.slurm\.cores"):
        SlurmEngine(2)
