"""The page of a campaign: the verdict first, then what it rests on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.report.compared import mean_sections, paired_sections
from modsim3d.campaign.report.coverage import coverage_sections, trace_sections
from modsim3d.campaign.report.parameter_charts import parameter_sections
from modsim3d.campaign.report.requirements import requirement_sections, verdict_sentence
from modsim3d.campaign.report.rests_on import rests_on
from modsim3d.campaign.report.runs_shown import crash_sections, worst_sections
from modsim3d.campaign.report.words import constant
from modsim3d.campaign.results.deaths import killed_sentence
from modsim3d.campaign.results.folder import CampaignFolder
from modsim3d.campaign.results.gather import results_table
from modsim3d.campaign.results.same_detections import same_detections
from modsim3d.campaign.verdicts.judging import judged
from modsim3d.campaign.verdicts.levels import levels_of
from modsim3d.campaign.verdicts.verdict import Verdict
from modsim3d.campaign.work.row import DONE
from modsim3d.display import counted, listed
from modsim3d.outputs.placing import write_files
from modsim3d.view.pages import page

REPORT_FILE = "report.html"


def write_campaign_page(
    folder: CampaignFolder,
    path: Path,
    advance: Callable[[int], None] = lambda done: None,
    command: str | None = None,
) -> str:
    """Write the page of a campaign.

    Args:
        folder: The campaign, finished or not.
        path: The file.
        advance: Called with 1 after each picture.
        command: What the page says it was made by; the call from Python if None.

    Returns:
        The verdict in a sentence.

    Raises:
        ModsimError: The results are damaged, or the page cannot be written.
    """
    table = results_table(folder)
    verdicts = judged(folder.plan, table)
    write_files({path: campaign_page(folder, table, verdicts, advance, command)})
    return lead(folder, table, verdicts)


def campaign_page(
    folder: CampaignFolder,
    table: pa.Table,
    verdicts: Sequence[Verdict],
    advance: Callable[[int], None] = lambda done: None,
    command: str | None = None,
) -> str:
    """The page as HTML.

    Args:
        folder: The campaign.
        table: Its rows, see `results_table`.
        verdicts: The verdicts on its requirements.
        advance: Called with 1 after each picture.
        command: What the page says it was made by; the call from Python if None.
    """
    plan = folder.plan
    body = [
        page.paragraph(lead(folder, table, verdicts), "lead"),
        *(page.paragraph(text, kind) for text, kind in cautions(folder, table)),
        page.facts(facts(folder, table)),
    ]
    if plan.keys.require:
        body += [page.heading("Requirements"), *requirement_sections(plan, verdicts), *_levels(plan)]
    if len(table):
        body += [page.heading("Means"), *mean_sections(plan, table), *paired_sections(plan, table)]
        body += parameter_sections(plan, table)
        body += worst_sections(folder, table, verdicts, advance)
        body += crash_sections(folder, table)
        body += [*coverage_sections(folder, table), *trace_sections(folder, table, verdicts)]
    asked = "are its requirements met?" if plan.keys.require else "what does it compare?"
    title = f"Campaign {folder.path.resolve().name}: {asked}"
    return page.page(title, body, rests_on(folder, "results of a campaign", command))


def lead(folder: CampaignFolder, table: pa.Table, verdicts: Sequence[Verdict]) -> str:
    """The first sentence of the page."""
    if folder.finished:
        return verdict_sentence(folder.plan, verdicts)
    done = f"{len(table):,} of {counted(len(folder.plan), 'run')} are done"
    return f"Not finished: {done}, and nothing on this page is a verdict."


def cautions(folder: CampaignFolder, table: pa.Table) -> list[tuple[str, str]]:
    """What a reader must know before the numbers, with how it is set."""
    plan, found = folder.plan, []
    if crashed := len(table) - int(pc.sum(pc.equal(table["status"], DONE)).as_py() or 0):
        found.append((f"{counted(crashed, 'run')} of {len(table):,} crashed: see below.", "bad"))
    if killed := killed_sentence(folder):
        found.append((killed, ""))
    found += [(f"{text[0].upper()}{text[1:]}.", "bad") for text in same_detections(plan, table)]
    fixed = dict.fromkeys(each["scene"] for each in folder.facts["conditions"] if not each["traffic_has_seed"])
    if fixed:
        said = f"This traffic only: vessels in {listed(list(fixed))} move the same way with every seed. "
        found.append((said + "Seeds change the detector and the waves; no result speaks of other traffic.", ""))
    if plan.keys.uncertainty == "learned":
        said = "The detector's parameters are drawn for each traffic seed from the intervals that learn wrote, so the "
        said += "intervals are wider where its test set was small. A mean is one over all detectors that this set "
        found.append((said + "allows: with many seeds its interval is narrow, however small the set.", ""))
    return found


def facts(folder: CampaignFolder, table: pa.Table) -> list[tuple[str, str]]:
    """What was run."""
    plan, keys = folder.plan, folder.keys
    seconds = pc.sum(table["simulated_s"]).as_py() or 0.0
    simulated = f"{seconds / 3600:,.1f} h" if seconds >= 3600 else f"{seconds / 60:.1f} min"
    runs = f"{len(table):,}" + ("" if len(table) == len(plan) else f" of {len(plan):,}")
    stop = f"sequential: looked at after every {counted(keys.batch, 'traffic seed')}"
    rows = [
        ("runs", f"{runs}; {simulated} simulated"),
        ("scenes", listed(list(dict.fromkeys(each["scene"] for each in folder.facts["conditions"])), 12)),
        ("trackers", listed([each.label for each in keys.trackers], 12)),
        ("conditions", f"{len(plan.conditions):,}"),
        ("seeds", f"{counted(keys.seeds.traffic, 'traffic seed')}, {keys.seeds.detector:,} of the detector for each"),
        ("the same everywhere", ", ".join(f"{key} {value}" for key, value in constant(plan).items())),
        ("stop", stop if keys.stop == "sequential" else "once: the number of seeds was fixed beforehand"),
        ("SHA-256 of the plan", folder.facts["sha256"]),
    ]
    return [(name, value) for name, value in rows if value]


def _levels(plan: Plan) -> list[str]:
    """At which level the requirements hold together."""
    return ["<h3>How often verdicts are wrong</h3>", page.paragraph(" ".join(levels_of(plan).sentences()))]
