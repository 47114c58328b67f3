"""Campaigns from Python: run one, go on with one, open one; and how far one is, seen from outside."""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.campaign.done_rows import NeededSeeds, needed_seeds, parsed_expectation, results_table
from modsim3d.campaign.folder import CampaignFolder, opened_campaign
from modsim3d.campaign.keys import read_campaign
from modsim3d.campaign.means import MeanRow, mean_rows, mean_table, usual_keys, usual_scores, with_required
from modsim3d.campaign.plan import Plan
from modsim3d.campaign.running import Progress, run_plan
from modsim3d.campaign.search import SearchResult, run_search
from modsim3d.campaign.search_folder import search_table
from modsim3d.campaign.verdicts.verdict import Verdict, judge
from modsim3d.campaign.work.checking import CheckedCampaign, checked
from modsim3d.campaign.work.row import CRASHED
from modsim3d.campaign.work.scenes import Scenes
from modsim3d.campaign.work.task import ROWS_PATTERN, changes, stored_report
from modsim3d.campaign.workers import Engine, ProcessPool
from modsim3d.core.document import Document, Items, Result, Table, Text, Where
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.core.text import UNKNOWN, counted
from modsim3d.io.overwrite_guard import LOCK_FILE, holder_of
from modsim3d.io.processes import WorkerCount, worker_count

# ---- The rows of a campaign, and how far it is, seen from outside ----


def rows_of(folder: CampaignFolder) -> pa.Table:
    """Runs or trials of a campaign in their order: all, or those done so far. Raises ModsimError for damaged ones."""
    return results_table(folder) if folder.keys.search is None else search_table(folder)


@dataclass(frozen=True, eq=False)
class CampaignStatus:
    """The present state of a campaign."""

    table: pa.Table  # rows that are done
    total: int  # runs of the plan; with `stop: sequential` fewer may do
    finished: bool  # whether the results are there
    worked_on_by: str | None  # process; None if there is none; parts of a job array are not seen
    left_s: float | None  # for the rest, at the rate since that process began; None if unknown
    last_s: float | None  # since the last rows were written; None if there are none or it is finished
    verdicts: tuple[Verdict, ...]  # on what is done

    @property
    def done(self) -> int:
        """Number of runs that are done, crashed ones too."""
        return len(self.table)

    @property
    def crashed(self) -> int:
        """Number of runs that crashed."""
        return crashed_runs(self.table)


def present_state(folder: CampaignFolder) -> CampaignStatus:
    """Read how far a campaign is; raises ModsimError for damaged results."""
    table, total, ended = rows_of(folder), folder.total, folder.finished
    holder = None if ended else holder_of(folder.path)
    left_s, last_s = (None, None) if ended else _times(folder, total - len(table), holder)
    verdicts = judge(folder.plan, table if ended else complete_batches(folder.plan, table))
    return CampaignStatus(table, total, ended, holder, left_s, last_s, verdicts)


def complete_batches(plan: Plan, table: pa.Table) -> pa.Table:
    """The rows that a campaign with `stop: sequential` has looked at; all of one that is looked at once."""
    if plan.keys.stop == "once":
        return table
    batch = plan.keys.batch * plan.runs_by_seed
    numbers = table["run"].to_pylist()
    without_gap = next((place for place, number in enumerate(numbers) if place != number), len(numbers))
    whole = without_gap if without_gap == len(plan) else without_gap - without_gap % batch
    return table.slice(0, whole)


def crashed_runs(table: pa.Table) -> int:
    """Number of rows of runs that crashed."""
    return int(pc.sum(pc.equal(table["status"], CRASHED)).as_py() or 0)


def _times(folder: CampaignFolder, left: int, holder: str | None) -> tuple[float | None, float | None]:
    """Times that the rest takes, and since the last rows were written, in seconds; None if unknown."""
    files = []
    for path in folder.done.glob(ROWS_PATTERN):
        with suppress(FileNotFoundError):  # gathered just now
            files.append((path.stat().st_mtime, path))
    written = [at for at, _ in files]
    last_s = max(0.0, time.time() - max(written)) if written else None
    try:
        began = (folder.path / LOCK_FILE).stat().st_mtime
    except FileNotFoundError:
        return None, last_s
    runs = sum(report.runs for at, path in files if at >= began and (report := stored_report(path)) is not None)
    if holder is None or not runs:
        return None, last_s
    return left * (max(written) - began) / runs, last_s


# ---- Campaigns from Python ----


