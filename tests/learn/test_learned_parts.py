"""Every model of a detector is learned, or said not to be, and can be left out."""

from collections.abc import Mapping
from typing import Any, cast, get_args

import numpy as np
import pytest

import modsim3d
from modsim3d.core.errors import InputError
from modsim3d.detector.chain import MODELS, DetectorPart
from modsim3d.detector.false_positives import FALSE_POSITIVE_MODELS, PerImage
from modsim3d.detector.file.schema_models import DropoutSection
from modsim3d.learn.learn_detector import LearnOptions, learn_detector
from modsim3d.learn.learned import LEARNERS, RICHER, LearnSettings
from modsim3d.learn.report_page import tables
from tests.detector.test_parts import WITHOUT_LEARNER
from tests.formats.labelled_files import found, images, truth
from tests.learn.one_state import of_boats
from tests.learn.round_trip import command, simulate

QUICK = {"replicates": 20, "check": False}


def estimates() -> dict[tuple[str, str], str]:
    image = np.arange(30)
    boxes = np.tile([100.0, 100, 160, 160], (30, 1))
    labelled = of_boats(images(30), truth(image, 0 * image, boxes), found(image, 0 * image, boxes, np.full(30, 0.9)))
    report = learn_detector(labelled, LearnSettings(replicates=20), LearnOptions())
    (table,) = (each for each in tables(report) if each.title == "Models that can be learned")
    return {(row[0], row[1]): row[2] for row in table.rows}


def test_the_report_says_of_every_registered_model_and_of_no_other_whether_it_is_learned(monkeypatch) -> None:
    expected = {
        (part, name): "not learned" if (part, name) in WITHOUT_LEARNER else "learned"
        for part, models in MODELS.items()
        for name in models
    }
    assert estimates() == expected
    assert all(set(learners) <= set(MODELS[part]) for part, learners in LEARNERS.items())
    assert set(get_args(DropoutSection.model_fields["model"].annotation)) == set(MODELS[DetectorPart.CLASS])
    monkeypatch.setitem(cast(dict[str, Any], FALSE_POSITIVE_MODELS), "fourth", PerImage())
    assert estimates()[DetectorPart.FALSE_POSITIVES, "fourth"] == "not learned"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of Simulation 1 with three labels, two states and nearly every model that can be learned."""
    return simulate("simulation_1", tmp_path_factory.mktemp("without"), 0, 600, 3)


def kept(content: Mapping[str, Any]) -> set[str]:
    clutter = content["false_positives"]
    has = {
        "effects": "dropout" in content,
        "persistence": "persistence" in content,
        "sizes": "size" in clutter,
        "places": "placement" in clutter,
        "confidence": "true" in content["states"]["clear"]["confidence"],
    }
    return {name for name, there in has.items() if there}


def test_each_model_is_left_out_by_its_name_and_without_all_it_is_the_thesis_s(run) -> None:
    every = {"effects", "persistence", "sizes", "places", "confidence"}
    # No two names are left out in the same of the cases, so each is known by where it is missing.
    for without in ((), ("effects", "places"), ("persistence", "places", "confidence"), ("sizes", "confidence")):
        assert kept(modsim3d.learn_detector(run=run, without=without, **QUICK).content) == every - set(without)
    content = modsim3d.learn_detector(run=run, without=RICHER, **QUICK).content
    assert kept(content) == set() and set(content["false_positives"]) == {"model"}
    for state in content["states"].values():
        assert state["box_error"].keys() == {"unit", "mean", "covariance"} and state["box_error"]["unit"] == "px"
        assert state["confidence"].keys() == {"mean", "std"}


def test_a_model_that_is_none_is_named(run, tmp_path) -> None:
    with pytest.raises(InputError, match=r"must be some of .*persistence.* \(got 'boxes' "):
        command("learn", run, "--without", "effects,boxes", "--out", tmp_path / "d.yaml")
    with pytest.raises(InputError, match="must be some of relative"):
        modsim3d.learn_detector(run=run, without=["boxes"])
