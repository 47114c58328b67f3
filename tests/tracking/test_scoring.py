"""All scores together: keys, groups, intervals and sentences; scores of a run's trackers and what is refused."""

import json
from dataclasses import fields, replace
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pytest

from modsim3d import RunDirectoryError, RunRows, RunScores, StoredRun, score_run, track_run
from modsim3d.core.errors import ModsimError
from modsim3d.core.text import number
from modsim3d.tracking.detector_seeds import Spread, detector_runs
from modsim3d.tracking.oracle import REFERENCES
from modsim3d.tracking.score_outcome import remarks_of, score_data
from modsim3d.tracking.score_page import score_page, seed_rows, survived_of
from modsim3d.tracking.score_text import LengthBin, TrackerOutcome, conclusion, keys_of, percent
from modsim3d.tracking.scores.breakdown import Bin
from modsim3d.tracking.scores.scored_run import Rules
from modsim3d.tracking.scores.scoring import Scores, SubsetScores, score_tracks
from modsim3d.tracks.tracks import Tracks, TrackSet
from modsim3d.tracks.true_tracks import TrueTracks
from tests.cli.bad_input.builders import Call
from tests.tracking.hand_made import LABELS, Seen, box, rows_of, tracks_of
from tests.tracks.track_files import csv_text, detected_tracks, mot_texts, scene_run, write_mot

A, B = box(0), box(100)
BY_CLASS = Rules(by_class=True)


def scores_of(truth, tracks, steps: int, rules: Rules | None = None, **kinds: object) -> Scores:
    cameras = kinds.get("cameras", 1)
    return score_tracks(rows_of(truth, steps, **kinds), tracks_of(tracks, cameras), rules or Rules())


@pytest.fixture(scope="module")
def miss_in_haze() -> Scores:
    """A vessel in two clear frames and in two in haze; it is missed in the last."""
    truth, tracks = [(k, 0, A) for k in range(4)], [(k, 1, A) for k in range(3)]
    return scores_of(truth, tracks, 4, states=[0, 0, 1, 1])


def test_every_key_is_that_of_one_part_and_a_state_has_the_scores_of_its_frames_only(miss_in_haze):
    keys = [field.name for part in miss_in_haze.parts for field in fields(part)]
    assert len(keys) == len(set(keys)) and [*miss_in_haze.flat()] == keys
    named = {"hota", "deta", "assa", "mota", "idf1", "id_switches", "gospa", "ospa", "siap_completeness", "rmse_px"}
    assert named | {"established_share", "hidden_followed", "occlusions_survived"} <= set(keys)
    assert set(miss_in_haze.as_json()) == set(keys) | {"by_state", "by_camera", "breakdown", "each_occlusion"}
    assert miss_in_haze.flat()["hota"] == pytest.approx(0.75)  # DetA = 3/4, A = 3/4
    perfect = SubsetScores(frames=2, vessel_frames=2, hota=1, deta=1, assa=1, mota=1, idf1=1)
    half = SubsetScores(frames=2, vessel_frames=2, hota=0.5, deta=0.5, assa=0.5, mota=0.5, idf1=2 / 3)
    assert [*miss_in_haze.by_state] == ["clear", "haze"]
    for name, expected in (("clear", perfect), ("haze", half)):
        assert vars(miss_in_haze.by_state[name]) == pytest.approx(vars(expected), abs=1e-12)


def test_a_camera_has_the_scores_of_its_frames_only_and_json_is_made_of_what_json_knows(miss_in_haze):
    found = scores_of([(k, 0, A) for k in range(4)], [(0, 1, A), (2, 1, A)], 2, cameras=2).by_camera
    assert found == {"C0": SubsetScores(2, 2, 1, 1, 1, 1, 1), "C1": SubsetScores(2, 2, 0, 0, None, 0, 0)}
    truth = [Seen(0, 0, A), Seen(1, 0, A, visible=0)]
    found = scores_of(truth, [(0, 1, A), (1, 1, A)], 2, states=[0, 1]).by_state
    assert found == {"clear": SubsetScores(1, 1, 1, 1, 1, 1, 1), "haze": SubsetScores(1, 0, *(None,) * 5)}
    found = miss_in_haze.as_json() | {"hota_by_alpha": list(miss_in_haze.flat()["hota_by_alpha"])}
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    for truth, tracks in (([], []), ([(0, 0, A)], []), ([], [(0, 1, A, 0)])):
        found = scores_of(truth, tracks, 2, BY_CLASS).as_json()
        assert json.loads(json.dumps(found, allow_nan=False)).keys() == found.keys()
        assert [*found.get("by_class", {})] == [LABELS[0]] * (len(truth) + len(tracks)), (truth, tracks)


