"""Every model of a detector is learned, or said not to be."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from modsim3d.detector.clutter import CLUTTER_MODELS
from modsim3d.detector.file.schema_models import DropoutSection
from modsim3d.formats.labelled import LabelledSet
from modsim3d.learn.learn_detector import LearnOptions, learn_detector
from modsim3d.learn.learned import Settings
from modsim3d.learn.parts import BOX_ERROR, CLASS, CONFIDENCE, FALSE_POSITIVES, LEARNERS, STATE
from modsim3d.learn.report import tables
from tests.formats.labelled_sets import found, images, truth


def test_every_model_that_a_detector_file_may_name_is_registered():
    assert LEARNERS[FALSE_POSITIVES].keys() == CLUTTER_MODELS.keys()
    assert LEARNERS[CLASS].keys() == set(get_args(DropoutSection.model_fields["model"].annotation))
    assert list(LEARNERS) == [STATE, CLASS, BOX_ERROR, FALSE_POSITIVES, CONFIDENCE]


@pytest.mark.parametrize("part", LEARNERS)
def test_the_report_says_which_models_are_learned(part):
    image = np.arange(30)
    boxes = np.tile([100.0, 100, 160, 160], (30, 1))
    labelled = LabelledSet(("boat",), ("day",), images(30), truth(image, 0 * image, boxes),
                           found(image, 0 * image, boxes, np.full(30, 0.9)))  # fmt: skip
    report = learn_detector(labelled, Settings(replicates=20), LearnOptions())
    (table,) = (each for each in tables(report) if each.title == "Models that are learned")
    rows = {(row[0], row[1]): row[2] for row in table.rows}
    for name, learner in LEARNERS[part].items():
        assert rows[part, name] == ("not learned" if learner is None else "learned")