@dataclass(frozen=True, eq=False, repr=False)
class Campaign(Result):
    """A campaign, finished or not.

        campaign = modsim3d.open_campaign("runs/example")
        campaign.verdicts, campaign.table.to_pandas(), campaign.means(["state"])

    Attributes:
        folder: Its folder.
        table: A row for each run that is done, in the order of the plan, with its parameters and all its scores.
        verdicts: The verdicts on its requirements; of a campaign that is not finished, on what is done.
        finished: Whether all runs are done.
    """

    folder: Path
    table: pa.Table
    verdicts: tuple[Verdict, ...]
    finished: bool

    def _document(self) -> Document:
        """The mean scores of each tracker in each condition, the verdicts, and the outcome."""
        title = f"Campaign {self.folder}: {self.conclusion}; means [95 % interval over traffic seeds]"
        verdicts = Items([f"{verdict.tracker}: {verdict.text}: {verdict.outcome}" for verdict in self.verdicts])
        rows = with_required(self._opened.plan, self.means(), self.verdicts)
        means = mean_table(rows, title, where=Where.EVERYWHERE)
        return Document(title, [Text(self.conclusion, "lead")], [means, verdicts])

    @property
    def conclusion(self) -> str:
        """The outcome in a sentence."""
        total, done = counted(len(self._opened.plan), "run"), len(self.table)
        parts = [counted(done, "run") if self.finished else f"{done:,} of {total}, not finished"]
        if crashed := crashed_runs(self.table):
            parts.append(f"{crashed:,} crashed")
        outcomes = [verdict.outcome for verdict in self.verdicts]
        counts = ((outcomes.count(outcome), outcome) for outcome in ("met", "failed", "undecided"))
        return ", ".join(parts + [f"{count} {outcome}" for count, outcome in counts if count])

    def means(self, by: Sequence[str] | None = None, scores: Sequence[str] | None = None) -> list[MeanRow]:
        """Mean scores over traffic seeds with 95 % intervals, for each tracker.

        Args:
            by: The varied keys to tell apart; all that are not drawn if None.
            scores: Columns of the table; HOTA and some others if None, and those of the requirements.

        Raises:
            ModsimError: There is no such key or score.
        """
        plan = self._opened.plan
        keys = usual_keys(plan) if by is None else by
        return mean_rows(self.table, keys, usual_scores(plan, self.table) if scores is None else scores)

    @cached_property
    def _opened(self) -> CampaignFolder:
        return opened_campaign(self.folder)


def run_campaign(
    campaign: StrPath,
    out: StrPath,
    *,
    workers: WorkerCount = "auto",
    scheduler: str | None = None,
    slurm: int | None = None,
    shard: tuple[int, int] | None = None,
    cache: StrPath | None = None,
    progress: Callable[[Progress], None] = lambda progress: None,
) -> Campaign:
    """Run a campaign, or go on with one that was interrupted.

        campaign = modsim3d.run_campaign("campaign.yaml", "runs/campaign", workers=2)

    Args:
        campaign: A campaign file, or the name of a shipped campaign; one with `search` is for `search_campaign`.
        out: The folder of the campaign.
        workers: Number of processes on this machine; `auto`: one for each CPU.
        scheduler: Address of a Dask scheduler, such as `tcp://10.0.0.1:8786`, whose workers do the work instead.
        slurm: Number of Slurm jobs that do the work instead.
        shard: Number of a part, from 1, and of all parts: only its runs are made, as by a job of an array.
        cache: Where layers that are kept are read and written; `cache` in the folder if None.
        progress: Called after each task.

    Raises:
        InputError: With every problem of the file.
        OutputError: The folder holds another campaign, or cannot be written.
        ModsimError: This is no number of workers, the workers are lost, or the campaign is a search.
        TypeError: The file or the folder is neither text nor a path.
    """
    folder = as_path(out, "out", "the folder of the campaign")
    setup = checked(read_campaign(campaign))
    if setup.file.keys.search is not None:
        raise ModsimError(f"{setup.file.path} is a search: run it with modsim3d.search_campaign")
    layers = None if cache is None else as_path(cache, "cache", "a folder")
    engine = engine_of(workers, scheduler, slurm)
    result = run_plan(setup, folder, engine, shard=shard, cache=layers, progress=progress)
    return open_campaign(folder) if result is None else Campaign(folder, result.table, result.verdicts, True)


def search_campaign(
    campaign: StrPath,
    out: StrPath,
    *,
    workers: WorkerCount = "auto",
    scheduler: str | None = None,
    slurm: int | None = None,
    cache: StrPath | None = None,
    progress: Callable[[Progress], None] = lambda progress: None,
) -> SearchResult:
    """Run a campaign with `search`, or go on with one that was interrupted: trials in which the tracker fails.

        found = modsim3d.search_campaign("search.yaml", "runs/search", workers=2)
        found.findings, modsim3d.reproduce_run("runs/search", found.findings[0].number, "runs/worst")

    Args:
        campaign: A campaign file.
        out, workers, scheduler, slurm, cache, progress: As those of `run_campaign`.

    Raises:
        InputError: With every problem of the file, as that it has no `search`.
        OutputError: The folder holds another campaign, or cannot be written.
        ModsimError: This is no number of workers, or the workers are lost.
        TypeError: The file or the folder is neither text nor a path.
    """
    folder, setup = as_path(out, "out", "the folder of the campaign"), checked(read_campaign(campaign))
    if setup.file.keys.search is None:
        raise InputError(str(setup.file.path), ["search: is missing: modsim3d.run_campaign runs campaigns without one"])
    layers = None if cache is None else as_path(cache, "cache", "a folder")
    return run_search(setup, folder, engine_of(workers, scheduler, slurm), cache=layers, progress=progress)


