"""What became of the faults: rows for the result file, and the table of the page."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.faults.jobs import Outcome, Tried

Rows = dict[str, list[dict[str, Any]]]
"""By the class of faults."""
BEGIN, END = "<!-- written by script/campaign faults -->", "<!-- end of what script/campaign faults writes -->"
TITLES = {
    "kills": "Runs that are killed",
    "calls": "Runs in which one call of the system fails",
    "disk": "Full and read-only disks",
    "power": "Runs that lose power",
    "writers": "Two runs at once",
    "damage": "Damage between interruption and `--resume`",
    "commands": "The other commands",
}
MAX_LENGTH = 300


def rows_of(tried: Sequence[Tried], folder: str) -> list[dict[str, Any]]:
    """A row for each kind of fault, with what failed and which failing calls did not matter."""
    rows = []
    for fault in sorted({one.fault for one in tried}, key=str.casefold):
        ours = [one for one in tried if one.fault == fault]
        counts = Counter(one.outcome for one in ours)
        failures = [f"{one.case}: {_short(one.said)}" for one in ours if one.outcome is Outcome.FAILED]
        no_matter = {_without_numbers(one.case) for one in ours if one.outcome is Outcome.NO_MATTER}
        rows.append(
            {
                "fault": fault,
                "tried": len(ours),
                "outcomes": {outcome.value: counts[outcome] for outcome in Outcome if counts[outcome]},
                "no_matter": sorted(no_matter) if " fails " in fault else [],
                "failures": [failure.replace(folder, "DIR") for failure in failures],
            }
        )
    return rows


def _short(said: str) -> str:
    return re.sub(r"\s+", " ", said)[-MAX_LENGTH:]


def _without_numbers(case: str) -> str:
    """The call and the file of a case, without what differs between calls on one file."""
    return re.sub(r" \d+, (\d+<)?|, \"\".*|>.*", " ", case).strip()


def table(found: Rows) -> str:
    """The rows as a Markdown table, and the failures."""
    good = [outcome for outcome in Outcome if outcome is not Outcome.FAILED]
    lines = [
        "| Fault | Tried | " + " | ".join(outcome.value.capitalize() for outcome in good) + " | Failures |",
        "|---|---" + "|---" * (len(good) + 1) + "|",
    ]
    for name, rows in found.items():
        lines.append(f"| **{TITLES[name]}** |" + " |" * (len(good) + 2))
        for row in rows:
            cells = [str(row["outcomes"].get(outcome.value, "")) for outcome in good]
            lines.append(f"| {row['fault']} | {row['tried']} | {' | '.join(cells)} | {len(row['failures'])} |")
    tried, failed = (
        sum(count(row) for rows in found.values() for row in rows)
        for count in (lambda row: row["tried"], lambda row: len(row["failures"]))
    )
    lines += ["", f"{tried} faults, {failed} failures."]
    return "\n".join(lines)


def read_rows(path: Path) -> Rows:
    """The rows of an earlier campaign; none if there was none."""
    if not path.exists():
        return {}
    rows: Rows = json.loads(path.read_text("utf-8"))["classes"]
    return rows


def write_between(page: Path, content: str) -> None:
    """Put a text between the markers of a page.

    Raises:
        ValueError: The page has no such markers.
    """
    before, begin, rest = page.read_text("utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"{page} has no lines '{BEGIN}' and '{END}'")
    page.write_text(f"{before}{BEGIN}\n{content}\n{END}{after}", encoding="utf-8")
