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

from modsim3d.errors import RunDirectoryError
from modsim3d.outputs.placing import put_folder_in_place, write_files
from modsim3d.runs.stored_run import StoredRun
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.pages.page import heading, table
from modsim3d.view.report.count_tables import (
    CAMERA_HEADER,
    STATE_HEADER,
    VESSEL_HEADER,
    CountTables,
    DetectorCounts,
    named_values,
)
from modsim3d.view.report.player_recording import Recording, recording
from modsim3d.view.report.recording_html import part_files, recording_html

REPORT_FILE = "report.html"
RELATED = {"verify.html": "verification", "compare.html": "comparison of sources"}
"""Pages that other commands write into a run directory, and what they are."""
PART_FILES = "*-*.js"
"""Files of parts beside the page."""
FILES = " 'self' file:"
"""Where they come from: a server or a disk."""
LOUD_SHARE = 0.1
"""A share of boxes with IoU below 0.5 that changes what an evaluation by IoU says; as the summary of a run has it."""
SCRIPTS = (
    "elements.js",
    "words.js",
    "columns.js",
    "overview.js",
    "recording.js",
    "picture.js",
    "track_picture.js",
    "pane.js",
    "closeup.js",
    "vessel_list.js",
    "moments.js",
    "timeline.js",
    "lanes.js",
    "legend.js",
    "gestures.js",
    "keys.js",
    "address.js",
    "player.js",
    "start.js",
)
"""In the order in which they need each other; in the page they are one script."""


def write_report(
    run: StoredRun,
    out: Path | None = None,
    every: int = 1,
    progress: Callable[[int], None] = lambda steps: None,
    followed: FollowedTracks | None = None,
    *,
    in_files: bool = False,
) -> Path:
    """Write the page of a run and return its file; the same run gives the same bytes.

    Args:
        run: A finished or an interrupted run.
        out: The file; `report.html` in the run directory if None.
        every: Show every K-th step; the tables count all of them.
        progress: Called with the number of shown steps done since its last call.
        followed: The tracks of a tracker, for lanes below the timeline; none if None.
        in_files: Write the parts of the recording into files in `parts_folder(out)`, which the page reads when it needs
            them, and not into the page.

    Raises:
        RunDirectoryError: An interrupted run has kept nothing yet, or the tables are not what a run has written.
        OutputError: A file cannot be written.
    """
    if not run.steps:
        raise RunDirectoryError(
            f"{run.folder} was interrupted before its first steps were finished: there is nothing to show; "
            "go on with modsim3d run --resume"
        )
    out = run.folder / REPORT_FILE if out is None else out
    counts = CountTables(run.scene)
    frames = recording(run, every, progress, followed, count=counts.add)
    folder = parts_folder(out) if in_files else None
    page = _page(run, counts, frames, every, out, folder, followed)
    if folder is None:
        write_files({out: page})
        return out
    with put_folder_in_place(folder, PART_FILES) as partial:
        for name, text in part_files(frames).items():
            (partial / name).write_text(text, encoding="utf-8")
        write_files({out: page})
    return out


def parts_folder(page: Path) -> Path:
    """The folder beside a page that has the parts of its recordings, if they are not in the page."""
    return page.with_name(f"{page.stem}_parts")


def _page(
    run: StoredRun,
    counts: CountTables,
    frames: Recording,
    every: int,
    out: Path,
    folder: Path | None,
    followed: FollowedTracks | None,
) -> str:
    script = "\n".join(map(_part, SCRIPTS))
    digest = base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
    parts = {
        "title": html.escape(f"{run.scene.name}: report of a run"),
        "name": html.escape(run.scene.name),
        # No script but this one and the parts' files runs and nothing is fetched, whatever a vessel is called.
        "policy": f"default-src 'none'; script-src 'sha256-{digest}'{FILES if folder else ''}; "
        "style-src 'unsafe-inline'; img-src data:",
        "style": _part("style.css") + (_part("lanes.css") if followed else ""),
        "lead": html.escape(_lead(run, every)),
        "sentence": f"\n  <p>{html.escape(followed.sentence())}</p>" if followed else "",
        "lanes": "\n" + _part("lanes.html").rstrip("\n") if followed else "",
        "track_key": " <kbd>K</kbd> tracks," if followed else "",
        "notes": _notes(run, every, out),
        "result": _result(counts.total),
        "tables": _tables(counts, run.settings),
        "recordings": recording_html(frames, folder.name if folder else None),
        "script": script,
    }
    # In one pass: what is put in is not looked at again.
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], _part("page.html"))


def _part(name: str) -> str:
    return (files("modsim3d.view.report") / "player" / name).read_text(encoding="utf-8")


def _lead(run: StoredRun, every: int) -> str:
    scene, last = run.scene, (run.steps - 1) // every * every
    cameras, vessels = _count(len(scene.cameras), "simulated camera"), _count(len(scene.vessels), "vessel")
    return (
        f"What {cameras} saw of {vessels} in {round(float(scene.times_s(0, last + 1)[-1]), 6):g} s, and what a "
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


def _tables(counts: CountTables, settings: dict[str, Any]) -> str:
    parts = [
        ("What happened", counts.overall(), ()),
        *([("By camera", cameras, CAMERA_HEADER)] if len(cameras := counts.by_camera()) > 1 else []),
        ("By performance state of the detector", counts.by_state(), STATE_HEADER),
        ("By vessel", counts.by_vessel(), VESSEL_HEADER),
        ("Settings and versions", named_values(settings), ()),
    ]
    return "\n".join(
        f"<section>{heading(title)}<div class=scroll>{table(rows, header)}</div></section>"
        for title, rows, header in parts
    )
