"""Does a run obey its detector file?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from modsim3d.detector.model import DetectorModel
from modsim3d.learn.box_error_checks import box_error_checks
from modsim3d.learn.class_checks import class_checks
from modsim3d.learn.clutter_checks import clutter_checks
from modsim3d.learn.confidence_checks import confidence_checks
from modsim3d.learn.error_fit import MomentTable
from modsim3d.learn.evidence import Evidence
from modsim3d.learn.parameters import Parameter, Verification, judge
from modsim3d.learn.state_checks import state_checks

Checks = Callable[[DetectorModel, Evidence], list[Parameter]]


def verify(model: DetectorModel, evidence: Evidence, table: MomentTable | None = None) -> Verification:
    """Hold what a run shows against a detector's parameters.

    Args:
        model: What was asked for.
        evidence: What the run shows.
        table: Kept between calls over the same truth, it saves most of the work.
    """
    box_errors = partial(box_error_checks, table=table or MomentTable())
    # In the order in which the detector works.
    every: Sequence[Checks] = (state_checks, class_checks, box_errors, clutter_checks, confidence_checks)
    return judge([parameter for checks in every for parameter in checks(model, evidence)])
