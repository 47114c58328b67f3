"""The page of a run, from its directory: the player's files, the recording and the tables in one file of HTML."""

from __future__ import annotations

import base64
import hashlib
import html
import os
import re
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import orjson

from modsim3d.errors import RunDirectoryError
from modsim3d.outputs.placing import write_files
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.pages.page import facts, folded, heading, table
from modsim3d.view.pages.print_style import PRINT_STYLE, mark_of, sheet_style
from modsim3d.view.pages.provenance import PROVENANCE_STYLE, Provenance, provenance
from modsim3d.view.pages.run_inputs import run_inputs, run_seeds, run_versions, track_inputs
from modsim3d.view.pages.tables import TABLE_STYLE
from modsim3d.view.report.count_tables import (
    CAMERA_HEADER,
    STATE_HEADER,
    VESSEL_HEADER,
    CountTables,
    DetectorCounts,
    named_values,
)
from modsim3d.view.report.player_recording import recording

REPORT_FILE = "report.html"
RELATED = {"verify.html": "verification", "compare.html": "comparison of sources"}
"""Pages that other commands write into a run directory, and what they are."""
LOUD_SHARE = 0.1
"""A share of boxes with IoU below 0.5 that changes what an evaluation by IoU says; as the summary of a run has it."""
SCRIPTS = ("recording.js", "picture.js", "moments.js", "timeline.js", "player.js", "start.js")
TRACK_SCRIPTS = (*SCRIPTS[:-1], "track_picture.js", "lanes.js", "track_player.js")
"""Without and with tracks, in the order in which they need each other; in the page they are one script."""


def write_report(
    run: StoredRun,
    out: Path | None = None,
    every: int = 1,
    progress: Callable[[int], None] = lambda steps: None,
    followed: FollowedTracks | None = None,
    command: str | None = None,
    tracks: Path | None = None,
) -> Path:
    """Write the page of a run and return its file; the same run gives the same bytes.

    Args:
        run: A finished or an interrupted run.
        out: The file; `report.html` in the run directory if None.
        every: Show every K-th step; the tables count all of them.
        progress: Called with the number of shown steps done since its last call.
        followed: The tracks of a tracker, for lanes below the timeline; none if None.
        command: What the page says it was made by; the call from Python if None.
        tracks: Where the tracks were read.

    Raises:
        RunDirectoryError: An interrupted run has kept nothing yet.
        OutputError: The file cannot be written.
    """
    if not run.steps:
        raise RunDirectoryError(
            f"{run.folder} was interrupted before its first steps were finished: there is nothing to show; "
            "go on with modsim3d run --resume"
        )
    out = run.folder / REPORT_FILE if out is None else out
    page = _page(run, every, out, progress, followed, _provenance(run, every, command, tracks))
    write_files({out: page})
    return out


def _page(
    run: StoredRun,
    every: int,
    out: Path,
    progress: Callable[[int], None],
    followed: FollowedTracks | None,
    rests_on: Provenance,
) -> str:
    rows = RunRows.of(run)
    counts = CountTables(rows)
    frames = recording(rows, every, progress, followed)
    index, columns = frames.packed()
    script = "\n".join(_part(name) for name in (TRACK_SCRIPTS if followed else SCRIPTS))
    digest = base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
    tables = _tables(counts, run.settings, rests_on)
    parts = {
        "title": html.escape(f"{run.scene.name}: report of a run"),
        "name": html.escape(run.scene.name),
        # No script but this one runs and nothing is fetched, whatever a vessel is called.
        "policy": f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; img-src data:",
        "style": _part("style.css") + (_part("lanes.css") if followed else "") + _more_style(run, tables),
        "lead": html.escape(_lead(frames.facts)),
        "sentence": f"\n  <p>{html.escape(followed.sentence())}</p>" if followed else "",
        "lanes": "\n" + _part("lanes.html").rstrip("\n") if followed else "",
        "track_key": " <kbd>K</kbd> tracks," if followed else "",
        "notes": _notes(run, every, out),
        "result": _result(counts.total),
        "tables": tables,
        "facts": _json_in_html({**frames.facts, "columns": index}),
        "columns": columns,
        "script": script,
    }
    # In one pass: what is put in is not looked at again.
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], _part("page.html"))


