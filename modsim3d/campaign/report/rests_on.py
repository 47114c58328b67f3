"""What the page of a campaign rests on: its file, its plan and its rows."""

from __future__ import annotations

from modsim3d.campaign.results.files import files_of_campaign
from modsim3d.campaign.results.folder import FILE, CampaignFolder
from modsim3d.campaign.work.task import PLAN
from modsim3d.view.pages.provenance import Input, Provenance, file_input, folder_input, versions_in_words

_ROWS = ".rows", ".parquet"


def rests_on(folder: CampaignFolder, page: str, command: str | None) -> Provenance:
    """What the page of a campaign rests on.

    Args:
        folder: The campaign.
        page: What kind of page it is.
        command: What it was made by; the call from Python if None.
    """
    keys, facts = folder.keys, folder.facts
    search = keys.search
    traffic = f"{search.seeds:,} to choose from" if search else f"{keys.seeds.traffic:,}"
    own = [
        Input("file that the campaign names", name, digest, "when it was planned")
        for name, digest in facts["files"].items()
    ]
    plan = Input(
        "plan", f"sha256 in {PLAN}", facts["sha256"], "of everything that decides a row; what a worker compares"
    )
    return Provenance(
        page=page,
        made_by=command or f"modsim3d.campaign.report.writing.write_page of {folder.path} from Python",
        inputs=(*_files(folder), plan, *own),
        seeds=(("campaign", f"{keys.seed}"),),
        options=(("Traffic seeds", traffic), ("Detector seeds", f"{keys.seeds.detector:,} for each traffic seed")),
        made_before=(("Its rows were made with", versions_in_words(facts["versions"])),),
    )


def _files(folder: CampaignFolder) -> list[Input]:
    read = [path for path in files_of_campaign(folder) if path.is_file()]
    rows = [path for path in read if path.suffix in _ROWS]
    named = {FILE: "campaign file", PLAN: "plan with all checksums"}
    found = [file_input(what, folder.path / name) for name, what in named.items() if (folder.path / name).is_file()]
    return found + ([folder_input("rows of the runs", folder.path, rows)] if rows else [])
