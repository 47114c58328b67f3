"""The page of two runs of the same truth: their images beside each other, one timeline, and where they differ."""

from __future__ import annotations

import html
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.view.pages.page import heading, table
from modsim3d.view.pages.provenance import Provenance, provenance
from modsim3d.view.pages.run_inputs import run_inputs, run_seeds, run_versions
from modsim3d.view.pages.tables import UNKNOWN, breaking
from modsim3d.view.report.compared_counts import PAIRED_HEADER, compared_counts, paired_detections
from modsim3d.view.report.count_tables import VESSEL_HEADER, CountTables, Rows, named_values
from modsim3d.view.report.player_page import PageText, write_page
from modsim3d.view.report.recording.packing import packed
from modsim3d.view.report.recording.recorder import recording
from modsim3d.view.report.recording.recording_html import data_element, json_in_html
from modsim3d.view.report.report import check_steps, note_on_steps, sections
from modsim3d.view.report.run_differences import Differences, check_same_truth, difference_columns, differences

SIDE_BY_SIDE_FILE = "side_by_side.html"


def write_side_by_side(
    first: StoredRun,
    second: StoredRun,
    out: Path | None = None,
    every: int = 1,
    progress: Callable[[int], None] = lambda steps: None,
    command: str | None = None,
    *,
    in_files: bool = False,
) -> Path:
    """Write the page of two runs and return its file; the same runs give the same bytes.

    Args:
        first: A run, A on the page.
        second: A run of the same truth, B on the page.
        out: The file; `side_by_side.html` in the first run's directory if None.
        every: Show every K-th step; the tables count all of them.
        progress: Called with the number of shown steps done since its last call, of both runs together.
        command: What the page says it was made by; the call from Python if None.
        in_files: As of `write_report`.

    Raises:
        RunDirectoryError: The runs do not hold the same truth, or their tables are not what a run has written.
        OutputError: A file cannot be written.
    """
    for run in (first, second):
        check_steps(run)
    check_same_truth(first, second)
    out = first.folder / SIDE_BY_SIDE_FILE if out is None else out
    runs, names = (first, second), run_names(first, second)
    tables = [CountTables(run.scene) for run in runs]
    recordings = [
        recording(run, every, progress, name=name, count=counts.add)
        for run, name, counts in zip(runs, "AB", tables, strict=True)
    ]
    found = differences(recordings[0].outcomes, recordings[1].outcomes)
    compared = compared_counts(tables[0], tables[1])
    paired = paired_detections(*(RunRows.of(run) for run in runs))
    parts = [
        ("What happened", compared, ("", names[0], "", names[1], "")),
        ("Vessels in frames, by who detected them", paired, PAIRED_HEADER),
        *(
            (f"By vessel: {name}", counts.by_vessel(), VESSEL_HEADER)
            for name, counts in zip(names, tables, strict=True)
        ),
    ]
    note = note_on_steps(every) if every > 1 else ""
    text = PageText(
        title=f"{first.scene.name}: two runs side by side",
        name=f"{first.scene.name}: two runs",
        lead=html.escape(
            f"{names[0]} and {names[1]}: what two detectors, or one with two seeds, made of the same truth. "
            f"They differ {_times(len(found.vessel))}; consecutive frames of a vessel count once."
        ),
        notes=note,
        result=_result(compared, names),
        tables="\n".join(
            [sections(parts), _settings(first, second, names), provenance(_provenance(runs, every, command))]
        ),
    )
    write_page(text, recordings, out, in_files=in_files, differences=_differences_html(found, names))
    return out


def _provenance(runs: tuple[StoredRun, StoredRun], every: int, command: str | None) -> Provenance:
    folders = " and ".join(str(run.folder) for run in runs)
    lettered = list(zip("AB", runs, strict=True))
    return Provenance(
        page="two runs side by side",
        made_by=command or f"modsim3d.view.report.side_by_side.write_side_by_side of {folders} from Python",
        inputs=tuple(replace(each, what=f"{name}: {each.what}") for name, run in lettered for each in run_inputs(run)),
        seeds=tuple((f"{name} {seed}", value) for name, run in lettered for seed, value in run_seeds(run)),
        options=(("Steps", f"{runs[0].steps:,}" + (f", one of {every} shown" if every > 1 else "")),),
        made_before=tuple((f"{name}: {what}", text) for name, run in lettered for what, text in run_versions(run)),
    )


def run_names(first: StoredRun, second: StoredRun) -> tuple[str, str]:
    """What the runs are called on the page: their letters and the names of their folders."""
    return f"A {first.folder.resolve().name}", f"B {second.folder.resolve().name}"


def _settings(first: StoredRun, second: StoredRun, names: tuple[str, str]) -> str:
    """The settings that differ, but for checksums, which stand below, and what follows from the noise."""
    one, other = ({row[0]: row[1] for row in named_values(run.settings)} for run in (first, second))
    left_out = ("scene_sha256", "truncation.")
    differ = [key for key in {**one, **other} if one.get(key) != other.get(key) and not key.startswith(left_out)]
    rows = [(key, *(breaking(each.get(key, UNKNOWN)) for each in (one, other))) for key in differ]
    shown = table(rows, ("", *names), markup=(1, 2))
    return f"<section>{heading('Settings that differ')}{shown}</section>"


def _differences_html(found: Differences, names: tuple[str, str]) -> str:
    facts = f'<script type="application/json" id="runs">{json_in_html(names)}</script>'
    return f"{facts}\n{data_element('differences-columns', packed(difference_columns(found)))}"


def _times(number: int) -> str:
    return "once" if number == 1 else f"{number:,} times"


def _result(compared: Rows, names: tuple[str, str]) -> str:
    tiles = "\n".join(
        f"<div><dt>{html.escape(name)}</dt>"
        + "".join(
            f'<dd class="of{letter}"><b>{letter}</b> {count}</dd><dd>{html.escape(share)}</dd>'
            for letter, count, share in (("A", one, share), ("B", other, second_share))
        )
        + "</div>"
        for name, one, share, other, second_share in compared
    )
    return f'<dl class="result two" aria-label="{html.escape(" and ".join(names), quote=True)}">\n{tiles}\n</dl>'
