"""A Dask scheduler and workers on this machine, in processes of their own."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.campaign.engines.campaigns import waited_for


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
        waited_for(lambda: answers(self._port))
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
