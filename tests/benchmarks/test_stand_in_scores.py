"""Scores on a small film whose real detections are those of a known detector and seed."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.stand_in import scores as film_scores
from benchmarks.stand_in.exchange import PARTS, Parts, exchanged
from benchmarks.stand_in.measure import measure
from benchmarks.stand_in.page import page, write_page
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
    return measure(
        films, {"a": DETECTOR, "b": DETECTOR}, [SEED], ("sort", "reference"), 0.25, workers=1, learned_from=7
    )


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
    hota = [
        f"`{name}` ({results['differences']['b'][name]['hota']['real']:.3f} ± 0.020)" for name in ("sort", "reference")
    ]
    assert f"- HOTA of {hota[0]} and {hota[1]}" in text.splitlines()
    assert "values that hold, 20 do with tests adjusted for their number" in text
    groups = {"misses": {"alone": 0.51}, "errors": {"alone": 0.54}}
    area = {"auc": 0.55, "low": 0.5, "high": 0.6, "groups": groups}
    seeds = {"auc": 0.4967, "aucs": [0.52, 0.5, 0.47]}
    told = page({**results, "told_apart": {"b": {"frames": area}, "seeds": {"tracks": seeds}}})
    assert (
        "|  | check: one seed of the last rung against its others | – | – | 0.50 (seeds: 0.47 to 0.52) | – |"
        in told.splitlines()
    )
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
    made = Parts.of(opened, exchanged(opened, unknown, strange, frozenset({"misses", "false detections"})))
    np.testing.assert_allclose(made.confidence[made.found], strange.confidence[made.found], atol=1e-6)
    np.testing.assert_allclose(made.errors[made.found], strange.errors[made.found], atol=1e-3)
