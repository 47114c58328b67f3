"""The command `modsim3d campaign status`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modsim3d.cli import shared
from modsim3d.cli.shared import argument, option
from modsim3d.cli.terminal import open_console, say, say_json, tell_files, timed
from modsim3d.cli.terminal_tables import print_blocks, print_prose
from modsim3d.core.errors import ModsimError

if TYPE_CHECKING:
    import pyarrow as pa

    from modsim3d.campaign.campaign import CampaignStatus
    from modsim3d.campaign.folder import CampaignFolder
    from modsim3d.campaign.means import MeanRow


def campaign_status_command(campaign: shared.CampaignArgument) -> None:
    """Say how far a campaign is and what is known of its requirements, while it is worked on or afterwards.

    Example: modsim3d campaign status runs/example
    """
    from modsim3d.campaign.campaign import present_state
    from modsim3d.campaign.folder import opened_campaign

    with timed("reading the rows"):
        opened = opened_campaign(campaign)
        state = present_state(opened)
    _print_state(opened, state, opened.keys.stop == "once")
    say_json(
        {
            "format": 1,
            "command": "campaign status",
            "folder": campaign,
            "runs": state.total,
            **{name: getattr(state, name) for name in ("done", "crashed", "finished", "worked_on_by")},
            "left_s": state.left_s,
            "last_s": state.last_s,
            "verdicts": [asdict(verdict) for verdict in state.verdicts],
        }
    )


def _print_state(opened: CampaignFolder, state: CampaignStatus, once: bool) -> None:
    from modsim3d.campaign.folder import killed_sentence
    from modsim3d.campaign.report.campaign_page import crash_sections, requirement_blocks
    from modsim3d.cli.campaign_text import MAX_ROWS, present_text

    console = open_console()
    shared.print_line(
        console, f"{state.done:,} of {state.total:,} runs are done, {state.crashed:,} of them crashed", "bold"
    )
    for line in _how(state):
        shared.print_line(console, line)
    if state.finished:
        print_blocks(console, requirement_blocks(opened.plan, state.verdicts))
    elif state.verdicts:
        shared.print_line(console, "")
        shared.print_line(console, "requirements so far" if once else "requirements at the last look", "bold")
        for verdict in state.verdicts[:MAX_ROWS]:
            shared.print_line(console, f"  {present_text(verdict, once)}")
    print_blocks(console, crash_sections(opened, state.table))
    if killed := killed_sentence(opened):
        print_prose(console, killed)


def _how(state: CampaignStatus) -> list[str]:
    from modsim3d.cli.campaign_text import time_left_text

    if state.finished:
        early = state.total - state.done
        return ["finished" + (f": all was decided {early:,} runs before the end of the plan" if early else "")]
    lines = []
    if state.last_s is not None:
        lines.append(f"last rows written {state.last_s:,.0f} s ago")
    if state.worked_on_by is None and state.done == state.total:
        return [*lines, "nobody holds its folder: the same command, without --shard, writes results and verdicts"]
    if state.worked_on_by is None:
        return [*lines, "nobody holds its folder: the same command goes on (parts of a job array are not seen here)"]
    return [*lines, f"worked on by {state.worked_on_by}, {time_left_text(state.left_s)}"]


# ---- The command `modsim3d campaign table` ----

ENDINGS = (".csv", ".parquet")
RUN = "run"  # what `--by` takes in place of a key for the rows of all runs


def campaign_table_command(
    campaign: shared.CampaignArgument,
    by: Annotated[
        list[str] | None,
        option(
            "KEY",
            "Key that varies, to tell apart; may be repeated. run: all columns of each run, in place of means.",
            show_default="all but those drawn",
        ),
    ] = None,
    score: Annotated[
        list[str] | None, option("NAME", "Column of the rows, such as hota or state.haze.hota; may be repeated.")
    ] = None,
    out: Annotated[Path | None, option("FILE", "Table to write, .csv or .parquet.", show_default="none")] = None,
    overwrite: shared.OverwriteOption = False,
) -> None:
    """Mean scores of a campaign by tracker and condition, with 95 % intervals over traffic seeds.

    Example: modsim3d campaign table runs/example --by state --score hota
    """
    from modsim3d.campaign.campaign import complete_batches, rows_of
    from modsim3d.campaign.folder import files_of_campaign, opened_campaign
    from modsim3d.campaign.means import REQUIRED, mean_rows, mean_table, usual_keys, usual_scores, with_required
    from modsim3d.campaign.verdicts.verdict import judge
    from modsim3d.campaign.verdicts.wording import score_name
    from modsim3d.core.document import Text
    from modsim3d.io.overwrite_guard import claimed

    runs = RUN in (by or ())
    _check(runs, score is not None or len(by or ()) > 1, out)
    opened = opened_campaign(campaign)
    if opened.keys.search is not None and not runs:
        reason = "no mean may be made of trials that were chosen to be bad: use --by run"
        raise ModsimError(f"{campaign} holds a search, and {reason}")
    files = files_of_campaign(opened)
    tell_files(files)
    paths = [] if out is None else [out]
    with claimed(paths, overwrite=overwrite, inputs=files):
        with timed("reading the rows"):
            table = rows_of(opened)
        keys = list(by or usual_keys(opened.plan))
        rows = [] if runs else mean_rows(table, keys, list(score or usual_scores(opened.plan, table)))
        if out is not None:
            _write(out, table if runs else flat_table(rows))
    if not runs:
        verdicts = judge(opened.plan, table if opened.finished else complete_batches(opened.plan, table))
        shown = with_required(opened.plan, rows, verdicts)
        print_blocks(open_console(), [mean_table(shown, names=score_name), Text(REQUIRED * (shown != rows), "soft")])
    shared.print_written(open_console(), paths)
    say_json(
        {
            "format": 1,
            "command": "campaign table",
            "folder": campaign,
            "finished": opened.finished,
            "by": [] if runs else [*dict.fromkeys([*keys, "tracker"])],
            "rows": [asdict(row) for row in rows],
            "written": paths,
        }
    )


def _check(runs: bool, selected: bool, out: Path | None) -> None:
    """Raise a `ModsimError` for options that contradict each other, and for a file of another kind."""
    if runs and selected:
        raise ModsimError("--by run writes all columns of each run: leave out --score and other --by")
    if runs and out is None:
        raise ModsimError("--by run writes a file: name it with --out, as in --out runs.csv")
    if out is not None and out.suffix not in ENDINGS:
        raise ModsimError(f"--out {out}: the name must end in {' or '.join(ENDINGS)}")


def flat_table(rows: list[MeanRow]) -> pa.Table:
    """Means as a table: the keys, `runs`, `crashed`, and of each score NAME, NAME_low, NAME_high and NAME_seeds."""
    import pyarrow as pa

    flat: list[dict[str, Any]] = []
    for row in rows:
        cells = {**row.values, "runs": row.runs, "crashed": row.crashed}
        for score, mean in row.means.items():
            cells |= {score: mean.value, f"{score}_low": mean.low, f"{score}_high": mean.high}
            cells[f"{score}_seeds"] = mean.seeds
        flat.append(cells)
    return pa.Table.from_pylist(flat)


def _write(out: Path, table: pa.Table) -> None:
    import pyarrow.csv
    import pyarrow.parquet

    from modsim3d.io.atomic_write import put_in_place

    with put_in_place(out) as partial:
        if out.suffix == ".csv":
            pyarrow.csv.write_csv(table, partial)
        else:
            pyarrow.parquet.write_table(table, partial, compression="zstd")


# ---- The command `modsim3d campaign report` ----


def campaign_report_command(
    context: typer.Context,
    campaign: Annotated[Path, argument("DIR", "Folder of a campaign, finished or not.")],
    out: Annotated[Path | None, option("FILE", "HTML file to write.", show_default="DIR/report.html")] = None,
    overwrite: shared.OverwriteOption = False,
) -> None:
    """Write a page about a campaign: requirements first, then means, charts, the worst runs and what was covered.

    Example: modsim3d campaign report runs/example
    """
    from modsim3d.campaign.folder import files_of_campaign, opened_campaign
    from modsim3d.campaign.report.search_page import report_campaign

    with timed("opening the campaign"):
        tell_files(files_of_campaign(opened_campaign(campaign)))
    with timed("page"), shared.progress("worst runs", None) as advance:
        given = shared.arguments(context, report_campaign, call=shared.typed_command(context))
        written = report_campaign(**given, progress=advance)
    path, (lead,) = written.path, written.notes
    say(lead)
    say(f"written  {path}  ({path.stat().st_size / 1e6:.1f} MB)")
    say_json({"format": 1, "command": "campaign report", "conclusion": lead, "written": [path]})
