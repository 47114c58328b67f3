"""Scores of tracks of a run: trackers, references, detector seeds, some cameras, files and what is refused."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pytest

from modsim3d import ModsimError, RunDirectoryError, RunRows, RunScores, StoredRun, score_run, track_run
from modsim3d.tracking.detector_seeds import detector_runs
from modsim3d.tracking.oracle import REFERENCES
from modsim3d.tracking.score_outcome import remarks_of, score_data
from modsim3d.tracking.score_page import score_page, seed_rows
from modsim3d.tracking.score_text import keys_of
from modsim3d.tracks.tracks import Tracks, TrackSet
from modsim3d.tracks.true_tracks import TrueTracks
from tests.cli.bad_input.builders import Call
from tests.tracks.track_files import csv_text, detected_tracks, mot_texts, scene_run, write_mot

NO_NAMES: list[Any] = [3, 0, True, [3], ["C0", None]]


@pytest.fixture(scope="module")
def tracks(run: StoredRun) -> Path:
    return track_run(run, run.folder.parent / "tracks").folder


@pytest.fixture(scope="module")
def perfect(run: StoredRun) -> TrackSet:
    truth = TrueTracks.of(RunRows.of(run))
    return TrackSet("perfect", Tracks.of(truth.cameras, truth.frame, truth.identity, truth.boxes_px), None)


@pytest.fixture(scope="module")
def scores(run: StoredRun, tracks: Path, perfect: TrackSet) -> RunScores:
    return score_run(run, [tracks, perfect])


def test_perfect_tracks_score_1_and_come_first(scores: RunScores) -> None:
    assert [each.name for each in scores.trackers] == ["perfect", "reference"]
    best = keys_of(scores.trackers[0].scores)
    assert (best["hota"], best["mota"], best["idf1"], best["gospa"]) == pytest.approx((1, 1, 1, 0))
    assert scores.conclusion.startswith("perfect has the highest HOTA of 2 trackers: it follows vessels for 100 %")
    assert repr(scores) == f"<RunScores {scores.run.folder}: {scores.conclusion}>"


def test_references_do_not_depend_on_the_trackers_beside_them(run: StoredRun, scores: RunScores, tracks: Path) -> None:
    alone = score_run(run, tracks)
    assert alone.references["raw"].flat() == scores.references["raw"].flat()
    raw, smoothed = (keys_of(alone.references[name]) for name in ("raw", "smoothed"))
    assert raw["id_switches"] == 0
    assert (smoothed["hota"] or 0) > (raw["hota"] or 0)  # the boxes of this scene are noisy
    exchanged = {"raw": alone.references["smoothed"], "smoothed": alone.references["raw"]}
    assert replace(alone, references=exchanged).conclusion == alone.conclusion  # beside the better one


def test_the_first_detector_seed_and_its_scores_are_those_of_the_run_and_the_others_are_not(
    run, scores, tracks
) -> None:
    (seed, first), (_, second) = detector_runs(run, 2)
    stored = RunRows.of(run)
    assert seed == run.scene.detector_seed
    assert first.detections.equals(stored.detections) and first.truth.equals(stored.truth)
    assert second.truth["full_x_min_px"].equals(stored.truth["full_x_min_px"])
    assert not np.array_equal(second.detection_boxes_px(), stored.detection_boxes_px())
    told: list[int] = []
    found = score_run(run, tracks, seeds=2, progress=told.append)
    assert told == [1, 1] and "it says nothing about other traffic" in score_page(found)
    of_tracker, of_smoothed = (found.seeds.spreads[name]["hota"].values for name in ("reference", "smoothed"))
    assert of_tracker[0] == keys_of(scores.trackers[1].scores)["hota"] != of_tracker[1]
    assert of_smoothed[0] == keys_of(scores.references["smoothed"])["hota"]
    lines = [row[:2] for row in seed_rows(found)]
    assert ("reference", "ANEES") in lines
    assert (REFERENCES["raw"], "HOTA") in lines and (REFERENCES["raw"], "ANEES") not in lines  # it has no covariances


def test_what_is_written_is_what_is_told_and_stays_without_overwrite(run, scores, perfect, tmp_path: Path) -> None:
    data, page = scores.write(tmp_path / "out")
    assert json.loads(data.read_text()) == orjson.loads(orjson.dumps(score_data(scores), default=str))
    assert scores.conclusion in page.read_text().split("<p", 2)[1]
    with pytest.raises(ModsimError, match="exists: use --overwrite"):
        scores.write(tmp_path / "out")
    first = page.read_bytes()
    scores.write(tmp_path / "out", overwrite=True)
    assert page.read_bytes() == first
    text = score_page(score_run(run, replace(perfect, name="<b>mine</b>"), by_class=False))
    assert "<b>mine" not in text and "&lt;b&gt;mine" in text
    assert not any(part in text for part in ("http:", "https:", "src=", "<script"))


def test_a_tracker_without_tracks_and_an_empty_file_are_scored(run, strait, of_bow: Path, tmp_path: Path) -> None:
    nothing = TrackSet("nothing", Tracks.of(1, *(np.empty(0, dtype=int) for _ in range(2)), np.empty((0, 4))), None)
    scores = score_run(run, nothing)
    assert scores.conclusion.startswith("nothing follows no vessel: no track counts")
    assert "nothing" in scores._repr_html_() and score_page(scores)
    (tmp_path / "none.csv").write_text(of_bow.read_text().splitlines()[0] + "\n")
    assert score_run(strait, tmp_path / "none.csv").trackers[0].scores.flat()["hota"] == 0


def test_noisy_boxes_are_told_where_iou_scores_them(run: StoredRun, tracks: Path, scores: RunScores) -> None:
    raw = keys_of(scores.references["raw"])["hota"]
    assert raw is not None and raw < 0.3 and f"have HOTA {raw:.2f} only" in remarks_of(scores)
    assert "only" not in remarks_of(score_run(run, tracks, similarity="centre", scale_px=150))


def test_tracks_in_the_world_have_a_table_of_their_own_and_tracks_of_one_name_are_told_apart(
    run: StoredRun, tracks: Path, perfect: TrackSet, tmp_path: Path
) -> None:
    paths = [tmp_path / name / "fused.csv" for name in ("a", "b")]
    for path in paths:
        path.parent.mkdir()
        path.write_text("time_s,track,w1_m,w2_m\n0,1,5000,5000\n")
    scores = score_run(run, paths[0])
    assert scores.trackers == () and scores.references == {}
    assert scores.conclusion == "fused follows no vessel in the world."
    assert "Tracks in the world" in score_page(scores) and score_data(scores)["world"][0]["rmse_m"] is None
    assert [each.name for each in score_run(run, paths).world] == [str(path) for path in paths]
    names = [each.name for each in score_run(run, [perfect, replace(perfect), tracks]).trackers]
    assert names == ["perfect 1", "perfect 2", "reference"]


def test_what_cannot_be_scored_is_refused(run: StoredRun, tracks: Path, perfect: TrackSet, tmp_path: Path) -> None:
    refused: list[tuple[Any, dict[str, Any], str]] = [
        ([tracks, perfect], {"seeds": 3}, "nothing says which one made 'perfect': give folders that `modsim3d track`"),
        (tracks, {"seeds": 1}, r"--seeds must be from 2 to 1000 \(got 1\)"),
        ([tracks, tracks], {}, "is given twice"),
        ([], {}, "there are no tracks to score"),
        (tracks, {"similarity": "centre"}, "similarity centre needs scale_px"),
    ]
    no_names = "cameras must be the name of a camera, or a list of names"
    for given, rules, said in [*refused, *((perfect, {"cameras": each}, no_names) for each in NO_NAMES)]:
        with pytest.raises(ModsimError, match=said):
            score_run(run, given, **rules)
    with pytest.raises(TypeError, match="tracks"):
        score_run(run, [3])  # type: ignore[list-item]
    with pytest.raises(RunDirectoryError):
        score_run(tmp_path, tracks)


@pytest.fixture(scope="module")
def strait(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    return scene_run(tmp_path_factory.mktemp("cameras") / "strait", "strait", steps=12, seed=3)


@pytest.fixture(scope="module")
def of_bow(strait: StoredRun) -> Path:
    """Tracks of the bow alone, as a program that was given one camera writes them."""
    rows = RunRows.of(strait)
    tracks = detected_tracks(rows)
    path = strait.folder.parent / "bow_only.csv"
    path.write_text(csv_text(rows, tracks.take(tracks.camera == 0)))
    return path


def test_the_camera_that_is_asked_for_is_scored_alone_and_tracks_of_others_are_left_out(
    strait, of_bow, tmp_path
) -> None:
    both, one = (score_run(strait, of_bow, cameras=each).trackers[0].scores for each in (["bow", "quay"], "bow"))
    flat, whole = one.flat(), both.flat()
    assert list(one.by_camera) == ["bow"] and one.by_camera["bow"] == both.by_camera["bow"]
    assert flat["hota"] == pytest.approx(one.by_camera["bow"].hota)
    assert flat["misses"] < whole["misses"] and flat["true_positives"] == whole["true_positives"]
    assert {each.camera for each in one.occlusions} <= {"bow"}
    rows = RunRows.of(strait)
    (tmp_path / "all.csv").write_text(csv_text(rows, detected_tracks(rows)))
    assert score_run(strait, tmp_path / "all.csv", cameras=("bow",)).trackers[0].scores.flat() == flat


def test_detector_seeds_are_of_the_same_camera(strait: StoredRun, tmp_path: Path) -> None:
    track_run(strait, tmp_path / "tracks")
    found = score_run(strait, tmp_path / "tracks", cameras="quay", seeds=2)
    first = found.seeds.spreads["reference"]["hota"].values[0]
    assert first == pytest.approx(found.trackers[0].scores.flat()["hota"])


def test_one_mot_file_is_enough_for_one_camera(strait: StoredRun, of_bow: Path, tmp_path: Path) -> None:
    rows = RunRows.of(strait)
    folder = write_mot(tmp_path / "mot", {"bow.txt": mot_texts(rows, detected_tracks(rows))["bow.txt"]})
    wanted = score_run(strait, of_bow, cameras="bow").trackers[0].scores.flat()
    for path in (folder, folder / "bow.txt"):
        found = score_run(strait, path, cameras="bow").trackers[0].scores.flat()
        assert found["hota"] == pytest.approx(wanted["hota"], abs=1e-4)
    with pytest.raises(ModsimError, match=r"quay\.txt is missing"):
        score_run(strait, folder)


def test_what_cannot_be_is_refused(strait: StoredRun, of_bow: Path, tmp_path: Path) -> None:
    with pytest.raises(ModsimError, match=r"have no line of camera 'quay'.*--camera bow.*--camera bow --camera quay"):
        score_run(strait, of_bow)
    with pytest.raises(ModsimError, match=r"no camera 'bov' in this run \(did you mean 'bow'\?\)"):
        score_run(strait, of_bow, cameras="bov")
    (tmp_path / "world.csv").write_text("time_s,track,w1_m,w2_m\n0,1,5000,5000\n")
    with pytest.raises(ModsimError, match="--camera is for tracks in the images"):
        score_run(strait, tmp_path / "world.csv", cameras="bow")


def test_the_command_says_which_cameras_it_scored(strait: StoredRun, of_bow: Path, call: Call) -> None:
    def scored(*options: str) -> str:
        status, text = call("score", strait.folder, of_bow, *options)
        assert status == 0
        return text

    assert "only bow" in scored("--camera", "bow")
    assert json.loads(scored("--camera", "bow", "--json"))["rules"]["cameras"] == ["bow"]
    assert json.loads(scored("--camera", "quay", "--camera", "bow", "--json"))["rules"]["cameras"] is None
