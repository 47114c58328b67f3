"""The page of two runs of the same truth: their images beside each other, one timeline, and where they differ."""

import html
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa

from modsim3d.core.arrays import Indices
from modsim3d.core.errors import RunDirectoryError
from modsim3d.core.text import UNKNOWN, listed
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.view.pages.page import heading
from modsim3d.view.pages.provenance import Provenance, provenance, run_inputs, run_seeds, run_versions
from modsim3d.view.pages.tables import table
from modsim3d.view.report import report
from modsim3d.view.report.count_tables import VESSEL_HEADER, CountTables, Rows, named_counts, named_values
from modsim3d.view.report.overview import OutcomeStretches
from modsim3d.view.report.packing import ROW_BEFORE, Codes, Column, packed
from modsim3d.view.report.recorder import recording

# ---- Two runs of the same truth ----

DETECTORS_OWN = "detected"  # the column of the truth that depends on the detector


def check_same_truth(first: StoredRun, second: StoredRun) -> None:
    """Raise RunDirectoryError if cameras, vessels, steps or a row of the truth differ between two runs."""
    for name, one, other in (
        ("cameras", *(listed([camera.name for camera in run.scene.cameras]) for run in (first, second))),
        ("vessels", *(listed(list(run.scene.vessel_names)) for run in (first, second))),
        ("number of steps", first.steps, second.steps),
        ("annotation mode", *(run.scene.annotation.mode for run in (first, second))),
    ):
        if one != other:
            raise _other_truth(first, second, f"the {name}: {one} against {other}")
    truths = [run.table("truth").drop_columns([DETECTORS_OWN]) for run in (first, second)]
    if not truths[0].equals(truths[1]):
        raise _other_truth(first, second, _first_difference(*truths))


def _other_truth(first: StoredRun, second: StoredRun, what: str) -> RunDirectoryError:
    return RunDirectoryError(
        f"{first.folder} and {second.folder} show different truth, in {what}. Runs are compared side by side if their "
        f"detectors looked at the same: modsim3d detect {first.folder} --detector FILE or --detector-seed N makes one"
    )


def _first_difference(one: pa.Table, other: pa.Table) -> str:
    if len(one) != len(other):
        return f"the number of vessels in frames: {len(one)} against {len(other)}"
    for name in one.column_names:
        first, second = one[name].combine_chunks(), other[name].combine_chunks()
        if first.equals(second):
            continue
        values = zip(first.to_pylist(), second.to_pylist(), strict=True)
        row = next(row for row, (a, b) in enumerate(values) if a != b and not (a != a and b != b))
        step, camera = one["step"][row], one["camera"][row]
        return f"{name} of {one['vessel'][row]} at step {step} of camera {camera}: {first[row]} against {second[row]}"
    return "its columns"


@dataclass(frozen=True, eq=False)
class Differences:
    """Stretches of shown steps in which two detectors made different things of a vessel, by camera, vessel and step."""

    camera: Indices  # index, shape (d,)
    vessel: Indices  # index, shape (d,)
    index: Indices  # first shown step, shape (d,)
    until: Indices  # last shown step, shape (d,)
    outcomes: Indices  # numbers of the `VesselOutcome` in the first and the second run, shape (d, 2)


