"""Single runs on the page: the worst with their pictures, and those that crashed."""

from __future__ import annotations

import html
import shlex
from collections.abc import Callable, Sequence
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.campaign.report.words import Score, in_words, number, values_of, varying
from modsim3d.campaign.results.folder import CampaignFolder
from modsim3d.campaign.verdicts.verdict import Verdict
from modsim3d.campaign.work.row import DONE
from modsim3d.campaign.worst.picture import moment_picture
from modsim3d.campaign.worst.ranking import WorstRun, worst_runs
from modsim3d.campaign.worst.remaking import remade
from modsim3d.display import counted, listed
from modsim3d.errors import ModsimError
from modsim3d.view.pages import page

WORST = 5
"""Runs that are shown with a picture."""
WIDTH_PX, QUALITY = 960, 82
"""Of a picture: pixels, and of JPEG."""
MOST_ERRORS, MOST_NUMBERS = 20, 8


def worst_sections(
    folder: CampaignFolder, table: pa.Table, verdicts: Sequence[Verdict], advance: Callable[[int], None]
) -> list[str]:
    """The worst runs, each with the moment at which it went wrong and the commands that show more.

    Args:
        folder: The campaign.
        table: Its rows.
        verdicts: The verdicts on its requirements.
        advance: Called with 1 after each run.
    """
    found = worst_runs(folder, table, verdicts, WORST) if len(table) else []
    parts = []
    for each in found:
        parts += _worst_run(folder, each)
        advance(1)
    if not parts:
        return []
    return [
        page.heading("The worst runs"),
        page.paragraph(
            "Runs that crashed come first, then the worst run of each requirement, then the second worst of each; "
            "failed requirements come before the others. They say how a tracker fails, and nothing about how often.",
            "soft",
        ),
        *parts,
    ]


def _worst_run(folder: CampaignFolder, each: WorstRun) -> list[str]:
    run = folder.plan.run(each.number)
    values = {**values_of(folder.plan, each.condition), **run.condition.values}
    what = "crashed" if each.value is None else f"{Score(each.score).name} {number(each.value)}"
    if each.requirement is not None:
        what += f" (requirement {each.requirement + 1})"
    said = in_words(values, [*varying(folder.plan), *folder.plan.drawn])
    parts = [
        f"<h3>{html.escape(f'Run {each.number}: {each.tracker}, {what}')}</h3>",
        page.paragraph(f"{said}; traffic seed {each.traffic_seed}, detector seed {each.detector_seed}.", "soft"),
    ]
    if each.moment_s is not None:
        parts.append(_picture(folder, each, each.moment_s))
    commands = [("Make it again", each.again), ("Film the moment", each.film)]
    return [*parts, *(_command(name, line) for name, line in commands if line)]


def _picture(folder: CampaignFolder, each: WorstRun, moment_s: float) -> str:
    """The moment at which a run went wrong; a run that cannot be made again says why."""
    try:
        image = moment_picture(remade(folder, each.number), moment_s, WIDTH_PX)
    except ModsimError as error:
        return page.paragraph(f"There is no picture: {error}", "soft")
    caption = f"Run {each.number} at {moment_s:g} s: what is true, and the tracks of {each.tracker}."
    return page.picture(image, caption, "jpeg", quality=QUALITY)


def _command(name: str, line: str) -> str:
    return f'<p>{html.escape(name)}:<br><code style="overflow-wrap: anywhere">{html.escape(line)}</code></p>'


def crash_sections(folder: CampaignFolder, table: pa.Table) -> list[str]:
    """The runs that crashed, by their error."""
    crashed = table.filter(pc.not_equal(table["status"], DONE)).select(["run", "tracker", "error"])
    if not len(crashed):
        return []
    by_error: dict[str, list[dict[str, Any]]] = {}
    for row in crashed.to_pylist():
        by_error.setdefault(row["error"] or "unknown", []).append(row)
    ordered = sorted(by_error.items(), key=lambda each: (-len(each[1]), each[1][0]["run"]))
    rows = [
        (
            f"{len(found):,}",
            error,
            listed(list(dict.fromkeys(row["tracker"] for row in found))),
            listed([str(row["run"]) for row in found], MOST_NUMBERS),
        )
        for error, found in ordered[:MOST_ERRORS]
    ]
    said = (
        f"{counted(len(crashed), 'run')} of {len(table):,} crashed. Means and charts are of the other runs; "
        "requirements count each crash as wrong, or stay undecided. To see an error again:"
    )
    first, path = ordered[0][1][0]["run"], folder.path
    again = (
        f"modsim3d campaign-run {shlex.quote(str(path))} {first} --out {shlex.quote(str(path / 'runs' / str(first)))}"
    )
    more = f" The {MOST_ERRORS} most frequent errors are shown." if len(ordered) > MOST_ERRORS else ""
    return [
        page.heading("Runs that crashed"),
        page.paragraph(said, "soft"),
        _command("Make the first again", again),
        page.table(rows, ("runs", "error", "trackers", "numbers of the runs")),
        *([page.paragraph(more.strip(), "soft")] if more else []),
    ]