def test_by_class_each_label_has_its_own_matching_and_a_track_without_one_is_refused():
    # Vessel 0 has label 0, vessel 2 label 1; the tracker takes both for label 0, and has a box of label 0 too much.
    truth = [(k, vessel, place) for k in range(2) for vessel, place in ((0, A), (2, B))]
    tracks = [(k, track, place, 0) for k in range(2) for track, place in ((1, A), (2, B))]
    found = scores_of(truth, tracks, 2, BY_CLASS)
    assert found.flat() == scores_of(truth, tracks, 2).flat() and found.flat()["hota"] == 1
    first, second = (found.by_class[name].flat() for name in LABELS[:2])
    assert [*found.by_class] == [*LABELS[:2]]  # nothing has the third
    # Label 0: 2 matches and 2 false boxes, so DetA = 2/4, A = 1, MOTA = 1 − 2/2. Label 1: 2 misses.
    assert (first["hota"], first["mota"], first["false_positives"]) == pytest.approx((sqrt(0.5), 0, 2))
    assert (second["hota"], second["mota"], second["misses"]) == (0, 0, 2)
    assert found.as_json()["by_class"] == {LABELS[0]: first, LABELS[1]: second}
    tracks = [(0, 1, A, 0), (0, 2, B), (1, 1, A, 0)]
    said = r"^by_class=True needs a label .* 1 of 3 rows have none: score without it$"
    with pytest.raises(ModsimError, match=said):
        scores_of([(0, 0, A)], tracks, 2, BY_CLASS)
    assert scores_of([(0, 0, A)], tracks, 2).by_class == {}


Numbers = dict[str, float | int | None]
SHORT, LONG = LengthBin("of 0 to 1 s", 10, 9), LengthBin("longer than 10 s", 9, 2)


def keys(hota: float | None, followed: int = 71, missed: int = 29, false: int = 0) -> Numbers:
    return {"hota": hota, "true_positives": followed, "misses": missed, "false_positives": false}


def told(name: str, lengths: tuple[LengthBin, ...] = (), **scores: float | None) -> TrackerOutcome:
    return TrackerOutcome(name, keys(**{"hota": 0.52, **scores}), lengths)  # type: ignore[arg-type]


REFERENCE = keys(0.78)


NOTHING = {"hota": 0.0, "followed": 0}
SAID = [
    ([told("sort"), told("slow", hota=0.4), told("slower", hota=None)], REFERENCE,
     "sort has the highest HOTA of 3 trackers: it follows vessels for 71 % of the time"),
    ([told("a"), told("b"), told("c", hota=0.1)], REFERENCE,
     "a and b have the same HOTA, the highest of 3 trackers: a follows vessels"),
    ([told("a"), told("b")], REFERENCE, "a and b have the same HOTA: a follows vessels"),
    ([told("sort")], keys(None), "sort follows vessels for 71 % of the time that it should (HOTA 0.52)."),
    ([told("sort", missed=40, **NOTHING)], REFERENCE,
     "sort follows no vessel: no track counts, and 40 boxes of vessels should be followed."),
    ([told("sort", **NOTHING)] * 2, REFERENCE, "None of the 2 trackers follows a vessel;"),
    ([told("sort", missed=1, false=1, **NOTHING)], REFERENCE,
     "sort follows no vessel: its only box is false, and 1 box of vessels should be followed."),
    ([told("sort", missed=1, false=7, **NOTHING)], REFERENCE,
     "sort follows no vessel: all of its 7 boxes are false, and 1 box of vessels should be followed."),
]  # fmt: skip
"""Trackers, the reference, and how the sentence begins."""


