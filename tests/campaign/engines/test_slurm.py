"""Jobs of Slurm, with the real dask-jobqueue; `sbatch` starts the script of a job in the background."""

import os
import signal
from collections.abc import Iterator
from contextlib import AbstractContextManager, suppress
from pathlib import Path

import pytest

from modsim3d.campaign.dask import SlurmEngine
from modsim3d.core.errors import ModsimError
from tests.campaign.engines.campaigns import Campaigns, alive, waited_for

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
    waited_for(lambda: not alive(job))


def test_a_configuration_without_cores_is_told() -> None:
    nothing = dict.fromkeys(["jobqueue.slurm.cores", "jobqueue.slurm.memory"])
    with configured(nothing), pytest.raises(ModsimError, match=r"set jobqueue\.slurm\.cores"):
        SlurmEngine(2)
