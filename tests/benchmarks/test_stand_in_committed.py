"""The committed comparison with a real detector, and a sample of it made again from the stored detections."""

import json
from pathlib import Path

import pytest

from benchmarks.stand_in.films import Film, all_films, judged_films
from benchmarks.stand_in.page import page
from benchmarks.stand_in.rungs import MIN_CONFIDENCE, RUNGS, learn_rung
from benchmarks.stand_in.scores import open_film, real_detections, scored_tracks, scores_of
from benchmarks.stand_in.stored import JUDGED, restore_films
from modsim3d.core.errors import ModsimError

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


def test_the_page_is_made_of_the_results() -> None:
    assert (ROOT / "docs" / "stand_in.md").read_text(encoding="utf-8") == page(RESULTS)


def test_a_film_scores_as_it_did(film: Film) -> None:
    opened = open_film(film)
    place = [each["name"] for each in RESULTS["films"]].index(NAME)
    real = real_detections(opened, MIN_CONFIDENCE)
    for tracker in ("reference", "sort"):
        again = scores_of(opened, scored_tracks(opened, real, tracker))
        for key, found in RESULTS["scores"][tracker].items():
            assert again[key] == pytest.approx(found["real"][place], rel=1e-5), (tracker, key)


def test_the_ladder_begins_with_the_thesis_s_model_and_adds_to_it(film: Film) -> None:
    plain, rich = (learn_rung([film], rung).content for rung in (RUNGS[0], RUNGS[-1]))
    assert "persistence" not in plain and plain["states"]["800 m"]["box_error"]["unit"] == "px"
    assert "persistence" in rich and rich["states"]["800 m"]["confidence"].keys() >= {"true", "false"}


def test_a_film_of_which_nothing_is_stored_is_refused(tmp_path) -> None:
    film = all_films(tmp_path)[0]
    unknown = Film(film.folder, "nowhere", film.place, film.weather, film.viewpoint, 1, film.role)
    with pytest.raises(ModsimError, match="nowhere: nothing is stored of this film"):
        restore_films(tmp_path, [unknown])
