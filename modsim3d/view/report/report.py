"""The page of a run, from its directory: the player's files, the recording and the tables in one file of HTML."""

import base64
import hashlib
import html
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson

from modsim3d.core.errors import RunDirectoryError
from modsim3d.core.text import counted, in_percent
from modsim3d.io.atomic_write import put_folder_in_place, write_files
from modsim3d.runs.counts import Counts
from modsim3d.runs.stored_run import StoredRun
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.pages import provenance
from modsim3d.view.pages.page import common_style, folded, heading, shipped_text, tiles, unbroken, with_contents
from modsim3d.view.pages.tables import facts, table
from modsim3d.view.report import count_tables
from modsim3d.view.report.images import image_facts, keyframe_facts
from modsim3d.view.report.packing import as_text
from modsim3d.view.report.recorder import Recording, recording
from modsim3d.view.sea_and_sky import RenderStyle

# ---- A recording as parts of an HTML page ----


def recording_html(recording: Recording, folder: str | None = None) -> str:
    """The elements from which `openRecording(name)` of the player has its recording: `facts-NAME`, `overview-NAME` and,
    unless the parts are in files in a folder beside the page, `part-NAME-0` and so on."""
    name, facts = recording.name, recording.facts | ({"folder": folder} if folder else {})
    return "\n".join(
        [
            f'<script type="application/json" id="facts-{name}">{json_in_html(facts)}</script>',
            data_element(f"overview-{name}", recording.overview),
            *(data_element(f"part-{name}-{i}", part) for i, part in enumerate(recording.parts) if folder is None),
        ]
    )


def data_element(element: str, data: bytes) -> str:
    """An element that holds packed columns."""
    return f'<script type="application/octet-stream" id="{element}">{as_text(data)}</script>'


def json_in_html(value: object) -> str:
    """JSON that no HTML parser finds a tag in."""
    text = orjson.dumps(value).decode("utf-8")
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


# ---- The page that plays recordings ----

PART_FILES = "*-*.js"  # files of parts beside the page
FILES = " 'self' file:"  # where they come from: a server or a disk


@dataclass(frozen=True)
class PageText:
    """Text around the player; all but the title and the name as HTML."""

    title: str
    name: str  # the heading
    lead: str  # a sentence below it
    notes: str  # below the result
    result: str  # what matters most
    tables: str  # below the player
    lanes: bool = False  # there is a panel for tracks


def write_page(
    text: PageText, recordings: Sequence[Recording], out: Path, *, in_files: bool, differences: str = ""
) -> None:
    """Write the page of one recording, or of two of the same truth, with their parts in it or in files in
    `parts_folder(out)`. `differences` is the element that holds those of two recordings.
    Raises OutputError for a file that cannot be written."""
    folder = parts_folder(out) if in_files else None
    page = _page(text, recordings, folder, differences)
    if folder is None:
        write_files({out: page})
        return
    with put_folder_in_place(folder, PART_FILES) as partial:
        for recording in recordings:
            for i, part in enumerate(recording.parts):  # as scripts: a page on a disk can read no data
                script = f'takePart("part-{recording.name}-{i}", "{as_text(part)}");\n'
                (partial / f"{recording.name}-{i}.js").write_text(script, encoding="utf-8")
        write_files({out: page})


def parts_folder(page: Path) -> Path:
    """The folder beside a page that has the parts of its recordings, if they are not in the page."""
    return page.with_name(f"{page.stem}_parts")


