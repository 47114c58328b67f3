"""Runs a search: proposes a batch, makes its trials, and proposes the next from what came of them."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import orjson
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.campaign import search_folder
from modsim3d.campaign.folder import CampaignFolder, check_ended, locked_campaign, planned, remove_done
from modsim3d.campaign.plan import PlannedRun
from modsim3d.campaign.running import Dispatch, Progress, read_back, write_log
from modsim3d.campaign.verdicts.wording import score_name
from modsim3d.campaign.work.checking import CheckedCampaign
from modsim3d.campaign.work.row import CRASHED, DONE
from modsim3d.campaign.work.scenes import Scenes
from modsim3d.campaign.work.task import Task, with_cache
from modsim3d.campaign.workers import Engine
from modsim3d.core.text import three_digits

# ---- What a search found ----

NO_RATE = "The trials were chosen to be bad: they show that the tracker fails there, and no share of them is a rate."


@dataclass(frozen=True)
class Finding:
    """A trial in which the tracker failed, or came closest to it."""

    number: int  # of the trial
    value: float | None  # the score; None if the run crashed
    error: str | None  # None if it did not crash
    traffic_seed: int  # of the scene
    values: dict[str, Any]  # of the keys that were searched
    again: str  # command line that makes the run again
    film: str  # command line that films it too


def findings(folder: CampaignFolder, table: pa.Table, count: int = 5) -> tuple[Finding, ...]:
    """At most `count` crashes, the first ones, and after them as many of the worst scores, the worst one first."""
    search = search_folder.searched(folder)
    score, order = search_folder.score_of(search), "ascending" if search.minimise is not None else "descending"
    crashed = table.filter(pc.equal(table["status"], CRASHED)).slice(0, count)
    scored = table.filter(pc.and_(pc.equal(table["status"], DONE), pc.is_valid(table[score])))
    scored = scored.sort_by([(score, order), ("run", "ascending")]).slice(0, count)
    columns = ["run", "traffic_seed", search_folder.VALUES, "status", "error", score]
    rows = [row for part in (crashed, scored) for row in part.select(columns).to_pylist()]
    return tuple(_finding(folder, row, score) for row in rows)


def sentence(folder: CampaignFolder, table: pa.Table) -> str:
    """Result of a search, in two or three sentences."""
    search = search_folder.searched(folder)
    score, word = search_folder.score_of(search), "lowest" if search.minimise is not None else "highest"
    counts = {
        status: pc.sum(pc.equal(table["status"], status)).as_py() or 0 for status in (CRASHED, search_folder.REFUSED)
    }
    worst = [finding for finding in findings(folder, table, 1) if finding.error is None]
    outcome = f"no trial has a {score_name(score)}"
    if worst:
        outcome = f"{word} {score_name(score)} {three_digits(worst[0].value)} in trial {worst[0].number}"
    summary = f"{len(table):,} of {search.budget:,} trials: {outcome}"
    if counts[CRASHED]:
        summary += f"; {counts[CRASHED]} crashed"
    if counts[search_folder.REFUSED]:
        summary += f"; {counts[search_folder.REFUSED]} had values that the scene, the detector or the tracker refuses"
    return f"{summary}. {NO_RATE}"


def _finding(folder: CampaignFolder, row: dict[str, Any], score: str) -> Finding:
    again, values = folder.reproducing(row["run"]), orjson.loads(row[search_folder.VALUES])
    return Finding(row["run"], row[score], row["error"], row["traffic_seed"], values, again, f"{again} --film")


@dataclass(frozen=True, eq=False, repr=False)
class SearchResult:
    """A search that ended, from `search_campaign`."""

    folder: CampaignFolder
    table: pa.Table  # its trials, in their order; see `trials_table`

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The first crashes and the worst scores."""
        return findings(self.folder, self.table)

    def __str__(self) -> str:
        """Result in two or three sentences."""
        return sentence(self.folder, self.table)

    def __repr__(self) -> str:
        """The folder, and the result."""
        return f"<SearchResult {self.folder.path}: {self}>"


def run_search(
    campaign: CheckedCampaign,
    folder: Path,
    engine: Callable[[], Engine],
    *,
    cache: Path | None = None,
    progress: Callable[[Progress], None] = lambda progress: None,
) -> SearchResult:
    """Run a search, or go on with it. What it finds does not depend on the engine, nor on interruptions. `engine` opens
    an engine, and is not called if there is nothing to do; `progress` is called after each trial. Layers are kept in
    `cache`, by default in the campaign's folder. Raises ModsimError if the campaign has no search, the folder holds
    another plan or cannot be written, or the engine fails."""
    with locked_campaign(folder):
        here = planned(campaign, folder)
        search = search_folder.searched(here)
        if not here.finished:
            started = time.perf_counter()
            with closing(engine()) as opened:
                trials = _Trials(here, opened, cache, progress)
                trials.make_all()
            search_folder.write_trials(here, search_folder.trials_table(trials.runs, trials.rows, search))
            write_log(here, f"{search.budget} trials in {time.perf_counter() - started:.3f} s")
        check_ended(folder)
        remove_done(here)
        return SearchResult(here, search_folder.search_table(here))


class _Trials:
    """Makes batches of trials; keeps their runs and rows in their order."""

    def __init__(
        self, folder: CampaignFolder, engine: Engine, cache: Path | None, progress: Callable[[Progress], None]
    ) -> None:
        self._common = with_cache(folder.work, cache)
        self._folder, self._search, self._progress = folder, search_folder.searched(folder), progress
        self._dispatch = Dispatch(folder, engine)
        self._scenes = Scenes(folder.keys.steps, Path(folder.facts["base"]))
        self._crashed = self._made = 0
        self._started = time.perf_counter()
        self.runs = list[PlannedRun]()
        self.rows = list[dict[str, Any]]()

    def make_all(self) -> None:
        """Make all trials, a batch after another."""
        search, history = self._search, list[search_folder.TriedPoint]()
        for batch in range(search_folder.batches(search)):
            points = search_folder.stored_batch(self._folder, batch)
            if points is None:
                points = search_folder.proposed(search, self._folder.keys.seed, batch, history)
                search_folder.store_batch(self._folder, batch, points)
            rows = self._make(search_folder.planned_batch(self._folder, batch, points))
            history += [search_folder.tried(point, row, search) for point, row in zip(points, rows, strict=True)]

    def _make(self, runs: Sequence[PlannedRun]) -> list[dict[str, Any]]:
        """The rows of a batch of trials."""
        tasks = {run.number: Task(self._common, (run,)) for run in runs}
        rows = {
            number: self._record(row, task) for number, task in tasks.items() if (row := search_folder.done_row(task))
        }
        waiting = deque(task for number, task in tasks.items() if number not in rows)
        for task, _ in self._dispatch.done(lambda: waiting.popleft() if waiting else None):
            self._made += 1
            rows[task.runs[0].number] = self._record(read_back(task, partial(search_folder.done_row, task)), task)
            self._tell(len(rows))
        self.runs += runs
        self.rows += [rows[run.number] for run in runs]
        return self.rows[-len(runs) :]

    def _record(self, row: dict[str, Any], task: Task) -> dict[str, Any]:
        row = search_folder.trial_row(row, task.runs[0], self._scenes)
        self._crashed += row["status"] == CRASHED
        return row

    def _tell(self, done: int) -> None:
        budget, done = self._search.budget, len(self.rows) + done
        left_s = (budget - done) * (time.perf_counter() - self._started) / self._made
        self._progress(Progress(budget, done, self._dispatch.running, self._crashed, left_s))
