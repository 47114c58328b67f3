"""Scores of a run's own detections, associated by where they came from, are TrackEval's of the exported run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from modsim3d.formats.writing import mot
from modsim3d.formats.writing.request import ExportRequest
from modsim3d.runs.files.columns import NOBODY
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracking.scores.association import clear, hota, identity
from modsim3d.tracking.scores.rules import Rules
from modsim3d.tracking.scores.scored import Scored
from modsim3d.tracks.tracks import Tracks
from tests.formats.exported import exported_run
from tests.formats.test_export_mot import scores


def by_provenance(rows: RunRows) -> Tracks:
    """Detections as tracks that coast over hidden vessels; false positives are tracks too, seven in turn."""
    hidden = rows.numbers("visible_px") == 0
    false = rows.detected_row == NOBODY
    track = np.where(false, 100 + np.arange(len(false)) % 7, rows.detection_vessel)
    frame = np.append(rows.detection_frame, rows.truth_frame[hidden])
    track = np.append(track, rows.truth_vessel[hidden])
    boxes_px = np.round(np.concatenate([rows.detection_boxes_px(), rows.boxes_px("full")[hidden]]), 3)
    _, first = np.unique(np.column_stack([frame, track]), axis=0, return_index=True)
    return Tracks.of(len(rows.scene.cameras), frame[first], track[first], boxes_px[first])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scored")


def test_the_scores_are_those_of_trackeval_over_the_exported_run(folder: Path) -> None:
    run = exported_run(folder, mode=2, source="analytic")
    rows = RunRows.of(run)
    tracks = by_provenance(rows)
    mot.write(ExportRequest(run, (0, 1)), folder / "mot")
    for camera, name in enumerate(("name-2", "quay.2")):
        here = tracks.take(tracks.camera == camera)
        taken = rows.frames[rows.frames % 2 == camera]
        corner, size = here.boxes_px[:, :2] + 1, here.boxes_px[:, 2:] - here.boxes_px[:, :2]
        table = np.column_stack([np.searchsorted(taken, here.frame) + 1, here.track + 1, corner, size])
        path = folder / "tracks" / mot.ALL_SET / "tracker" / "data" / f"{name}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        lines = ("{:.0f},{:.0f},{:.12g},{:.12g},{:.12g},{:.12g},1,-1,-1,-1\n".format(*row) for row in table)
        path.write_text("".join(lines))
    scored = Scored.of(rows, tracks, Rules())
    assert scored.following.truth.hidden.any() and not scored.following.counted.all()
    found = hota(scored).hota, clear(scored).mota, identity(scored).idf1
    expected = scores(folder / "mot", folder / "tracks", "all")["COMBINED_SEQ"]
    assert 0.1 < found[0] < 0.9
    assert found == pytest.approx([expected[key] for key in ("HOTA", "MOTA", "IDF1")], abs=1e-12)
