"""Runs a campaign: hands tasks to an engine, splits those whose worker died, and stops when all is decided."""

import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.campaign.done_rows import DoneRows, results_table, write_results, write_verdicts
from modsim3d.campaign.folder import (
    LOG,
    RESULTS,
    VERDICTS,
    CampaignFolder,
    check_ended,
    locked_campaign,
    note_kill,
    planned,
    remove_done,
)
from modsim3d.campaign.plan import Plan, layer_of
from modsim3d.campaign.verdicts.verdict import Verdict, judge, repeatable
from modsim3d.campaign.work.checking import CheckedCampaign, ConditionFacts
from modsim3d.campaign.work.task import DONE_FOLDER, Task, TaskReport, store_crashed, stored_report, with_cache
from modsim3d.campaign.workers import Death, Engine
from modsim3d.core.errors import ModsimError, OutputError

TASK_S = 30.0  # long against what a scheduler spends on a task, short against what a lost worker costs
FIRST_RUNS = 8  # most runs of a task while nothing is known of their time
WEIGHT = 0.3  # of the latest task in the mean time of a run


def same_truth(plan: Plan, facts: Sequence[ConditionFacts], numbers: Iterable[int]) -> list[list[int]]:
    """Runs grouped by their truth, in the order of the first run of each group; `numbers` ascend."""
    drawn = any(layer_of(key) == "truth" for key in plan.drawn)
    by_condition = plan.keys.seeds.detector * len(plan.keys.trackers)
    groups: dict[tuple[str, int], list[int]] = {}
    for number in numbers:
        seed, place = divmod(number, plan.runs_by_seed)
        condition = facts[place // by_condition]
        key = condition.truth_sha256, seed if condition.truth_has_seed or drawn else 0
        groups.setdefault(key, []).append(number)
    return list(groups.values())


class Cutter:
    """Gives the numbers of the runs of one task after another; learns from tasks that are done how long a run takes."""

    def __init__(self, width: int) -> None:
        """Take the number of tasks that are worked on at once; it may change."""
        self.width = width
        self._groups: deque[list[int]] = deque()
        self._run_s: float | None = None
        self.waiting = 0

    def add(self, groups: Iterable[list[int]]) -> None:
        """Add runs, grouped by their truth."""
        for group in groups:
            self._groups.append(group)
            self.waiting += len(group)

    def learn(self, report: TaskReport) -> None:
        """Take in what a task took."""
        if report.wall_s > 0:
            latest = report.wall_s / report.runs
            self._run_s = latest if self._run_s is None else (1 - WEIGHT) * self._run_s + WEIGHT * latest

    def next(self) -> list[int]:
        """The runs of the next task."""
        most = FIRST_RUNS if self._run_s is None else max(1, int(TASK_S / self._run_s))
        fair = max(1, self.waiting // (2 * self.width))  # towards the end smaller ones, so that all end together
        taken = self._groups.popleft()
        if len(taken) > most:
            cut = min(most, max(fair, FIRST_RUNS))
            taken, rest = taken[:cut], taken[cut:]
            self._groups.appendleft(rest)
        while self._groups and len(taken) + len(self._groups[0]) <= min(most, fair):
            taken = taken + self._groups.popleft()
        self.waiting -= len(taken)
        return taken

    def seconds(self, runs: int) -> float | None:
        """Time that some runs will take at this rate; None while nothing is known."""
        return None if self._run_s is None else runs * self._run_s / self.width


T = TypeVar("T")

DEATHS = 2  # a run whose worker is killed so often while it does nothing else is given up
AHEAD = 2  # tasks that are handed in for each worker, so that none waits
READ_AGAIN_S = (0.1, 0.5, 2.0, 10.0, 30.0)  # waits for a file of another machine, up to a minute on a network
DIED = "its worker process was killed, or ran out of memory"


@dataclass(frozen=True)
class Progress:
    """Progress of a campaign."""

    total: int  # runs
    done: int  # of these, crashed ones too
    running: int  # runs that are handed in
    crashed: int
    left_s: float | None  # None while nothing is known
    verdicts: tuple[Verdict, ...] = ()  # as of the last look, of a campaign that stops by them only


@dataclass(frozen=True, eq=False)
class CampaignResult:
    """A campaign that ended."""

    folder: CampaignFolder
    table: pa.Table
    verdicts: tuple[Verdict, ...]


def run_plan(
    campaign: CheckedCampaign,
    folder: Path,
    engine: Callable[[], Engine],
    *,
    shard: tuple[int, int] | None = None,
    cache: Path | None = None,
    progress: Callable[[Progress], None] = lambda progress: None,
) -> CampaignResult | None:
    """Run a campaign, or go on with it. `shard` is the number of a part, from 1, and that of all parts: only its runs
    are made, no results are written, and None is returned. `engine` opens an engine, and is not called if there is
    nothing to do; `progress` is called after each task. Layers are kept in `cache`, by default in the campaign's
    folder. Raises ModsimError if the folder holds another plan or cannot be written, or the engine fails."""
    _check_cache(cache, folder)
    if shard is not None:
        _check_shard(campaign, *shard)
        here = planned(campaign, folder)
        if not here.finished:
            _Campaign(campaign, here, shard, cache, progress).make(engine)
        return None
    with locked_campaign(folder):
        here = planned(campaign, folder)
        if not here.finished:
            started = time.perf_counter()
            running = _Campaign(campaign, here, None, cache, progress)
            rows = running.rows(running.make(engine))
            write_results(here, rows, judge(here.plan, rows))
            running.log(time.perf_counter() - started)
        check_ended(folder, later=(VERDICTS,))
        remove_done(here)
        table = results_table(here)
        verdicts = judge(here.plan, table)
        write_verdicts(here, verdicts)
    return CampaignResult(here, table, verdicts)


class Dispatch:
    """Tasks in the hands of an engine; `running` is the number of runs that are handed in."""

    def __init__(self, folder: CampaignFolder, engine: Engine) -> None:
        """Hand in nothing yet."""
        self._folder, self._engine = folder, engine
        self._deaths = Counter[int]()
        self.running = 0

    def done(self, following: Callable[[], Task | None]) -> Iterator[tuple[Task, TaskReport]]:
        """Tasks as they are done, each with its report, until there are no more; `following` gives the next task, None
        if there is none now. Raises OutputError if a file cannot be written."""
        split, tasks = list[Task](), 0
        while True:
            while tasks < AHEAD * self._engine.width and (task := split.pop() if split else following()) is not None:
                self._engine.submit(task)
                tasks, self.running = tasks + 1, self.running + len(task.runs)
            if not tasks:
                return
            task, report = self._engine.next()
            tasks, self.running = tasks - 1, self.running - len(task.runs)
            if isinstance(report, Death):
                stored = stored_report(task.path)
                alone, others = (task, []) if stored is not None else _split(task, report)
                split += others
                if stored is None and (error := self._error(task, report)) is not None:
                    store_crashed(alone, error)
                    stored = TaskReport(1, 1, 0.0, 0.0, "", 0)
                if stored is None:
                    split += [alone] if alone.runs else []
                    continue
                task, report = alone, stored
            yield task, report

    def _error(self, task: Task, death: Death) -> str | None:
        """Error of the run whose worker died, None if it is to be tried again; a killed worker is logged."""
        if death.error is not None:
            return death.error
        note_kill(self._folder, death, [run.number for run in task.runs])
        if len(task.runs) > 1:
            return None
        self._deaths[task.runs[0].number] += 1
        return DIED if self._deaths[task.runs[0].number] >= DEATHS else None


def _split(task: Task, death: Death) -> tuple[Task, list[Task]]:
    """The run that a dead worker had begun by itself, perhaps none, and the others of its task together."""
    runs, numbers = task.runs, [run.number for run in task.runs]
    begin = len(runs) // 2 if death.run is None else numbers.index(death.run)
    end = begin + (death.run is not None or len(runs) == 1)
    others = [replace(task, runs=part) for part in (runs[end:], runs[:begin]) if part]
    return replace(task, runs=runs[begin:end]), others


def read_back(task: Task, read: Callable[[], T | None]) -> T:
    """Result that `read` reads from the file of a task that is done. It gives None while the file is not there: that of
    another machine may take a while to be seen on this one. Raises OutputError if it cannot be read."""
    for wait_s in (0.0, *READ_AGAIN_S):
        time.sleep(wait_s)
        if (content := read()) is not None:
            return content
    raise OutputError(
        f"{task.path} was written, and cannot be read here: all workers need the folder of the campaign itself"
    )


def write_log(folder: CampaignFolder, line: str) -> None:
    """Write into the log of a campaign that it ended, and what it cost; times and hosts are named nowhere else."""
    with (folder.path / LOG).open("a", encoding="utf-8") as log:
        log.write(f"finished {time.strftime('%Y-%m-%dT%H:%M:%S%z')}\n{line}\n")


def _check_cache(cache: Path | None, folder: Path) -> None:
    """Check that layers are kept apart from the rows and results of the campaign; OutputError if not."""
    for name in (DONE_FOLDER, RESULTS):
        if cache is not None and (folder / name).resolve() in (cache.resolve(), *cache.resolve().parents):
            raise OutputError(
                f"--cache {cache}: {folder / name} is for the rows of the campaign: choose another folder"
            )


def _check_shard(campaign: CheckedCampaign, part: int, parts: int) -> None:
    """Refuse, with ModsimError, a part that is not there, or whose runs depend on what was run before."""
    keys = campaign.file.keys
    if not 1 <= part <= parts:
        raise ModsimError(f"--shard {part}/{parts}: there are the parts 1/{parts} to {parts}/{parts}")
    if keys.search is not None:
        raise ModsimError("--shard: what a search runs next depends on all that it has run: leave --shard out")
    if keys.stop == "sequential":
        raise ModsimError("--shard: stop: sequential looks at the runs of all parts: leave --shard out, or stop: once")


class _Campaign:
    def __init__(
        self,
        campaign: CheckedCampaign,
        folder: CampaignFolder,
        shard: tuple[int, int] | None,
        cache: Path | None,
        progress: Callable[[Progress], None],
    ) -> None:
        self._campaign, self._folder, self._shard, self._progress = campaign, folder, shard, progress
        self._common = with_cache(folder.work, cache)
        self._plan = folder.plan
        self._reports: list[TaskReport] = []
        self._looked = 0
        self._verdicts: tuple[Verdict, ...] = ()
        mine = self._own_runs()
        self._rows = DoneRows(folder).read(None if shard is None else set(mine))
        self._total, self._done = len(mine), set(mine).intersection(self._rows.numbers().tolist())
        runs = len(self._plan)
        self._batch = runs if self._plan.keys.stop == "once" else self._plan.keys.batch * self._plan.runs_by_seed
        self._todo: list[list[int]] = [[] for _ in range(0, runs, self._batch)]
        for number in mine:
            if number not in self._done:
                self._todo[number // self._batch].append(number)
        self._missing = [len(numbers) for numbers in self._todo]
        self._crashed = self._rows.crashed() if self._done else 0

    def make(self, engine: Callable[[], Engine]) -> int:
        """Make all rows; the number of the first run that does not count any more."""
        if (end := self._look()) is not None:
            return end
        opened = engine()
        try:
            return self._work(opened)
        finally:
            opened.close()

    def rows(self, end: int) -> pa.Table:
        """Rows of all runs before the run `end`; OutputError if some are missing, because files were removed."""
        table = self._rows.table()
        table = table.filter(pc.less(table["run"], end))
        if len(table) < end:
            raise OutputError(f"{self._folder.done}: files were removed while the campaign ran: start it again")
        return table

    def _own_runs(self) -> list[int]:
        """The runs of this part: every n-th truth, and a piece of each truth that has more runs than a part."""
        numbers = range(len(self._plan))
        if self._shard is None:
            return list(numbers)
        part, parts = self._shard
        most = -(-len(numbers) // parts)
        groups = same_truth(self._plan, self._campaign.facts, numbers)
        pieces = [group[first : first + most] for group in groups for first in range(0, len(group), most)]
        return sorted(number for piece in pieces[part - 1 :: parts] for number in piece)

    def _look(self) -> int | None:
        """Look at the complete batches, one after the other; the end of the runs that count, if it is known."""
        while self._looked < len(self._missing) and not self._missing[self._looked]:
            self._looked += 1
            stop = min(self._looked * self._batch, len(self._plan))
            if stop == len(self._plan):
                return stop
            rows = self._rows.table()
            self._verdicts = judge(self._plan, rows.filter(pc.less(rows["run"], stop)))
            if all(verdict.outcome != "undecided" for verdict in repeatable(self._plan, self._verdicts)):
                return stop
        return None

    def _work(self, engine: Engine) -> int:
        dispatch, cutter, batches = Dispatch(self._folder, engine), Cutter(engine.width), iter(self._todo)

        def following() -> Task | None:
            cutter.width = engine.width
            while not cutter.waiting and (numbers := next(batches, None)) is not None:
                cutter.add(same_truth(self._plan, self._campaign.facts, numbers))
            return Task(self._common, tuple(self._plan.runs(cutter.next()))) if cutter.waiting else None

        for task, report in dispatch.done(following):
            cutter.learn(report)
            self._take(task, report)
            if (end := self._look()) is not None:
                return end
            done = len(self._done)
            left_s = cutter.seconds(self._total - done)
            self._progress(Progress(self._total, done, dispatch.running, self._crashed, left_s, self._verdicts))
        return len(self._plan)

    def _take(self, task: Task, report: TaskReport) -> None:
        """Note that a task is done; OutputError if its file cannot be read here."""
        read_back(task, lambda: self._rows.add(task.path) or None)
        self._reports.append(report)
        self._crashed += report.crashed
        for run in task.runs:
            if run.number not in self._done:
                self._done.add(run.number)
                self._missing[run.number // self._batch] -= 1

    def log(self, seconds: float) -> None:
        cpu_s = sum(report.cpu_s for report in self._reports)
        runs = sum(report.runs for report in self._reports)
        hosts = sorted({report.host for report in self._reports if report.host})
        write_log(self._folder, f"{runs} runs in {seconds:.3f} s, {cpu_s:.3f} s of processors, on {', '.join(hosts)}")
