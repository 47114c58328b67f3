"""Scores of a run's own detections, associated by where they came from, are TrackEval's of the exported run."""

from pathlib import Path

import numpy as np
import pytest

from modsim3d import RunRows, StoredRun, Tracks
from modsim3d.core.arrays import NOBODY
from modsim3d.formats.writing import mot
from modsim3d.formats.writing.request import ExportRequest
from modsim3d.tracking.scores.association import clear, hota, identity
from modsim3d.tracking.scores.scored import Rules, Scored
from tests.formats.exported import exported_run
from tests.formats.test_export_mot import scores
from tests.tracking.test_association import check_the_one_matching_is_that_of_clear


def by_provenance(rows: RunRows, coasting: bool = True) -> Tracks:
    """Detections as tracks; they may coast over hidden vessels, and false positives are seven tracks in turn."""
    hidden, false = (rows.numbers("visible_px") == 0) & coasting, rows.detected_row == NOBODY
    track = np.where(false, 100 + np.arange(len(false)) % 7, rows.detection_vessel)
    frame = np.append(rows.detection_frame, rows.truth_frame[hidden])
    track = np.append(track, rows.truth_vessel[hidden])
    boxes_px = np.round(np.concatenate([rows.detection_boxes_px(), rows.boxes_px("full")[hidden]]), 3)
    _, first = np.unique(np.column_stack([frame, track]), axis=0, return_index=True)
    return Tracks.of(len(rows.scene.cameras), frame[first], track[first], boxes_px[first])


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    return exported_run(tmp_path_factory.mktemp("scored"), mode=2, source="analytic")


def test_the_scores_are_those_of_trackeval_over_the_exported_run(run: StoredRun, tmp_path: Path) -> None:
    rows = RunRows.of(run)
    tracks = by_provenance(rows)
    mot.write(ExportRequest(run, (0, 1)), tmp_path / "mot")
    for camera, name in enumerate(("name-2", "quay.2")):
        here, taken = tracks.take(tracks.camera == camera), rows.frames[rows.frames % 2 == camera]
        corner, size = here.boxes_px[:, :2] + 1, here.boxes_px[:, 2:] - here.boxes_px[:, :2]
        table = np.column_stack([np.searchsorted(taken, here.frame) + 1, here.track + 1, corner, size])
        path = tmp_path / "tracks" / mot.ALL_SET / "tracker" / "data" / f"{name}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        lines = ("{:.0f},{:.0f},{:.12g},{:.12g},{:.12g},{:.12g},1,-1,-1,-1\n".format(*row) for row in table)
        path.write_text("".join(lines))
    scored = Scored.of(rows, tracks, Rules())
    assert scored.following.truth.hidden.any() and not scored.following.counted.all()
    found = hota(scored).hota, clear(scored).mota, identity(scored).idf1
    expected = scores(tmp_path / "mot", tmp_path / "tracks", "all")["COMBINED_SEQ"]
    assert 0.1 < found[0] < 0.9
    assert found == pytest.approx([expected[key] for key in ("HOTA", "MOTA", "IDF1")], abs=1e-12)


def test_the_one_matching_is_that_of_clear_where_no_track_is_on_a_hidden_vessel(run: StoredRun) -> None:
    rows = RunRows.of(run)
    tracks = by_provenance(rows, coasting=False)
    later = tracks.step > 20  # from where on the same vessels have other tracks
    switched = Tracks.of(tracks.cameras, tracks.frame, tracks.track + 50 * later, tracks.boxes_px)
    scored = Scored.of(rows, switched, Rules())
    assert scored.following.counted.all()
    check_the_one_matching_is_that_of_clear(scored)
