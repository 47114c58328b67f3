"""Learning from a voyage on which not everything that floats has a transponder."""

from __future__ import annotations

from dataclasses import replace

from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import match
from modsim3d.learn.learn_detector import LearnOptions, learn_detector
from modsim3d.learn.learned import Settings
from modsim3d.learn.observed.observed import Observed
from modsim3d.learn.states.states import each_its_own, parse_states
from modsim3d.learn.told.report import Report
from modsim3d.voyage.unseen.judged import Judged, judge
from modsim3d.voyage.unseen.lifetimes import LEAST_S
from modsim3d.voyage.unseen.stretches import Stretch
from modsim3d.voyage.unseen.told import sentences


def learn_beside_unseen(
    labelled: LabelledSet,
    settings: Settings,
    options: LearnOptions,
    stretches: tuple[Stretch, ...] = (),
    least_s: float = LEAST_S,
) -> tuple[Report, Judged]:
    """Learn a detector; detections that behave like a vessel which is not annotated are neither hits nor false.

    Args:
        labelled: The annotations are vessels with a transponder.
        settings: How it is learned.
        options: What is wanted besides.
        stretches: Stretches in which nothing floats but what is annotated, on the clock of the images.
        least_s: Least mean lifetime of what lasts as vessels do.

    Returns:
        The report, whose rates of false positives are those that `Judged` says and whose remarks say which these are,
        and the judgement.

    Raises:
        ModsimError: As `learn_detector`; also if no frame lies in a stretch that is marked as empty.
    """
    conditions = labelled.conditions
    states = parse_states(options.states, conditions) if options.states else each_its_own(conditions)
    image_state = states.of_images(labelled.images, conditions)
    matched = match(labelled, settings.rule, settings.threshold)
    observed = Observed(labelled, matched, states.names, image_state, settings.threshold, settings.without)
    judged = judge(observed, stretches, least_s)
    report = learn_detector(judged.labelled, settings, options)
    learned = report.learned
    rates = judged.rates(learned.resampling, learned.observed.image_state, learned.observed.states)
    remarks = (*report.remarks_on_data, *sentences(judged, rates))
    return replace(report, learned=judged.corrected(learned), remarks_on_data=remarks), judged
