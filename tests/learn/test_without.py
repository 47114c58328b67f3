"""Models that learning is told to leave out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from modsim3d.core.errors import InputError
from modsim3d.learn.learning import learn_detector
from modsim3d.learn.model_selection import RICHER
from tests.learn.round_trip import command, simulate


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of Simulation 1 with three labels, two states and nearly every model that can be learned."""
    return simulate("simulation_1", tmp_path_factory.mktemp("without"), 0, 600, 3)


def test_without_all_of_them_the_model_is_the_thesis_s(run) -> None:
    content = learn_detector(run=run, without=RICHER, replicates=20).content
    assert not {"dropout", "persistence"} & set(content)
    assert set(content["false_positives"]) == {"model"}
    for state in content["states"].values():
        assert state["box_error"].keys() == {"unit", "mean", "covariance"} and state["box_error"]["unit"] == "px"
        assert state["confidence"].keys() == {"mean", "std"}


def kept(content: Mapping[str, Any]) -> set[str]:
    """Which of some models a detector file has."""
    clutter = content["false_positives"]
    has = {
        "effects": "dropout" in content,
        "persistence": "persistence" in content,
        "sizes": "size" in clutter,
        "places": "placement" in clutter,
        "confidence": "true" in content["states"]["clear"]["confidence"],
    }
    return {name for name, there in has.items() if there}


def test_each_model_is_left_out_by_its_name(run) -> None:
    every = {"effects", "persistence", "sizes", "places", "confidence"}
    # No two names are left out in the same of the cases, so each is known by where it is missing.
    for without in ((), ("effects", "places"), ("persistence", "places", "confidence"), ("sizes", "confidence")):
        assert kept(learn_detector(run=run, without=without, replicates=20).content) == every - set(without)


def test_a_model_that_is_none_is_named(run, tmp_path) -> None:
    with pytest.raises(InputError, match=r"must be some of .*persistence.* \(got 'boxes'\)"):
        command("learn", run, "--without", "effects,boxes", "--out", tmp_path / "d.yaml")
    with pytest.raises(InputError, match="must be some of relative"):
        learn_detector(run=run, without=["boxes"])
