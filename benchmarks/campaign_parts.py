"""What the parts of a campaign cost: the layers of a run, an empty Dask task, and the process that hands tasks out.

The last one is measured in a process of its own: `python -m benchmarks.campaign_parts FILE FOLDER` prints it as JSON.
"""

from __future__ import annotations

import json
import pickle
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from benchmarks.processes import ROOT, environment
from modsim3d.campaign.done_rows import plan_columns, results_table
from modsim3d.campaign.folder import opened_campaign
from modsim3d.campaign.keys import read_campaign
from modsim3d.campaign.plan import PlannedRun
from modsim3d.campaign.running import TASK_S, run_plan
from modsim3d.campaign.work.checking import checked
from modsim3d.campaign.work.layers import LayeredRun, TruthLayer
from modsim3d.campaign.work.row import row_of
from modsim3d.campaign.work.scenes import Scenes
from modsim3d.campaign.work.task import Task, TaskReport, Work, store
from modsim3d.runs.files.block_files import detected_tables
from modsim3d.runs.pipeline import open_renderer, step_ranges, truth_block
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracking.trackers.registry import named_tracker
from modsim3d.tracking.trackers.running import run_tracker

LAYERS = ("scene", "truth", "detections", "tracks", "scores")
TASKS_OF_CORE = 40
"""Tasks that each core has in a long campaign; with few they would be cut smaller, so that all cores end together."""
PATIENCE_S = 60.0


@dataclass(frozen=True)
class LayerCost:
    """Processor time of a layer, each time that it is made.

    Attributes:
        median_s: The median.
        made: How often it is made for all the runs that were timed.
    """

    median_s: float
    made: int


def layer_costs(file: Path, seeds: int) -> tuple[dict[str, LayerCost], int]:
    """The layers of the runs of the first traffic seeds, made in this process as a worker makes them; number of runs.

    A traffic seed before them, which opens what is opened once, is not timed.
    """
    campaign = checked(read_campaign(file))
    plan, times = campaign.plan, {name: list[float]() for name in LAYERS}
    scenes, rules = Scenes(plan.keys.steps, campaign.file.base), plan.keys.score
    runs = plan.runs(range((seeds + 1) * plan.runs_by_seed))

    @contextmanager
    def timed(name: str, run: PlannedRun) -> Iterator[None]:
        started = time.process_time()
        yield
        if run.seed_index:
            times[name].append(time.process_time() - started)

    def truth_of(run: PlannedRun) -> list[Any]:
        return [run.seed_index, sorted(run.condition.of_truth().items())]

    with ExitStack() as opened:
        renderer: Any = None
        for _, same_truth in groupby(runs, truth_of):
            truth = None
            for _, same_detections in groupby(same_truth, lambda run: (run.condition_index, run.detector_seed)):
                several = list(same_detections)
                run = several[0]
                with timed("scene", run):
                    scene = scenes.of(run.condition, run.traffic_seed, run.detector_seed)
                if renderer is None:
                    renderer = opened.enter_context(open_renderer(scene))
                if truth is None:
                    with timed("truth", run):
                        blocks = [(truth_block(scene, *ends, renderer), *ends) for ends in step_ranges(scene)]
                        truth = TruthLayer(scene, made=blocks)
                with timed("detections", run):
                    rows = RunRows.of_tables(scene, scene.steps, detected_tables(scene, truth.blocks))
                for each in several:
                    with timed("tracks", each):
                        tracker = named_tracker(each.tracker.tracker, each.tracker.settings, scene.name)
                        tracks = run_tracker(tracker, rows).tracks
                    with timed("scores", each):
                        row_of(each.number, LayeredRun(rows, tracks, "", "", ""), rules)
    costs = {name: LayerCost(statistics.median(found), len(found)) for name, found in times.items()}
    return costs, seeds * plan.runs_by_seed


@dataclass(frozen=True)
class TaskCost:
    """What an empty task costs that carries as much as a real one.

    Attributes:
        wall_s: Time by the clock, with tasks always waiting.
        scheduler_s: Processor time of the scheduler.
        client_s: Processor time of the process that hands it in.
        bytes: Size of what it carries.
    """

    wall_s: float
    scheduler_s: float
    client_s: float
    bytes: int


def task_cost(file: Path, runs: int, tasks: int, workers: int = 2) -> TaskCost:
    """Empty tasks on a Dask scheduler and workers in processes of their own, over the loopback.

    Args:
        file: A campaign.
        runs: Number of runs of a task.
        tasks: Number of tasks.
        workers: Number of worker processes.
    """
    import psutil
    from distributed import Client

    campaign = checked(read_campaign(file))
    work = Work(
        campaign.file.keys, str(campaign.file.base), "/campaign", campaign.sha256, files=campaign.content["files"]
    )
    carried = pickle.dumps(Task(work, tuple(campaign.plan.runs(range(min(runs, len(campaign.plan)))))))
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="modsim3d-dask-"))
        port = _free_port()
        address = f"tcp://127.0.0.1:{port}"
        where = ("--host", "127.0.0.1", "--no-dashboard")
        scheduler = stack.enter_context(_process(folder, "scheduler", "--port", str(port), *where))
        _wait_for(port)
        for _ in range(workers):
            stack.enter_context(_process(folder, "worker", address, "--nthreads", "1", "--no-nanny", *where))
        client = stack.enter_context(Client(address, set_as_default=False))
        client.wait_for_workers(workers)
        watched = psutil.Process(scheduler.pid)

        def made(count: int) -> None:
            client.gather([client.submit(len, carried, key=f"{count}-{place}", pure=False) for place in range(count)])

        made(tasks // 10)
        before, own, started = watched.cpu_times(), time.process_time(), time.perf_counter()
        made(tasks)
        seconds, own = time.perf_counter() - started, time.process_time() - own
        after = watched.cpu_times()
    spent = after.user + after.system - before.user - before.system
    return TaskCost(seconds / tasks, spent / tasks, own / tasks, len(carried))


@contextmanager
def _process(folder: str, name: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    line = [sys.executable, "-m", f"distributed.cli.dask_{name}", *arguments]
    settings = {**environment(), "DASK_DISTRIBUTED__LOGGING__DISTRIBUTED": "critical"}
    quiet = subprocess.DEVNULL
    process = subprocess.Popen(line, cwd=folder, env=settings, stdout=quiet, stderr=quiet)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def _free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port: int = found.getsockname()[1]
        return port


def _wait_for(port: int) -> None:
    ends = time.monotonic() + PATIENCE_S
    while time.monotonic() < ends:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port)):
            return
        time.sleep(0.05)
    raise RuntimeError(f"no scheduler answers on port {port} after {PATIENCE_S:g} s")