def test_the_sentence_says_first_what_is_worth_knowing_with_the_reference_and_what_is_lost_most():
    for trackers, reference, beginning in SAID:
        assert conclusion(trackers, reference).startswith(beginning)
    assert conclusion([told("sort", (SHORT, LONG))], REFERENCE) == (
        "sort follows vessels for 71 % of the time that it should (HOTA 0.52; the same detections with perfect "
        "association reach 0.78). Among occlusions it does worst in those longer than 10 s: 2 of 9 are survived."
    )
    above = conclusion([told("sort", hota=0.8)], REFERENCE)
    assert "(HOTA 0.80, above the 0.78 of the same detections with perfect association)" in above
    assert "reach" not in above
    empty = keys(None, 0, 0)
    said = conclusion([TrackerOutcome("sort", empty, ())], empty)
    assert said == "There is no vessel to follow in this run, and sort has no track."
    said = conclusion([TrackerOutcome("sort", keys(0.0, 0, 0, 3), ())], empty)
    assert said == "There is no vessel to follow in this run, and sort reports 3 boxes, all false."
    assert "can only be false" in conclusion([TrackerOutcome("sort", empty, ()), TrackerOutcome("b", empty, ())], empty)


def lengths(*counts: tuple[int, int]) -> tuple[LengthBin, ...]:
    return tuple(LengthBin(f"of {k} s", all_of_them, survived) for k, (all_of_them, survived) in enumerate(counts))


def test_occlusions_are_told_as_far_as_there_are_enough_and_shares_of_0_or_100_percent_only_if_so():
    for bins, said in (
        ((), "No vessel that it followed went into an occlusion and came out of it."),
        (lengths((0, 0)), "No vessel that it followed went into an occlusion and came out of it."),
        (lengths((1, 1)), "It keeps its vessel through the only occlusion."),
        (lengths((1, 0)), "It keeps its vessel through 0 of 1 occlusion."),
        (lengths((2, 2), (3, 3)), "It keeps its vessel through all 5 occlusions."),
        (lengths((2, 1), (9, 3)), "It keeps its vessel through 4 of 11 occlusions."),
    ):
        assert conclusion([told("sort", bins)], REFERENCE).endswith(said)
    said = [percent(share) for share in (0.0, 0.001, 0.5, 0.999, 1.0, None)]
    assert said == ["0 %", "under 1 %", "50 %", "over 99 %", "100 %", "–"]
    assert [number(-0.25, 2), number(None), number(1234.0, 0)] == ["−0.25", "–", "1,234"]
    counts = ({"occlusions": 5, "judged": 3, "survived": 2 / 3}, {"occlusions": 5, "judged": 0}, {})
    assert [survived_of(Bin("3 to 10", 40, 0.5, 0.4, **each)) for each in counts] == ["2 of 3", "–", ""]


def test_half_an_interval_is_students_quantile_and_equal_or_infinite_values_have_none():
    """Tables have 12.7062 for 1, 4.30265 for 2 and 2.77645 for 4 degrees of freedom at 97.5 %."""
    half = 2.77645 * (2.5 / 5) ** 0.5
    assert Spread((0.0, 2.0)).interval == pytest.approx((1 - 12.7062, 1 + 12.7062), rel=1e-5)
    assert Spread(tuple(range(5))).interval == pytest.approx((2 - half, 2 + half), abs=1e-5)
    spread = Spread((1.0, None, 2.0, 3.0))
    assert (spread.mean, spread.deviation) == (2.0, 1.0)
    assert spread.interval == pytest.approx((2 - 4.30265 / 3**0.5, 2 + 4.30265 / 3**0.5), abs=1e-5)
    assert Spread((1.0, 3.0)).deviation == pytest.approx(2**0.5)
    # A share of 1 in ten runs says nothing of how far the next one may be off.
    for values in ((), (3.0,), (None,), (1.0,) * 19, (0.1 + 0.2, 0.3, 0.3), (0.5, 0.5), (1.0, np.inf)):
        assert Spread(values).interval is None, values
    assert (Spread((None,)).mean, Spread((1.0,)).deviation) == (None, None)
    spread = Spread((1.0, np.inf, None))
    assert (spread.mean, spread.deviation) == (np.inf, None) and number(spread.mean, 1) == "∞"


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


def test_perfect_tracks_come_first_references_depend_on_none_and_noisy_boxes_are_told(scores, run, tracks):
    assert [each.name for each in scores.trackers] == ["perfect", "reference"]
    best = keys_of(scores.trackers[0].scores)
    assert (best["hota"], best["mota"], best["idf1"], best["gospa"]) == pytest.approx((1, 1, 1, 0))
    assert scores.conclusion.startswith("perfect has the highest HOTA of 2 trackers: it follows vessels for 100 %")
    assert repr(scores) == f"<RunScores {scores.run.folder}: {scores.conclusion}>"
    alone = score_run(run, tracks)
    assert alone.references["raw"].flat() == scores.references["raw"].flat()
    raw, smoothed = (keys_of(alone.references[name]) for name in ("raw", "smoothed"))
    assert raw["id_switches"] == 0
    assert (smoothed["hota"] or 0) > (raw["hota"] or 0)  # the boxes of this scene are noisy
    exchanged = {"raw": alone.references["smoothed"], "smoothed": alone.references["raw"]}
    assert replace(alone, references=exchanged).conclusion == alone.conclusion  # beside the better one
    raw = keys_of(scores.references["raw"])["hota"]
    assert raw is not None and raw < 0.3 and f"have HOTA {raw:.2f} only" in remarks_of(scores)
    assert "only" not in remarks_of(score_run(run, tracks, similarity="centre", scale_px=150))


