"""Scores of some cameras of a run, and tracks that say nothing of others."""

import json
from pathlib import Path

import pytest

import modsim3d
from modsim3d import ModsimError, RunRows, StoredRun
from tests.cli.bad_input.builders import Call
from tests.tracks.track_files import csv_text, detected_tracks, mot_texts, scene_run, write_mot


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    return scene_run(tmp_path_factory.mktemp("cameras") / "strait", "strait", steps=12, seed=3)


@pytest.fixture(scope="module")
def of_bow(run: StoredRun) -> Path:
    """Tracks of the bow alone, as a program that was given one camera writes them."""
    rows = RunRows.of(run)
    tracks = detected_tracks(rows)
    path = run.folder.parent / "bow_only.csv"
    path.write_text(csv_text(rows, tracks.take(tracks.camera == 0)))
    return path


def test_the_camera_that_is_asked_for_is_scored_alone_and_tracks_of_others_are_left_out(run, of_bow, tmp_path) -> None:
    both, one = (modsim3d.score_run(run, of_bow, cameras=each).trackers[0].scores for each in (["bow", "quay"], "bow"))
    flat, whole = one.flat(), both.flat()
    assert list(one.by_camera) == ["bow"] and one.by_camera["bow"] == both.by_camera["bow"]
    assert flat["hota"] == pytest.approx(one.by_camera["bow"].hota)
    assert flat["misses"] < whole["misses"] and flat["true_positives"] == whole["true_positives"]
    assert {each.camera for each in one.occlusions} <= {"bow"}
    rows = RunRows.of(run)
    (tmp_path / "all.csv").write_text(csv_text(rows, detected_tracks(rows)))
    among = modsim3d.score_run(run, tmp_path / "all.csv", cameras=("bow",)).trackers[0]
    assert among.scores.flat() == flat


def test_detector_seeds_are_of_the_same_camera(run: StoredRun, tmp_path: Path) -> None:
    modsim3d.track_run(run, tmp_path / "tracks")
    found = modsim3d.score_run(run, tmp_path / "tracks", cameras="quay", seeds=2)
    first = found.seeds.spreads["reference"]["hota"].values[0]
    assert first == pytest.approx(found.trackers[0].scores.flat()["hota"])


def test_one_mot_file_is_enough_for_one_camera(run: StoredRun, of_bow: Path, tmp_path: Path) -> None:
    rows = RunRows.of(run)
    folder = write_mot(tmp_path / "mot", {"bow.txt": mot_texts(rows, detected_tracks(rows))["bow.txt"]})
    wanted = modsim3d.score_run(run, of_bow, cameras="bow").trackers[0].scores.flat()
    for path in (folder, folder / "bow.txt"):
        found = modsim3d.score_run(run, path, cameras="bow").trackers[0].scores.flat()
        assert found["hota"] == pytest.approx(wanted["hota"], abs=1e-4)
    with pytest.raises(ModsimError, match=r"quay\.txt is missing"):
        modsim3d.score_run(run, folder)


def test_an_empty_file_is_a_tracker_that_found_nothing(run: StoredRun, of_bow: Path, tmp_path: Path) -> None:
    (tmp_path / "none.csv").write_text(of_bow.read_text().splitlines()[0] + "\n")
    assert modsim3d.score_run(run, tmp_path / "none.csv").trackers[0].scores.flat()["hota"] == 0


def test_what_cannot_be_is_refused(run: StoredRun, of_bow: Path, tmp_path: Path) -> None:
    with pytest.raises(ModsimError, match=r"have no line of camera 'quay'.*--camera bow.*--camera bow --camera quay"):
        modsim3d.score_run(run, of_bow)
    with pytest.raises(ModsimError, match=r"no camera 'bov' in this run \(did you mean 'bow'\?\)"):
        modsim3d.score_run(run, of_bow, cameras="bov")
    (tmp_path / "world.csv").write_text("time_s,track,w1_m,w2_m\n0,1,5000,5000\n")
    with pytest.raises(ModsimError, match="--camera is for tracks in the images"):
        modsim3d.score_run(run, tmp_path / "world.csv", cameras="bow")


def test_the_command_says_which_cameras_it_scored(run: StoredRun, of_bow: Path, call: Call) -> None:
    def scored(*options: str) -> str:
        status, text = call("score", run.folder, of_bow, *options)
        assert status == 0
        return text

    assert "only bow" in scored("--camera", "bow")
    assert json.loads(scored("--camera", "bow", "--json"))["rules"]["cameras"] == ["bow"]
    assert json.loads(scored("--camera", "quay", "--camera", "bow", "--json"))["rules"]["cameras"] is None
