"""The page of a search: what it found is evidence of failure, never a rate."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa

from modsim3d.campaign.campaign import Campaign
from modsim3d.campaign.done_rows import results_table
from modsim3d.campaign.folder import CampaignFolder, files_of_campaign, opened_campaign
from modsim3d.campaign.keys import Range, SearchKeys
from modsim3d.campaign.plan import text_of
from modsim3d.campaign.report.campaign_page import REPORT_FILE, WORST, campaign_page, moment_block
from modsim3d.campaign.report.campaign_page import lead as campaign_lead
from modsim3d.campaign.report.words import Score, rests_on
from modsim3d.campaign.search_folder import REFUSED, search_table
from modsim3d.campaign.verdicts.verdict import judge
from modsim3d.campaign.work.row import DONE
from modsim3d.core.document import Block, Document, Figure, Heading, Table, Text
from modsim3d.core.paths import StrPath, out_file
from modsim3d.core.text import counted, three_digits, with_minus
from modsim3d.core.written_files import OutputFiles
from modsim3d.io.atomic_write import write_files
from modsim3d.io.overwrite_guard import claimed
from modsim3d.view.pages import charts
from modsim3d.view.pages.charts import marks, span_of
from modsim3d.view.pages.page import document_page

SHOWN = 20  # trials in the table
NO_RATE = (
    "These trials were chosen to be bad. Each is evidence of a failure that can happen; together they say nothing "
    "about how often, and no share or mean of them is a rate."
)


def lead(search: SearchKeys, table: pa.Table) -> str:
    """Result of the search, in a sentence."""
    score = Score(search.minimise or search.maximise or "")
    worst = "lowest" if search.minimise else "highest"
    done = _valued_trials(search, table)
    crashed = sum(status not in (DONE, REFUSED) for status in table["status"].to_pylist())
    crashes = f" {counted(crashed, 'trial')} crashed, which is a finding too." if crashed else ""
    if not done:
        return f"No trial has a value of {score.name} yet.{crashes}"
    first = done[0]
    return (
        f"The {worst} {score.name} of {counted(len(table), 'trial')} is {significant(first[score.column])}, in trial "
        f"{first['run']}.{crashes}"
    )


def search_page(
    folder: CampaignFolder,
    search: SearchKeys,
    table: pa.Table,
    command: str | None = None,
    advance: Callable[..., None] = lambda *_: None,
) -> str:
    """Page of a search as HTML; `command` and `advance` are the call and progress of `report_campaign`."""
    score = Score(search.minimise or search.maximise or "")
    left = f"Not finished: {len(table):,} of {counted(search.budget, 'trial')} are done."
    document = Document(
        f"Campaign {folder.path.resolve().name}: what a search found",
        [Text(lead(search, table), "lead"), Text(NO_RATE), Text(left if len(table) < search.budget else "", "bad")],
        [
            Heading("How it went"),
            *_progress(search, score, table),
            Heading("The worst trials"),
            *_worst(folder, search, score, table),
            *_moments(folder, score, _valued_trials(search, table)[:WORST], advance),
            Heading("Others"),
            *_others(table),
            Heading("Where it looked"),
            Table("", (), [*((key, _range(span)) for key, span in search.over.items()), *_facts(folder)]),
        ],
    )
    return document_page(document, rests_on(folder, "findings of a search", command))


def _valued_trials(search: SearchKeys, table: pa.Table) -> list[dict[str, Any]]:
    """Trials with a value, the worst first."""
    column = search.minimise or search.maximise or ""
    rows = [row for row in table.to_pylist() if row["status"] == DONE and row.get(column) is not None]
    return sorted(rows, key=lambda row: (row[column] if search.minimise else -row[column], row["run"]))


def _progress(search: SearchKeys, score: Score, table: pa.Table) -> list[Block]:
    """The score of each trial, and the worst so far."""
    rows = sorted(_valued_trials(search, table), key=lambda row: int(row["run"]))
    if not rows:
        return [Text("No trial has a value." if len(table) else "")]
    x = np.array([row["run"] for row in rows], dtype=float)
    y = np.array([row[score.column] for row in rows], dtype=float)
    best = np.minimum.accumulate(y) if search.minimise else np.maximum.accumulate(y)
    axes = charts.Axes((-1, max(float(x[-1]) + 1, 1.0)), span_of(y.tolist()), 620, 300)
    line = charts.line(axes, np.repeat(x, 2)[1:], np.repeat(best, 2)[:-1], charts.colour_of(1))
    content = marks(axes, x, y, 0, opacity=0.5) + line
    draw = partial(axes.drawing, content, f"{score.name} of each trial", "trial", score.label)
    return [Figure(draw, "Dots: trials in their order. Line: the worst until then.")]


def _worst(folder: CampaignFolder, search: SearchKeys, score: Score, table: pa.Table) -> list[Block]:
    rows = [
        (
            str(row["run"]),
            significant(row[score.column]),
            *(_value(row[key]) for key in search.over),
            str(row["traffic_seed"]),
            folder.reproducing(row["run"]),
        )
        for row in _valued_trials(search, table)[:SHOWN]
    ]
    header = ("trial", score.name, *search.over, "traffic seed", "make it again")
    return [Table("", header, rows), Text("" if rows else "There are none.")]


def _moments(
    folder: CampaignFolder, score: Score, rows: Sequence[dict[str, Any]], advance: Callable[..., None]
) -> Iterator[Block]:
    """Pictures of the moments at which trials went wrong; `advance(1)` follows each."""
    shown = [row for row in rows if row.get("worst_s") is not None]
    advance(0, len(shown))
    for row in shown:
        yield Heading(f"Trial {row['run']}: {score.name} {significant(row[score.column])}", 3)
        yield moment_block(folder, row["run"], row["tracker"], row["worst_s"], score.column)
        advance(1)


def _others(table: pa.Table) -> list[Block]:
    rows = [(str(row["run"]), row["status"], row["error"] or "") for row in table.to_pylist() if row["status"] != DONE]
    note = "A trial that is refused has values that the scene does not take; it is no failure of the tracker."
    return [Table("", ("trial", "status", "error"), rows[:SHOWN], about=note)]


def _range(span: Range) -> str:
    if span.choices is not None:
        return "one of " + ", ".join(map(text_of, span.choices))
    kind = f"{', logarithmic' if span.scale == 'log' else ''}{', whole numbers' if span.whole else ''}"
    return f"{with_minus(f'{span.low:g}')} to {with_minus(f'{span.high:g}')}{kind}"


def _facts(folder: CampaignFolder) -> list[tuple[str, str]]:
    search, keys = folder.keys.search, folder.keys
    assert search is not None
    return [
        ("tracker", ", ".join(tracker.label for tracker in keys.trackers)),
        ("traffic seeds", f"{search.seeds:,} to choose from"),
        ("budget", f"{counted(search.budget, 'trial')}, {search.batch:,} at once"),
        ("versions", ", ".join(f"{name} {version}" for name, version in folder.facts["versions"].items())),
        ("SHA-256 of the plan", folder.facts["sha256"]),
    ]


def _value(value: Any) -> str:
    return significant(value) if isinstance(value, int | float) and not isinstance(value, bool) else text_of(value)


def significant(value: float) -> str:
    """A number with at least three digits behind the zeros, which tell small values of a search apart."""
    return f"{value:#.3g}".replace("-", "−") if 0 < abs(value) < 0.1 else three_digits(value)


# ---- Writes the page that a campaign has ----


def report_campaign(
    campaign: Campaign | StrPath,
    out: StrPath | None = None,
    *,
    overwrite: bool = False,
    progress: Callable[..., None] = lambda *_: None,
    call: str | None = None,
) -> OutputFiles:
    """Write a page about a campaign or a search: requirements first, then means, charts and the worst runs.

        modsim3d.report_campaign("runs/example", "page.html")

    Args:
        campaign, out: A campaign or its folder; HTML file to write, `report.html` in the folder if None.
        overwrite, call: As those of `modsim3d.report`.
        progress: Called with 1 after each picture of a worst run, first with 0 and their number in all.

    Raises:
        ModsimError: It is no campaign, its results are damaged, or the page cannot be written.
        TypeError: A path is neither text nor a path.
    """
    opened = opened_campaign(campaign.folder if isinstance(campaign, Campaign) else campaign)
    path = out_file(out, opened.path / REPORT_FILE)
    with claimed([path], overwrite=overwrite, inputs=files_of_campaign(opened)):
        if opened.keys.search is not None:
            trials = search_table(opened)
            write_files({path: search_page(opened, opened.keys.search, trials, call, progress)})
            return OutputFiles((path,), (lead(opened.keys.search, trials),))
        table = results_table(opened)
        verdicts = judge(opened.plan, table)
        write_files({path: campaign_page(opened, table, verdicts, progress, call)})
    return OutputFiles((path,), (campaign_lead(opened, table, verdicts),))
