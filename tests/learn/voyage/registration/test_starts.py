"""The start of a fit among several local optima of the clock."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.voyages.cases import AIS, REGISTRATION_SETTINGS
from benchmarks.voyages.reported import as_reported
from benchmarks.voyages.wrong_camera import WRONG, Voyage
from modsim3d.learn.voyage.registration import initial_guesses as module
from modsim3d.learn.voyage.registration.icp import Aligner
from modsim3d.learn.voyage.registration.initial_guesses import Guess, Search, rivals_of, starts
from modsim3d.learn.voyage.registration.model import BoxModel, HidingBodies, KnownTraffic
from modsim3d.learn.voyage.registration.parameters import SHARED_NAMES, Values
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene

A_WAVE_EARLIER = Guess(0.3, 2.0, 0.4, 400)
"""The waves' motion looks much the same there, and a search may well like it better."""
RIGHT = Guess(3.5, 2.0, 0.4, 380)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("strait", settings=REGISTRATION_SETTINGS)


@pytest.fixture(scope="module")
def aligner(scene: Scene) -> Aligner:
    """A voyage on board, by AIS."""
    reported, _ = as_reported(scene, 10, AIS)
    model = BoxModel.of(reported, KnownTraffic.of(reported, reported.cameras[0]))
    found = Voyage.of(scene, "bow", WRONG).detections(10).some(60)
    free = tuple(name for name in SHARED_NAMES if not name.endswith("_px"))
    return Aligner(model, HidingBodies.of(reported, model), found, free, True)


def test_the_clock_that_explains_the_detections_is_chosen_whatever_the_votes_and_a_close_rival_is_said(
    aligner: Aligner, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "search", lambda *_: Search((A_WAVE_EARLIER, RIGHT), 100, 1000))
    monkeypatch.setattr(module, "SURE", np.inf)  # then any other clock is a rival
    best, (rival,) = starts(aligner, 10.0, 5.0, scene)
    assert best["clock_s"] == pytest.approx(3.7, abs=0.1)
    assert rival["clock_s"] == pytest.approx(0.2, abs=0.5)


def test_rivals_have_another_clock_and_are_not_clearly_worse() -> None:
    best, other = (Values.none(1).changed(clock_s=clock) for clock in (3.7, 0.2))
    assert rivals_of(np.array([5.0, 6.0, 4.0]), best, [(np.zeros(3), other)]) == []
    assert rivals_of(np.array([5.0, -4.0, 1.0]), best, [(np.zeros(3), other)]) == [other]
    assert rivals_of(np.array([5.0, -4.0, 1.0]), best, [(np.zeros(3), best)]) == []
