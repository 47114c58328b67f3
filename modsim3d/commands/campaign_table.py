"""The command `modsim3d campaign-table`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modsim3d.commands.shared import (
    CampaignArgument,
    JsonOption,
    OverwriteOption,
    QuietOption,
    VerboseOption,
    print_written,
)
from modsim3d.commands.terminal import open_console, say_json, tell_files, timed
from modsim3d.errors import ModsimError

if TYPE_CHECKING:
    import pyarrow as pa

    from modsim3d.campaign.results.means import MeanRow

ENDINGS = (".csv", ".parquet")


def campaign_table_command(
    campaign: CampaignArgument,
    by: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY", help="Varied key to tell apart; may be repeated.", show_default="all but those drawn"
        ),
    ] = None,
    score: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Column of the rows, such as hota or state.haze.hota; may be repeated."),
    ] = None,
    runs: Annotated[bool, typer.Option("--runs", help="Write all columns of each run, in place of means.")] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Table to write, .csv or .parquet.", show_default="none")
    ] = None,
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
) -> None:
    """Mean scores of a campaign by tracker and condition, with 95 % intervals over traffic seeds.

    Example: modsim3d campaign-table runs/example --by state --score hota
    """
    from modsim3d.campaign.results.files import files_of_campaign
    from modsim3d.campaign.results.folder import opened_campaign
    from modsim3d.campaign.results.means import mean_rows, usual_keys, usual_scores
    from modsim3d.campaign.rows import has_ended, rows_of
    from modsim3d.commands.campaign_text import print_means
    from modsim3d.outputs.claims import claimed

    _check(runs, bool(by or score), out)
    opened = opened_campaign(campaign)
    if opened.keys.search is not None and not runs:
        raise ModsimError(
            f"{campaign} holds a search, and no mean may be made of trials that were chosen to be bad: use --runs"
        )
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
        print_means(open_console(), "mean scores [95 % interval over traffic seeds]", rows, most=None)
    print_written(open_console(), paths)
    say_json(
        {
            "format": 1,
            "command": "campaign-table",
            "folder": campaign,
            "finished": has_ended(opened),
            "by": [] if runs else [*dict.fromkeys([*keys, "tracker"])],
            "rows": [asdict(row) for row in rows],
            "written": paths,
        }
    )


def _check(runs: bool, selected: bool, out: Path | None) -> None:
    """Refuse options that contradict each other, and a file of another kind.

    Raises:
        ModsimError: They do, or it is.
    """
    if runs and selected:
        raise ModsimError("--runs writes all columns of each run: leave out --by and --score")
    if runs and out is None:
        raise ModsimError("--runs writes a file: name it with --out, as in --out runs.csv")
    if out is not None and out.suffix not in ENDINGS:
        raise ModsimError(f"--out {out}: the name must end in {' or '.join(ENDINGS)}")


def flat_table(rows: list[MeanRow]) -> pa.Table:
    """Means as a table: the keys, `runs`, `crashed`, and of each score NAME, NAME_low, NAME_high and NAME_seeds."""
    import pyarrow as pa

    flat: list[dict[str, Any]] = []
    for row in rows:
        cells = {**row.values, "runs": row.runs, "crashed": row.crashed}
        for score, mean in row.means.items():
            cells |= {
                score: mean.value,
                f"{score}_low": mean.low,
                f"{score}_high": mean.high,
                f"{score}_seeds": mean.seeds,
            }
        flat.append(cells)
    return pa.Table.from_pylist(flat)


def _write(out: Path, table: pa.Table) -> None:
    import pyarrow.csv
    import pyarrow.parquet

    from modsim3d.outputs.placing import put_in_place

    with put_in_place(out) as partial:
        if out.suffix == ".csv":
            pyarrow.csv.write_csv(table, partial)
        else:
            pyarrow.parquet.write_table(table, partial, compression="zstd")