def _more_style(run: StoredRun, tables: str) -> str:
    """What this page has in common with the others: tables on a phone, what it rests on, and print."""
    sheets = sheet_style(f"{run.scene.name}: report of a run", mark_of(tables))
    return TABLE_STYLE + PROVENANCE_STYLE + PRINT_STYLE + sheets


def _part(name: str) -> str:
    return (files("modsim3d.view.report") / name).read_text(encoding="utf-8")


def _json_in_html(value: object) -> str:
    """JSON that no HTML parser finds a tag in."""
    text = orjson.dumps(value).decode("utf-8")
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _lead(facts: dict[str, Any]) -> str:
    cameras, vessels = _count(len(facts["cameras"]), "simulated camera"), _count(len(facts["vessels"]), "vessel")
    return (
        f"What {cameras} saw of {vessels} in {facts['times'][-1]:g} s, and what a "
        "simulated vessel detector made of it. The truth is known exactly, so each mistake of the detector is counted "
        "and marked."
    )


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"


def _notes(run: StoredRun, every: int, out: Path) -> str:
    """What the page does not show, and links to what other commands have written into the run directory."""
    notes = []
    if not run.finished:
        notes.append(
            f"<p class=warning><strong>This run was interrupted.</strong> {run.steps} of {run.scene.steps} steps "
            "are there and shown; <code>modsim3d run --resume</code> goes on with it.</p>"
        )
    if every > 1:
        notes.append(f"<p class=soft>Every {every}th step is shown; the tables count all of them.</p>")
    folder = Path(os.path.relpath(run.folder.resolve(), out.parent.resolve()))
    links = [
        f'<a href="{html.escape((folder / name).as_posix(), quote=True)}">{html.escape(text)}</a>'
        for name, text in RELATED.items()
        if (run.folder / name).is_file()
    ]
    if links:
        notes.append(f"<p>Also of this run: {', '.join(links)}</p>")
    return "\n".join(notes)


def _result(counts: DetectorCounts) -> str:
    """The counts of what the detector did, under a warning where many of its boxes do not fit."""
    tiles = "\n".join(
        f"<div><dt>{html.escape(name)}</dt><dd>{count}</dd><dd>{html.escape(meaning)}</dd></div>"
        for name, count, meaning in counts.named()
    )
    result = f"<dl class=result>\n{tiles}\n</dl>"
    if counts.bad_share <= LOUD_SHARE:
        return result
    return (
        f"<p class=warning><strong>{counts.bad_share:.1%} of the boxes do not fit their vessels.</strong> "
        f"{counts.below_half_iou} of {counts.true_detections} true detections have IoU below 0.5 with their vessel's "
        f"annotated box; {counts.off_vessel} of them do not touch it. An evaluation that matches by IoU counts "
        f"each as a miss and a false alarm.</p>\n{result}"
    )


def _provenance(run: StoredRun, every: int, command: str | None, tracks: Path | None) -> Provenance:
    return Provenance(
        page="report of a run",
        made_by=command or f"modsim3d.view.report.report.write_report of {run.folder} from Python",
        inputs=(*run_inputs(run), *(() if tracks is None else track_inputs(tracks.name, tracks))),
        seeds=run_seeds(run),
        options=(("Steps", f"{run.steps:,}" + (f", every {every}th shown" if every > 1 else "")),),
        made_before=run_versions(run),
    )


def _tables(counts: CountTables, settings: dict[str, Any], rests_on: Provenance) -> str:
    parts = [
        ("What happened", counts.overall(), ()),
        *([("By camera", cameras, CAMERA_HEADER)] if len(cameras := counts.by_camera()) > 1 else []),
        ("By performance state of the detector", counts.by_state(), STATE_HEADER),
        ("By vessel", counts.by_vessel(), VESSEL_HEADER),
    ]
    every_setting = folded("All settings of the run", facts([(name, text) for name, text in named_values(settings)]))
    tables = "\n".join(
        f"<section>{heading(title)}<div class=scroll>{table(rows, header)}</div></section>"
        for title, rows, header in parts
    )
    return f"{tables}\n<section>{every_setting}</section>\n{provenance(rests_on)}"
