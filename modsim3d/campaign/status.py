"""How far a campaign is, seen from outside: while another process works on it, too."""

from __future__ import annotations

import time
from dataclasses import dataclass

import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.campaign.done_rows import results_table
from modsim3d.campaign.folder import CampaignFolder
from modsim3d.campaign.plan import Plan
from modsim3d.campaign.search_folder import search_ended, search_table
from modsim3d.campaign.verdicts.verdict import Verdict, judged
from modsim3d.campaign.work.row import CRASHED
from modsim3d.campaign.work.task import ROWS_PATTERN, stored_report
from modsim3d.io.locks import LOCK_FILE, holder_of

# ---- The rows of a campaign, whether it follows a plan or searches ----


def rows_of(folder: CampaignFolder) -> pa.Table:
    """The runs or trials of a campaign in their order: all, or those that are done so far.

    Raises:
        ModsimError: They are damaged.
    """
    return results_table(folder) if folder.keys.search is None else search_table(folder)


def has_ended(folder: CampaignFolder) -> bool:
    """Whether all of them are written."""
    return folder.finished if folder.keys.search is None else search_ended(folder)


def planned_rows(folder: CampaignFolder) -> int:
    """How many there are at most."""
    return len(folder.plan) if folder.keys.search is None else folder.keys.search.budget


@dataclass(frozen=True, eq=False)
class Present:
    """The present state of a campaign.

    Attributes:
        table: The rows that are done.
        total: Number of runs of the plan; with `stop: sequential` fewer may do.
        finished: Whether the results are there.
        worked_on_by: The process that works on it; None if there is none. Parts of a job array are not seen.
        left_s: Time that the rest takes at the rate since that process began; None if unknown.
        last_s: Seconds since the last rows were written; None if there are none or it is finished.
        verdicts: The verdicts on what is done.
    """

    table: pa.Table
    total: int
    finished: bool
    worked_on_by: str | None
    left_s: float | None
    last_s: float | None
    verdicts: tuple[Verdict, ...]

    @property
    def done(self) -> int:
        """Number of runs that are done, crashed ones too."""
        return len(self.table)

    @property
    def crashed(self) -> int:
        """Number of runs that crashed."""
        return crashed_runs(self.table)


def present_state(folder: CampaignFolder) -> Present:
    """Read how far a campaign is.

    Raises:
        ModsimError: Its results are damaged.
    """
    table, total, ended = rows_of(folder), planned_rows(folder), has_ended(folder)
    holder = None if ended else holder_of(folder.path)
    left_s, last_s = (None, None) if ended else _times(folder, total - len(table), holder)
    verdicts = judged(folder.plan, table if ended else complete_batches(folder.plan, table))
    return Present(table, total, ended, holder, left_s, last_s, verdicts)


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
    """Time that the rest takes, and since the last rows were written, in seconds; None if unknown."""
    now, written, files = time.time(), list[float](), []
    for path in folder.done.glob(ROWS_PATTERN) if folder.done.is_dir() else ():
        try:
            files.append((path.stat().st_mtime, path))
        except FileNotFoundError:  # gathered just now
            continue
    written = [at for at, _ in files]
    last_s = max(0.0, now - max(written)) if written else None
    try:
        began = (folder.path / LOCK_FILE).stat().st_mtime
    except FileNotFoundError:
        return None, last_s
    reports = [stored_report(path) for at, path in files if at >= began]
    runs = sum(report.runs for report in reports if report is not None)
    if holder is None or not runs:
        return None, last_s
    return left * (max(written) - began) / runs, last_s
