"""The page that plays recordings: its scripts, its styles and what is around the player, in one HTML text."""

from __future__ import annotations

import base64
import hashlib
import html
import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from modsim3d.outputs.placing import put_folder_in_place, write_files
from modsim3d.view.pages.print_style import PRINT_STYLE, mark_of, sheet_style
from modsim3d.view.pages.provenance import PROVENANCE_STYLE
from modsim3d.view.pages.tables import TABLE_STYLE
from modsim3d.view.report.recording.recorder import Recording
from modsim3d.view.report.recording.recording_html import part_files, recording_html

PART_FILES = "*-*.js"
"""Files of parts beside the page."""
FILES = " 'self' file:"
"""Where they come from: a server or a disk."""
SCRIPTS = (
    "elements.js",
    "colours.js",
    "words.js",
    "columns.js",
    "overview.js",
    "parts.js",
    "recording.js",
    "kinds.js",
    "highlight.js",
    "plates.js",
    "picture.js",
    "track_picture.js",
    "bounds.js",
    "pane.js",
    "stage.js",
    "closeup.js",
    "vessel_list.js",
    "moments.js",
    "strips.js",
    "moment_controls.js",
    "timeline.js",
    "lane_panel.js",
    "lanes.js",
    "differences.js",
    "difference_lanes.js",
    "above.js",
    "legend.js",
    "hint.js",
    "gestures.js",
    "focus.js",
    "hover.js",
    "numbers.js",
    "share.js",
    "loop.js",
    "playback.js",
    "keys.js",
    "key_help.js",
    "address.js",
    "player.js",
    "start.js",
)
"""In the order in which they need each other; in the page they are one script."""
STYLES = (
    "base.css",
    "player.css",
    "timeline.css",
    "tables.css",
    "boxes.css",
    "vessel_list.css",
    "numbers.css",
    "actions.css",
    "keys.css",
    "lanes.css",
    "panes.css",
)


@dataclass(frozen=True)
class PageText:
    """What is around the player; all but the title and the name as HTML.

    Attributes:
        name: The heading.
        lead: A sentence below it.
        notes: Below the result.
        result: What matters most.
        tables: Below the player.
        lanes: There is a panel for tracks.
    """

    title: str
    name: str
    lead: str
    notes: str
    result: str
    tables: str
    lanes: bool = False


def write_page(
    text: PageText, recordings: Sequence[Recording], out: Path, *, in_files: bool, differences: str = ""
) -> None:
    """Write the page, with the parts of the recordings in it or in files in `parts_folder(out)`.

    Args:
        text: What is around the player.
        recordings: One, or two of the same truth.
        out: The file.
        in_files: Write the parts into files.
        differences: The element that holds the differences of two recordings.

    Raises:
        OutputError: A file cannot be written.
    """
    folder = parts_folder(out) if in_files else None
    page = _page(text, recordings, folder, differences)
    if folder is None:
        write_files({out: page})
        return
    with put_folder_in_place(folder, PART_FILES) as partial:
        for recording in recordings:
            for name, content in part_files(recording).items():
                (partial / name).write_text(content, encoding="utf-8")
        write_files({out: page})


def parts_folder(page: Path) -> Path:
    """The folder beside a page that has the parts of its recordings, if they are not in the page."""
    return page.with_name(f"{page.stem}_parts")


def _page(text: PageText, recordings: Sequence[Recording], folder: Path | None, differences: str) -> str:
    script = "\n".join(map(_part, SCRIPTS))
    digest = base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
    data = [recording_html(recording, folder.name if folder else None) for recording in recordings]
    parts = {
        "title": html.escape(text.title),
        "name": html.escape(text.name),
        # No script but this one and the parts' files runs and nothing is fetched, whatever a vessel is called.
        "policy": f"default-src 'none'; script-src 'sha256-{digest}'{FILES if folder else ''}; "
        "style-src 'unsafe-inline'; img-src data:",
        "style": "".join(map(_part, STYLES))
        + TABLE_STYLE
        + PROVENANCE_STYLE
        + PRINT_STYLE
        + sheet_style(text.title, mark_of(text.lead + text.notes + text.result + text.tables)),
        "lead": text.lead,
        "notes": text.notes,
        "result": text.result,
        "tables": text.tables,
        "lanes": "\n" + _part("lanes.html").rstrip("\n") if text.lanes else "",
        "differences": "\n" + _part("differences.html").rstrip("\n") if differences else "",
        **{name: _part(f"{name}.html") for name in ("vessel_list", "note")},
        "moments": _part("moments.html").replace("{{actions}}", _part("actions.html")),
        "numbers": _part("numbers.html").replace("{{quantum}}", f"{recordings[0].facts['quantum']:.3g}"),
        "recordings": "\n".join([*data, *([differences] if differences else [])]),
        "script": script,
    }
    # In one pass: what is put in is not looked at again.
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], _part("page.html"))


def _part(name: str) -> str:
    return (files("modsim3d.view.report") / "player" / name).read_text(encoding="utf-8")
