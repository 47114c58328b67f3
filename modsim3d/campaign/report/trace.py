"""The sections of a page that trace each requirement to its runs, and say how to repeat them."""

from __future__ import annotations

import html
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from modsim3d.arrays import Indices
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.results.done_rows import text_of
from modsim3d.campaign.results.folder import FILE, VERDICTS, CampaignFolder
from modsim3d.campaign.verdicts.verdict import Verdict
from modsim3d.campaign.work.task import PLAN
from modsim3d.view.pages import page
from modsim3d.view.pages.provenance import shown_path

_MOST_RANGES = 6
_MOST_ROWS = 200
"""Of a table; the files of the campaign have all."""
_DIGITS = 16
"""Hexadecimal digits of a checksum on the page; `plan.json` has all."""


def trace_sections(folder: CampaignFolder, table: pa.Table, verdicts: Sequence[Verdict]) -> list[str]:
    """HTML of what each verdict rests on: runs, seeds, checksums, versions, and the commands that repeat it.

    Args:
        folder: The campaign.
        table: Its rows so far, see `results_table`.
        verdicts: The verdicts on its requirements.
    """
    return [
        page.heading("What each verdict rests on"),
        *_verdicts(folder.plan, table, verdicts),
        *_conditions(folder),
        *_repeating(folder, table),
    ]


def _verdicts(plan: Plan, table: pa.Table, verdicts: Sequence[Verdict]) -> Iterator[str]:
    if not verdicts:
        yield page.paragraph("The campaign has no requirements.")
        return
    conditions = table["condition"].to_numpy()
    trackers = table["tracker"].to_numpy(zero_copy_only=False)
    runs, seeds, looks = (table[name].to_numpy() for name in ("run", "traffic_seed", "detector_seed"))
    names, rows = {each.label for each in plan.keys.trackers}, []
    for verdict in verdicts[:_MOST_ROWS]:
        labels = [verdict.tracker]
        if verdict.tracker not in names:  # a difference between two
            requirement = plan.keys.require[verdict.requirement]
            labels = [label for label in (requirement.of, requirement.minus) if label is not None]
        chosen = (conditions == verdict.condition) & np.isin(trackers, labels)
        rows.append(
            [
                f"{verdict.requirement + 1}. {verdict.text}",
                verdict.tracker,
                f"{verdict.condition}",
                verdict.outcome,
                numbers_in_words(runs[chosen]),
                numbers_in_words(np.unique(seeds[chosen])),
                f"{len(np.unique(looks[chosen]))}",
            ]
        )
    header = ["requirement", "tracker", "condition", "outcome", "runs", "traffic seeds", "detector seeds"]
    yield page.table(rows, header)
    yield from _left_out(len(verdicts), VERDICTS)


def _left_out(count: int, file: str) -> Iterator[str]:
    if count > _MOST_ROWS:
        yield page.paragraph(f"{count - _MOST_ROWS} more are in {file}.")


def numbers_in_words(numbers: Indices) -> str:
    """Ascending numbers, shape (n,): `3, 9, … 57 (10, every 6th)`, or ranges; at most six of them."""
    found = numbers.tolist()
    if not found:
        return "none"
    steps = np.diff(numbers)
    if len(found) > 3 and len(set(steps.tolist())) == 1 and steps[0] > 1:
        return f"{found[0]}, {found[1]}, … {found[-1]} ({len(found)} of them, {int(steps[0])} apart)"
    ends = np.flatnonzero(steps != 1)
    firsts, lasts = numbers[np.append(0, ends + 1)], numbers[np.append(ends, -1)]
    ranges = [f"{a}" if a == b else f"{a}–{b}" for a, b in zip(firsts, lasts, strict=True)]
    more = f" and {len(ranges) - _MOST_RANGES} ranges more" if len(ranges) > _MOST_RANGES else ""
    return ", ".join(ranges[:_MOST_RANGES]) + more + (f" ({len(found)} of them)" if len(found) > 1 else "")


def _conditions(folder: CampaignFolder) -> Iterator[str]:
    """Checksums of the scene and the detector of each condition."""
    yield "<h3>Conditions</h3>"
    rows = []
    conditions = folder.facts["conditions"]
    for number, each in enumerate(conditions[:_MOST_ROWS]):
        values = ", ".join(f"{key} {text_of(value)}" for key, value in each["values"].items())
        sums = (each[name][:_DIGITS] for name in ("truth_sha256", "detector_sha256"))
        rows.append([f"{number}", each["scene"], values or "as it is", *sums])
    yield page.table(rows, ["condition", "scene", "values", "SHA-256 of the scene", "SHA-256 of the detector"])
    yield from _left_out(len(conditions), PLAN)
    if folder.plan.drawn:
        keys = ", ".join(folder.plan.drawn)
        yield page.paragraph(f"Checksums are those of the first traffic seed: {keys} differ from seed to seed.", "soft")


def _repeating(folder: CampaignFolder, table: pa.Table) -> Iterator[str]:
    """Versions, the checksum of the plan, and the commands."""
    number = int(table["run"][0].as_py()) if len(table) else 0
    yield "<h3>Versions</h3>"
    versions = dict(folder.facts["versions"])
    for condition in folder.facts["conditions"]:
        for tracker in condition["trackers"].values():
            versions |= tracker["versions"]
    yield page.table([[name, text] for name, text in versions.items()], ["package", "version"])
    yield "<h3>Again</h3>"
    yield page.paragraph(
        f"SHA-256 of the plan: {folder.facts['sha256']}. {PLAN} has all checksums in full. With the same plan and the "
        "same versions the rows come out the same, byte by byte. "
        f"Paths in {FILE} are relative to {shown_path(Path(folder.facts['base']))}."
    )
    path, again = folder.path, f"{folder.path.name}_again"
    commands = {
        "the whole campaign again": ["modsim3d", "campaign", str(path / FILE), "--out", again],
        f"run {number} alone": ["modsim3d", "campaign-run", str(path), str(number), "--out", f"run_{number}"],
    }
    rows = "\n".join(
        f"<tr><td>{html.escape(what)}</td><td><code>{html.escape(shlex.join(words))}</code></td></tr>"
        for what, words in commands.items()
    )
    yield page.scrolling(f"<table>\n{rows}\n</table>")
