"""The page of a run as text: the player's files, the recording and the tables in one."""

from __future__ import annotations

import base64
import hashlib
import html
import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import orjson

from modsim3d.view.pages.page import heading, table
from modsim3d.view.report.count_tables import STATE_HEADER, VESSEL_HEADER, Rows
from modsim3d.view.report.recording import Recording

SCRIPTS = ("recording.js", "picture.js", "timeline.js", "player.js")
"""In the order in which they need each other; in the page they are one script."""


@dataclass(frozen=True, eq=False)
class Page:
    """What the page says.

    Attributes:
        name: Name of the scene.
        recording: The frames, for the player.
        settings: The settings in `run.json`.
        overall: Rows of the table of counts.
        by_vessel: Rows of the table of counts by vessel.
        by_state: Rows of the table of counts by performance state.
        steps: Number of steps that are there.
        planned_steps: Number of steps of the scene.
        finished: Whether the run is finished.
        every: Every K-th step is shown.
        related: Addresses and titles of other pages of the run.
    """

    name: str
    recording: Recording
    settings: dict[str, Any]
    overall: Rows
    by_vessel: Rows
    by_state: Rows
    steps: int
    planned_steps: int
    finished: bool
    every: int
    related: Sequence[tuple[str, str]]


def report_page(page: Page) -> str:
    """The whole page. The same run gives the same text."""
    index, columns = page.recording.packed()
    script = "\n".join(_part(name) for name in SCRIPTS)
    digest = base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
    parts = {
        "title": html.escape(f"{page.name}: report of a run"),
        "name": html.escape(page.name),
        # No script but this one runs and nothing is fetched, whatever a vessel is called.
        "policy": f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; img-src data:",
        "style": _part("style.css"),
        "lead": html.escape(_lead(page)),
        "notes": _notes(page),
        "tables": _tables(page),
        "facts": _json_in_html({**page.recording.facts, "columns": index}),
        "columns": columns,
        "script": script,
    }
    # In one pass: what is put in is not looked at again.
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], _part("page.html"))


def _part(name: str) -> str:
    return (files("modsim3d.view.report") / name).read_text(encoding="utf-8")


def _json_in_html(value: object) -> str:
    """JSON that no HTML parser finds a tag in."""
    text = orjson.dumps(value).decode("utf-8")
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _lead(page: Page) -> str:
    facts = page.recording.facts
    cameras, vessels = len(facts["cameras"]), len(facts["vessels"])
    seconds = facts["times"][-1]
    return (
        f"What {_count(cameras, 'simulated camera')} saw of {_count(vessels, 'vessel')} in {seconds:g} s, and what a "
        "simulated vessel detector made of it. The truth is known exactly, so every miss and every false alarm is "
        "marked."
    )


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"


def _notes(page: Page) -> str:
    notes = []
    if not page.finished:
        notes.append(
            f"<p class=warning><strong>This run was interrupted.</strong> {page.steps} of {page.planned_steps} steps "
            "are there and shown; <code>modsim3d run --resume</code> goes on with it.</p>"
        )
    if page.every > 1:
        notes.append(f"<p class=soft>Every {page.every}th step is shown; the tables count all of them.</p>")
    if page.related:
        links = ", ".join(
            f'<a href="{html.escape(address, quote=True)}">{html.escape(text)}</a>' for address, text in page.related
        )
        notes.append(f"<p>Also of this run: {links}</p>")
    return "\n".join(notes)


def _tables(page: Page) -> str:
    parts = [
        ("What happened", page.overall, ()),
        ("By performance state of the detector", page.by_state, STATE_HEADER),
        ("By vessel", page.by_vessel, VESSEL_HEADER),
        ("Settings and versions", _settings(page.settings), ()),
    ]
    return "\n".join(
        f"<section>{heading(title)}<div class=scroll>{table(rows, header)}</div></section>"
        for title, rows, header in parts
    )


def _settings(settings: dict[str, Any], prefix: str = "") -> Rows:
    """The settings as rows, what is inside others under a dotted name; counts have tables of their own."""
    rows: Rows = []
    for key, value in settings.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            rows += [] if name == "counts" else _settings(value, f"{name}.")
        else:
            rows.append((name, ", ".join(map(str, value)) if isinstance(value, list) else str(value)))
    return rows
