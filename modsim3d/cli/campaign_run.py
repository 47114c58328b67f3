"""The commands `modsim3d campaign run` and `modsim3d campaign plan`."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modsim3d.cli import shared
from modsim3d.cli.shared import argument, option
from modsim3d.cli.terminal import open_console, say, say_json, tell_files, timed, warn
from modsim3d.cli.terminal_tables import print_blocks, print_prose, print_table
from modsim3d.core.errors import ModsimError
from modsim3d.core.text import three_digits

if TYPE_CHECKING:
    from modsim3d.campaign.done_rows import NeededSeeds
    from modsim3d.campaign.plan import Plan
    from modsim3d.campaign.running import CampaignResult
    from modsim3d.campaign.search import SearchResult
    from modsim3d.campaign.verdicts.verdict import Verdict
    from modsim3d.campaign.work.checking import CheckedCampaign

FORMAT = 1
FAILED, UNDECIDED = 1, 3  # exit status if a requirement failed, and if none failed but one is undecided
MAX_SHARDS = 100_000


def _shard(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([0-9]{1,6})/([0-9]{1,6})", text)
    part, parts = (int(match[1]), int(match[2])) if match else (0, 0)
    if not 1 <= part <= parts <= MAX_SHARDS:
        raise ModsimError(f"--shard: needs K/N with K from 1 to N and N at most {MAX_SHARDS:,} (got '{text[:40]}')")
    return part, parts


def _cluster(text: str) -> dict[str, Any]:
    """The arguments of `engine_of` for a Dask cluster."""
    kind, _, jobs = text.partition(":")
    if kind != "slurm":
        return {"scheduler": text}
    if not jobs.isdecimal() or not 1 <= int(jobs) <= MAX_SHARDS:
        raise ModsimError(f"--cluster: needs slurm:JOBS with JOBS from 1 to {MAX_SHARDS:,} (got '{text[:40]}')")
    return {"slurm": int(jobs)}


CampaignFileArgument = Annotated[
    str,
    argument(
        "CAMPAIGN",
        "Campaign file, or name of a shipped campaign, such as example.",
        autocompletion=shared.complete_campaign,
    ),
]


def campaign_run_command(
    campaign: CampaignFileArgument,
    out: Annotated[
        Path | None,
        option("DIR", "Folder of the campaign, new or with a part of its runs.", show_default="runs/CAMPAIGN"),
    ] = None,
    workers: shared.WorkersOption = "auto",
    cluster: Annotated[
        Any,
        option(
            "ADDRESS|slurm:JOBS",
            "Work on a Dask cluster: its scheduler, such as tcp://10.0.0.1:8786, or so many Slurm jobs.",
            parser=_cluster,
        ),
    ] = None,
    shard: Annotated[
        Any, option("K/N", "Make one part of N only, as a job of an array; gather them without it.", parser=_shard)
    ] = None,
    cache: Annotated[
        Path | None, option("DIR", "Where kept layers are read and written.", show_default="DIR/cache")
    ] = None,
) -> None:
    """Run a campaign, or go on with one that was interrupted: many runs, their scores, verdicts on requirements.

    Exit status: 0 all requirements are met, 1 one failed, 3 one is undecided, 2 wrong input.

    Example: modsim3d campaign run example --out runs/example
    """
    from modsim3d.campaign.campaign import engine_of
    from modsim3d.campaign.folder import killed_sentence
    from modsim3d.campaign.means import same_detections
    from modsim3d.campaign.running import run_plan
    from modsim3d.cli.campaign_text import campaign_progress

    if shard is not None and cluster is not None:
        raise ModsimError("--shard is for jobs without a scheduler: leave out --cluster, or --shard")
    engine = engine_of(workers, **(cluster or {}))
    setup = read(campaign)
    if shard is not None and setup.file.keys.search is not None:
        raise ModsimError("--shard: what a search runs next depends on all that it has run: leave --shard out")
    folder = out if out is not None else Path("runs") / setup.file.path.stem
    warnings = introduced(setup)
    kept = f"; runs that are done are kept in {folder}: the same command goes on"
    bar = campaign_progress(folder, setup.file.keys.stop == "once")
    with timed("runs"), shared.interruptible(kept), shared.stoppable(), bar as advance:
        if setup.file.keys.search is None:
            result = run_plan(setup, folder, engine, shard=shard, cache=cache, progress=advance)
        else:
            from modsim3d.campaign.search import run_search

            searched = run_search(setup, folder, engine, cache=cache, progress=advance)
    if setup.file.keys.search is not None:
        _print_search(searched)
        say_json({**_json(setup, folder, warnings), "finished": True, "trials": len(searched.table)})
        return
    if result is None:
        gather = f"modsim3d campaign run {shlex.quote(campaign)} --out {shlex.quote(str(folder))}"
        say(f"part {shard[0]} of {shard[1]} is done; gather all with: {gather}")
        say_json(_json(setup, folder, warnings))
        return
    _print_result(result)
    if killed := killed_sentence(result.folder):
        warn(killed)
        warnings.append(killed)
    for text in (same := same_detections(result.folder.plan, result.table)):
        warn(text)
    say_json(_json(setup, folder, [*warnings, *same]) | _result_json(result))
    if status := exit_status(result.verdicts):
        raise typer.Exit(status)


def read(campaign: str) -> CheckedCampaign:
    """A campaign, read and checked."""
    from modsim3d.campaign.keys import read_campaign
    from modsim3d.campaign.work.checking import checked

    with timed("reading and checking the campaign"):
        setup = checked(read_campaign(campaign))
    tell_files([setup.file.path])
    return setup


def exit_status(verdicts: tuple[Verdict, ...]) -> int:
    """The exit status that verdicts come to."""
    outcomes = {verdict.outcome for verdict in verdicts}
    return FAILED if "failed" in outcomes else UNDECIDED if "undecided" in outcomes else 0


def introduced(campaign: CheckedCampaign) -> list[str]:
    """Print the plan before it starts; the warnings about it."""
    from modsim3d.campaign.verdicts.wording import warnings_of
    from modsim3d.cli.campaign_text import plan_rows, program_warnings, traffic_warnings

    console = open_console()
    shared.print_line(console, str(campaign.file.path), "bold")
    print_table(console, "", plan_rows(campaign), styles=("dim", ""))
    warnings = [*traffic_warnings(campaign), *program_warnings(campaign), *warnings_of(campaign.plan)]
    for note in campaign.notes:
        print_prose(console, f"Note: {note}.")
    for text in warnings:
        warn(text)
    return warnings


def _print_result(result: CampaignResult) -> None:
    from modsim3d.campaign.report.campaign_page import compared_blocks, requirement_blocks

    console, folder = open_console(), result.folder.path
    print_blocks(console, requirement_blocks(result.folder.plan, result.verdicts))
    print_blocks(console, compared_blocks(result.folder, result.table, result.verdicts))
    shared.print_line(console, "")
    print_prose(console, _conclusion(result), "bold")
    shared.print_path(console, "campaign", folder)
    for command in ("report", "table"):
        shared.print_line(console, f"  modsim3d campaign {command} {shlex.quote(str(folder))}", "dim")


def _conclusion(result: CampaignResult) -> str:
    from modsim3d.campaign.campaign import Campaign

    conclusion = Campaign(result.folder.path, result.table, result.verdicts, True).conclusion
    early = len(result.folder.plan) - len(result.table)
    return conclusion + (f"; all was decided {early:,} runs before the end of the plan" if early else "")


def _print_search(result: SearchResult) -> None:
    from modsim3d.campaign.plan import value_text

    console = open_console()
    shared.print_line(console, "")
    print_prose(console, str(result), "bold")
    for finding in result.findings:
        shared.print_line(console, "")
        values = ", ".join(f"{key} {value_text(value)}" for key, value in finding.values.items())
        outcome = finding.error if finding.value is None else three_digits(finding.value)
        print_prose(console, f"trial {finding.number}: {outcome}; traffic seed {finding.traffic_seed}, {values}")
        shared.print_line(console, f"  {finding.again}", "dim")
    shared.print_path(console, "search", result.folder.path)
    shared.print_line(console, f"  modsim3d campaign report {shlex.quote(str(result.folder.path))}", "dim")


def _json(campaign: CheckedCampaign, folder: Path | None, warnings: list[str], command: str = "run") -> dict[str, Any]:
    return {
        "format": FORMAT,
        "command": f"campaign {command}",
        "campaign": campaign.file.path,
        "folder": folder,
        "sha256": campaign.sha256,
        "runs": len(campaign.plan),
        "frames": None,
        "needed": [],
        "finished": False,
        **dict.fromkeys(("done", "crashed", "trials"), None),
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


# ---- How many runs there will be, and how many seeds each requirement needs ----


def campaign_plan_command(
    campaign: CampaignFileArgument,
    expect: Annotated[
        list[str] | None,
        option(
            "SCORE=MEAN:SPREAD",
            "Expected mean and spread of a score over traffic seeds; may be repeated.",
            show_default="none",
        ),
    ] = None,
    like: Annotated[Path | None, option("DIR", "Earlier campaign of this kind, which says what is expected.")] = None,
) -> None:
    """Say how many runs a campaign has and how many seeds its requirements need, without running it.

    Example: modsim3d campaign plan example --expect hota=0.6:0.05
    """
    setup = read(campaign)
    warnings = introduced(setup)
    say_json({**_json(setup, None, warnings, "plan"), **_told_plan(setup, expect or [], like)})


def _told_plan(campaign: CheckedCampaign, expect: Sequence[str], like: Path | None) -> dict[str, Any]:
    """Print how many frames and seeds there will be and are needed; the same for JSON. Raises as `plan_campaign`."""
    from modsim3d.campaign.campaign import plan_campaign

    plan, console = plan_campaign(campaign, expect=expect, like=like), open_console()
    shared.print_line(console, f"{plan.runs:,} runs of {plan.frames:,} frames together")
    if plan.needed:
        rows = [_needed_row(campaign.plan, need) for need in plan.needed]
        header = ("requirement", "tracker", "condition", "seeds needed", "why")
        print_table(console, "traffic seeds needed", rows, header=header, right=(3,))
        print_prose(
            console,
            "Seeds needed by a mean: so many that the bound of its verdict is beyond the threshold in 80 % of such "
            "campaigns, if the means of seeds are normal values with this mean and spread, and no run is lost.",
            "dim",
        )
    return {"frames": plan.frames, "needed": [asdict(need) for need in plan.needed]}


def _needed_row(plan: Plan, need: NeededSeeds) -> tuple[str, ...]:
    from modsim3d.campaign.plan import values_text
    from modsim3d.campaign.verdicts.wording import with_name
    from modsim3d.core.text import UNKNOWN

    values = "all" if need.condition is None else values_text(plan.conditions[need.condition].values)
    seeds = UNKNOWN if need.seeds is None else f"{need.seeds:,}"
    return (with_name(need.text), need.tracker or "all", values, seeds, need.why)
