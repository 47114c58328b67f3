"""Runs a search: proposes a batch, makes its trials, and proposes the next from what came of them."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa

from modsim3d.campaign.engines.death import Death
from modsim3d.campaign.engines.interface import Engine
from modsim3d.campaign.plan.plan import PlannedRun
from modsim3d.campaign.results.ended import check_ended
from modsim3d.campaign.results.folder import LOG, CampaignFolder, locked_campaign, planned
from modsim3d.campaign.results.gather import remove_done
from modsim3d.campaign.running import Progress, crash_of, read_back
from modsim3d.campaign.search.findings import Finding, findings, sentence
from modsim3d.campaign.search.folder import (
    batches,
    done_row,
    planned_batch,
    search_ended,
    search_table,
    searched,
    store_batch,
    stored_batch,
    trials_table,
    write_trials,
)
from modsim3d.campaign.search.proposing import Tried, proposed
from modsim3d.campaign.search.trials import told_apart, tried
from modsim3d.campaign.work.checking import CheckedCampaign
from modsim3d.campaign.work.row import CRASHED
from modsim3d.campaign.work.scenes import Scenes
from modsim3d.campaign.work.task import Task, store_crashed, with_cache


@dataclass(frozen=True, eq=False)
class SearchResult:
    """A search that ended.

    Attributes:
        folder: Its folder.
        table: Its trials, in their order; see `trials_table`.
    """

    folder: CampaignFolder
    table: pa.Table

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The first crashes and the worst scores."""
        return findings(self.folder, self.table)

    def __str__(self) -> str:
        """What it comes to."""
        return sentence(self.folder, self.table)


def run_search(
    campaign: CheckedCampaign,
    folder: Path,
    engine: Callable[[], Engine],
    *,
    cache: Path | None = None,
    progress: Callable[[Progress], None] = lambda progress: None,
) -> SearchResult:
    """Run a search, or go on with it. What it finds does not depend on the engine, nor on interruptions.

    Args:
        campaign: A campaign with a search.
        folder: Its folder.
        engine: Opens an engine; not called if there is nothing to do.
        cache: The folder of layers on the disk, in place of `cache` in the campaign's.
        progress: Called after each trial.

    Raises:
        ModsimError: The campaign has no search, the folder holds another plan or cannot be written, or the engine
            fails.
    """
    with locked_campaign(folder):
        here = planned(campaign, folder)
        search = searched(here)
        if not search_ended(here):
            started = time.perf_counter()
            with closing(engine()) as opened:
                trials = _Trials(here, opened, cache, progress)
                _make_all(trials, here)
            write_trials(here, trials_table(trials.runs, trials.rows, search))
            _log(here, search.budget, time.perf_counter() - started)
        check_ended(folder)
        remove_done(here)
        return SearchResult(here, search_table(here))


def _make_all(trials: _Trials, folder: CampaignFolder) -> None:
    """Make all trials, a batch after another."""
    search, known = searched(folder), list[Tried]()
    for batch in range(batches(search)):
        points = stored_batch(folder, batch)
        if points is None:
            points = proposed(search, folder.keys.seed, batch, known)
            store_batch(folder, batch, points)
        rows = trials.make(planned_batch(folder, batch, points))
        known += [tried(point, row, search) for point, row in zip(points, rows, strict=True)]


class _Trials:
    """Makes batches of trials; keeps their runs and rows in their order."""

    def __init__(
        self, folder: CampaignFolder, engine: Engine, cache: Path | None, progress: Callable[[Progress], None]
    ) -> None:
        self._common = with_cache(folder.work, cache)
        self._folder, self._engine, self._progress = folder, engine, progress
        self._scenes = Scenes(folder.keys.steps, Path(folder.facts["base"]))
        self._deaths = Counter[int]()
        self._crashed = self._made = 0
        self._started = time.perf_counter()
        self.runs = list[PlannedRun]()
        self.rows = list[dict[str, Any]]()

    def make(self, runs: Sequence[PlannedRun]) -> list[dict[str, Any]]:
        """The rows of a batch of trials."""
        found = dict[int, dict[str, Any]]()
        waiting, running = deque[Task](), 0
        for run in runs:
            task = Task(self._common, (run,))
            if (row := done_row(task)) is None:
                waiting.append(task)
            else:
                found[run.number] = self._known(row, run)
        while waiting or running:
            while waiting and running < 2 * self._engine.width:
                self._engine.submit(waiting.popleft())
                running += 1
            task, report = self._engine.next()
            running -= 1
            error = crash_of(self._folder, task, report, self._deaths) if isinstance(report, Death) else ""
            if error is None:
                waiting.append(task)
            else:
                if error:
                    store_crashed(task, error)
                self._made += 1
                found[task.runs[0].number] = self._known(read_back(task, partial(done_row, task)), task.runs[0])
            self._tell(len(found), running)
        self.runs += runs
        self.rows += [found[run.number] for run in runs]
        return self.rows[-len(runs) :]

    def _known(self, row: dict[str, Any], run: PlannedRun) -> dict[str, Any]:
        row = told_apart(row, run, self._scenes)
        self._crashed += row["status"] == CRASHED
        return row

    def _tell(self, done: int, running: int) -> None:
        budget, done = searched(self._folder).budget, len(self.rows) + done
        each_s = (time.perf_counter() - self._started) / self._made if self._made else None
        left_s = None if each_s is None else each_s * (budget - done)
        self._progress(Progress(budget, done, running, self._crashed, left_s))


def _log(folder: CampaignFolder, trials: int, seconds: float) -> None:
    """Write what the search cost into the log; times are named nowhere else."""
    with (folder.path / LOG).open("a", encoding="utf-8") as log:
        log.write(f"finished {time.strftime('%Y-%m-%dT%H:%M:%S%z')}\n{trials} trials in {seconds:.3f} s\n")
