"""The command `modsim3d campaign-report`: the page of a campaign."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modsim3d.commands.progress import progress
from modsim3d.commands.shared import JsonOption, OverwriteOption, QuietOption, VerboseOption, out_file
from modsim3d.commands.terminal import say, say_json, tell_files, timed
from modsim3d.commands.typed import typed_command


def campaign_report_command(
    context: typer.Context,
    campaign: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a campaign, finished or not.")],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="HTML file to write.", show_default="DIR/report.html")
    ] = None,
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
) -> None:
    """Write a page about a campaign: requirements first, then means, charts, the worst runs and what was covered.

    Example: modsim3d campaign-report runs/example
    """
    from modsim3d.campaign.report.campaign_page import REPORT_FILE
    from modsim3d.campaign.report.writing import write_page
    from modsim3d.campaign.results.files import files_of_campaign
    from modsim3d.campaign.results.folder import opened_campaign
    from modsim3d.outputs.claims import claimed

    with timed("opening the campaign"):
        opened = opened_campaign(campaign)
    path, read = out_file(out, campaign / REPORT_FILE), files_of_campaign(opened)
    tell_files(read)
    with timed("page"), claimed([path], overwrite=overwrite, inputs=read), progress("worst runs", None) as advance:
        lead = write_page(opened, path, advance, typed_command(context))
    say(lead)
    say(f"written  {path}  ({path.stat().st_size / 1e6:.1f} MB)")
    say_json({"format": 1, "command": "campaign-report", "conclusion": lead, "written": [path]})