def test_the_first_detector_seed_and_its_scores_are_those_of_the_run_and_the_others_are_not(run, scores, tracks):
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
    assert scores.conclusion in page.read_text().replace("\xa0", " ").split("<p", 2)[1]
    with pytest.raises(ModsimError, match="exists: use overwrite=True"):
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
        ([tracks, perfect], {"seeds": 3}, "nothing says which one made 'perfect': give folders that `modsim3d.track"),
        (tracks, {"seeds": 1}, r"^seeds must be from 2 to 1000 \(got 1\)"),
        ([tracks, tracks], {}, "is given twice"),
        ([], {}, "there are no tracks to score"),
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


def test_the_camera_that_is_asked_for_is_scored_alone_also_over_detector_seeds(strait, of_bow, tmp_path):
    both, one = (score_run(strait, of_bow, cameras=each).trackers[0].scores for each in (["bow", "quay"], "bow"))
    flat, whole = one.flat(), both.flat()
    assert list(one.by_camera) == ["bow"] and one.by_camera["bow"] == both.by_camera["bow"]
    assert flat["hota"] == pytest.approx(one.by_camera["bow"].hota)
    assert flat["misses"] < whole["misses"] and flat["true_positives"] == whole["true_positives"]
    assert {each.camera for each in one.occlusions} <= {"bow"}
    rows = RunRows.of(strait)
    (tmp_path / "all.csv").write_text(csv_text(rows, detected_tracks(rows)))
    assert score_run(strait, tmp_path / "all.csv", cameras=("bow",)).trackers[0].scores.flat() == flat
    track_run(strait, tmp_path / "tracks")
    found = score_run(strait, tmp_path / "tracks", cameras="quay", seeds=2)
    first = found.seeds.spreads["reference"]["hota"].values[0]
    assert first == pytest.approx(found.trackers[0].scores.flat()["hota"])


def test_one_mot_file_is_enough_for_one_camera_and_what_cannot_be_is_refused(strait, of_bow, tmp_path):
    rows = RunRows.of(strait)
    folder = write_mot(tmp_path / "mot", {"bow.txt": mot_texts(rows, detected_tracks(rows))["bow.txt"]})
    wanted = score_run(strait, of_bow, cameras="bow").trackers[0].scores.flat()
    for path in (folder, folder / "bow.txt"):
        found = score_run(strait, path, cameras="bow").trackers[0].scores.flat()
        assert found["hota"] == pytest.approx(wanted["hota"], abs=1e-4)
    with pytest.raises(ModsimError, match=r"quay\.txt is missing"):
        score_run(strait, folder)
    with pytest.raises(ModsimError, match=r"have no line of camera 'quay'.*cameras .bow.;.*cameras .bow., .quay.$"):
        score_run(strait, of_bow)
    with pytest.raises(ModsimError, match=r"no camera 'bov' in this run \(did you mean 'bow'\?\)"):
        score_run(strait, of_bow, cameras="bov")
    (tmp_path / "world.csv").write_text("time_s,track,w1_m,w2_m\n0,1,5000,5000\n")
    with pytest.raises(ModsimError, match="cameras is for tracks in the images"):
        score_run(strait, tmp_path / "world.csv", cameras="bow")


def test_the_command_says_which_cameras_it_scored(strait: StoredRun, of_bow: Path, call: Call) -> None:
    def scored(*options: str) -> str:
        status, text = call("score", strait.folder, of_bow, *options)
        assert status == 0
        return text

    assert "only bow" in scored("--camera", "bow")
    assert json.loads(scored("--camera", "bow", "--json"))["rules"]["cameras"] == ["bow"]
    assert json.loads(scored("--camera", "quay", "--camera", "bow", "--json"))["rules"]["cameras"] is None
