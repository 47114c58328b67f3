"""Scores on a small film of a known detector; differences over films on made-up numbers with known answers."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.stand_in import scores as film_scores
from benchmarks.stand_in.differences import AGREES, DIFFERS, UNDECIDED, difference, verdict
from benchmarks.stand_in.distributions import compared, gaps_and_runs, holm, wasserstein
from benchmarks.stand_in.exchange import PARTS, Parts, exchanged
from benchmarks.stand_in.goals import goals
from benchmarks.stand_in.margins import BY_KEY
from benchmarks.stand_in.measure import measure
from benchmarks.stand_in.page import page, write_page
from benchmarks.stand_in.ranking import ranking, tau
from benchmarks.stand_in.words import films_needed, headline, steps
from modsim3d import ModsimError, load_scene, run_scene
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.writing.coco import write_coco
from modsim3d.io.input_files import data_folder
from modsim3d.tracking.scores.scoring import score_tracks

SEED, STATE = 4, "good"
DETECTOR = data_folder("scenes") / "detectors" / "thesis.yaml"


@dataclass(frozen=True)
class Film:
    name: str
    run: Path
    truth: Path
    real: Path
    place: str = "harbour"
    weather: str = STATE
    seed: int = 0


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Film:
    folder = tmp_path_factory.mktemp("film")
    scene = load_scene("harbour", steps=24, source="rectangles", detector=DETECTOR, detector_seed=SEED, state=STATE)
    run_scene(scene, folder / "run")
    return Film("small", folder / "run", *write_coco(labelled_run(folder / "run")[0], folder / "coco"))


@pytest.fixture(scope="module")
def results(film: Film) -> dict:
    films = [film, replace(film, name="again")]
    detectors = {"a": DETECTOR, "b": DETECTOR}
    return measure(films, detectors, [SEED], ("sort", "reference"), 0.25, workers=1, learned_from=7)


def test_the_same_detector_and_seed_give_the_real_detections_and_films_share_no_seed(film: Film) -> None:
    opened = film_scores.open_film(film)
    real = film_scores.real_detections(opened, 0.3)
    simulated = film_scores.simulated_detections(opened, DETECTOR, [SEED, SEED + 1], 0.3)
    for name, column in vars(real).items():
        # COCO has corner and size, so a corner may differ in its last digit.
        np.testing.assert_allclose(column, getattr(simulated[0], name), atol=0.0011)
    assert len(real) and real.confidence.min() >= 0.3
    other = film_scores.simulated_detections(replace(opened, film=replace(film, seed=1)), DETECTOR, [SEED], 0.3)[0]
    for another in (simulated[1], other):  # of another seed, and of a film with another one
        assert len(another.confidence) and not np.array_equal(simulated[0].confidence, another.confidence)


def test_scores_are_those_of_the_command_score_and_recall_of_all_bins_together_that_of_the_film(film: Film) -> None:
    opened = film_scores.open_film(film)
    scored = film_scores.scored_tracks(opened, film_scores.real_detections(opened, 0.25), "sort")
    whole = score_tracks(opened.rows, scored.following.tracks, scored.rules).flat()
    found = film_scores.scores_of(opened, scored)
    assert found["track_s"] > 0 and found["tracks"] > 2
    for key in ("hota", "deta", "assa", "idf1", "mota", "gospa", "id_switches", "false_tracks"):
        assert found[key] == whole[key], key
    again = film_scores.scored_tracks(opened, film_scores.real_detections(opened, 0.25), "sort")
    assert film_scores.scores_of(opened, again) == found
    bins, recall = film_scores.bins_of(opened, scored.truth), film_scores.recall_of_bins(opened, scored)
    for names in (("visible", "hidden"), ("near", "middle", "far")):
        assert np.sum([bins[name] for name in names], axis=0).tolist() == [1] * len(scored.truth)
        followed = sum(recall[name]["recall"] * bins[name].sum() for name in names if bins[name].any())
        assert followed == pytest.approx(len(scored.pairs[0]))
    assert bins["hidden"].any()
    found, row = film_scores.found_vessels(opened, film_scores.real_detections(opened, 0.25))
    on_vessels = row[row >= 0]
    assert len(np.unique(on_vessels)) == len(on_vessels) == found.sum() > 20 and (row < 0).any()


def test_real_detections_as_the_simulated_ones_differ_in_nothing(results: dict) -> None:
    for rung in ("a", "b"):
        for scores in results["differences"][rung].values():
            # The last digits of the file's boxes may move GOSPA.
            assert all(abs(each["mean"]) < 1e-3 and each["verdict"] == "agrees" for each in scores.values())
        assert results["ranking"][rung]["tau"] == 1 == results["ranking"][rung]["same_order"]
        assert all(each["p_value"] in (None, 1) for each in results["distributions"][rung])
    assert json.loads(json.dumps(results, allow_nan=False)) == results


def test_the_page_is_made_of_the_results_alone_and_its_picture_shows_each_tracker(results, tmp_path: Path) -> None:
    text = page(results)
    assert text.splitlines()[2].startswith("Mean HOTA gap over 2 films, simulated minus real: ")
    assert "agreement within 0.02 is shown for `sort` and `reference`." in text
    assert "in sight of these 2 films; the detector files are learned from 7 others" in text
    assert "are the second set" in page({**results, "judged": True})
    assert "| `sort` | mean HOTA | 0.02 |" in text and "| misses and confidence |" in text
    assert "HOTA agrees for `sort` and `reference`." in text
    assert "classifier" not in text and "nan" not in text and "None" not in text
    real = {name: results["differences"]["b"][name]["hota"]["real"] for name in ("sort", "reference")}
    hota = [f"`{name}` ({value:.3f} ± 0.020)" for name, value in real.items()]
    assert f"- HOTA of {hota[0]} and {hota[1]}" in text.splitlines()
    assert "values that hold, 20 do with tests adjusted for their number" in text
    groups = {"misses": {"alone": 0.51}, "errors": {"alone": 0.54}}
    area = {"auc": 0.55, "low": 0.5, "high": 0.6, "groups": groups}
    seeds = {"auc": 0.4967, "aucs": [0.52, 0.5, 0.47]}
    told = page({**results, "told_apart": {"b": {"frames": area}, "seeds": {"tracks": seeds}}})
    row = "|  | check: one seed of the last rung against its others | – | – | 0.50 (seeds: 0.47 to 0.52) | – |"
    assert row in told.splitlines()
    assert "to tell frames apart reaches an area of 0.55 (0.50 to 0.60): 0.5 is guessing." in told
    assert "| b | b | 0.55 (0.50 to 0.60) | errors (0.54), misses (0.51) | – | – |" in told.splitlines()
    write_page(results, tmp_path)
    assert (tmp_path / "stand_in.md").read_text(encoding="utf-8") == page(results)
    with Image.open(tmp_path / "stand_in.png") as picture:
        pixels = np.asarray(picture.convert("RGB"))
    halves = pixels[:, : pixels.shape[1] // 2], pixels[:, pixels.shape[1] // 2 :]
    assert all((half == (0, 0x72, 0xB2)).all(axis=2).sum() > 100 for half in halves)  # the colour of agreement


def test_a_truth_of_other_frames_and_a_comparison_without_films_are_refused(film: Film, tmp_path: Path) -> None:
    content = json.loads(film.truth.read_text(encoding="utf-8"))
    short = tmp_path / "truth.json"
    short.write_text(json.dumps({**content, "images": content["images"][:-1]}), encoding="utf-8")
    with pytest.raises(ModsimError, match="has 23 images, and the run"):
        film_scores.real_detections(film_scores.open_film(replace(film, truth=short)), 0.2)
    with pytest.raises(ModsimError, match="needs films, seeds and detector files"):
        measure([], {"a": DETECTOR}, [1])


def test_exchanged_parts_are_those_of_the_other_detector(film: Film) -> None:
    """Nothing exchanged gives the same detections, everything those of the other; misses alone say which are found."""
    opened = film_scores.open_film(film)
    real, other = (film_scores.simulated_detections(opened, DETECTOR, [seed], 0.25)[0] for seed in (1, 2))
    usual, strange = Parts.of(opened, real), Parts.of(opened, other)
    for chosen, expected in ((frozenset(), real), (frozenset(PARTS), other)):
        made = exchanged(opened, usual, strange, chosen)
        np.testing.assert_allclose(made.boxes_px, expected.boxes_px, atol=2e-3)
        np.testing.assert_allclose(made.confidence, expected.confidence, atol=1e-6)
    made = Parts.of(opened, exchanged(opened, usual, strange, frozenset({"misses"})))
    assert len(made.false.frame) == len(usual.false.frame) and (usual.found != strange.found).any() and made.found.any()
    assert (made.found == strange.found).mean() > 0.95  # an error of the nearest frame may put a box off its vessel
    both = usual.found & strange.found & made.found
    np.testing.assert_allclose(made.errors[both], usual.errors[both], atol=1e-3)
    unknown = replace(usual, known=np.zeros(len(usual.known), dtype=bool))  # all of it was missed: the other's values
    made = Parts.of(opened, exchanged(opened, unknown, strange, frozenset({"misses", "false positives"})))
    np.testing.assert_allclose(made.confidence[made.found], strange.confidence[made.found], atol=1e-6)
    np.testing.assert_allclose(made.errors[made.found], strange.errors[made.found], atol=1e-3)


def test_a_difference_of_three_films_is_worked_by_hand_and_a_verdict_is_where_the_interval_lies():
    """0.01, 0.02, 0.03: standard deviation 0.01; the 97.5 % quantile of t with 2 degrees of freedom is 4.302653."""
    found = difference(np.array([0.5, 0.6, 0.7]), np.array([[0.51], [0.62], [0.73]]), 0.05)
    half = 4.302653 * 0.01 / np.sqrt(3)
    assert (found.films, found.within) == (3, None)
    assert [found.mean, found.low, found.high] == pytest.approx([0.02, 0.02 - half, 0.02 + half], rel=1e-5)
    assert found.verdict == AGREES
    # t = (0.05 - 0.02) / (0.01 / sqrt(3)) = 5.196; for 2 degrees of freedom P(T > t) = 1/2 - t / (2 sqrt(2 + t^2)).
    t = 0.03 / (0.01 / np.sqrt(3))
    assert found.p_value == pytest.approx(0.5 - t / (2 * np.sqrt(2 + t**2)))
    one = difference(np.array([0.5, np.nan]), np.array([[0.5], [0.7]]), 0.02)
    assert (one.films, one.mean, one.verdict, one.real) == (1, None, UNDECIDED, 0.5)
    for low, high, expected in (
        (-0.02, 0.02, AGREES),
        (0.001, 0.015, AGREES),  # not 0, but within the margin
        (0.021, 0.1, DIFFERS),
        (-0.1, -0.021, DIFFERS),
        (0.01, 0.03, UNDECIDED),
        (-0.3, 0.3, UNDECIDED),  # a wide interval is no agreement
    ):
        assert verdict(low, high, 0.02) == expected, (low, high)


def test_intervals_hold_what_they_claim_and_real_outputs_like_the_simulated_ones_scatter_as_these():
    """Films have differences of their own, and seeds scatter within them; the true difference is the margin itself."""
    random, margin, trials = np.random.default_rng(7), 0.02, 1500
    inside = agree = 0
    for _ in range(trials):
        real = random.normal(0.5, 0.1, 12)
        film = random.normal(margin, 0.03, 12)
        found = difference(real, (real + film)[:, None] + random.normal(0, 0.04, (12, 4)), margin)
        inside += found.low <= margin <= found.high
        agree += found.verdict == AGREES
    assert inside / trials == pytest.approx(0.95, abs=0.02) and agree / trials < 0.04
    random, low, ratios = np.random.default_rng(11), 0, []
    for _ in range(400):
        outputs = random.normal(0, 0.2, (15, 1)) + random.normal(0, 0.05, (15, 5))
        found = difference(outputs[:, 0], outputs[:, 1:], 0.02)
        ratios.append(found.scatter)
        low += found.scatter_p < 0.05
    assert np.mean(ratios) == pytest.approx(1, abs=0.03) and low / 400 == pytest.approx(0.05, abs=0.03)
    of_films = difference(outputs[:, 0] + random.normal(0, 0.2, 15), outputs[:, 1:], 0.02)
    assert of_films.scatter > 2 and of_films.scatter_p < 0.001
    film = random.normal(0, 0.03, 4000)
    found = difference(np.zeros(4000), film[:, None] + random.normal(0, 0.06, (4000, 5)), 0.02)
    assert [found.between, found.within] == pytest.approx([0.03, 0.06], rel=0.05)


def test_the_ranking_is_that_of_the_mean_over_seeds_and_gaps_lie_between_sightings():
    real = np.array([[0.5, 0.4]] * 9 + [[0.5, 0.6]])
    found = ranking(real, np.repeat(real[:, ::-1, None], 2, axis=2), ("a", "b"))
    assert (found["real"], found["simulated"]) == (["a", "b"], ["b", "a"])
    assert found["tau"] == -1 and found["tau_of_seeds"] == 1 and found["same_order"] < 0.05
    assert ranking(real, np.repeat(real[:, :, None], 2, axis=2), ("a", "b"))["same_order"] == 1
    scores = np.array([[0.1, 0.2, 0.3], [0.6, 0.4, 0.5]])
    assert (tau(scores, scores), tau(scores, -scores)) == (1, -1)
    # The best may stay where others change places.
    simulated = np.tile([[[0.5, 0.1], [0.4, 0.4]]], (5, 1, 1))  # films, trackers, seeds
    assert ranking(simulated[:, :, 0], simulated, ("a", "b"))["simulated"] == ["b", "a"]
    real = np.tile([[0.6, 0.4, 0.5]], (5, 1))
    found = ranking(real, real[:, [0, 2, 1], None], ("a", "b", "c"))
    assert (found["same_order"], found["same_best"], found["simulated"]) == (0, 1, ["a", "b", "c"])
    assert found["tau"] == pytest.approx(1 / 3) and found["tau_of_seeds"] is None
    identity = np.array([0] * 8 + [1] * 3)
    frame = np.array([*range(8), 0, 1, 2])
    #                 0: miss, hit hit, miss, unscored, miss, hit, miss; 1: miss, hit, miss
    found = np.array([0, 1, 1, 0, 0, 0, 1, 0, 0, 1, 0], dtype=bool)
    scored = np.array([1, 1, 1, 1, 0, 1, 1, 1, 1, 1, 1], dtype=bool)
    order = np.random.default_rng(1).permutation(11)
    gaps, runs = gaps_and_runs(identity[order], frame[order], scored[order], found[order])
    assert gaps.tolist() == [2] and runs.tolist() == [2, 1, 1]
    # The distance of shifted values is the shift; nothing on one side cannot be compared.
    assert wasserstein(np.array([0.0, 1.0, 3.0]), np.array([3.5, 0.5, 1.5, 3.5, 0.5, 1.5])) == pytest.approx(1 / 2)
    found = compared([np.empty(0)], [[np.ones(3)]])
    assert found["p_value"] is None and found["simulated"]["values"] == 3
    assert holm([0.01, None, 0.04, 0.03]) == pytest.approx([0.03, None, 0.06, 0.06])


def test_films_that_differ_from_each_other_are_no_difference_of_real_and_simulated_and_a_shift_of_all_is() -> None:
    """Every value of a film is alike, so that a test of single values would see differences everywhere."""
    random, low = np.random.default_rng(5), 0
    for _ in range(30):
        outputs = random.normal(0, 1, (8, 4, 1)) + random.normal(0, 0.3, (8, 4, 30))
        low += compared([each[0] for each in outputs], [list(each[1:]) for each in outputs])["p_value"] < 0.05
    assert low <= 5
    outputs = np.random.default_rng(5).normal(0, 1, (8, 4, 30))
    outputs[:, 0] += 1
    found = compared([each[0] for each in outputs], [list(each[1:]) for each in outputs])
    assert found["p_value"] == 0.001 and found["wasserstein"] == pytest.approx(1, abs=0.15)
    # Of five films and one seed, two of 32 exchanges are as far apart: as it is, and with all films exchanged.
    assert compared([np.ones(3)] * 5, [[np.zeros(3)]] * 5)["p_value"] == pytest.approx(2 / 32, abs=0.025)


def _results(*means: float) -> dict:
    """Results of two trackers whose differences have these means over four films, rung by rung, ± 0.01."""
    ends = [(mean, mean - 0.01, mean + 0.01) for mean in means]
    hota = [{"mean": mean, "low": low, "high": high, "verdict": verdict(low, high, 0.02)} for mean, low, high in ends]
    each = [{"hota": {"films": 4, **entry}} for entry in hota]
    noise = np.array([-0.02, 0.02, -0.02, 0.02])  # the same at all rungs: films differ by it, rungs do not
    scores: dict = {str(k): (0.5 + noise + mean).tolist() for k, mean in enumerate(means)}
    return {
        "scores": {name: {"hota": {"real": [0.5] * 4, **scores}} for name in ("sort", "ocsort")},
        "rungs": [{"name": str(k), "title": f"model {k}"} for k in range(len(means))],
        "differences": {str(k): {"sort": one, "ocsort": one} for k, one in enumerate(each)},
    }


def test_the_headline_names_what_brought_the_scores_closer_and_how_many_films_are_needed():
    assert headline(_results(0.15, 0.07, 0.068, -0.0069)) == (
        "Mean HOTA gap over 4 films, simulated minus real: −0.007 ± 0.010 for `sort` and −0.007 ± 0.010 for `ocsort`; "
        "agreement within 0.02 is shown for `sort` and `ocsort`. What brought it closer: *model 1* (mean gap 0.150 "
        "before, 0.070 after) and *model 3* (mean gap 0.068 before, 0.007 after)."
    )
    assert "not shown for `sort` and `ocsort`. No model surely brought it closer." in headline(_results(0.015, 0.015))
    # A rung that takes scores farther, or helps in some films only, is no cause.
    (farther,) = steps(_results(0.1, 0.2))
    assert (farther.before, farther.after) == pytest.approx((0.1, 0.2))
    results = _results(0.1, 0.1)
    for scores in results["scores"].values():
        scores["hota"]["1"] = [0.2, 0.6, 0.6, 0.6]  # the mean gap shrinks to 0, by one film
    assert steps(results) == []
    assert films_needed({"low": -0.03, "high": 0.05, "mean": 0.01, "margin": 0.02, "films": 10}) == 160
    assert films_needed({"low": 0.0, "high": 0.06, "mean": 0.03, "margin": 0.02, "films": 10}) is None
    # Margins of counts are shares but for small ones.
    assert [BY_KEY["false_tracks"].margin(real) for real in (0.3, 30)] == [0.5, 3]
    assert BY_KEY["gospa"].margin(100) == 5 and BY_KEY["hota"].margin(0.4) == 0.02


def test_a_goal_is_reached_missed_or_not_shown_and_trackers_surely_apart_are_compared_in_pairs():
    def found(mean: float, half: float) -> dict:
        return {"mean": mean, "low": mean - half, "high": mean + half, "real": 5.0}

    scores = {"hota": found(0.005, 0.01), "assa": found(-0.06, 0.01), "id_switches": found(0.9, 0.3)}
    results = {
        "rungs": [{"name": "a", "title": ""}],
        "differences": {"a": {"sort": scores}},
        "groups": {"a": {"sort": {"place: strait": found(0.06, 0.02), "weather: clear": found(0.0, 0.1)}}},
        "film_correlation": {"a": {"sort": {"real": 0.8, "seeds": 0.86}}},
    }
    verdicts = [(goal.title, goal.verdict) for goal in goals(results, "sort")]
    assert verdicts == [
        ("mean HOTA", "reached"),
        ("mean AssA", "missed"),
        ("ID switches of a film", "not shown; the mean lies inside"),
        ("mean HOTA, strait", "not shown; the mean lies outside"),
        ("correlation of films' HOTA", "missed"),
    ]
    rng = np.random.default_rng(0)
    film = rng.normal(0.5, 0.1, 40)
    real = np.column_stack([film, film + 0.05 + rng.normal(0, 0.02, 40), film + rng.normal(0, 0.02, 40)])
    simulated = np.repeat((real - [0, 0.02, 0])[:, :, None], 2, axis=2)
    found = ranking(real, simulated, ("a", "b", "c"))["pairs"]
    assert [(each["better"], each["worse"]) for each in found] == [("b", "a"), ("b", "c")]
    assert found[0]["real"] == pytest.approx(0.05, abs=0.01)
    assert found[0]["real"] - found[0]["simulated"] == pytest.approx(0.02)