@dataclass(frozen=True, repr=False)
class CampaignPlan(Result):
    """Number of runs that a campaign would make, from `plan_campaign`; of frames of all cameras in all of them; and of
    traffic seeds that each requirement needs."""

    runs: int
    frames: int
    needed: tuple[NeededSeeds, ...]

    def _document(self) -> Document:
        rows = [(need.text, need.tracker or "all", str(need.seeds or UNKNOWN), need.why) for need in self.needed]
        table = Table("traffic seeds needed", ("requirement", "tracker", "seeds", "why"), rows, where=Where.EVERYWHERE)
        return Document("", [Text(f"{self.runs:,} runs of {self.frames:,} frames together")], [table])


def plan_campaign(
    campaign: StrPath | CheckedCampaign,
    *,
    expect: Mapping[str, tuple[float, float]] | Sequence[str] = (),
    like: StrPath | None = None,
) -> CampaignPlan:
    """Count the runs of a campaign and the seeds that its requirements need, without running it.

        modsim3d.plan_campaign("example", expect={"hota": (0.6, 0.05)}).needed

    Args:
        campaign: A campaign file, or the name of a shipped campaign.
        expect: Expected mean and spread over traffic seeds of scores.
        like: Folder of an earlier campaign of this kind, which says what is expected.

    Raises:
        ModsimError: The file is wrong or a search, or what is expected is of no required mean.
        TypeError: The file or the folder is neither text nor a path.
    """
    setup = campaign if isinstance(campaign, CheckedCampaign) else checked(read_campaign(campaign))
    keys, plan = setup.file.keys, setup.plan
    if keys.search is not None:
        reason = "a search has no requirements, and its budget says how many trials there will be"
        raise ModsimError(f"campaign plan: {reason}")
    texts = (
        [f"{name}={mean}:{spread}" for name, (mean, spread) in expect.items()]
        if isinstance(expect, Mapping)
        else expect
    )
    expected = dict(parsed_expectation(text, plan) for text in texts)
    earlier = None if like is None else opened_campaign(like)
    if earlier is not None and earlier.keys.search is not None:
        raise ModsimError(f"--like {like}: holds a search, whose trials were chosen to be bad, and has no mean")
    needed = needed_seeds(plan, expected, earlier)
    scenes = Scenes(keys.steps, setup.file.base, learned=keys.uncertainty == "learned")
    first = (plan.run(place * plan.runs_by_seed // len(plan.conditions)) for place in range(len(plan.conditions)))
    made = (scenes.of(run.condition, run.traffic_seed, run.detector_seed) for run in first)
    frames = sum(scene.steps * len(scene.cameras) for scene in made) * len(plan) // len(plan.conditions)
    return CampaignPlan(len(plan), frames, tuple(needed))


def open_campaign(folder: StrPath) -> Campaign:
    """Open the folder of a campaign, finished or not, also while it is worked on.

        campaign = modsim3d.open_campaign("runs/campaign")

    Raises:
        ModsimError: It is no folder of a campaign, or its files are damaged.
        TypeError: It is neither text nor a path.
    """
    opened = opened_campaign(folder)
    state = present_state(opened)
    return Campaign(opened.path, state.table, state.verdicts, state.finished)


def engine_of(workers: WorkerCount, scheduler: str | None = None, slurm: int | None = None) -> Callable[[], Engine]:
    """Function that opens the engine asked for: processes on this machine, a Dask scheduler at an address, or Slurm
    jobs. Raises ModsimError if this is no number of workers, both others are given, or their library is missing."""
    worker_count(workers)
    if scheduler is not None and slurm is not None:
        raise ModsimError("scheduler and slurm contradict each other: leave one out")
    if scheduler is None and slurm is None:
        return lambda: ProcessPool(workers)
    from modsim3d.campaign.dask import DaskEngine, SlurmEngine, check_libraries

    check_libraries("distributed", *(["dask_jobqueue"] if slurm is not None else []))
    return lambda: DaskEngine(scheduler) if scheduler is not None else SlurmEngine(slurm or 1)


# ---- Whether the files of a campaign are still as they were when it was planned ----


def check_files(folder: CampaignFolder) -> None:
    """Refuse to make runs again from other files: InputError with every file that has changed or is not there."""
    if problems := changes(folder.work):
        hint = "put the files back as they were: runs are made again from the same bytes only"
        raise InputError(f"campaign {folder.path}", [*problems, hint])