def _page(text: PageText, recordings: Sequence[Recording], folder: Path | None, differences: str) -> str:
    script = re.sub(r"(?m)^ *//.*\n", "", "\n".join(map(_part, _part("scripts.txt").split())))  # without comments
    digest = base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
    data = [recording_html(recording, folder.name if folder else None) for recording in recordings]
    parts = {
        "title": html.escape(text.title),
        "name": html.escape(text.name),
        # No script but this one and the parts' files runs and nothing is fetched, whatever a vessel is called.
        "policy": f"default-src 'none'; script-src 'sha256-{digest}'{FILES if folder else ''}; "
        f"style-src 'unsafe-inline'; img-src data:{FILES if 'images' in recordings[0].facts else ''}",
        "style": "".join(map(_part, _part("styles.txt").split()))
        + common_style(text.title, text.lead + text.notes + text.result + text.tables),
        "lead": text.lead,
        "notes": text.notes,
        "result": unbroken(text.result),
        "tables": unbroken(text.tables),
        "lanes": "\n" + _part("lanes.html").rstrip("\n") if text.lanes else "",
        "differences": "\n" + _part("differences.html").rstrip("\n") if differences else "",
        **{name: _part(f"{name}.html") for name in ("vessel_list", "note", "gallery")},
        "moments": _part("moments.html").replace("{{actions}}", _part("actions.html")),
        "numbers": _part("numbers.html").replace("{{quantum}}", f"{recordings[0].facts['quantum']:.3g}"),
        "recordings": "\n".join([*data, *([differences] if differences else [])]),
        "script": script,
    }
    # In one pass: what is put in is not looked at again.
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], _part("page.html"))


def _part(name: str) -> str:
    return shipped_text("report", "player", name)


REPORT_FILE = "report.html"
RELATED = {"verify.html": "verification", "compare.html": "comparison of sources"}
"""Pages that other commands write into a run directory, and what they are."""
LOUD_SHARE = 0.1  # of boxes with IoU below 0.5; above it, evaluations by IoU are warned of, as in a run's summary


def write_report(
    run: StoredRun,
    out: Path | None = None,
    every: int = 1,
    progress: Callable[[int], None] = lambda steps: None,
    followed: FollowedTracks | None = None,
    command: str | None = None,
    tracks: Path | None = None,
    *,
    in_files: bool = False,
    pictures: Path | None = None,
    look: RenderStyle | None = None,
) -> Path:
    """Write the page of a run, finished or interrupted, and return its file, by default `report.html` in the run
    directory; the same run gives the same bytes.
    The page shows every K-th step (`every`); its tables count all of them. It has lanes for the tracks `followed`,
    which were read from `tracks`, and says that `command` made it, or the call from Python if None. With `in_files` it
    reads the parts of the recording from `parts_folder(out)` when it needs them. It shows the pictures in the folder
    `pictures` below the boxes, from where they are; or with `look` pictures of the scene that looks so, at first frames
    of mistakes. `progress` is called with the number of shown steps done since its last call.
    Raises RunDirectoryError if an interrupted run has kept nothing yet or the tables are not what a run has written,
    and OutputError for a file that cannot be written."""
    check_steps(run)
    out = run.folder / REPORT_FILE if out is None else out
    counts = count_tables.CountTables(run.scene)
    shown = None if pictures is None else image_facts(run, pictures, out, every)
    frames = recording(run, every, progress, followed, count=counts.add)
    if shown is not None:
        frames.facts["images"] = shown
    if look is not None:
        frames.facts.update(images=keyframe_facts(run, look, frames, every), keyframes=True)
    lead = html.escape(_lead(run, every))
    text = PageText(
        title=f"{run.scene.name}: report of a run",
        name=run.scene.name,
        lead=lead if followed is None else f'{lead}</p>\n  <p class="of-tracks">{html.escape(followed.sentence())}',
        notes=_notes(run, every, out),
        result=_result(counts.total),
        tables=_tables(counts, run.settings, _provenance(run, every, command, tracks)),
        lanes=followed is not None,
    )
    write_page(text, [frames], out, in_files=in_files)
    return out


def check_steps(run: StoredRun) -> None:
    """Raise RunDirectoryError if a run was interrupted before its first steps were kept: there is nothing to show."""
    if not run.steps:
        raise RunDirectoryError(
            f"{run.folder} was interrupted before its first steps were finished: there is nothing to show; "
            "go on with modsim3d run --resume"
        )


