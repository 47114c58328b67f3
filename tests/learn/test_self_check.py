"""A learned detector is compared with the real one where it was not learned."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

import modsim3d
from modsim3d import ModsimError, learn_detector
from modsim3d.cli.learn import learn_json
from modsim3d.cli.main import app
from modsim3d.detector.file.reading import parse_detector
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.reading.builder import ReadOptions
from modsim3d.formats.reading.pair import read_pair
from modsim3d.learn import self_check as learning_check
from modsim3d.learn.learned_detector import LearnSettings
from modsim3d.learn.match_types import NAMES
from modsim3d.learn.self_check import RealityComparison, hota_counts, self_check, simulated
from tests.formats.labelled_video.videos import coco, write
from tests.learn.one_state import detected, detector, learned_in, moored, observed_as, observed_in
from tests.learn.round_trip import simulate

FRAMES, BOATS, SEEDS = 400, 20, 12
SCORE = {"score": {"vessel_share": 0.2, "shares": [0.3, 0.4], "times_s": [1.0, 4.0]}}


def two_films(frames: int, side_px) -> LabelledSet:
    """Boats in twenty places, of which each half of the frames has its own."""
    labelled = moored(frames, BOATS, columns=5, size_px=(1400.0, 1100.0), top_px=100.0, side_px=side_px)
    film = (np.arange(frames) >= frames // 2).astype(np.int64)
    there = labelled.annotations
    there = replace(there, identity=there.identity + BOATS * film[there.image])
    return replace(labelled, images=replace(labelled.images, sequence=film), annotations=there)


def compared(without: frozenset[str] = frozenset(), frames: int = FRAMES) -> dict[str, RealityComparison]:
    """Comparisons of a simulated detector in place of a real one, in two films, by name."""
    data = detector({"mean": 0.6, "std": 0.15}, persistence=SCORE)
    data["states"]["usual"] |= {"confusion": [[0.7], [0.3]], "false_discovery_rate": 0.1}
    rows = checked(detected(two_films(frames, 30.0 + 4 * np.arange(BOATS)), data, 1), without)
    assert [row.p_value for row in rows] == sorted(row.p_value for row in rows)
    return {row.name: row for row in rows}


def checked(labelled: LabelledSet, without: frozenset[str] = frozenset()) -> tuple[RealityComparison, ...]:
    settings = LearnSettings(replicates=20, without=without)
    return self_check(learned_in(observed_in(labelled, without=without)), settings, SEEDS)


def test_a_detector_of_the_models_that_are_learned_is_found_again(monkeypatch) -> None:
    monkeypatch.setattr(learning_check, "TRACKED_SEEDS", 3)
    rows = compared()
    assert not [row for row in rows.values() if row.differs]
    names = ("share found", "frames of a gap", "confidence before a miss", "false positives an image")
    for name in (*names, "HOTA of reference", "HOTA of sort"):
        assert rows[name].real == pytest.approx(rows[name].simulated, rel=0.2)
        assert 0 < rows[name].spread < rows[name].real


def test_a_model_that_lacks_the_memory_is_told_by_runs_and_gaps(monkeypatch) -> None:
    monkeypatch.setattr(learning_check, "TRACKERS", ())  # which are not asked here
    rows = compared(frozenset({"persistence", "score", "vessels"}))
    for name in ("frames of a gap", "frames of a run of sightings", "confidence before a miss"):
        assert rows[name].differs
    assert rows["frames of a gap"].simulated < 0.7 * rows["frames of a gap"].real
    assert not rows["mean IoU of matches"].differs


def test_the_command_says_what_differs_first_and_can_leave_the_check_out(tmp_path) -> None:
    short_run = simulate("simulation_1", tmp_path, mode=0, steps=150)
    quick = {"replicates": 20, "without": ("relative", "mixed", "student_t", *NAMES)}
    result = learn_detector(run=short_run, **quick)
    check = result.report.check
    assert check is not None and len(check.comparisons) > 10
    first, second = result.report.remarks[:2]
    assert first.startswith("In state haze only shares are known") and second == check.sentence
    assert check.sentence.startswith("Learned from one half of the data and simulated 2 times over the other")
    content = learn_json(result.report, [])["self_check"]
    assert [each["name"] for each in content] == [each.name for each in check.comparisons]
    without = learn_detector(run=short_run, **quick, check=False)
    assert without.report.check is None and learn_json(without.report, [])["self_check"] is None
    assert without.content == result.content
    out = tmp_path / "detector.yaml"
    options = ("--replicates", "20", "--without", ",".join(quick["without"]), "--no-check")
    said = CliRunner().invoke(app, ["learn", str(short_run), "--out", str(out), *options])
    assert said.exit_code == 0 and "Where it was not learned" not in said.output + out.with_suffix(".html").read_text()


def test_hota_in_the_check_is_that_of_the_tracker_over_the_same_files(tmp_path) -> None:
    labels = coco({"left": 60, "right": 40}, categories=modsim3d.load_detector("coastal").labels)
    region = {"category_id": 4, "bbox": [0, 345, 640, 135], "iscrowd": 1}  # in which nothing counts
    labels["annotations"] += [region | {"id": -each["id"], "image_id": each["id"]} for each in labels["images"]]
    truth, size = write(tmp_path / "gt.json", labels), {"frame_rate_hz": 5.0}
    options = {"detector": "coastal", "horizon": 150, **size}
    found = modsim3d.detect_truth(truth, tmp_path / "simulated", **options).folder / "dt.json"
    stays = {"category_id": 4, "bbox": [500, 400, 60, 60], "score": 0.9}
    write(found, json.loads(found.read_text()) + [stays | {"image_id": each["id"]} for each in labels["images"]])
    run = modsim3d.detect_truth(truth, tmp_path / "run", detections=found, **size).folder
    labelled = read_pair("day", truth, found, ReadOptions(**size))
    counts = hota_counts(observed_as(labelled, ("usual",), np.zeros(len(labelled.images), dtype=np.int64)))
    for name in ("reference", "sort"):
        tracks = modsim3d.track_run(run, tmp_path / name, tracker=name).folder
        asked = modsim3d.score_run(run, tracks).trackers[0].scores.flat()["hota"]
        total, number = counts[f"HOTA of {name}"]
        assert total / number == pytest.approx(asked, abs=1e-9) and 0.1 < asked < 0.99
    halves = np.repeat([0, -1, 0, -1], 25)
    first = hota_counts(observed_as(labelled, ("usual",), halves))
    assert first["HOTA of sort"][1] == 150  # three vessels in 50 images


def test_halves_that_differ_in_opposite_ways_are_told_and_one_without_matches_is_refused(monkeypatch) -> None:
    """Summed over both halves, what is learned from each would make up for the other."""
    monkeypatch.setattr(learning_check, "TRACKERS", ())
    shown = two_films(FRAMES, 60.0)
    data = detector({"mean": 0.6, "std": 0.15}, initial_state="easy", transition_matrix=[[1, 0], [0, 1]])
    usual, misses = data["states"]["usual"], {"easy": 0.1, "hard": 0.6}
    data["states"] = {name: usual | {"confusion": [[1 - miss], [miss]]} for name, miss in misses.items()}
    labelled = simulated(shown, shown.images.sequence, parse_detector(data), 1)
    # As of files, which do not say what a detection came from.
    results = replace(labelled.results, origin=None, kind=None, partner=None)
    rows = {row.name: row for row in checked(replace(labelled, results=results))}
    assert rows["share found"].differs
    with pytest.raises(ModsimError, match="one half of the data has no matches"):
        compared(frames=1)
