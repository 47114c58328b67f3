"""Runs a search: proposes a batch, makes its trials, and proposes the next from what came of them."""

from __future__ import annotations

import shlex
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import orjson
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.campaign.done_rows import remove_done
from modsim3d.campaign.folder import LOG, CampaignFolder, check_ended, locked_campaign, planned
from modsim3d.campaign.plan import PlannedRun
from modsim3d.campaign.running import Progress, crash_of, read_back
from modsim3d.campaign.search_folder import (
    REFUSED,
    VALUES,
    Tried,
    batches,
    done_row,
    planned_batch,
    proposed,
    score_of,
    search_ended,
    search_table,
    searched,
    store_batch,
    stored_batch,
    told_apart,
    trials_table,
    tried,
    write_trials,
)
from modsim3d.campaign.work.checking import CheckedCampaign
from modsim3d.campaign.work.row import CRASHED, DONE
from modsim3d.campaign.work.scenes import Scenes
from modsim3d.campaign.work.task import Task, store_crashed, with_cache
from modsim3d.campaign.workers import Death, Engine

# ---- What a search found ----

NO_RATE = "The trials were chosen to be bad: they show that the tracker fails there, and no share of them is a rate."


@dataclass(frozen=True)
class Finding:
    """A trial in which the tracker failed, or came closest to it.

    Attributes:
        number: Number of the trial.
        value: The score; None if the run crashed.
        error: Why it crashed; None if it did not.
        traffic_seed: Seed of the scene.
        values: The values of the keys that were searched.
        again: The command line that makes the run again.
        film: The command line that films it too.
    """

    number: int
    value: float | None
    error: str | None
    traffic_seed: int
    values: dict[str, Any]
    again: str
    film: str


def findings(folder: CampaignFolder, table: pa.Table, count: int = 5) -> tuple[Finding, ...]:
    """The first crashes, and after them the worst scores, the worst one first.

    Args:
        folder: The folder of the search.
        table: Its trials.
        count: The most crashes, and the most scores.
    """
    search = searched(folder)
    score, order = score_of(search), "ascending" if search.minimise is not None else "descending"
    crashed = table.filter(pc.equal(table["status"], CRASHED)).slice(0, count)
    scored = _scored(table, score).sort_by([(score, order), ("run", "ascending")]).slice(0, count)
    columns = ["run", "traffic_seed", VALUES, "status", "error", score]
    rows = [row for part in (crashed, scored) for row in part.select(columns).to_pylist()]
    return tuple(_finding(folder, row, score) for row in rows)


def sentence(folder: CampaignFolder, table: pa.Table) -> str:
    """Result of a search, in two or three sentences."""
    search = searched(folder)
    score, word = score_of(search), "lowest" if search.minimise is not None else "highest"
    counts = {status: pc.sum(pc.equal(table["status"], status)).as_py() or 0 for status in (CRASHED, REFUSED)}
    worst = [each for each in findings(folder, table, 1) if each.error is None]
    found = f"{word} {score} {worst[0].value:.4g} in trial {worst[0].number}" if worst else f"no trial has a {score}"
    said = f"{len(table)} of {search.budget} trials: {found}"
    if counts[CRASHED]:
        said += f"; {counts[CRASHED]} crashed"
    if counts[REFUSED]:
        said += f"; {counts[REFUSED]} had values that the scene, the detector or the tracker refuses"
    return f"{said}. {NO_RATE}"


def _scored(table: pa.Table, score: str) -> pa.Table:
    return table.filter(pc.and_(pc.equal(table["status"], DONE), pc.is_valid(table[score])))


def _finding(folder: CampaignFolder, row: dict[str, Any], score: str) -> Finding:
    out = folder.path / "runs" / str(row["run"])
    again = f"modsim3d campaign reproduce {shlex.quote(str(folder.path))} {row['run']} --out {shlex.quote(str(out))}"
    values = orjson.loads(row[VALUES])
    return Finding(row["run"], row[score], row["error"], row["traffic_seed"], values, again, f"{again} --film")


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
        """Result in two or three sentences."""
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
