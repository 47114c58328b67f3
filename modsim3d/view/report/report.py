"""The page of a run, from its directory."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from modsim3d.errors import RunDirectoryError
from modsim3d.runs.files.columns import indices
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.view.report.count_tables import CountTables
from modsim3d.view.report.page import Page, report_page
from modsim3d.view.report.run_recording import recording

REPORT_FILE = "report.html"
RELATED = {"verify.html": "verification", "compare.html": "comparison of sources"}
"""Pages that other commands write into a run directory, and what they are."""


def write_report(
    run: StoredRun, out: Path | None = None, every: int = 1, progress: Callable[[int], None] = lambda steps: None
) -> Path:
    """Write the page of a run.

    Args:
        run: A finished or an interrupted one.
        out: The file; `report.html` in the run directory if None.
        every: Show every K-th step; the tables count all of them.
        progress: Called with the number of shown steps done since its last call.

    Returns:
        The file.

    Raises:
        RunDirectoryError: An interrupted run has kept nothing yet, or the file cannot be written.
    """
    if not run.steps:
        raise RunDirectoryError(
            f"{run.folder} was interrupted before its first steps were finished: there is nothing to show; "
            "go on with modsim3d run --resume"
        )
    out = run.folder / REPORT_FILE if out is None else out
    rows, scene = RunRows.of(run), run.scene
    count_tables = _count_tables(rows)
    page = Page(
        name=scene.name,
        recording=recording(rows, every, progress),
        settings=run.settings,
        overall=count_tables.overall(),
        by_vessel=count_tables.by_vessel(scene.vessel_names),
        by_state=count_tables.by_state([state.name for state in scene.detector.states]),
        steps=run.steps,
        planned_steps=scene.steps,
        finished=run.finished,
        every=every,
        related=_related(run.folder, out),
    )
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(report_page(page), encoding="utf-8")
    except OSError as error:
        raise RunDirectoryError(f"{out} cannot be written: {error.strerror or error}") from error
    return out


def _count_tables(rows: RunRows) -> CountTables:
    """The columns that are counted for the tables of the page."""
    known, labels = rows.detection_vessel >= 0, rows.scene.detector.labels
    true_label = np.array([labels.index(vessel.label) for vessel in rows.scene.vessels])
    label = indices(rows.detections, "label", labels)
    return CountTables(
        frame_state=rows.frame_state,
        vessel=rows.truth_vessel,
        state=rows.states_of(rows.truth_frame),
        silhouette_px=rows.numbers("silhouette_px"),
        visible_px=rows.numbers("visible_px"),
        annotated=rows.annotated,
        detected=rows.detected,
        false_state=rows.states_of(rows.detection_frame[~known]),
        mislabelled=int((label[known] != true_label[rows.detection_vessel[known]]).sum()),
    )


def _related(folder: Path, out: Path) -> list[tuple[str, str]]:
    """Links, as seen from the page, to what other commands have written into the run directory, and what they are."""
    base = Path(os.path.relpath(folder.resolve(), out.parent.resolve()))
    return [((base / name).as_posix(), text) for name, text in RELATED.items() if (folder / name).is_file()]
