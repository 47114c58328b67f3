"""Every model of a detector is learned, or said not to be."""

from __future__ import annotations

from typing import Any, cast, get_args

import numpy as np
import pytest

from modsim3d.detector.chain import MODELS, DetectorPart
from modsim3d.detector.false_positives import FALSE_POSITIVE_MODELS, PerImage
from modsim3d.detector.file.schema_models import DropoutSection
from modsim3d.learn.learn_detector import LearnOptions, learn_detector
from modsim3d.learn.learned import LEARNERS, LearnSettings
from modsim3d.learn.report_page import tables
from tests.detector.test_parts import WITHOUT_LEARNER
from tests.formats.labelled_sets import found, images, truth
from tests.learn.one_state import of_boats


def estimates() -> dict[tuple[str, str], str]:
    """What the report says of each part and model."""
    image = np.arange(30)
    boxes = np.tile([100.0, 100, 160, 160], (30, 1))
    labelled = of_boats(images(30), truth(image, 0 * image, boxes), found(image, 0 * image, boxes, np.full(30, 0.9)))
    report = learn_detector(labelled, LearnSettings(replicates=20), LearnOptions())
    (table,) = (each for each in tables(report) if each.title == "Models that can be learned")
    return {(row[0], row[1]): row[2] for row in table.rows}


def test_every_model_that_is_learned_is_one_that_a_detector_has() -> None:
    assert set(LEARNERS) == set(DetectorPart)
    assert all(set(learners) <= set(MODELS[part]) for part, learners in LEARNERS.items())
    assert set(get_args(DropoutSection.model_fields["model"].annotation)) == set(MODELS[DetectorPart.CLASS])


def test_the_report_says_of_every_registered_model_whether_it_is_learned() -> None:
    expected = {
        (part, name): "not learned" if (part, name) in WITHOUT_LEARNER else "learned"
        for part, models in MODELS.items()
        for name in models
    }
    assert estimates() == expected


def test_a_model_that_nothing_learns_is_listed_as_not_learned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(cast(dict[str, Any], FALSE_POSITIVE_MODELS), "fourth", PerImage())
    assert estimates()[DetectorPart.FALSE_POSITIVES, "fourth"] == "not learned"