def differences(first: Sequence[OutcomeStretches], second: Sequence[OutcomeStretches]) -> Differences:
    """Differences between two runs of the same truth, from what became of the vessels of each camera in them."""
    parts = []
    for camera, (one, other) in enumerate(zip(first, second, strict=True)):
        span = int(one.until.max(initial=0)) + 1
        begins = [stretches.vessel * span + stretches.first for stretches in (one, other)]
        begin = np.union1d(*begins)  # each run's outcome changes at some of them
        row, other_row = (np.searchsorted(starts, begin, side="right") - 1 for starts in begins)
        outcomes = np.column_stack([one.outcome[row], other.outcome[other_row]])
        vessel, index = np.divmod(begin, span)
        until = np.minimum(one.until[row], other.until[other_row])
        differs = outcomes[:, 0] != outcomes[:, 1]
        columns = np.full(len(begin), camera), vessel, index, until, outcomes
        parts.append([column[differs] for column in columns])
    return Differences(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def difference_columns(changes: Differences) -> dict[str, Column | Codes]:
    """The differences for the player of a page, in order of camera and first step."""
    order = np.lexsort((changes.vessel, changes.index, changes.camera))
    return {
        "camera": Codes(changes.camera[order].astype(np.uint16), by=ROW_BEFORE),
        "vessel": changes.vessel[order].astype(np.uint16),
        "index": Codes(changes.index[order].astype(np.uint32), by=ROW_BEFORE),
        "long": Codes((changes.until - changes.index)[order].astype(np.uint32)),
        "outcomes": changes.outcomes[order].astype(np.uint8),
    }


# ---- Counts of two runs of the same truth side by side, as rows of tables ----

PAIRED_HEADER = ("Vessel", "Annotated", "Detected by both", "Only by A", "Only by B", "By neither")


def paired_detections(first: RunRows, second: RunRows) -> Rows:
    """Counts of annotated vessels that both, one or none of the runs detect, by vessel and in all: `PAIRED_HEADER`."""
    vessel, given, rows = first.truth_vessel, first.annotated, list[tuple[str, ...]]()
    for name, which in (*((name, vessel == i) for i, name in enumerate(first.scene.vessel_names)), ("all", given)):
        one, other = first.detected[given & which], second.detected[given & which]
        counts = np.ones_like(one), one & other, one & ~other, ~one & other, ~one & ~other
        rows.append((name, *(f"{np.sum(outcome):,}" for outcome in counts)))
    return rows


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
    """Write the page of two runs of the same truth, A and B on the page, and return its file, by default
    `side_by_side.html` in the first run's directory; the same runs give the same bytes.
    Options are as of `write_report`; `progress` counts the steps of both runs together.
    Raises RunDirectoryError if the runs do not hold the same truth or their tables are not what a run has written, and
    OutputError for a file that cannot be written."""
    for run in (first, second):
        report.check_steps(run)
    check_same_truth(first, second)
    out = first.folder / SIDE_BY_SIDE_FILE if out is None else out
    runs, names = (first, second), (f"A {first.folder.resolve().name}", f"B {second.folder.resolve().name}")
    tables = [CountTables(run.scene) for run in runs]
    recordings = [
        recording(run, every, progress, name=name, count=counts.add)
        for run, name, counts in zip(runs, "AB", tables, strict=True)
    ]
    changes = differences(recordings[0].outcomes, recordings[1].outcomes)
    pairs = zip(*(named_counts(table.total) for table in tables), strict=True)
    compared: Rows = [(name, one, share, other, second_share) for (name, one, share), (_, other, second_share) in pairs]
    paired = paired_detections(*(RunRows.of(run) for run in runs))
    parts = [
        ("What happened", compared, ("", names[0], "", names[1], "")),
        ("Vessels in frames, by who detected them", paired, PAIRED_HEADER),
        *(
            (f"By vessel: {name}", counts.by_vessel(), VESSEL_HEADER)
            for name, counts in zip(names, tables, strict=True)
        ),
    ]
    number = len(changes.vessel)
    times = "once" if number == 1 else f"{number:,} times"
    settings, rests_on = _settings(first, second, names), provenance(_provenance(runs, every, command))
    text = report.PageText(
        title=f"{first.scene.name}: two runs side by side",
        name=f"{first.scene.name}: two runs",
        lead=html.escape(
            f"{names[0]} and {names[1]}: what two detectors, or one with two seeds, made of the same truth. "
        )
        + f'They differ <span id="differing">{times}</span>; consecutive frames of a vessel count once.',
        notes=report.note_on_steps(every) if every > 1 else "",
        result=_result(compared, names),
        tables="\n".join([report.sections(parts), settings, rests_on]),
    )
    facts = f'<script type="application/json" id="runs">{report.json_in_html(names)}</script>'
    columns = report.data_element("differences-columns", packed(difference_columns(changes)))
    report.write_page(text, recordings, out, in_files=in_files, differences=f"{facts}\n{columns}")
    return out


def _provenance(runs: tuple[StoredRun, StoredRun], every: int, command: str | None) -> Provenance:
    folders = " and ".join(str(run.folder) for run in runs)
    lettered = list(zip("AB", runs, strict=True))
    return Provenance(
        page="two runs side by side",
        made_by=command or f"modsim3d.view.report.side_by_side.write_side_by_side of {folders} from Python",
        inputs=tuple(replace(file, what=f"{name}: {file.what}") for name, run in lettered for file in run_inputs(run)),
        seeds=tuple((f"{name} {seed}", value) for name, run in lettered for seed, value in run_seeds(run)),
        options=(("Steps", f"{runs[0].steps:,}" + (f", one of {every} shown" if every > 1 else "")),),
        made_before=tuple((f"{name}: {what}", text) for name, run in lettered for what, text in run_versions(run)),
    )


def _settings(first: StoredRun, second: StoredRun, names: tuple[str, str]) -> str:
    """The settings that differ, but for checksums, which stand below, and what follows from the noise."""
    one, other = ({row[0]: row[1] for row in named_values(run.settings)} for run in (first, second))
    left_out = ("scene_sha256", "truncation.")
    differ = [key for key in {**one, **other} if one.get(key) != other.get(key) and not key.startswith(left_out)]
    rows = [(key, *(values.get(key, UNKNOWN) for values in (one, other))) for key in differ]
    return f"<section>{heading('Settings that differ')}{table(rows, ('', *names))}</section>"


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
