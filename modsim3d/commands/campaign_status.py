"""The command `modsim3d campaign-status`."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from modsim3d.commands.shared import CampaignArgument, JsonOption, QuietOption, VerboseOption, print_line
from modsim3d.commands.tables import print_prose
from modsim3d.commands.terminal import open_console, say_json, timed

if TYPE_CHECKING:
    from modsim3d.campaign.present import Present
    from modsim3d.campaign.results.folder import CampaignFolder


def campaign_status_command(
    campaign: CampaignArgument,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
) -> None:
    """Say how far a campaign is and what is known of its requirements, while it is worked on or afterwards.

    Example: modsim3d campaign-status runs/example
    """
    from modsim3d.campaign.present import present_state
    from modsim3d.campaign.results.folder import opened_campaign

    with timed("reading the rows"):
        opened = opened_campaign(campaign)
        found = present_state(opened)
    _print_state(opened, found, opened.keys.stop == "once")
    say_json(
        {
            "format": 1,
            "command": "campaign-status",
            "folder": campaign,
            "runs": found.total,
            "done": found.done,
            "crashed": found.crashed,
            "finished": found.finished,
            "worked_on_by": found.worked_on_by,
            "left_s": found.left_s,
            "last_s": found.last_s,
            "verdicts": [asdict(verdict) for verdict in found.verdicts],
        }
    )


def _print_state(opened: CampaignFolder, found: Present, once: bool) -> None:
    from modsim3d.campaign.results.deaths import killed_sentence
    from modsim3d.commands.campaign_progress import present_text
    from modsim3d.commands.campaign_text import MOST_ROWS, print_crashed, print_verdicts

    console = open_console()
    print_line(console, f"{found.done:,} of {found.total:,} runs are done, {found.crashed:,} of them crashed", "bold")
    for line in _how(found):
        print_line(console, line)
    if found.finished:
        print_verdicts(console, "requirements", found.verdicts, reasons=True)
    elif found.verdicts:
        print_line(console, "")
        print_line(console, "requirements so far" if once else "requirements at the last look", "bold")
        for verdict in found.verdicts[:MOST_ROWS]:
            print_line(console, f"  {present_text(verdict, once)}")
    print_crashed(console, found.table, opened.path)
    if killed := killed_sentence(opened):
        print_prose(console, killed)


def _how(found: Present) -> list[str]:
    from modsim3d.commands.campaign_text import duration_text

    if found.finished:
        early = found.total - found.done
        return ["finished" + (f": all was decided {early:,} runs before the end of the plan" if early else "")]
    lines = []
    if found.last_s is not None:
        lines.append(f"last rows written {found.last_s:,.0f} s ago")
    if found.worked_on_by is None and found.done == found.total:
        return [*lines, "nobody holds its folder: the same command, without --shard, writes results and verdicts"]
    if found.worked_on_by is None:
        return [*lines, "nobody holds its folder: the same command goes on (parts of a job array are not seen here)"]
    return [*lines, f"worked on by {found.worked_on_by}, {duration_text(found.left_s)}"]
