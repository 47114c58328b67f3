"""A learned detector is compared with the real one where it was not learned."""

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from modsim3d import ModsimError, learn_detector, load_scene, run_scene
from modsim3d.cli.learn import learn_json
from modsim3d.cli.main import app
from modsim3d.detector.file.reading import parse_detector
from modsim3d.formats.labelled import LabelledSet
from modsim3d.learn.learned import LearnSettings
from modsim3d.learn.self_check import RealityComparison, self_check
from modsim3d.learn.simulated_results import simulated
from tests.learn.one_state import detected, detector, learned_in, moored, observed_in

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


def test_a_detector_of_the_models_that_are_learned_is_found_again() -> None:
    rows = compared()
    assert not [row for row in rows.values() if row.differs]
    for name in ("share found", "frames of a gap", "confidence before a miss", "false detections an image"):
        assert rows[name].real == pytest.approx(rows[name].simulated, rel=0.2)
        assert 0 < rows[name].spread < rows[name].real


def test_a_model_that_lacks_the_memory_is_told_by_runs_and_gaps() -> None:
    rows = compared(frozenset({"persistence", "score", "vessels"}))
    for name in ("frames of a gap", "frames of a run of sightings", "confidence before a miss"):
        assert rows[name].differs
    assert rows["frames of a gap"].simulated < 0.7 * rows["frames of a gap"].real
    assert not rows["mean IoU of matches"].differs


def test_the_command_says_what_differs_first_and_can_leave_the_check_out(tmp_path) -> None:
    short_run = run_scene(load_scene("simulation_1", steps=150), tmp_path / "run").folder
    result = learn_detector(run=short_run, replicates=20)
    check = result.report.check
    assert check is not None and len(check.comparisons) > 10 and result.report.remarks[0] == check.sentence
    assert check.sentence.startswith("Learned from one half of the data and simulated 3 times over the other")
    content = learn_json(result.report, [])["self_check"]
    assert [each["name"] for each in content] == [each.name for each in check.comparisons]
    without = learn_detector(run=short_run, replicates=20, check=False)
    assert without.report.check is None and learn_json(without.report, [])["self_check"] is None
    assert without.content == result.content
    out = tmp_path / "detector.yaml"
    said = CliRunner().invoke(app, ["learn", str(short_run), "--out", str(out), "--replicates", "20", "--no-check"])
    assert said.exit_code == 0 and "Where it was not learned" not in said.output + out.with_suffix(".html").read_text()


def test_halves_that_differ_in_opposite_ways_are_told_and_one_without_matches_is_refused() -> None:
    """Summed over both halves, what is learned from each would make up for the other."""
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