class Stored:
    """An engine whose workers have rows at once: those of a smaller campaign, again and again with other numbers."""

    def __init__(self, rows: pa.Table, run_s: float, width: int) -> None:
        """Take the rows, without what the plan says of them, and the time that a run is said to take."""
        self._rows, self._run_s, self.width = rows, run_s, width
        self._rng = np.random.default_rng(1)
        self._waiting = deque[Task]()
        self.tasks = self.bytes = 0
        self.own_s = 0.0

    def submit(self, task: Task) -> None:
        self._waiting.append(task)

    def next(self) -> tuple[Task, TaskReport]:
        started, task = time.process_time(), self._waiting.popleft()
        numbers = [run.number for run in task.runs]
        rows = self._other(self._rows.take([number % len(self._rows) for number in numbers]))
        report = TaskReport(len(numbers), 0, self._run_s * len(numbers), 0.0, "", 0)
        store(task.path, rows.set_column(0, "run", pa.array(numbers, pa.int64())), report)
        self.tasks, self.bytes = self.tasks + 1, self.bytes + task.path.stat().st_size
        self.own_s += time.process_time() - started
        return task, report

    def close(self) -> None:
        pass

    def _other(self, rows: pa.Table) -> pa.Table:
        """Rows with numbers and checksums of their own, which compress no better than those of runs."""
        for place, field in enumerate(rows.schema):
            if pa.types.is_floating(field.type):
                factor = pa.array(1 + 1e-3 * self._rng.random(len(rows)))
                rows = rows.set_column(place, field, pc.multiply(rows[place], factor))
            elif field.name.endswith("_key"):
                rows = rows.set_column(place, field, pa.array([self._rng.bytes(8).hex() for _ in range(len(rows))]))
        return rows


@dataclass(frozen=True)
class Coordinated:
    """What the process that hands out a campaign costs, without its workers.

    Attributes:
        runs: Number of runs.
        tasks: Number of tasks.
        done_bytes: Bytes of the files of all tasks.
        handing_s: Processor time from the plan to the last row.
        gathering_s: Processor time of the data set and the verdicts.
        peak_bytes: Most memory that it held.
        results_bytes: Bytes of the data set.
        results_files: Number of its files.
    """

    runs: int
    tasks: int
    done_bytes: int
    handing_s: float
    gathering_s: float
    peak_bytes: int
    results_bytes: int
    results_files: int


def coordinated(file: Path, like: Path, run_s: float) -> Coordinated:
    """Hand out a campaign and gather it in a process of its own, with the rows of another one.

    Args:
        file: The campaign.
        like: The folder of a smaller campaign with the same conditions and trackers.
        run_s: Time that a run is said to take.
    """
    command = [sys.executable, "-m", "benchmarks.campaign_parts", str(file), str(like), str(run_s)]
    done = subprocess.run(command, env=environment(), cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    return Coordinated(**json.loads(done.stdout))


def _coordinate(file: Path, like: Path, run_s: float) -> dict[str, int | float]:
    before = opened_campaign(like)
    rows = results_table(before)
    campaign, handed = checked(read_campaign(file)), [0.0]
    width = max(1, len(campaign.plan) // (TASKS_OF_CORE * runs_of_task(run_s)))
    engine = Stored(rows.drop_columns(plan_columns(before.plan)).combine_chunks(), run_s, width)
    with tempfile.TemporaryDirectory(prefix="modsim3d-coordinator-") as folder:
        started = time.process_time()

        def note(progress: object) -> None:
            handed[0] = time.process_time() - started - engine.own_s

        result = run_plan(campaign, Path(folder) / "campaign", lambda: engine, progress=note)
        seconds = time.process_time() - started - engine.own_s
        assert result is not None
        files = [path for path in result.folder.results.rglob("*") if path.is_file()]
        sizes = [path.stat().st_size for path in files]
    return {
        "runs": len(result.table),
        "tasks": engine.tasks,
        "done_bytes": engine.bytes,
        "handing_s": handed[0],
        "gathering_s": seconds - handed[0],
        "peak_bytes": _peak_bytes(),
        "results_bytes": sum(sizes),
        "results_files": len(files),
    }


def _peak_bytes() -> int:
    """Most memory of this process; that of `getrusage` may be its parent's."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return 1024 * int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")))


def runs_of_task(run_s: float) -> int:
    """How many runs a task has that takes as long as one should."""
    return max(1, int(TASK_S / run_s))


if __name__ == "__main__":
    print(json.dumps(_coordinate(Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]))))
