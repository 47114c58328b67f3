"""The command `modsim3d campaign`."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modsim3d.cli.completion import complete_campaign
from modsim3d.cli.shared import (
    INTERRUPTED,
    JsonOption,
    QuietOption,
    Stopped,
    VerboseOption,
    WorkersOption,
    print_line,
    print_path,
    stoppable,
)
from modsim3d.cli.terminal import (
    open_console,
    print_blocks,
    print_prose,
    print_table,
    say,
    say_json,
    tell_files,
    timed,
    warn,
)
from modsim3d.core.errors import ModsimError

if TYPE_CHECKING:
    from modsim3d.campaign.running import CampaignResult
    from modsim3d.campaign.search import SearchResult
    from modsim3d.campaign.verdicts.verdict import Verdict
    from modsim3d.campaign.work.checking import CheckedCampaign

FORMAT = 1
FAILED, UNDECIDED = 1, 3
"""Exit status if a requirement failed, and if none failed but one is undecided."""
MAX_SHARDS = 100_000


def _shard(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"([0-9]{1,6})/([0-9]{1,6})", text)
    part, parts = (int(found[1]), int(found[2])) if found else (0, 0)
    if not 1 <= part <= parts <= MAX_SHARDS:
        raise ModsimError(f"--shard: needs K/N with K from 1 to N and N at most {MAX_SHARDS:,} (got '{text[:40]}')")
    return part, parts


def _check(cluster: bool, shard: bool, plan: bool, expected: bool) -> None:
    """Refuse options that contradict each other.

    Raises:
        ModsimError: They do.
    """
    if shard and cluster:
        raise ModsimError("--shard is for jobs without a scheduler: leave out --scheduler and --slurm, or --shard")
    if plan and (cluster or shard):
        raise ModsimError("--plan runs nothing: leave out --scheduler, --slurm and --shard")
    if expected and not plan:
        raise ModsimError("--expect and --like are for --plan: a campaign that is run has scores of its own")


def campaign_command(
    campaign: Annotated[
        str,
        typer.Argument(
            metavar="CAMPAIGN",
            help="Campaign file, or name of a shipped campaign, such as example.",
            autocompletion=complete_campaign,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder of the campaign, new or with a part of its runs.", show_default="runs/CAMPAIGN"
        ),
    ] = None,
    workers: WorkersOption = "auto",
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Work on a Dask cluster: its scheduler, such as tcp://10.0.0.1:8786."),
    ] = None,
    slurm: Annotated[
        int | None, typer.Option(min=1, metavar="JOBS", help="Work in so many Slurm jobs, as Dask is configured.")
    ] = None,
    shard: Annotated[
        Any,
        typer.Option(
            parser=_shard, metavar="K/N", help="Make one part of N only, as a job of an array; gather them without it."
        ),
    ] = None,
    plan: Annotated[
        bool, typer.Option("--plan", help="Run nothing: say how many runs there are and how many seeds are needed.")
    ] = False,
    expect: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SCORE=MEAN:SPREAD",
            help="With --plan: what is expected of a score over traffic seeds; may be repeated.",
            show_default="none",
        ),
    ] = None,
    like: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="With --plan: an earlier campaign of this kind.", show_default="none"),
    ] = None,
    cache: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Where kept layers are read and written.", show_default="DIR/cache"),
    ] = None,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
) -> None:
    """Run a campaign, or go on with one that was interrupted: many runs, their scores, verdicts on requirements.

    Exit status: 0 all requirements are met, 1 one failed, 3 one is undecided, 2 wrong input.

    Example: modsim3d campaign example --out runs/example
    """
    from modsim3d.campaign.campaign import engine_of
    from modsim3d.campaign.folder import killed_sentence
    from modsim3d.campaign.keys import read_campaign
    from modsim3d.campaign.means import same_detections
    from modsim3d.campaign.running import run_plan
    from modsim3d.campaign.work.checking import checked
    from modsim3d.cli.campaign_progress import campaign_progress

    _check(bool(scheduler or slurm), shard is not None, plan, bool(expect or like))
    engine = engine_of(workers, scheduler, slurm)
    with timed("reading and checking the campaign"):
        found = checked(read_campaign(campaign))
    if shard is not None and found.file.keys.search is not None:
        raise ModsimError("--shard: what a search runs next depends on all that it has run: leave --shard out")
    tell_files([found.file.path])
    folder = out if out is not None else Path("runs") / found.file.path.stem
    warnings = _introduced(found)
    if plan:
        from modsim3d.cli.campaign_plan import told_plan

        needed = told_plan(found, expect or [], like)
        say_json({**_json(found, folder, warnings), "folder": None, **needed})
        return
    with timed("runs"), _interruptible(folder), campaign_progress(folder, found.file.keys.stop == "once") as advance:
        if found.file.keys.search is not None:
            from modsim3d.campaign.search import run_search

            searched = run_search(found, folder, engine, cache=cache, progress=advance)
            result = None
        else:
            searched = None
            result = run_plan(found, folder, engine, shard=shard, cache=cache, progress=advance)
    if searched is not None:
        _print_search(searched)
        say_json({**_json(found, folder, warnings), "finished": True, "trials": len(searched.table)})
        return
    if result is None:
        gather = f"modsim3d campaign {shlex.quote(campaign)} --out {shlex.quote(str(folder))}"
        say(f"part {shard[0]} of {shard[1]} is done; gather all with: {gather}")
        say_json(_json(found, folder, warnings))
        return
    _print_result(result)
    if killed := killed_sentence(result.folder):
        warn(killed)
        warnings.append(killed)
    for text in (same := same_detections(result.folder.plan, result.table)):
        warn(text)
    say_json(_json(found, folder, [*warnings, *same]) | _result_json(result))
    if status := exit_status(result.verdicts):
        raise typer.Exit(status)


def exit_status(verdicts: tuple[Verdict, ...]) -> int:
    """The exit status that verdicts come to."""
    outcomes = {verdict.outcome for verdict in verdicts}
    return FAILED if "failed" in outcomes else UNDECIDED if "undecided" in outcomes else 0


@contextmanager
def _interruptible(folder: Path) -> Iterator[None]:
    """End the command after Ctrl-C or when the system stops it, and say how to go on."""
    try:
        with stoppable():
            yield
    except KeyboardInterrupt as stop:
        kept = f"runs that are done are kept in {folder}"
        say(f"\nmodsim3d: interrupted; {kept}: the same command goes on", err=True)
        raise typer.Exit(stop.status if isinstance(stop, Stopped) else INTERRUPTED) from None


def _introduced(campaign: CheckedCampaign) -> list[str]:
    """Print the plan before it starts; the warnings about it."""
    from modsim3d.campaign.verdicts.wording import warnings_of
    from modsim3d.cli.campaign_text import plan_rows, traffic_warnings

    console = open_console()
    print_line(console, str(campaign.file.path), "bold")
    print_table(console, "", plan_rows(campaign), styles=("dim", ""))
    warnings = [*traffic_warnings(campaign), *warnings_of(campaign.plan)]
    for text in warnings:
        warn(text)
    return warnings


def _print_result(result: CampaignResult) -> None:
    from modsim3d.campaign.report.campaign_page import compared_blocks, requirement_blocks

    console, folder = open_console(), result.folder.path
    print_blocks(console, requirement_blocks(result.folder.plan, result.verdicts))
    print_blocks(console, compared_blocks(result.folder, result.table, result.verdicts))
    print_line(console, "")
    print_prose(console, _conclusion(result), "bold")
    print_path(console, "campaign", folder)
    for command in ("campaign-report", "campaign-table"):
        print_line(console, f"  modsim3d {command} {shlex.quote(str(folder))}", "dim")


def _conclusion(result: CampaignResult) -> str:
    from modsim3d.campaign.campaign import Campaign

    conclusion = Campaign(result.folder.path, result.table, result.verdicts, True).conclusion
    early = len(result.folder.plan) - len(result.table)
    return conclusion + (f"; all was decided {early:,} runs before the end of the plan" if early else "")


def _print_search(result: SearchResult) -> None:
    console = open_console()
    print_line(console, "")
    print_prose(console, str(result), "bold")
    for finding in result.findings:
        print_line(console, "")
        values = ", ".join(f"{key} {value}" for key, value in finding.values.items())
        said = finding.error if finding.value is None else f"{finding.value:.4g}"
        print_prose(console, f"trial {finding.number}: {said}; traffic seed {finding.traffic_seed}, {values}")
        print_line(console, f"  {finding.again}", "dim")
    print_path(console, "search", result.folder.path)
    print_line(console, f"  modsim3d campaign-report {shlex.quote(str(result.folder.path))}", "dim")


def _json(campaign: CheckedCampaign, folder: Path, warnings: list[str]) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "command": "campaign",
        "campaign": campaign.file.path,
        "folder": folder,
        "sha256": campaign.sha256,
        "runs": len(campaign.plan),
        "frames": None,
        "needed": [],
        "finished": False,
        "done": None,
        "crashed": None,
        "trials": None,
        "verdicts": [],
        "means": [],
        "warnings": warnings,
    }


def _result_json(result: CampaignResult) -> dict[str, Any]:
    from modsim3d.campaign.campaign import crashed_runs
    from modsim3d.campaign.means import mean_rows, usual_keys, usual_scores

    plan = result.folder.plan
    return {
        "finished": True,
        "done": len(result.table),
        "crashed": crashed_runs(result.table),
        "verdicts": [asdict(verdict) for verdict in result.verdicts],
        "means": [asdict(row) for row in mean_rows(result.table, usual_keys(plan), usual_scores(plan, result.table))],
    }
