"""A tracker over a finished run, and what it writes."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import modsim3d
from modsim3d import ModsimError, OutputError, RunDirectoryError, RunRows, StoredRun, load_scene
from modsim3d.runs.camera_sequences import camera_sequences
from modsim3d.tracking.trackers import registry
from modsim3d.tracking.trackers.interface import CameraFacts, SensedFrame, TrackedFrame, Tracker
from modsim3d.tracking.trackers.names import BUILT_IN, BuiltIn
from tests.run_folders import interrupt
from tests.scenes import crossing

STEPS = 40


class EveryBox(Tracker):
    """The detections themselves, from a frame on; the k-th most confident of a frame is track k."""

    most: int = 100
    first: int = 0

    def follow(self, frames: Iterable[SensedFrame], camera: CameraFacts) -> Iterator[TrackedFrame]:
        for place, frame in enumerate(frames):
            count = min(len(frame.label), self.most) if place >= self.first else 0
            yield TrackedFrame(np.arange(count), frame.boxes_px[:count], frame.label[:count], frame.confidence[:count])


@pytest.fixture(autouse=True)
def every_box(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(BUILT_IN, "sort", BuiltIn(__name__, "EveryBox"))
    monkeypatch.setattr(registry, "data_folder", lambda kind: Path("/nowhere"))  # settings of SORT are not its own


def test_the_tracks_of_a_tracker_that_repeats_detections_are_the_detections(run: StoredRun, tmp_path: Path) -> None:
    result = modsim3d.track_run(run, tmp_path / "tracks", tracker="sort")
    (sequence,) = camera_sequences(run, (0,))
    told = sequence.detections
    assert len(told) > STEPS
    assert np.lexsort((result.tracks.track, result.tracks.frame)).tolist() == list(range(len(told)))
    np.testing.assert_array_equal(result.tracks.boxes_px, told.boxes_px)
    np.testing.assert_array_equal(result.tracks.step, sequence.steps[told.frame])
    np.testing.assert_array_equal(result.tracks.confidence, told.confidence)


class Coasting(Tracker):
    """A track that begins where a detection is and leaves the image at a thousand pixels a frame, barely certain."""

    xy: float = 0.5
    yx: float = 0.5

    def follow(self, frames: Iterable[SensedFrame], camera: CameraFacts) -> Iterator[TrackedFrame]:
        for place, _ in enumerate(frames):
            box = np.array([[10.0, 20.0, 30.0, 40.0]]) - 1000.0 * place
            yield TrackedFrame(np.array([7]), box, covariance_px2=np.array([[[1.0, self.xy], [self.yx, 1.0]]]))


def test_a_track_far_out_of_the_image_is_read_and_no_unreadable_covariance_is_written(run, tmp_path, monkeypatch):
    monkeypatch.setitem(BUILT_IN, "sort", BuiltIn(__name__, "Coasting"))
    modsim3d.track_run(run, tmp_path / "tracks", tracker="sort")
    (one,) = modsim3d.score_run(run, tmp_path / "tracks").trackers
    assert len(one.track_set.tracks) == STEPS
    # Its two covariances differ by rounding; with the one that is written it is none.
    with pytest.raises(ModsimError, match="this is no covariance of x and y"):
        modsim3d.track_run(run, tmp_path / "t", tracker="sort", settings={"xy": 1 + 4e-7, "yx": 1 - 5e-7})


def test_counts_are_those_of_the_tracks(run: StoredRun, tmp_path: Path) -> None:
    told: list[int] = []
    few = {"most": 1, "first": 5}
    result = modsim3d.track_run(run, tmp_path / "t", tracker="sort", settings=few, progress=told.append)
    tracks, rows = result.tracks, RunRows.of(run)
    times_s = run.scene.times_s(0, STEPS)
    counts = result.counts
    assert (counts.frames, counts.detections) == (STEPS, len(rows.detections))
    seen = np.unique(rows.detection_frame[rows.detection_frame >= 5])
    assert (counts.tracks, counts.boxes) == (1, len(seen))
    assert counts.median_track_s == pytest.approx(times_s[seen[-1]] - times_s[seen[0]])
    assert times_s[seen[0]] > 0 and np.isin(seen, tracks.step).all()
    assert result.camera_counts == {"C0": counts} and sum(told) == STEPS
    assert result.name == "sort (most=1, first=5)"
    assert "tracks 1" in repr(result) and "sort (most=1, first=5)" in result._repr_html_()
    result = modsim3d.track_run(run, tmp_path / "none", tracker="sort", settings={"most": 0})
    assert (result.counts.tracks, result.counts.boxes, result.counts.median_track_s) == (0, 0, None)
    assert "median" not in repr(result)


def test_what_is_written_says_how_it_was_made_is_the_same_again_and_refused_where_it_is_there(run, tmp_path):
    for name in ("a", "b"):
        modsim3d.track_run(run.folder, str(tmp_path / name), tracker="sort", settings={"most": 3})
    files = [{path.name: path.read_bytes() for path in (tmp_path / name).iterdir()} for name in ("a", "b")]
    assert files[0] == files[1] and set(files[0]) == {"tracks.parquet", "tracks.json"}
    facts = json.loads(files[0]["tracks.json"])
    assert (facts["tracker"], facts["settings"]) == ("sort", {"most": 3, "first": 0})
    assert facts["chosen"].startswith("the tracker's defaults")
    text = (Path(__file__).parents[2] / "docs" / "track.md").read_text(encoding="utf-8")
    section = text.split("## What it writes")[1].split("\n## ")[0].split("`tracks.json`")[0]
    columns = pq.read_schema(tmp_path / "a" / "tracks.parquet").names
    assert [name for name in columns if f"`{name}`" not in section] == []
    tracks = tmp_path / "tracks"
    modsim3d.track_run(run, tracks, tracker="sort")
    frames: list[int] = []
    with pytest.raises(OutputError, match="exists: use overwrite=True"):
        modsim3d.track_run(run, tracks, tracker="sort", progress=frames.append)
    assert frames == []
    before = (tracks / "tracks.parquet").read_bytes()
    modsim3d.track_run(run, tracks, tracker="sort", settings={"most": 1}, overwrite=True)
    assert (tracks / "tracks.parquet").read_bytes() != before


PLACES = {
    "file": "file is a file, and tracks.parquet is to be",
    "file/deep": "file is a file",
    "/proc/t": "cannot be",
    **dict.fromkeys(("run", "run/tracks", "run/scene/tracks"), "which this command reads"),
}


@pytest.mark.parametrize("place", PLACES)
def test_an_unwritable_folder_or_one_in_the_run_is_refused_before_the_work(run, tmp_path: Path, place: str) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "run").symlink_to(run.folder)
    frames, before = [], sorted(run.folder.rglob("*"))
    with pytest.raises(OutputError, match=PLACES[place]):
        modsim3d.track_run(run, tmp_path / place, tracker="sort", overwrite=True, progress=frames.append)
    assert frames == [] and (tmp_path / "file").read_text() == "mine"
    assert sorted(run.folder.rglob("*")) == before


def test_a_tracker_that_fails_leaves_nothing_and_an_interrupted_run_is_refused(run, tmp_path, monkeypatch) -> None:
    interrupt(load_scene(crossing(tmp_path, 5), source="analytic"), tmp_path / "run")
    with pytest.raises(
        RunDirectoryError, match=r"interrupted run: finish it with `modsim3d\.run_scene\(…, resume=True"
    ):
        modsim3d.track_run(tmp_path / "run", tmp_path / "tracks", tracker="sort")
    monkeypatch.setattr(EveryBox, "follow", lambda self, frames, camera: iter(()))
    with pytest.raises(ModsimError, match="the tracker 'sort': camera 'C0' at 0 s: it ended after 0 of 40 frames"):
        modsim3d.track_run(run, tmp_path / "tracks", tracker="sort")
    assert not (tmp_path / "tracks").exists()