def _lead(run: StoredRun, every: int) -> str:
    scene, last = run.scene, (run.steps - 1) // every * every
    vessels, seconds = counted(len(scene.vessels), "vessel"), round(float(scene.times_s(0, last + 1)[-1]), 6)
    if scene.labels is not None:
        detector = "a simulated" if scene.labels.detections is None else "a real"
        videos, several = counted(len(scene.cameras), "labelled video"), len(scene.cameras) > 1
        return (
            f"What {videos} {'show' if several else 'shows'} of {vessels} in {seconds:g} s, and what {detector} vessel "
            "detector made of it. The labels are taken for the truth, a box for a silhouette, and each mistake is "
            "counted and marked."
        )
    cameras = counted(len(scene.cameras), "simulated camera")
    return (
        f"What {cameras} saw of {vessels} in {seconds:g} s, and what a simulated vessel detector made of it. The truth "
        "is known exactly, so each mistake of the detector is counted and marked."
    )


def _notes(run: StoredRun, every: int, out: Path) -> str:
    """Notes on what the page does not show, and links to what other commands have written into the run directory."""
    notes = []
    if not run.finished:
        notes.append(
            f"<p class=warning><strong>This run was interrupted.</strong> {run.steps} of {run.scene.steps} steps "
            "are there and shown; <code>modsim3d run --resume</code> goes on with it.</p>"
        )
    if every > 1:
        notes.append(note_on_steps(every))
    folder = Path(os.path.relpath(run.folder.resolve(), out.parent.resolve()))
    links = [
        f'<a href="{html.escape((folder / name).as_posix(), quote=True)}">{html.escape(text)}</a>'
        for name, text in RELATED.items()
        if (run.folder / name).is_file()
    ]
    if links:
        notes.append(f"<p>Also of this run: {', '.join(links)}</p>")
    return "\n".join(notes)


def note_on_steps(every: int) -> str:
    """A paragraph that says that only every K-th step is shown, K being 2 at least."""
    return f'<p class="soft all-steps">One of {every:,} steps is shown; the tables count all of them.</p>'


def _result(counts: Counts) -> str:
    """The counts of what the detector did, under a warning where many of its boxes do not fit."""
    result = tiles(count_tables.named_counts(counts), "result")
    share = counts.below_half_iou / max(counts.true_detections, 1)
    if share <= LOUD_SHARE:
        return result
    return (
        f'<p class="warning all-detections"><strong>{in_percent(share, 1)} of the boxes do not fit their vessels.'
        f"</strong> {counts.below_half_iou:,} of {counts.true_detections:,} true detections have IoU below 0.5 with "
        f"their vessel's annotated box; {counts.off_vessel:,} of them do not touch it. An evaluation that matches by "
        f"IoU counts each as a miss and a false positive.</p>\n{result}"
    )


def _provenance(run: StoredRun, every: int, command: str | None, tracks: Path | None) -> provenance.Provenance:
    whole = "" if run.finished else f" of {run.scene.steps:,}: the run was interrupted"
    steps = f"{run.steps:,}{whole}" + (f", one of {every} shown" if every > 1 else "")
    return provenance.Provenance(
        page="report of a run",
        made_by=command or f"modsim3d.view.report.report.write_report of {run.folder} from Python",
        inputs=(*provenance.run_inputs(run), *(provenance.track_inputs(tracks.name, tracks) if tracks else ())),
        seeds=provenance.run_seeds(run),
        options=(("Steps", steps),),
        made_before=provenance.run_versions(run),
    )


def _tables(counts: count_tables.CountTables, settings: dict[str, Any], rests_on: provenance.Provenance) -> str:
    parts = [
        ("What happened", counts.overall(), ()),
        *([("By camera", cameras, count_tables.CAMERA_HEADER)] if len(cameras := counts.by_camera()) > 1 else []),
        ("By performance state of the detector", counts.by_state(), count_tables.STATE_HEADER),
        ("By vessel", counts.by_vessel(), count_tables.VESSEL_HEADER),
    ]
    every_setting = folded(
        "All settings of the run", facts([(name, text) for name, text in count_tables.named_values(settings)])
    )
    settings_and_inputs = f"<section>{every_setting}</section>\n{provenance.provenance(rests_on)}"
    return with_contents(f"{sections(parts)}\n{settings_and_inputs}")


def sections(parts: Sequence[tuple[str, count_tables.Rows, Sequence[str]]]) -> str:
    """Tables below the player: their titles, rows and headers."""
    return "\n".join(f"<section>{heading(title)}{table(rows, header)}</section>" for title, rows, header in parts)
